"""Trains the network of the formulation ``learned``: python -m nfbench.problems.near_field.learned.train

It draws the scenes, trains with PyTorch on one thread (``pip install 'nfbench[learned]'``), and writes the weights, and
beside them how they were made. Running it again with the same versions gives the same weights, up to rounding errors of
the machine.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import MissingExtra

from .features import PolarGrid, to_polar
from .network import COMMAND, WEIGHTS
from .scenes import NEAR_M, SETTING, SNR_DB, draw_scenes, training_scenario

try:
    import torch
except ModuleNotFoundError:
    torch = None  # ``main`` says so

__all__ = ["main", "train"]

GRID = PolarGrid(step_u=1 / 64, half_u=58, step_v=0.001, count_v=17)  # half a beamwidth; λ/r up to 0.016 (0.0157)
WIDTHS = (5, 5, 3, 1, 1)  # of the convolutions, in steps of u
HIDDEN = 48
SEED, HELD_OUT_SEED = 2026, 1
SCENES, HELD_OUT, EPOCHS = 5000, 300, 24
BATCH, RATE = 32, 3e-3
DETECTION = 0.3  # weight of the loss of the score


def spectra(seed: int, count: int) -> tuple[Float[ndarray, "s n j"], Float[ndarray, "s k 2"]]:
    """Return the spectra of training scenes, and their sources in steps of the grid."""
    manifold = training_scenario().manifold()
    subspaces, sources = draw_scenes(seed, count)
    e = np.array([GRID.spectrum(U_s, manifold) for U_s in subspaces])
    return e, to_polar(sources, manifold) / [GRID.step_u, GRID.step_v]


def build() -> Any:
    """Return the network with random weights; the last biases start at few sources, in the middle of the grid."""
    channels = [2 * GRID.count_v, *[HIDDEN] * (len(WIDTHS) - 1), 3]
    parts: list[Any] = []
    for width, inputs, outputs in zip(WIDTHS, channels[:-1], channels[1:], strict=True):
        parts += [torch.nn.Conv1d(inputs, outputs, width, padding=width // 2), torch.nn.SiLU()]
    network = torch.nn.Sequential(*parts[:-1])
    with torch.no_grad():
        network[-1].bias.copy_(torch.tensor([-3.0, 0.0, GRID.count_v / 2]))
    return network


def losses(network: Any, x: Any, sources: Any) -> tuple[Any, Any, Any]:
    """Return the losses of the score, of u and of v.

    The score is the log-odds that there is a source within half a step (cross entropy per source). Within a step, u and
    v are those of the nearest source (mean absolute errors, in steps of the grid).
    """
    out = network(x)
    distance = sources[:, :, None, 0] - torch.arange(-GRID.half_u, GRID.half_u + 1, dtype=torch.float32)
    nearest = distance.abs().argmin(1, keepdim=True)
    u = distance.gather(1, nearest)[:, 0]
    v = sources[:, :, 1].gather(1, nearest[:, 0])
    is_there, counts = (u.abs() <= 0.5).float(), (u.abs() <= 1.0).float()
    score = torch.nn.functional.binary_cross_entropy_with_logits(out[:, 0], is_there, reduction="sum")
    errors = [(counts * (out[:, i] - wanted).abs()).sum() / counts.sum() for i, wanted in ((1, u), (2, v))]
    return score / sources.shape[:2].numel(), errors[0], errors[1]


def as_tensors(e: ndarray, sources: ndarray) -> tuple[Any, Any]:
    """Return inputs (scenes, channels, u) and sources in steps of the grid."""
    x = torch.from_numpy(GRID.channels(e)).transpose(1, 2).contiguous()
    return x, torch.from_numpy(sources.astype(np.float32))


def train(scenes: int, epochs: int) -> tuple[Any, dict[str, float]]:
    """Return the trained network, and its losses in scenes that it was not trained on.

    Every scene is mirrored, u ← −u, in half of the epochs: the array is symmetric. Adam, with a rate that rises during
    the first tenth of the steps and then falls to zero.
    """
    torch.set_num_threads(1)
    torch.manual_seed(SEED)
    network = build()
    x, sources = as_tensors(*spectra(SEED, scenes))
    steps = epochs * (scenes // BATCH)
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps, pct_start=0.1)
    for epoch in range(epochs):
        order = torch.randperm(scenes)
        for first in range(0, scenes - BATCH + 1, BATCH):
            batch = order[first : first + BATCH]
            inputs, wanted = x[batch], sources[batch]
            if torch.rand(()) < 0.5:
                inputs, wanted = inputs.flip(2), wanted * torch.tensor([-1.0, 1.0])
            score, u, v = losses(network, inputs, wanted)
            optimizer.zero_grad()
            (DETECTION * score + u + v).backward()
            optimizer.step()
            schedule.step()
        print(f"epoch {epoch + 1}/{epochs}: score {score.item():.3f}, u {u.item():.4f}, v {v.item():.4f}", flush=True)
    with torch.no_grad():
        final = losses(network, *as_tensors(*spectra(HELD_OUT_SEED, HELD_OUT)))
    return network, {name: round(float(loss), 5) for name, loss in zip(("score", "u", "v"), final, strict=True)}


def save(network: Any, folder: Path, recipe: dict[str, Any]) -> None:
    """Write the weights with an example of PyTorch's forward pass, and the recipe beside them."""
    convolutions = [part for part in network if isinstance(part, torch.nn.Conv1d)]
    arrays = {}
    for i, part in enumerate(convolutions):  # PyTorch: (outputs, inputs, width)
        arrays[f"weights_{i}"] = part.weight.detach().numpy().transpose(2, 1, 0)
        arrays[f"bias_{i}"] = part.bias.detach().numpy()
    e, sources = spectra(HELD_OUT_SEED, 1)
    with torch.no_grad():
        arrays["example_output"] = network(as_tensors(e, sources)[0])[0].T.numpy()
    arrays["example_spectrum"] = e[0]
    np.savez(folder / WEIGHTS, **arrays)
    recipe["sha256"] = hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest()
    text = json.dumps(recipe, indent=2, ensure_ascii=False) + "\n"
    (folder / WEIGHTS.replace(".npz", ".json")).write_text(text, encoding="utf-8")


def main() -> None:
    """Train, and write the weights."""
    parser = argparse.ArgumentParser(prog=COMMAND, description="Train the network of the formulation learned.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder (default: that of the package)")
    parser.add_argument("--scenes", type=int, default=SCENES, help="number of training scenes (default: %(default)s)")
    parser.add_argument("--epochs", type=int, default=EPOCHS, help="passes over the scenes (default: %(default)s)")
    options = parser.parse_args()
    if torch is None:
        raise MissingExtra("training needs PyTorch, which is not installed: pip install 'nfbench[learned]'")
    started, used = time.perf_counter(), time.process_time()
    network, held_out = train(options.scenes, options.epochs)
    seconds = {"cpu_s": round(time.process_time() - used), "wall_s": round(time.perf_counter() - started)}
    recipe = {
        "command": f"{COMMAND} --scenes {options.scenes} --epochs {options.epochs}",
        "seed": SEED,
        "scenario": SETTING | {"snr_db": f"uniform from {SNR_DB[0]:g} to {SNR_DB[1]:g}, one per scene"},
        "scenes": options.scenes,
        "ranges": f"uniform in range_m; in every second scene up to {NEAR_M:g} m",
        "augmentation": "half of the batches are mirrored, u ← −u",
        "epochs": options.epochs,
        "batch": BATCH,
        "optimizer": f"Adam, one-cycle rate up to {RATE:g}",
        "loss": f"{DETECTION:g} · cross entropy of the score + mean absolute errors of u and v in steps of the grid",
        "held_out": {"seed": HELD_OUT_SEED, "scenes": HELD_OUT, **held_out},
        "training_time": {**seconds, "threads": 1},
        "versions": {"python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__},
        "parameters": sum(part.numel() for part in network.parameters()),
        "grid": vars(GRID),
        "widths": WIDTHS,
        "hidden": HIDDEN,
    }
    save(network, options.out, recipe)


if __name__ == "__main__":
    main()
