"""Problems that several test modules of this folder use."""

import numpy as np

from nfbench import Problem


class Formula(Problem):
    """A problem given by a formula for a batch and by its bounds; it records the evaluated points."""

    def __init__(self, formula, lower, upper):
        self.formula = formula
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        self.batches = []

    def evaluate(self, X):
        self.batches.append(X.copy())
        return self.formula(X)

    @property
    def points(self):
        return np.vstack(self.batches)


def bowl(n=2, at=0.3):
    """Mean of (x_j - at)² over [-1, 2]ⁿ."""
    return Formula(lambda X: ((X - at) ** 2).mean(axis=1), -np.ones(n), 2 * np.ones(n))


def ramp(n=2):
    """A plane that falls towards the upper corner of [-1, 2]ⁿ."""
    return Formula(lambda X: -X.sum(axis=1), -np.ones(n), 2 * np.ones(n))


def two_valleys(n=2, width=0.1):
    """A wide valley of depth 1 at -0.5 and a valley of depth 2 and the given width at 0.7, over [-1, 1]ⁿ."""

    def formula(X):
        wide = np.exp(-((X + 0.5) ** 2).sum(axis=1) / 0.5)
        narrow = 2 * np.exp(-((X - 0.7) ** 2).sum(axis=1) / (2 * width**2))
        return -wide - narrow

    return Formula(formula, -np.ones(n), np.ones(n))
