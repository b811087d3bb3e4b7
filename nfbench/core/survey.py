"""What is worth knowing about an array before anything is measured, in the coordinates of the user."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray

__all__ = ["Survey"]


@dataclass(frozen=True, eq=False)
class Survey:
    """The properties of an array as sentences, and the positions to draw, in the coordinates of the user [m].

    title: what kind of array it is.
    facts: (name, text with units) of each property.
    warnings: sentences about what is probably not as it was meant, each with a remedy.
    elements: positions of the elements, shape (M, 3).
    names: names of the elements; empty if they have none.
    broadside: unit vector in front of the array.
    up: unit vector upwards.
    """

    title: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    elements: Float[ndarray, "m 3"]
    names: tuple[str, ...]
    broadside: Float[ndarray, " 3"]
    up: Float[ndarray, " 3"]
