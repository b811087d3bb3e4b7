"""What an estimate says about the sources of a measurement, in the coordinates of the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float
from numpy import ndarray

__all__ = ["Localization", "Picture"]


@dataclass(frozen=True, eq=False)
class Picture:
    """Positions that a figure of an estimate shows, all in the coordinates of the user [m].

    elements: positions of the elements of the array, shape (M, 3).
    box: lines along the edges of the box in which sources are searched, each of shape (points, 3).
    sources: estimated positions, shape (K, 3).
    covariances: covariances of the estimated positions [m²], shape (K, 3, 3); NaN where they are not known.
    truth: true positions, shape (any, 3); None if they are not known.
    distances: distances from the origin that are worth knowing, such as the Fraunhofer distance: name and length.
    origin: point from which they are measured, shape (3,); None: the origin of the coordinates.
    """

    elements: Float[ndarray, "m 3"]
    box: tuple[Float[ndarray, "_ 3"], ...]
    sources: Float[ndarray, "k 3"]
    covariances: Float[ndarray, "k 3 3"]
    truth: Float[ndarray, "_ 3"] | None = None
    distances: tuple[tuple[str, float], ...] = ()
    origin: Float[ndarray, " 3"] | None = None


@dataclass(frozen=True, eq=False)
class Localization:
    """The sources that an estimate consists of, how well they explain the data, and what may be wrong.

    sources: one table per source, numbers by their names with units, such as ``x_m`` or ``azimuth_deg``; standard
        errors have the prefix ``std_``. NaN where a number is not known.
    fit: numbers that say how well the estimate explains the data, by their names.
    warnings: sentences about what does not fit, each with a remedy.
    picture: positions to draw; None if there is nothing to draw.
    method: what was used: formulation, solver, their options, budget and seed, as plain data; where a study recommends
        it, its label, the swept point that counts, and the folder. Empty if it is not known.
    replaces: beginnings of warnings of the scenario that a tested cause replaces, which then comes first.
    notes: sentences about how the data were read, which are no warnings.
    """

    sources: tuple[Mapping[str, float], ...]
    fit: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    picture: Picture | None = None
    notes: tuple[str, ...] = ()
    method: Mapping[str, Any] = field(default_factory=dict)
    replaces: tuple[str, ...] = ()
