"""The networks without PyTorch: their weights, and their forward pass in NumPy."""

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
from .scenes import Setting

__all__ = ["COMMAND", "Network", "load_network"]

COMMAND = "python -m nfbench.problems.near_field.learned.train"
"""The command that trains a network and writes both of its files; it needs ``nfbench[learned]``."""


@final
@dataclass(frozen=True, eq=False)
class Network:
    """Convolutions over u, or over u and w, with SiLU between them.

    At each direction they end in a score and the coordinates of a source.

    grid: grid of the spectrum that the network sees.
    layers: weights (width, inputs, outputs) or (width, width, inputs, outputs), the widths odd, and biases (outputs,)
        of each convolution.
    recipe: how the network was trained, as in the .json beside the weights.
    """

    grid: PolarGrid
    layers: tuple[tuple[Float[ndarray, "*width c d"], Float[ndarray, " d"]], ...]
    recipe: dict[str, Any]

    def __call__(self, x: Float[ndarray, "*n c"]) -> Float[ndarray, "*n o"]:
        """Return the raw output at each direction of the grid: the log-odds of a source there, and its coordinates.

        They are in steps of the grid, u and w from those of the grid and v from 0.
        """
        *hidden, last = self.layers
        for weights, bias in hidden:
            x = _silu(_convolve(x, weights, bias))
        return _convolve(x, *last)

    def propose(self, spectrum: Float[ndarray, "*n j"]) -> tuple[Float[ndarray, " n"], Float[ndarray, "n d"]]:
        """Return a score for a source near each direction of the grid, and its coordinates, (u, v) or (u, w, v)."""
        out = self(self.grid.channels(spectrum)).astype(np.float64)
        direction = self.grid.directions + self.grid.step_u * np.clip(out[..., 1:-1], -1.0, 1.0)
        x = np.concatenate([direction, self.grid.step_v * out[..., -1:]], axis=-1)
        return out[..., 0].ravel(), x.reshape(-1, x.shape[-1])


@cache
def load_network(setting: Setting, folder: Traversable | None = None) -> Network:
    """Return the network of a setting, whose weights are part of the package, or in another folder.

    Raises FileNotFoundError if they are not there.
    """
    place = files(__package__) if folder is None else folder
    weights, about = place / f"{setting.file}.npz", place / f"{setting.file}.json"
    if not weights.is_file() or not about.is_file():
        command = f"{COMMAND} --array {setting.name}"
        raise FileNotFoundError(
            f"{setting.file}.npz: expected the weights in {place}; reinstall nfbench, or run: {command}"
        )
    recipe = json.loads(about.read_text(encoding="utf-8"))
    with weights.open("rb") as file, np.load(file) as stored:
        layers = tuple((stored[f"weights_{i}"], stored[f"bias_{i}"]) for i in range(len(recipe["widths"])))
    return Network(PolarGrid(**recipe["grid"]), layers, recipe)


def _convolve(
    x: Float[ndarray, "*n c"], weights: Float[ndarray, "*width c d"], bias: Float[ndarray, " d"]
) -> Float[ndarray, "*n d"]:
    """y_n = b + Σ_i W_iᵀ·x_{n+i−h}, with zeros beyond the ends, h = (width − 1)/2, and likewise over two indices.

    The points of the padded grid are counted row by row, so that an offset i is one offset of that count.
    """
    *shape, channels = x.shape
    widths = weights.shape[:-2]
    padded = np.pad(x, [*((width // 2, width // 2) for width in widths), (0, 0)])
    rows, strides = padded.reshape(-1, channels), _strides(padded.shape[:-1])
    last = int(np.dot(np.array(shape) - 1, strides))
    offsets = ((index, int(np.dot(index, strides))) for index in np.ndindex(*widths))
    total = bias + sum(rows[offset : offset + last + 1] @ weights[index] for index, offset in offsets)
    if len(shape) == 1:
        return total
    full = np.zeros((shape[0] * int(strides[0]), len(bias)), dtype=total.dtype)  # with the points of the padding
    full[: last + 1] = total
    return full.reshape(shape[0], -1, len(bias))[:, : shape[1]]


def _strides(shape: tuple[int, ...]) -> ndarray:
    """How many points further the next point along each axis is."""
    return np.array([int(np.prod(shape[axis + 1 :])) for axis in range(len(shape))])


def _silu(x: Float[ndarray, "*n c"]) -> Float[ndarray, "*n c"]:
    """x/(1 + exp(−x)), written so that nothing overflows."""
    return np.float32(0.5) * x * (1 + np.tanh(np.float32(0.5) * x))
