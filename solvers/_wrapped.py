"""What wrapped libraries need so that the meter sees what they do, and they see when it ends."""

from __future__ import annotations

import contextlib
import random
import sys
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import MeteredProblem

__all__ = ["Stop", "from_unit", "global_random", "planned"]

ROUNDING = 1e-9  # in widths of the box; a library that leaves it by more did not keep its bounds

T = TypeVar("T")


def from_unit(problem: MeteredProblem, U: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
    """Points of the unit box as the problem's, for a library that is trusted to round and no more.

    A point further outside is handed on as it is, for the meter to refuse: it shall not be clipped unseen.
    """
    if np.all((U >= -ROUNDING) & (U <= 1.0 + ROUNDING)):
        return problem.from_unit(U)
    return np.asarray(problem.lower + U * (problem.upper - problem.lower))


def planned(problem: MeteredProblem, horizon: int) -> int:
    """The evaluations a library may plan for: what is left of the budget or, where time alone ends it, ``horizon``."""
    return problem.remaining if problem.remaining < sys.maxsize // 2 else horizon


@contextlib.contextmanager
def global_random(seed: int) -> Iterator[None]:
    """For a library that draws from the global generators: seeded within this context, and left as they were found."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


@final
class Stop:
    """Carries what an evaluation raises past a library that swallows it or makes another exception of it.

    Wrap the objective in ``guard`` and the library's call in ``run``. After the first exception the objective raises
    it again at once, so that no evaluation is asked for after the end.
    """

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def guard(self, objective: Callable[..., T]) -> Callable[..., T]:
        def guarded(*arguments: Any) -> T:
            if self.error is not None:
                raise self.error
            try:
                return objective(*arguments)
            except BaseException as error:
                self.error = error
                raise

        return guarded

    def run(self, library: Callable[[], object]) -> None:
        """Call the library; raise what the objective raised, whatever the library made of it."""
        try:
            library()
        except BaseException:
            if self.error is None:
                raise
        if self.error is not None:
            raise self.error
