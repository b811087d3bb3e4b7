"""A search for false certificates: ``python tests/benchmarks/false_certificates.py [SCENES [STARTS [SEED]]]``.

Draws random scenes (K = 1 to 5, −10 to 40 dB, three arrays, with and without fading, sources close together or not) and
certifies each. Local searches then start from the true sources, from random sources, and from estimates that are
perturbed or of which one is doubled. None may end below the proven bound, whether the scene is certified or not, and a
certificate for a local minimum that such a search finds must be refused. Prints the counts of each cell, then every
contradiction with the seed of its scene; there should be none.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from numpy import ndarray

sys.path.append(str(Path(__file__).parents[1] / "problems" / "near_field" / "certificate"))
import certificate_scenes as scenes

ARRAYS = {"line": scenes.LINE, "line, paper": scenes.PAPER, "plane": scenes.PLANE}
SNR_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
FADING = {"none": {}, "κ = 100": {"rician_k": 100.0}, "κ = 10": {"rician_k": 10.0}}
TOLERANCE = 1e-11  # of J itself


def scene(seed: int) -> tuple[tuple[str, ...], scenes.NearFieldInstance, np.random.Generator]:
    """Return the cell of a random scene, the scene, and the generator of its attacks."""
    rng = np.random.default_rng(seed)
    array, fading = rng.choice(list(ARRAYS)), rng.choice(list(FADING), p=[0.6, 0.2, 0.2])
    K, snr, apart = int(rng.integers(1, 6)), float(rng.choice(SNR_DB)), float(rng.choice([0.0, 2.0]))
    changes = {"sources": K, "snr_db": snr, "min_separation_deg": apart} | FADING[fading]
    if FADING[fading]:
        changes["fading"] = "block"
    cell = (array, f"K = {K}", f"{snr:g} dB", f"fading {fading}")
    return cell, scenes.draw(ARRAYS[array], seed, **changes), rng


def starts(instance: scenes.NearFieldInstance, theta: ndarray, count: int, rng: np.random.Generator) -> list[ndarray]:
    """Return the true sources, and ``count`` starts of three kinds."""
    found, width = [instance.theta], instance.upper - instance.lower
    for n in range(count):
        random = rng.uniform(instance.lower, instance.upper, theta.shape)
        if n % 3 == 0:
            start = random
        elif n % 3 == 1:  # a few sources moved
            moved = theta + 10 ** rng.uniform(-4, 0) * width * rng.standard_normal(theta.shape)
            start = np.where(rng.random((len(theta), 1)) < 0.5, moved, theta)
        else:  # one source twice, in the place of another, or a random one where there is none
            start = theta.copy()
            j, k = rng.integers(len(theta), size=2)
            start[j] = theta[k] + 1e-3 * width * rng.standard_normal(theta.shape[1]) if j != k else random[j]
        found.append(np.clip(start, instance.lower, instance.upper))
    return found


def attack(seed: int, count: int) -> tuple[tuple[str, ...], bool, int, int, list[str]]:
    """Return the cell, whether it is certified, the numbers of searches and of refused minima, and contradictions."""
    cell, instance, rng = scene(seed)
    U = scenes.subspace(instance)
    theta = scenes.estimate(instance)
    proof = scenes.certify_scene(instance, theta)
    wrong, worse = [], []
    bound = proof.J - proof.gap
    ends = starts(instance, theta, count, rng)
    for start in ends:
        x = scenes.local_minimum(U, instance, start)
        J = scenes.misfit(U, instance.manifold, x)
        if bound - TOLERANCE > J:
            wrong.append(f"seed {seed}: J = {J:.6g} below the proven {bound:.6g} (certified: {proof.certified})")
        if proof.J + proof.gap + 1e-7 < J:
            worse.append((J, x))
    for J, x in sorted(worse, key=lambda pair: pair[0])[:3]:
        again = scenes.certify_scene(instance, x)
        if again.J > proof.J + 1e-9 and again.certified:
            wrong.append(f"seed {seed}: certified J = {J:.6g}, but {proof.J:.6g} was found")
    return cell, proof.certified, len(ends), min(len(worse), 3), wrong


def main(total: int = 200, count: int = 12, seed: int = 0) -> int:
    cells: dict[tuple[str, ...], Counter[str]] = {}
    contradictions: list[str] = []
    for number in range(seed, seed + total):
        cell, certified, searches, refused, wrong = attack(number, count)
        for key in [(cell[0], cell[1]), (cell[0], cell[2]), (cell[0], cell[3])]:
            found = cells.setdefault(key, Counter())
            found += Counter(scenes=1, certified=certified, searches=searches, refused=refused)
            cells[key] = found
        contradictions += wrong
        if (number - seed + 1) % 50 == 0:
            print(f"{number - seed + 1} scenes, {len(contradictions)} contradictions", file=sys.stderr, flush=True)
    print(f"{'array':12} {'cell':16} {'scenes':>7} {'certified':>10} {'searches':>9} {'refused minima':>15}")
    for (array, name), row in sorted(cells.items()):
        counts = f"{row['scenes']:7} {row['certified']:10} {row['searches']:9} {row['refused']:15}"
        print(f"{array:12} {name:16} {counts}")
    print(f"{total} scenes, {len(contradictions)} contradictions", *contradictions, sep="\n")
    return len(contradictions)


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
