"""Tests every claim of the paper against the committed tables: ``python results/paper/ledger.py`` rewrites the ledger.

A claim is a comparison of two methods, or of one method with itself elsewhere, under each condition that was studied.
For each condition, the ledger gives the ratio with its 95 % interval, from a bootstrap over scenes (paired if both
methods ran on the same scenes). The claim holds where the interval lies on the claimed side of 1, fails where it lies
on the other side, and is open otherwise. A claim is confirmed if it fails under no condition and holds under at least
a quarter of them,
refuted if it holds under none and fails under at least a quarter, and undecided otherwise. For undecided claims the
table lists the conditions under which they hold, fail or are open.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from nfbench.analysis import bootstrap, mean, percentile_interval, rms

HERE = Path(__file__).parent
RESAMPLES = 4000
OUTLIER = 10.0
BEGIN, END = "<!-- ledger: written by ledger.py -->", "<!-- end of ledger -->"

Statistic = Callable[[np.ndarray], np.ndarray]  # over the last axis


def median(errors: np.ndarray) -> np.ndarray:
    return np.median(errors, axis=-1)


STATISTICS: dict[str, Statistic] = {"RMSE": rms, "median": median}


@dataclass(frozen=True)
class Evidence:
    """The evidence under one condition: a ratio, its 95 % interval, and whether the claim holds (None: open)."""

    condition: str
    ratio: float
    low: float
    high: float
    holds: bool | None


@dataclass(frozen=True)
class Claim:
    """A claim of the paper (text), its place there (where), the comparison that tests it, the study, and the
    evidence."""

    text: str
    where: str
    compared: str
    study: str
    evidence: list[Evidence]

    @property
    def verdict(self) -> str:
        holds, fails = (sum(item.holds is value for item in self.evidence) for value in (True, False))
        many = len(self.evidence) / 4
        return "confirmed" if not fails and holds >= many else "refuted" if not holds and fails >= many else "undecided"


@cache
def errors(study: str) -> pd.DataFrame:
    return pd.read_csv(HERE / study / "errors.csv")


def conditions(study: str, keys: list[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The scenes of a study for each value of these keys."""
    table = errors(study)
    if not keys:
        yield "", table
        return
    for values, scenes in table.groupby([f"scenario.{key}" for key in keys], sort=False):
        named = (f"{key} = {value}" for key, value in zip(keys, values, strict=True))
        yield ", ".join(named), scenes


def ratio(
    first: np.ndarray, second: np.ndarray, statistic: Statistic, paired: bool = True
) -> tuple[float, float, float]:
    """The ratio statistic(first)/statistic(second) and its 95 % bootstrap interval; if paired, over common scenes."""

    def quotient(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return statistic(first) / statistic(second)

    if paired:
        both = np.isfinite(first) & np.isfinite(second)
        first, second = first[both], second[both]
    else:
        first, second = first[np.isfinite(first)], second[np.isfinite(second)]
    return with_interval(quotient, first, second, paired=paired)


def with_interval(
    statistic: Callable[..., np.ndarray], *samples: np.ndarray, paired: bool
) -> tuple[float, float, float]:
    """A statistic of samples and its 95 % bootstrap interval."""
    rng = np.random.default_rng(0)
    resampled = bootstrap(statistic, *samples, rng=rng, resamples=RESAMPLES, paired=paired)
    return float(statistic(*samples)), *percentile_interval(resampled)


def below(low: float, high: float, limit: float = 1.0) -> bool | None:
    """Whether a ratio is below the limit."""
    return True if high < limit else False if low >= limit else None


def above(low: float, high: float, limit: float = 1.0) -> bool | None:
    return None if (is_below := below(low, high, limit)) is None else not is_below


def alike(low: float, high: float, factor: float = 1.25) -> bool | None:
    """Whether a ratio lies in [1/factor, factor]: True or False if its whole interval lies inside or outside, else
    None."""
    if low > 1 / factor and high < factor:
        return True
    return False if high < 1 / factor or low > factor else None


def versus(
    study: str,
    keys: list[str],
    first: str,
    second: str,
    judge: Callable[[float, float], bool | None],
    kind: str = "both",
) -> list[Evidence]:
    """The ratio of one method's error to another's under each condition, for the RMSE and the median."""
    found = []
    for condition, scenes in conditions(study, keys):
        for name, statistic in STATISTICS.items():
            if kind not in ("both", name):
                continue
            value, low, high = ratio(scenes[first].to_numpy(), scenes[second].to_numpy(), statistic)
            found.append(Evidence(f"{name}{', ' if condition else ''}{condition}", value, low, high, judge(low, high)))
    return found


def across(
    study: str,
    key: str,
    start: str,
    end: str,
    keys: list[str],
    methods: list[str],
    judge: Callable[[float, float], bool | None],
    kinds: tuple[str, ...] = ("RMSE",),
) -> list[Evidence]:
    """The ratio of each method's error at the ``end`` of a sweep to that at its ``start``, whose scenes are
    independent."""
    found = []
    for condition, scenes in conditions(study, keys):
        column = scenes[f"scenario.{key}"].astype(str)
        for method in methods:
            last, first = (scenes[column == value][method].to_numpy() for value in (end, start))
            for kind in kinds:
                value, low, high = ratio(last, first, STATISTICS[kind], paired=False)
                label = ", ".join(filter(None, [kind, method, condition]))
                found.append(Evidence(label, value, low, high, judge(low, high)))
    return found


def claims() -> list[Claim]:
    quarter, half = "rmse_snr_quarter", "rmse_snr_half"
    fading = ["fading"]
    coarse, fine = "2D MUSIC 200×1000", "2D MUSIC 400×2000"
    m_coarse, m_fine = "modified MUSIC 200×1000", "modified MUSIC 400×2000"
    return [
        Claim(
            "NEMO-DE beats 2D MUSIC at equal SNR (λ/4)",
            "Fig. RMSE vs. SNR, λ/4",
            f"NEMO-DE ÷ {fine}, at each SNR",
            quarter,
            versus(quarter, ["fading", "snr_db"], "NEMO-DE", fine, below),
        ),
        Claim(
            "NEMO-DE beats 2D MUSIC at equal SNR (λ/2)",
            "Fig. RMSE vs. SNR, λ/2",
            "NEMO-DE ÷ 2D MUSIC 600×3000, at each SNR",
            half,
            versus(half, ["fading", "snr_db"], "NEMO-DE", "2D MUSIC 600×3000", below),
        ),
        Claim(
            "2D MUSIC loses more accuracy on the coarse grid than modified MUSIC does",
            "Fig. RMSE vs. SNR, λ/4",
            "(2D MUSIC coarse ÷ fine) ÷ (modified MUSIC coarse ÷ fine), over all SNRs",
            quarter,
            [
                item
                for condition, scenes in conditions(quarter, fading)
                for item in _grid_mismatch(condition, scenes, coarse, fine, m_coarse, m_fine)
            ],
        ),
        Claim(
            "The RMSE of every method grows with the number of sources (λ/4)",
            "Fig. RMSE vs. number of sources, λ/4",
            "RMSE and median at K = 5 ÷ at K = 2",
            "rmse_sources_quarter",
            across(
                "rmse_sources_quarter",
                "sources",
                "2",
                "5",
                fading,
                ["NEMO-DE", coarse, fine, m_coarse, m_fine],
                above,
                ("RMSE", "median"),
            ),
        ),
        Claim(
            "The RMSE of every method grows with the number of sources (λ/2)",
            "Fig. RMSE vs. number of sources, λ/2",
            "RMSE and median at K = 5 ÷ at K = 2",
            "rmse_sources_half",
            across(
                "rmse_sources_half",
                "sources",
                "2",
                "5",
                fading,
                ["NEMO-DE", coarse, fine, "2D MUSIC 600×3000"],
                above,
                ("RMSE", "median"),
            ),
        ),
        Claim(
            "Modified MUSIC cannot run at λ/2",
            "Text with Fig. RMSE vs. SNR, λ/2",
            "share of its runs that were skipped as impossible (1: all)",
            half,
            _refused(half, m_fine),
        ),
        Claim(
            "NEMO-DE is as accurate as 3D MUSIC at equal SNR",
            "Fig. locations, NEMO-DE and MUSIC",
            "NEMO-DE ÷ 3D MUSIC; equally accurate: within a factor of 1.25",
            "positions_equal_snr",
            versus("positions_equal_snr", fading, "NEMO-DE", "3D MUSIC 200×200×400", alike),
        ),
        Claim(
            "NEEF-DE is as accurate as 3D MUSIC at 10, 20 and 30 dB",
            "Fig. locations, NEEF-DE and MUSIC",
            "NEEF-DE ÷ 3D MUSIC; equally accurate: within a factor of 1.25",
            "positions_unequal_snr",
            versus("positions_unequal_snr", fading, "NEEF-DE", "3D MUSIC 200×200×400", alike),
        ),
        Claim(
            "NEEF-DE is more stable under SNR imbalance than NEMO-DE (κ = 10)",
            "Fig. RMSE under unequal SNRs",
            "NEEF-DE ÷ NEMO-DE, at each imbalance",
            "snr_imbalance",
            _unequal(versus("snr_imbalance", ["fading", "snr_db"], "NEEF-DE", "NEMO-DE", below)),
        ),
        Claim(
            "NEMO-DE degrades as the imbalance grows (κ = 10)",
            "Fig. RMSE under unequal SNRs",
            "RMSE at 0, 20, 40 dB ÷ at 20, 20, 20 dB",
            "snr_imbalance",
            across("snr_imbalance", "snr_db", "[20.0, 20.0, 20.0]", "[0.0, 20.0, 40.0]", fading, ["NEMO-DE"], above),
        ),
        Claim(
            "NEEF-DE varies only mildly with the imbalance (κ = 10)",
            "Fig. RMSE under unequal SNRs",
            "RMSE at 0, 20, 40 dB ÷ RMSE at 20, 20, 20 dB; mildly: by less than a factor of 2",
            "snr_imbalance",
            across(
                "snr_imbalance",
                "snr_db",
                "[20.0, 20.0, 20.0]",
                "[0.0, 20.0, 40.0]",
                fading,
                ["NEEF-DE"],
                lambda low, high: below(low, high, 2.0),
            ),
        ),
        Claim(
            "NEEF-DE is more stable under SNR imbalance than NEMO-DE (line of sight)",
            "The paper's explanation (masking by strong sources), tested without fading",
            "NEEF-DE ÷ NEMO-DE, at each imbalance",
            "snr_imbalance_los",
            _unequal(versus("snr_imbalance_los", ["snr_db"], "NEEF-DE", "NEMO-DE", below)),
        ),
        Claim(
            "Modified MUSIC fails under SNR imbalance (κ = 10)",
            "Fig. RMSE under unequal SNRs",
            "RMSE at 0, 20, 40 dB ÷ at 20, 20, 20 dB; fails: above 2",
            "snr_imbalance",
            across(
                "snr_imbalance",
                "snr_db",
                "[20.0, 20.0, 20.0]",
                "[0.0, 20.0, 40.0]",
                fading,
                [m_fine],
                lambda low, high: above(low, high, 2.0),
            ),
        ),
        Claim(
            "NEMO-DE is faster than NEEF-DE",
            "Table of run times",
            "seconds of NEMO-DE ÷ NEEF-DE",
            "runtime",
            _seconds("NEMO-DE", "NEEF-DE"),
        ),
        Claim(
            "NEEF-DE is faster than 3D MUSIC",
            "Table of run times",
            "seconds of NEEF-DE ÷ 3D MUSIC",
            "runtime",
            _seconds("NEEF-DE", "3D MUSIC 200×200×400"),
        ),
        Claim(
            "At equal SNRs NEMO-DE is preferable to NEEF-DE: as accurate, and cheaper",
            "Text with the table of run times",
            "NEMO-DE ÷ NEEF-DE in error (as accurate: below 1.25) and in seconds (cheaper: below 1)",
            "positions_equal_snr",
            [
                *versus("positions_equal_snr", fading, "NEMO-DE", "NEEF-DE", lambda low, high: below(low, high, 1.25)),
                *_seconds("NEMO-DE", "NEEF-DE"),
            ],
        ),
        Claim(
            "A wrong number of sources degrades NEEF more than NEMO",
            "Limitations",
            "(NEEF-DE wrong ÷ right) ÷ (NEMO-DE wrong ÷ right) in GOSPA",
            "source_number_mismatch",
            [
                item
                for condition, scenes in conditions("source_number_mismatch", ["rician_k"])
                for item in _wrong_number(condition, scenes)
            ],
        ),
        Claim(
            "NEMO-DE's run time grows linearly with M",
            "Complexity analysis",
            "exponent of time in M over 64 … 512; 1 ± 0.25",
            "complexity",
            _exponent("NEMO-DE", 1.0),
        ),
        Claim(
            "NEEF-DE's run time grows linearly with M",
            "Complexity analysis",
            "exponent of time in M over 64 … 512; 1 ± 0.25",
            "complexity",
            _exponent("NEEF-DE", 1.0),
        ),
        Claim(
            "2D MUSIC's run time grows with M²",
            "Complexity analysis",
            "exponent of time in M over 64 … 512; 2 ± 0.25",
            "complexity",
            _exponent(fine, 2.0),
        ),
        Claim(
            "The paper's DE parameters are well chosen: changing any single one does not improve them",
            "Table of DE parameters; the sensitivity analysis is mentioned but not shown",
            "RMSE of each variant ÷ RMSE with the paper's parameters; better: below 0.95",
            "de_sensitivity",
            [
                Evidence(f"{variant}, {item.condition}", item.ratio, item.low, item.high, item.holds)
                for variant in [name for name in _methods("de_sensitivity") if not name.startswith("paper")]
                for item in versus(
                    "de_sensitivity",
                    ["rician_k"],
                    variant,
                    "paper: N_p 50, G 300, F 0.5, C_r 0.8",
                    lambda low, high: high >= 0.95,
                    "RMSE",
                )
            ],
        ),
        Claim(
            "The repulsion prevents duplicate detections",
            "Algorithm 1",
            "RMSE without repulsion (α = 0) ÷ RMSE with the paper's α = 1000; repulsion helps: above 1",
            "penalty",
            versus("penalty", ["rician_k"], "none: α = 0", "paper: α = 1000", lambda low, high: low > 1, "RMSE"),
        ),
    ]


def _methods(study: str) -> list[str]:
    table = errors(study)
    return [
        name
        for name in table.columns
        if not name.startswith("scenario.") and name not in ("repetition", "crb_m", "floor_m")
    ]


def _unequal(evidence: list[Evidence]) -> list[Evidence]:
    """The evidence without the condition of equal SNRs."""
    return [item for item in evidence if "[20.0, 20.0, 20.0]" not in item.condition]


def _grid_mismatch(
    condition: str, scenes: pd.DataFrame, coarse: str, fine: str, m_coarse: str, m_fine: str
) -> Iterator[Evidence]:
    errors = scenes[[coarse, fine, m_coarse, m_fine]].dropna().to_numpy().T
    for name, statistic in STATISTICS.items():
        value, low, high = with_interval(_quotient_of_quotients(statistic), *errors, paired=True)
        yield Evidence(f"{name}, {condition}", value, low, high, above(low, high))


def _quotient_of_quotients(statistic: Statistic) -> Callable[..., np.ndarray]:
    return lambda a, b, c, d: statistic(a) / statistic(b) / (statistic(c) / statistic(d))


def _wrong_number(condition: str, scenes: pd.DataFrame) -> Iterator[Evidence]:
    for wrong in (2, 4):
        names = [f"gospa_m: {method}, K = {k}" for method in ("NEEF-DE", "NEMO-DE") for k in (wrong, 3)]
        errors = scenes[names].dropna().to_numpy().T
        value, low, high = with_interval(_quotient_of_quotients(rms), *errors, paired=True)
        yield Evidence(f"K = {wrong} for 3, {condition}", value, low, high, above(low, high))


def _seconds(first: str, second: str) -> list[Evidence]:
    table = errors("runtime")
    value, low, high = ratio(table[f"runtime_s: {first}"].to_numpy(), table[f"runtime_s: {second}"].to_numpy(), mean)
    return [Evidence("seconds, this implementation", value, low, high, below(low, high))]


def _exponent(method: str, claimed: float) -> list[Evidence]:
    table = errors("complexity")
    times = [(M, group[f"runtime_s: {method}"].to_numpy()) for M, group in table.groupby("scenario.array.elements")]
    M = np.log(np.array([elements for elements, _ in times], dtype=float))

    def exponent(*seconds: np.ndarray) -> np.ndarray:
        return np.polyfit(M, np.log([median(each) for each in seconds]), 1)[0]

    value, low, high = with_interval(exponent, *(seconds for _, seconds in times), paired=False)
    inside, outside = abs(low - claimed) < 0.25 > abs(high - claimed), high < claimed - 0.25 or low > claimed + 0.25
    return [Evidence("exponent", value, low, high, True if inside else False if outside else None)]


def _refused(study: str, method: str) -> list[Evidence]:
    summary = pd.read_csv(HERE / study / "summary.csv")
    rows = summary[summary["method"] == method]
    share = rows["failed"].sum() / rows["runs"].sum()
    return [Evidence(f"{rows['runs'].sum()} runs", share, share, share, bool(share == 1))]


# ------------------------------------------------------------------------------------------------- the page


def page(judged: list[Claim]) -> str:
    """The ledger in Markdown: a table of verdicts, then the evidence for each claim."""
    counts = {verdict: sum(c.verdict == verdict for c in judged) for verdict in ("confirmed", "refuted", "undecided")}
    lines = [
        f"Of {len(judged)} claims, {counts['confirmed']} are confirmed, {counts['refuted']} are refuted and "
        f"{counts['undecided']} are undecided: open, or true under some conditions and false under others.",
        "A claim is confirmed if it fails under no condition and holds under at least a quarter of them, refuted if it",
        "holds under none and fails under at least a quarter. A condition is open if its 95 % interval includes values "
        "on both sides of the limit.",
        "",
        "| | claim | in the paper | verdict | holds / fails / open | exceptions | study |",
        "|---|---|---|---|---|---|---|",
    ]
    for number, claim in enumerate(judged, start=1):
        holds, fails, opened = ([e for e in claim.evidence if e.holds is value] for value in (True, False, None))
        flips = f"open: {_some(opened)}" if opened and claim.verdict != "undecided" else ""
        if claim.verdict == "undecided" and holds and fails:
            flips = f"holds: {_some(holds)}; fails: {_some(fails)}"
        elif claim.verdict == "undecided" and holds:
            flips = f"open: {_some(opened)}"
        elif claim.verdict == "undecided" and fails:
            flips = f"fails: {_some(fails)}"
        drawing = "runtime" if claim.study == "runtime" else "error"
        lines.append(
            f"| {number} | {claim.text} | {claim.where} | **{claim.verdict}** "
            f"| {len(holds)} / {len(fails)} / {len(opened)} | {flips} | [{claim.study}]({claim.study}/{drawing}.svg) |"
        )
    for number, claim in enumerate(judged, start=1):
        lines += [
            "",
            f"<details><summary>{number}. {claim.text}: {claim.verdict}</summary>",
            "",
            f"{claim.compared}. Study `{claim.study}`.",
            "",
            "| condition | ratio | 95 % interval | |",
            "|---|---|---|---|",
            *(
                f"| {e.condition} | {e.ratio:.3g} | {e.low:.3g} – {e.high:.3g} "
                f"| {'open' if e.holds is None else 'holds' if e.holds else 'fails'} |"
                for e in claim.evidence
            ),
            "",
            "</details>",
        ]
    return "\n".join([*lines, "", *efficiency()])


def efficiency() -> list[str]:
    """How far each method's RMSE lies above the Cramér–Rao bound in line of sight, with outliers counted apart."""
    lines = [
        "### RMSE relative to the Cramér–Rao bound",
        "",
        "Line of sight, sources at least 2° apart: the RMSE over 100 scenes ÷ the root mean square of the stochastic",
        "Cramér–Rao bounds of the same scenes. Runs whose error exceeds their scene's bound by more than a factor of",
        f"{OUTLIER:g} are left out and counted as outliers.",
        "",
        "| method | SNR | RMSE ÷ bound | 95 % interval | outliers | RMSE ÷ bound with outliers |",
        "|---|---|---|---|---|---|",
    ]
    for method in ["NEEF-DE", "grid-refine", "2D MUSIC 400×2000, refined", "NEMO-DE"]:
        for condition, scenes in conditions("line_of_sight", ["snr_db"]):
            E, bound = scenes[method].to_numpy(), scenes["crb_m"].to_numpy()
            near = E / bound <= OUTLIER
            value, low, high = ratio(E[near], bound[near], rms)
            everything = float(rms(E) / rms(bound))
            lines.append(
                f"| {method} | {condition.removeprefix('snr_db = ')} dB | {value:.2f} | {low:.2f} – {high:.2f} "
                f"| {np.sum(~near)} of {len(E)} | {everything:.2f} |"
            )
    return lines


def _some(evidence: list[Evidence], most: int = 3) -> str:
    """The first few conditions with their ratios, and how many more there are."""
    names = [f"{e.condition} ({e.ratio:.2g})" for e in evidence]
    return "; ".join(names[:most]) + (f"; {len(names) - most} more" if len(names) > most else "")


def main() -> None:
    path = HERE / "README.md"
    text = path.read_text(encoding="utf-8")
    new = re.sub(f"{BEGIN}.*{END}", f"{BEGIN}\n{page(claims())}\n{END}".replace("\\", r"\\"), text, flags=re.DOTALL)
    path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
