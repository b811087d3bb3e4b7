"""The network without PyTorch: its weights, and its forward pass in NumPy."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .features import PolarGrid

__all__ = ["COMMAND", "WEIGHTS", "Network", "load_network"]

WEIGHTS = "ula_128_quarter.npz"
"""The weights for the paper's ULA of 128 elements at λ/4, beside this module; a .json beside them has their recipe."""

COMMAND = "python -m nfbench.problems.near_field.learned.train"
"""The command that trains the network and writes both files; it needs ``nfbench[learned]``."""


@final
@dataclass(frozen=True, eq=False)
class Network:
    """Convolutions over u with SiLU between them; at each u they end in a score and the coordinates of a source.

    grid: grid of the spectrum that the network sees.
    layers: weights (width, inputs, outputs), the width odd, and biases (outputs,) of each convolution.
    recipe: how the network was trained, as in the .json beside the weights.
    """

    grid: PolarGrid
    layers: tuple[tuple[Float[ndarray, "width c d"], Float[ndarray, " d"]], ...]
    recipe: dict[str, Any]

    def __call__(self, x: Float[ndarray, "n c"]) -> Float[ndarray, "n 3"]:
        """Return the raw output at each u: the log-odds of a source there, and its u and v.

        Both are in steps of the grid, u from that of the grid and v from 0.
        """
        *hidden, last = self.layers
        for weights, bias in hidden:
            x = _silu(_convolve(x, weights, bias))
        return _convolve(x, *last)

    def propose(self, spectrum: Float[ndarray, "n j"]) -> tuple[Float[ndarray, " n"], Float[ndarray, "n 2"]]:
        """Return a score for a source near each u of the grid, and its coordinates (u, v)."""
        out = self(self.grid.channels(spectrum)).astype(np.float64)
        u = self.grid.u + self.grid.step_u * np.clip(out[:, 1], -1.0, 1.0)
        return out[:, 0], np.stack([u, self.grid.step_v * out[:, 2]], axis=1)


@cache
def load_network(folder: Traversable | None = None) -> Network:
    """Return the network whose weights are part of the package, or in another folder.

    Raises FileNotFoundError if they are not there.
    """
    place = files(__package__) if folder is None else folder
    weights, about = place / WEIGHTS, place / WEIGHTS.replace(".npz", ".json")
    if not weights.is_file() or not about.is_file():
        raise FileNotFoundError(f"{WEIGHTS}: expected the weights in {place}; reinstall nfbench, or run: {COMMAND}")
    recipe = json.loads(about.read_text(encoding="utf-8"))
    with weights.open("rb") as file, np.load(file) as stored:
        layers = tuple((stored[f"weights_{i}"], stored[f"bias_{i}"]) for i in range(len(recipe["widths"])))
    return Network(PolarGrid(**recipe["grid"]), layers, recipe)


def _convolve(
    x: Float[ndarray, "n c"], weights: Float[ndarray, "width c d"], bias: Float[ndarray, " d"]
) -> Float[ndarray, "n d"]:
    """y_n = b + Σ_i W_iᵀ·x_{n+i−h}, with zeros beyond the ends, h = (width − 1)/2."""
    width = len(weights)
    padded = np.pad(x, [(width // 2, width // 2), (0, 0)])
    return bias + sum(padded[i : i + len(x)] @ weights[i] for i in range(width))


def _silu(x: Float[ndarray, "n c"]) -> Float[ndarray, "n c"]:
    """x/(1 + exp(−x)), written so that nothing overflows."""
    return np.float32(0.5) * x * (1 + np.tanh(np.float32(0.5) * x))
