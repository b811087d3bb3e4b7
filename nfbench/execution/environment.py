"""Describes where results were computed: versions, machine and threads. It is stored with every study's results."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info

__all__ = ["THREAD_VARIABLES", "describe_environment"]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

# every library that can change a result
LIBRARIES = (
    "nfbench",
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "nlopt",
    "cma",
    "nevergrad",
    "pymoo",
    "optuna",
    "cmaes",
    "pygmo",
    "minionpy",
    "fcmaes",
    "coco-experiment",
    "ioh",
    "pandas",
    "pydantic",
    "threadpoolctl",
    "distributed",
)


def describe_environment(plugins: Iterable[str | Path] = ()) -> dict[str, Any]:
    """Versions, CPU, BLAS, threads and git state, as plain data for ``environment.json``."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "versions": {name: found for name in LIBRARIES if (found := _version(name))},
        "blas": [
            {key: info.get(key) for key in ("internal_api", "version", "architecture", "threading_layer")}
            for info in threadpool_info()
            if info.get("user_api") == "blas"
        ],
        "threads": {
            "in runs": 1,
            **{name: os.environ[name] for name in THREAD_VARIABLES if name in os.environ},
        },
        "git": _git_state(Path(__file__).parent),
        "plugins": {Path(file).name: hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in plugins},
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor())


def _git_state(folder: Path) -> dict[str, Any] | None:
    """The commit, and whether the working tree differs from it; None unless nfbench runs from a git checkout."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(git("status", "--porcelain"))}
    except (OSError, subprocess.SubprocessError):
        return None
