"""Keeps the last scene that was drawn: the methods of a study run on it one after another."""

from __future__ import annotations

import copy
from collections.abc import Callable, Hashable, Sequence

import numpy as np

from .instance import NearFieldInstance

__all__ = ["drawn_once"]

LARGEST = 100 * 2**20  # bytes of a scene that is kept
_last: tuple[Hashable, NearFieldInstance] | None = None  # of this process


def drawn_once(
    scenario: Hashable,
    streams: Sequence[np.random.Generator],
    draw: Callable[[Sequence[np.random.Generator]], NearFieldInstance],
) -> NearFieldInstance:
    """Return ``draw(streams)``, or a copy of it if the last call had an equal scenario and equal streams.

    scenario: scenario of the scene. streams: new generators. draw: function that depends on these two alone.

    A copy has arrays of its own, so that a method that writes to the data of a scene does not change them for the next
    one, nor their bounds, which are those of the scene as it was drawn. A scene of more than 100 MiB is not kept.
    """
    global _last
    key = (scenario, *map(_identity, streams))
    last = _last
    if last is None or last[0] != key:
        _last = None  # a large scene does not need room for two
        instance = draw(streams)
        if _bytes(instance) > LARGEST:
            return instance
        last = _last = (key, instance)
    scene = copy.deepcopy(last[1])
    object.__setattr__(scene, "original", last[1])
    return scene


def _bytes(instance: NearFieldInstance) -> int:
    arrays = [value for band in instance.bands for value in vars(band).values() if isinstance(value, np.ndarray)]
    return sum(array.nbytes for array in arrays)


def _identity(stream: np.random.Generator) -> Hashable:
    """What determines the numbers of a new generator."""
    seeds = stream.bit_generator.seed_seq
    entropy = seeds.entropy  # type: ignore[attr-defined]  # of a SeedSequence
    numbers = entropy if isinstance(entropy, int) else tuple(np.atleast_1d(entropy).tolist())
    return type(stream.bit_generator), numbers, tuple(seeds.spawn_key)  # type: ignore[attr-defined]
