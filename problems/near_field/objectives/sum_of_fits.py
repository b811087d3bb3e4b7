"""The sum of the misfits of several frequency bins: incoherent fitting of wideband data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias, TypeVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Problem

from ..wavefronts import Manifold
from .conditional_fit import ConditionalFit
from .rls import RLS
from .subspace_fitting import SubspaceFit

__all__ = ["Fit", "SumOfFits", "together"]

Fit: TypeAlias = RLS | SubspaceFit | ConditionalFit
"""A misfit of the data of one frequency bin."""

_OneFit = TypeVar("_OneFit", RLS, SubspaceFit, ConditionalFit)


@final
class SumOfFits(Problem):
    """J(x) = Σ_f J_f(x) over frequency bins f, each with its own factor of the data and its own wavelength.

    The data of the bins are added without regard to their phases (incoherent wideband processing, Wax, Shan & Kailath
    1984, doi:10.1109/TASSP.1984.1164400), so neither the symbols nor the phases of the bins need to be related. If the
    J_f are those of maximum likelihood, each divided by the power of its noise, J is that of all bins. The unknowns,
    their units, and the box are those of each part; the gradient is the sum of theirs.

    parts: the misfits of the bins, at least one. Raises ValueError where there is none or their boxes differ.
    """

    has_gradient = True

    def __init__(self, parts: Iterable[Fit]) -> None:
        self.parts: tuple[Fit, ...] = tuple(parts)
        if not self.parts:
            raise ValueError("parts: expected at least one misfit, got none")
        first = self.parts[0]
        for part in self.parts:
            if not (np.array_equal(part.lower, first.lower) and np.array_equal(part.upper, first.upper)):
                raise ValueError(f"parts: expected the same box, got {part.lower}, {part.upper} and others")
        self.lower, self.upper = first.lower, first.upper

    @property
    def manifold(self) -> Manifold:
        """The array and wavefront model of the first bin."""
        return self.parts[0].manifold

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        J = self.parts[0].evaluate(X)
        for part in self.parts[1:]:
            J += part.evaluate(X)
        return J

    def value(self, x: Float[ndarray, " n"]) -> float:
        return sum(part.value(x) for part in self.parts)

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        J, gradient = self.parts[0].value_and_gradient(x)
        for part in self.parts[1:]:
            value, slope = part.value_and_gradient(x)
            J, gradient = J + value, gradient + slope
        return J, gradient


def together(parts: Sequence[_OneFit]) -> _OneFit | SumOfFits:
    """Return the problem of all bins: their sum, or the misfit of a single bin itself."""
    return parts[0] if len(parts) == 1 else SumOfFits(parts)
