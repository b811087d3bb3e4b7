"""Cost and capacity of the engine and the store: ``python tests/benchmarks/engine.py [RUNS]`` (default 200,000).

First, empty runs (a formulation that returns the true answer) on two workers: the rate, the peak memory of the parent,
the time to resume the finished folder and to print its status, and its size. Then real runs, NEMO with DE at the
settings of the paper: the rate of two workers divided by twice the rate of one, measured alternately.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

TOY = Path(__file__).parent.parent / "toy_plugins" / "toy.py"
EMPTY = """
name = "empty"
repetitions = {runs}
seed = 1
plugins = ['{toy}']
[scenario]
kind = "toy"
[[formulation]]
kind = "oracle"
"""
REAL = """
name = "real"
repetitions = 150
seed = 1
[scenario]
kind = "near-field"
array = {{ kind = "ula", elements = 128, spacing_wavelengths = 0.25, origin = "first" }}
wavelength_m = 0.02
wavefront = "paper"
sources = 3
snapshots = 200
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [1.27, 20.16]
[[formulation]]
kind = "nemo"
[[solver]]
kind = "de"
[budget]
evaluations = 15000
"""


def nfbench(*arguments: object) -> float:
    """Run one command and return its wall-clock time [s]."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "nfbench", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def child(folder: Path, manifest: Path) -> None:
    """Run the study in this process and print its peak memory [MiB] for the parent process."""
    import nfbench as library

    library.run(library.load_study(manifest), out=folder, jobs=2)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def session_seconds(folder: Path) -> float:
    """Return the time [s] from the first finished run to the last, which excludes starting workers and the tables."""
    import nfbench as library

    finished = library.Results(folder).origins["finished"]
    return float((finished.max() - finished.min()).total_seconds())


def main(runs: int) -> None:
    table = Table("measured", "value", title="engine and store, two workers")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "empty.toml").write_text(EMPTY.format(runs=runs, toy=TOY))
        (folder / "real.toml").write_text(REAL.format())
        start = time.perf_counter()
        command = [sys.executable, __file__, "child", str(folder / "empty"), str(folder / "empty.toml")]
        memory = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        whole = time.perf_counter() - start
        size = (folder / "empty" / "runs.sqlite").stat().st_size
        table.add_row(f"{runs:,} empty runs, complete command", f"{whole:.1f} s, {runs / whole:,.0f} runs/s")
        table.add_row(
            "the same, from the first to the last run", f"{runs / session_seconds(folder / 'empty'):,.0f} runs/s"
        )
        table.add_row("peak memory of the parent", f"{memory:.0f} MiB")
        table.add_row("runs.sqlite", f"{size / 2**20:.0f} MiB, {size / runs:.0f} bytes per row")
        resumed = nfbench("run", folder / "empty.toml", "--out", folder / "empty", "--quiet")
        table.add_row("resuming the finished folder", f"{resumed:.2f} s")
        table.add_row("status", f"{nfbench('status', folder / 'empty'):.2f} s")
        rates = []
        for turn in range(3):
            seconds = []
            for jobs in (1, 2):
                out = folder / f"real-{turn}-{jobs}"
                nfbench("run", folder / "real.toml", "--out", out, "--quiet", "--jobs", jobs)
                seconds.append(session_seconds(out))
            rates.append(seconds[0] / seconds[1] / 2)
        size = (folder / "real-0-1" / "runs.sqlite").stat().st_size
        table.add_row("NEMO + DE with its three traces", f"{size / 150 / 1024:.0f} KiB per row")
        shown = ", ".join(f"{rate:.2f}" for rate in rates)
        median = f"{statistics.median(rates):.2f} (median of {shown})"
        table.add_row("rate of 2 workers / (2 × rate of 1)", median)
    Console(width=110).print(table)


if __name__ == "__main__":
    if sys.argv[1:2] == ["child"]:
        child(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 200_000)
