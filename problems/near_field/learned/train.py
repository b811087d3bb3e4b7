"""Trains the networks of the formulation ``learned``: python -m nfbench.problems.near_field.learned.train --array upa

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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import MissingExtra

from .features import PolarGrid, to_polar
from .network import COMMAND
from .scenes import SETTINGS, SNR_DB, Setting, draw_scenes

try:
    import torch
except ModuleNotFoundError:
    torch = None  # ``main`` says so

__all__ = ["RECIPES", "Recipe", "main", "train"]

SEED, HELD_OUT_SEED = 2026, 1
HELD_OUT = 300
RATE = 3e-3
DETECTION = 0.3  # weight of the loss of the score
NEAR = 4  # steps from a source within which every second window of the background lies
CHECKPOINT = 4  # epochs after which the weights are written


@final
@dataclass(frozen=True)
class Recipe:
    """The network for one setting, and how it is trained.

    grid: grid of the spectrum that the network sees.
    widths: widths of the convolutions in steps of the grid, along u, and along w too.
    hidden: number of channels between two convolutions.
    scenes: number of training scenes. epochs: passes over them. batch: scenes in a step.
    windows: whether the network is evaluated in windows around the sources and elsewhere, which saves most of the time
        on a grid of two dimensions, rather than everywhere.
    """

    setting: Setting
    grid: PolarGrid
    widths: tuple[int, ...]
    hidden: int
    scenes: int
    epochs: int
    batch: int
    windows: bool

    @property
    def axes(self) -> int:
        """The number of coordinates of a direction."""
        return len(self.grid.halves)

    @property
    def reach(self) -> int:
        """The steps of the grid to each side that the network sees."""
        return sum(width // 2 for width in self.widths)


RECIPES = {
    "ula": Recipe(
        SETTINGS["ula"],
        PolarGrid(step_u=1 / 64, half_u=58, step_v=0.001, count_v=17),  # half a beamwidth; λ/r up to 0.016 (0.0157)
        widths=(5, 5, 3, 1, 1),
        hidden=48,
        scenes=5000,
        epochs=24,
        batch=32,
        windows=False,
    ),
    "upa": Recipe(
        SETTINGS["upa"],
        PolarGrid(step_u=1 / 16, half_u=15, step_v=0.011, count_v=5, half_w=9),  # the same; λ/r up to 0.044 (0.0442)
        widths=(5, 3, 3, 3, 1, 1),
        hidden=40,
        scenes=8000,
        epochs=40,
        batch=64,
        windows=True,
    ),
}


def spectra(recipe: Recipe, seed: int, count: int) -> tuple[Float[ndarray, "s *n j"], Float[ndarray, "s k d"]]:
    """Return the spectra of training scenes, and their sources in steps of the grid."""
    grid, manifold = recipe.grid, recipe.setting.scenario.manifold()
    subspaces, sources = draw_scenes(recipe.setting, seed, count)
    e = np.array([grid.spectrum(U_s, manifold) for U_s in subspaces])
    return e, to_polar(sources, manifold) / [*[grid.step_u] * recipe.axes, grid.step_v]


def build(recipe: Recipe) -> Any:
    """Return the network with random weights; the last biases start at few sources, in the middle of the grid."""
    grid, widths = recipe.grid, recipe.widths
    convolution = (torch.nn.Conv1d, torch.nn.Conv2d)[recipe.axes - 1]
    channels = [grid.channels_count, *[recipe.hidden] * (len(widths) - 1), recipe.axes + 2]
    parts: list[Any] = []
    for width, inputs, outputs in zip(widths, channels[:-1], channels[1:], strict=True):
        parts += [convolution(inputs, outputs, width, padding=width // 2), torch.nn.SiLU()]
    network = torch.nn.Sequential(*parts[:-1])
    with torch.no_grad():
        network[-1].bias.copy_(torch.tensor([-3.0, *[0.0] * recipe.axes, grid.count_v / 2]))
    return network


def losses(out: Any, points: Any, sources: Any) -> tuple[Any, ...]:
    """Return the losses of the score, of the direction u (and w), and of v.

    The score is the log-odds that there is a source within half a step (cross entropy per source). Within a step, the
    coordinates are those of the nearest source (mean absolute errors, in steps of the grid). A distance is the larger
    of those in u and w.

    out: outputs of the network (scenes, 2 + axes, points). points: their directions (scenes or 1, points, axes).
    sources: (scenes, sources, axes + 1). All in steps of the grid.
    """
    offsets = sources[:, :, None, :-1] - points[:, None]
    nearest = offsets.abs().amax(-1).argmin(1, keepdim=True)
    offset = offsets.gather(1, nearest[..., None].expand(-1, -1, -1, points.shape[-1]))[:, 0]
    distance = offset.abs().amax(-1)
    wanted = [*offset.unbind(-1), sources[:, :, -1].gather(1, nearest[:, 0])]
    is_there, counts = (distance <= 0.5).float(), (distance <= 1.0).float()
    score = torch.nn.functional.binary_cross_entropy_with_logits(out[:, 0], is_there, reduction="sum")
    errors = [(counts * (out[:, i] - x).abs()).sum() / counts.sum() for i, x in enumerate(wanted, start=1)]
    return score / sources.shape[:2].numel(), *errors


def everywhere(recipe: Recipe, network: Any, x: Any, sources: Any) -> tuple[Any, Any, Any]:
    """Return the arguments of ``losses`` at all directions of the grid."""
    points = torch.from_numpy((recipe.grid.directions / recipe.grid.step_u).astype(np.float32))
    return network(x).flatten(2), points.reshape(1, -1, recipe.axes), sources


def in_windows(recipe: Recipe, network: Any, x: Any, sources: Any) -> tuple[Any, Any, Any]:
    """Return the same at the points around each source within a step, and around one other point of each scene.

    Half of the latter lie near a source. The outputs are those of ``everywhere``: without padding, and with zeros
    outside the grid after every convolution.
    """
    scenes, K = sources.shape[:2]
    halves, reach = torch.tensor(recipe.grid.halves), recipe.reach + 1
    at_sources = sources[:, :, :-1].round().long()
    anywhere = (torch.rand(scenes, 1, recipe.axes) * (2 * halves - 1)).long() - (halves - 1)
    close = at_sources[:, :1] + torch.randint(-NEAR, NEAR + 1, (scenes, 1, recipe.axes))
    others = torch.where(torch.rand(scenes, 1, 1) < 0.5, anywhere, close)
    centers = torch.cat([at_sources, others], dim=1).clamp(1 - halves, halves - 1).flatten(0, 1)
    index = torch.arange(scenes).repeat_interleave(K + 1)
    first = (centers + halves).unbind(-1)  # corner of the window in the padded grid
    inside = torch.ones(1, 1, *x.shape[2:])
    windows, inside = (
        _unfold(torch.nn.functional.pad(each, [reach] * 2 * recipe.axes), 2 * reach + 1) for each in (x, inside)
    )
    out = _without_padding(network, windows[(index, slice(None), *first)], inside[(index * 0, slice(None), *first)])
    around = torch.cartesian_prod(*[torch.arange(-1, 2)] * recipe.axes).reshape(-1, recipe.axes)
    return out.flatten(2), (centers[:, None] + around).float(), sources[index]


def _unfold(x: Any, size: int) -> Any:
    """Return a view of all windows along the axes from the third on, which come last."""
    for axis in range(2, x.dim()):
        x = x.unfold(axis, size, 1)
    return x


def _without_padding(network: Any, x: Any, inside: Any) -> Any:
    """Return the outputs in the middle of the windows x; ``inside`` is 1 in the grid and 0 outside."""
    convolve = (torch.nn.functional.conv1d, torch.nn.functional.conv2d)[x.dim() - 3]
    for part in network:
        if isinstance(part, torch.nn.SiLU):
            x = part(x) * inside
            continue
        x = convolve(x, part.weight, part.bias)
        margin = part.kernel_size[0] // 2
        for axis in range(2, x.dim()):
            inside = inside.narrow(axis, margin, inside.shape[axis] - 2 * margin)
    return x


def as_tensors(recipe: Recipe, e: ndarray, sources: ndarray) -> tuple[Any, Any]:
    """Return inputs (scenes, channels, *directions) and sources in steps of the grid."""
    x = torch.from_numpy(recipe.grid.channels(e)).movedim(-1, 1).contiguous()
    return x, torch.from_numpy(sources.astype(np.float32))


def mirror(recipe: Recipe, x: Any, sources: Any, axis: int) -> tuple[Any, Any]:
    """Return the scenes with u ← −u (axis 0) or w ← −w (axis 1); the channels of the direction stay."""
    seen = 2 * recipe.grid.count_v
    signs = torch.ones(sources.shape[-1])
    signs[axis] = -1.0
    return torch.cat([x[:, :seen].flip(2 + axis), x[:, seen:]], dim=1), sources * signs


def train(
    recipe: Recipe, scenes: int, epochs: int, checkpoint: Callable[[Any, int], None] | None = None
) -> tuple[Any, dict[str, float]]:
    """Return the trained network, and its losses in scenes that it was not trained on.

    Every scene is mirrored, u ← −u, in half of the epochs, and w ← −w likewise: the array is symmetric. Adam, with a
    rate that rises during the first tenth of the steps and then falls to zero. After every few epochs, ``checkpoint``
    is called with the network and the number of epochs.
    """
    torch.set_num_threads(1)
    torch.manual_seed(SEED)
    network = build(recipe)
    x, sources = as_tensors(recipe, *spectra(recipe, SEED, scenes))
    steps = epochs * (scenes // recipe.batch)
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps, pct_start=0.1)
    evaluate = in_windows if recipe.windows else everywhere
    for epoch in range(1, epochs + 1):
        order = torch.randperm(scenes)
        for first in range(0, scenes - recipe.batch + 1, recipe.batch):
            batch = order[first : first + recipe.batch]
            inputs, wanted = x[batch], sources[batch]
            for axis in range(recipe.axes):
                if torch.rand(()) < 0.5:
                    inputs, wanted = mirror(recipe, inputs, wanted, axis)
            score, *errors = losses(*evaluate(recipe, network, inputs, wanted))
            optimizer.zero_grad()
            sum(errors, DETECTION * score).backward()
            optimizer.step()
            schedule.step()
        found = ", ".join(f"{name} {error.item():.4f}" for name, error in zip(names(recipe), errors, strict=True))
        print(f"epoch {epoch}/{epochs}: score {score.item():.3f}, {found}", flush=True)
        if checkpoint is not None and epoch % CHECKPOINT == 0:
            checkpoint(network, epoch)
    return network, held_out(recipe, network)


def names(recipe: Recipe) -> tuple[str, ...]:
    """The names of the coordinates."""
    return ("u", "v") if recipe.axes == 1 else ("u", "w", "v")


def held_out(recipe: Recipe, network: Any) -> dict[str, float]:
    """Return the losses in scenes that the network was not trained on, at all directions."""
    with torch.no_grad():
        tensors = as_tensors(recipe, *spectra(recipe, HELD_OUT_SEED, HELD_OUT))
        final = losses(*everywhere(recipe, network, *tensors))
    return {name: round(float(loss), 5) for name, loss in zip(("score", *names(recipe)), final, strict=True)}


def save(recipe: Recipe, network: Any, folder: Path, about: dict[str, Any]) -> None:
    """Write the weights with an example of PyTorch's forward pass, and how they were made beside them."""
    convolutions = [part for part in network if not isinstance(part, torch.nn.SiLU)]
    arrays = {}
    for i, part in enumerate(convolutions):  # PyTorch: (outputs, inputs, *width)
        arrays[f"weights_{i}"] = np.moveaxis(part.weight.detach().numpy(), (0, 1), (-1, -2))
        arrays[f"bias_{i}"] = part.bias.detach().numpy()
    e, sources = spectra(recipe, HELD_OUT_SEED, 1)
    with torch.no_grad():
        arrays["example_output"] = network(as_tensors(recipe, e, sources)[0])[0].movedim(0, -1).numpy()
    arrays["example_spectrum"] = e[0]
    weights = folder / f"{recipe.setting.file}.npz"
    np.savez(weights, **arrays)
    about["sha256"] = hashlib.sha256(weights.read_bytes()).hexdigest()
    text = json.dumps(about, indent=2, ensure_ascii=False) + "\n"
    weights.with_suffix(".json").write_text(text, encoding="utf-8")


def describe(recipe: Recipe, network: Any, scenes: int, epochs: int, seconds: dict[str, int]) -> dict[str, Any]:
    """Return how the network was trained, apart from the losses in held-out scenes."""
    setting, mirrored = recipe.setting, ", ".join(f"{x} ← −{x}" for x in names(recipe)[:-1])
    others = ", ".join(names(recipe)[:-1])
    return {
        "command": f"{COMMAND} --array {setting.name} --scenes {scenes} --epochs {epochs}",
        "seed": SEED,
        "scenario": {**setting.keys, "snr_db": f"uniform from {SNR_DB[0]:g} to {SNR_DB[1]:g}, one per scene"},
        "scenes": scenes,
        "ranges": f"uniform in range_m; in every second scene up to {setting.near_m:g} m",
        "augmentation": f"half of the batches are mirrored, {mirrored}",
        "epochs": epochs,
        "batch": recipe.batch,
        "evaluated": "in windows around the sources and one other point" if recipe.windows else "everywhere",
        "optimizer": f"Adam, one-cycle rate up to {RATE:g}",
        "loss": f"{DETECTION:g} · cross entropy of the score + mean absolute errors of {others} and v in steps of the "
        "grid",
        "training_time": {**seconds, "threads": 1},
        "versions": {"python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__},
        "parameters": sum(part.numel() for part in network.parameters()),
        "grid": {name: value for name, value in vars(recipe.grid).items() if value is not None},
        "widths": recipe.widths,
        "hidden": recipe.hidden,
    }


def main() -> None:
    """Train, and write the weights."""
    parser = argparse.ArgumentParser(prog=COMMAND, description="Train a network of the formulation learned.")
    parser.add_argument("--array", choices=RECIPES, default="ula", help="which network (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder (default: that of the package)")
    parser.add_argument("--scenes", type=int, help="number of training scenes (default: as for the package's weights)")
    parser.add_argument("--epochs", type=int, help="passes over the scenes (default: as for the package's weights)")
    options = parser.parse_args()
    if torch is None:
        raise MissingExtra("training needs PyTorch, which is not installed: pip install 'nfbench[learned]'")
    recipe = RECIPES[options.array]
    scenes, epochs = options.scenes or recipe.scenes, options.epochs or recipe.epochs
    started, used = time.perf_counter(), time.process_time()

    def write(network: Any, done: int, measured: dict[str, float] | None = None) -> None:
        seconds = {"cpu_s": round(time.process_time() - used), "wall_s": round(time.perf_counter() - started)}
        about = describe(recipe, network, scenes, epochs, seconds)
        if measured is None:
            about["unfinished"] = f"after {done} of {epochs} epochs"
            measured = {}
        about["held_out"] = {"seed": HELD_OUT_SEED, "scenes": HELD_OUT, **measured}
        save(recipe, network, options.out, about)

    network, measured = train(recipe, scenes, epochs, write)
    write(network, epochs, measured)


if __name__ == "__main__":
    main()
