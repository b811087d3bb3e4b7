"""A bowl whose optimum its formulation proves, in several right and wrong ways. Calls are counted in $PROOF_LOG."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from nfbench import Formulation, Instance, Problem, Reference, Scenario


class Bowl(Problem):
    """‖x − centre‖² + level over [-1, 1]²."""

    def __init__(self, centre, level):
        self.centre, self.level = centre, level
        self.lower, self.upper = -np.ones(2), np.ones(2)

    def evaluate(self, X):
        return ((X - self.centre) ** 2).sum(axis=1) + self.level


class BowlInstance(Instance):
    def __init__(self, centre, level):
        self.problem = Bowl(centre, level)

    def score(self, estimate):
        return {"rmse_m": float(np.linalg.norm(estimate - self.problem.centre))}


@dataclass(frozen=True)
class Bowls(Scenario):
    """A bowl.

    lift: added to the level of the bowl.
    """

    instance: ClassVar[type[Instance]] = BowlInstance
    lift: float = 0.0

    def draw(self, rng):
        return BowlInstance(rng.uniform(-0.9, 0.9, 2), rng.uniform(1.0, 2.0) + self.lift)


@dataclass(frozen=True)
class Silent(Formulation):
    """Minimizes the bowl, and proves nothing."""

    accepts: ClassVar[type[Instance]] = BowlInstance

    def solve(self, instance, minimize):
        return minimize(instance.problem).x


@dataclass(frozen=True)
class Proving(Formulation):
    """Minimizes the bowl.

    how: how the optimum is proven.
    """

    accepts: ClassVar[type[Instance]] = BowlInstance
    how: str = "right"

    def solve(self, instance, minimize):
        return minimize(instance.problem).x

    def reference(self, instance):
        if log := os.environ.get("PROOF_LOG"):
            with Path(log).open("a", encoding="utf-8") as file:
                file.write(f"{self.how}\n")
        level, point = instance.problem.level, instance.problem.centre
        match self.how:
            case "right":
                return Reference(level, 0.0, True, point, columns={"cuts": 3})
            case "wrong":  # far above what any search finds
                return Reference(level + 0.5, 0.01, True)
            case "open":  # a good value, but no proof
                return Reference(level, np.inf, False, point, step=2)
            case "raises":
                raise RuntimeError("no proof today")
            case "crashes":
                os._exit(3)
            case "hangs":
                time.sleep(3600)
            case "negative":
                return Reference(level, -1.0, True)
            case "text":
                return "proven"
        return None
