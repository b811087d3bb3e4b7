"""Makes everything in this folder: ``python results/paper/make.py`` runs the paper's studies, draws their figures and
rewrites the ledger.

Finished runs are not repeated. Studies of run time use one worker process, all others two.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import ledger
import pandas as pd

import nfbench

HERE = Path(__file__).parent
STUDIES = HERE.parents[1] / "studies" / "paper"
ALONE = ("runtime", "complexity")  # studies that measure run time, which must not share the cores
METRICS = {"runtime": "runtime_s", "complexity": "runtime_s", "source_number_mismatch": "gospa_m"}


def nfbench_command(*arguments: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "nfbench", *map(str, arguments)], check=False)


def write_errors(folder: Path) -> None:
    """``errors.csv``: the error [m] of every run, one row per scene and one column per method. The ledger is computed
    from it.

    The columns ``crb_m`` and ``floor_m`` of the scene follow if it has them. Studies of run time also have columns
    ``runtime_s: <method>``, and the study of a wrong number of sources has ``gospa_m: <method>``.
    """
    runs = nfbench.Results(folder).runs
    swept = [name for name in runs.columns if name.startswith("scenario.")]
    runs = runs[runs["status"] == "ok"].assign(**{name: runs[name].astype(str) for name in swept})
    metrics = dict.fromkeys(["rmse_m", METRICS.get(folder.name, "rmse_m")])
    order = dict.fromkeys(runs["method"])
    wide = [
        runs.pivot(index=[*swept, "repetition"], columns="method", values=metric)[list(order)].add_prefix(
            "" if metric == "rmse_m" else f"{metric}: "
        )
        for metric in metrics
    ]
    points = runs[[*swept, "repetition"]].drop_duplicates().set_index([*swept, "repetition"]).index
    scenes = runs.groupby([*swept, "repetition"])[[name for name in ("crb_m", "floor_m") if name in runs]].first()
    table = pd.concat([*wide, scenes.dropna(axis=1, how="all")], axis=1).reindex(points)
    table.to_csv(folder / "errors.csv", float_format="%.4g")


def main() -> None:
    manifests = sorted(STUDIES.glob("*.toml"), key=lambda path: path.stem in ALONE)
    for manifest in manifests:
        folder = HERE / manifest.stem
        print(f"--- {manifest.stem}", flush=True)
        jobs = 1 if manifest.stem in ALONE else 2
        nfbench_command("run", manifest, "--out", folder, "--jobs", str(jobs))
        nfbench_command("figure", folder, *(["--positions"] if manifest.stem.startswith("positions") else []))
        write_errors(folder)
    ledger.main()


if __name__ == "__main__":
    main()
