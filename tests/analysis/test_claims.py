"""Claims: what each kind confirms and contradicts, the size and power of its test, and the claims of the paper."""

import itertools
import math
import tomllib

import numpy as np
import pytest

from nfbench import OptionError
from nfbench.analysis import claims as module
from nfbench.analysis.claim_parts import parts_of
from nfbench.analysis.claims import Claim, Compare, judge_claims, quantity
from nfbench.analysis.outcomes import Outcomes
from nfbench.core import build

INF = math.inf
SNR = "scenario.snr_db"


def outcome(values, runs=1, hits=None, failed=None, **ended):
    """Outcomes of errors {method: (n,)}; the run time of each method is ten times its error."""
    error = np.column_stack(list(values.values())).astype(float)
    n, k = error.shape
    hits = np.isfinite(error).astype(int) * runs if hits is None else np.asarray(hits)
    return Outcomes(
        methods=tuple(values),
        scenes=tuple(range(n)),
        error=error,
        runs=np.full(k, runs),
        hits=hits,
        cost=np.where(hits > 0, 100 * error, INF),
        spent=np.full((n, k), 1000.0),
        cap=np.full(k, 1000.0),
        error_name="rmse_m",
        columns={"runtime_s": 10 * error},
        failed=failed,
        ended={name: np.asarray(counts) for name, counts in ended.items()},
    )


def judged(points, *tables):
    claims = [Claim(f"claim {i}", build(Compare, table)) for i, table in enumerate(tables)]
    return judge_claims(claims, points).to_dict("records")


def one(points, **table):
    return judged(points, table)[0]


def verdicts(points, **table):
    return one(points, **table)["verdict"]


def swept(levels, n=20, sigma=0.2, seed=0, key=SNR, keys=None):
    """Points whose errors have these levels {method: [level at each value]}, on the same scenes."""
    rng = np.random.default_rng(seed)
    count = len(next(iter(levels.values())))
    scene = rng.lognormal(sigma=0.5, size=n)
    return [
        ({key: value}, outcome({m: at[p] * scene * rng.lognormal(sigma=sigma, size=n) for m, at in levels.items()}))
        for p, value in enumerate(keys or range(count))
    ]


# each kind


def test_better_everywhere_and_overall():
    points = swept({"a": [1, 1, 1], "b": [2, 2, 2]})
    row = one(points, better="a", worse="b")
    assert row["verdict"] == "confirmed"
    assert row["estimate"] == pytest.approx(0.5, rel=0.15)
    assert row["low"] < row["estimate"] < row["high"] < 1
    assert row["scenes"] == 20
    assert row["p"] == row["p_holm"] < 1e-3
    assert verdicts(points, better="b", worse="a") == "contradicted"
    mixed = swept({"a": [1, 1, 1], "b": [2, 2, 1]})
    assert verdicts(mixed, better="a", worse="b") == "not decided by 20 scenes"
    assert verdicts(mixed, better="a", worse="b", over="overall") == "confirmed"
    assert verdicts(mixed, better="a", worse="b", key=SNR, values=[0, 1.0]) == "confirmed"
    assert verdicts(mixed, better="a", worse="b", measure="runtime_s", key=SNR, values=["0"]) == "confirmed"


def test_better_by_a_factor_than_several_methods():
    points = swept({"a": [1], "b": [1], "c": [3]})
    assert verdicts(points, better="a", worse="others", factor=1.25) == "confirmed"
    assert verdicts(points, better="a", worse=["b", "c"]) == "not decided by 20 scenes"
    assert verdicts(points, better="a", worse="c", factor=0.5) == "confirmed"
    assert verdicts(points, better="a", worse="c", factor=0.2) == "contradicted"


def test_more_hits_are_better():
    n = 20
    hits = np.column_stack([np.full(n, 4), np.full(n, 1)])
    points = [({}, outcome({"a": np.ones(n), "b": np.ones(n)}, runs=5, hits=hits))]
    row = one(points, better="a", worse="b", measure="hits")
    assert row["verdict"] == "confirmed"
    assert row["estimate"] == pytest.approx(0.8)
    assert verdicts(points, better="b", worse="a", measure="hits") == "contradicted"


def test_trends():
    points = swept({"a": [1, 2, 4, 8], "b": [1, 1, 1, 1], "c": [1, 2, 2, 4]}, sigma=0.1)
    assert verdicts(points, grows="a", key=SNR) == "confirmed"
    assert verdicts(points, falls="a", key=SNR) == "contradicted"
    assert verdicts(points, grows="b", key=SNR) == "not decided by 20 scenes"
    assert verdicts(points, grows=["a", "c"], key=SNR) == "confirmed"
    assert verdicts(points, grows="all", key=SNR) == "not decided by 20 scenes"
    assert verdicts(points, grows="a", key=SNR, every_step=True) == "confirmed"
    assert verdicts(points, grows="c", key=SNR, every_step=True) == "not decided by 20 scenes"
    assert one(points, grows="a", key=SNR)["estimate"] == pytest.approx(8, rel=0.1)
    backwards = list(reversed(points))  # the order of the sweep does not matter for numbers
    assert verdicts(backwards, grows="a", key=SNR) == "confirmed"


def test_trend_reference_values():
    rows = np.array([[1, 2, 3], [1, 3, 2], [2, 1, 3], [1, 2, 3], [1, 2, 3], [2, 3, 4]])
    points = [({SNR: p}, outcome({"a": rows[:, p]})) for p in range(3)]
    (part,) = parts_of(Compare(grows="a", key=SNR), points)
    assert part.p == 0.015625


def test_degrades_more():
    points = swept({"a": [1, 2, 8], "b": [1, 1.3, 2], "a2": [3, 3, 30], "b2": [1, 1, 1]}, sigma=0.1)
    assert verdicts(points, degrades="a", more_than="b", key=SNR, start=0, stop=2) == "confirmed"
    assert verdicts(points, degrades="b", more_than="a", key=SNR, start=0, stop=2) == "contradicted"
    noisy = swept({"a": [1, 2, 8], "b": [1, 1, 1]})
    assert verdicts(noisy, degrades="a", more_than="b", key=SNR) == "confirmed"
    row = one(points, degrades=["a", "a2"], more_than=["b", "b2"], key=SNR, values=[0])
    assert row["verdict"] == "confirmed"
    assert row["estimate"] == pytest.approx(3, rel=0.15)
    assert verdicts(points, degrades=["b", "b2"], more_than=["a", "a2"]) == "contradicted"


def test_equal_reference_values():
    d = np.array([0.01, -0.02, 0.03, 0, 0.05, -0.04, 0.02, -0.01, 0.015, -0.03])
    points = [({}, outcome({"a": np.exp(d), "b": np.ones(10)}))]
    parts = parts_of(Compare(equal=("a", "b"), factor=1.1), points)
    assert [part.p for part in parts] == [0.0009765625] * 2
    assert verdicts(points, equal=["a", "b"], factor=1.1) == "confirmed"
    assert verdicts(points, equal=["a", "b"], factor=1.01) == "not decided by 10 scenes"
    apart = [({}, outcome({"a": 2 * np.exp(d), "b": np.ones(10)}))]
    assert verdicts(apart, equal=["a", "b"], factor=1.1) == "contradicted"


def test_changes_and_floors():
    points = swept({"a": [1, 2, 3], "b": [4, 2, 1.9], "c": [4, 2, 0.5]}, sigma=0.1)
    ends = {"key": SNR, "start": 0, "stop": 2}
    assert verdicts(points, changes="a", **ends, at_least=2) == "confirmed"
    assert verdicts(points, changes="a", **ends, at_most=2) == "contradicted"
    assert verdicts(points, changes="a", **ends, at_least=2, at_most=4) == "confirmed"
    assert verdicts(points, floor="b", key=SNR, start=1, stop=2) == "confirmed"
    assert verdicts(points, floor="c", key=SNR, start=1, stop=2) == "contradicted"
    assert one(points, floor="c", key=SNR, start=1, stop=2)["estimate"] == pytest.approx(0.25, rel=0.1)


def test_no_significant_fall_is_not_a_floor():
    points = swept({"a": [1, 0.75]}, n=12, sigma=1.0)
    assert verdicts(points, falls="a", key=SNR) == "not decided by 12 scenes"
    assert verdicts(points, floor="a", key=SNR, start=0, stop=1) == "not decided by 12 scenes"


def test_values_that_are_lists_are_found_in_text():
    keys = ["[20.0, 20.0, 20.0]", "[0.0, 20.0, 40.0]"]
    points = swept({"a": [1, 3]}, keys=keys)
    table = {"changes": "a", "key": SNR, "start": [20, 20, 20], "stop": [0.0, 20.0, 40.0], "at_least": 2.0}
    assert verdicts(points, **table) == "confirmed"


def test_exponents():
    elements = [64, 128, 256, 512]
    points = swept({"a": [m**2 for m in elements]}, keys=elements, key="scenario.elements", sigma=0.1)
    table = {"exponent": "a", "key": "scenario.elements", "measure": "runtime_s"}
    row = one(points, **table, at_least=1.75, at_most=2.25)
    assert row["verdict"] == "confirmed"
    assert row["estimate"] == pytest.approx(2, abs=0.05)
    assert verdicts(points, **table, at_most=1.5) == "contradicted"


def test_shares_of_failures():
    error = np.where(np.arange(40) < 20, INF, 1.0)
    points = [({}, outcome({"a": error, "b": np.ones(40)}))]
    row = one(points, fails="a", at_least=0.3)
    assert (row["verdict"], row["estimate"]) == ("confirmed", 0.5)
    assert row["p"] == pytest.approx(0.0063, abs=1e-3)  # P(Bin(40, 0.3) ≥ 20)
    assert verdicts(points, fails="a", at_most=0.3) == "contradicted"
    assert verdicts(points, fails="a", at_least=0.45) == "not decided by 40 scenes"
    assert verdicts(points, fails="b", at_most=0.1) == "confirmed"
    assert verdicts(points, fails="b", at_most=0.05) == "not decided by 40 scenes"  # up to 3/40 may fail
    several = [({}, outcome({"a": error}, runs=5, failed=np.where(error == INF, 4, 0)[:, None]))]
    assert one(several, fails="a", at_least=0.2)["estimate"] == 0.4
    assert verdicts(several, fails="a", at_least=0.2) == "confirmed"
    assert verdicts(several, fails="a", at_most=0.2) == "contradicted"
    assert verdicts(points, fails="a", at_least=0.3, measure="hits") == "confirmed"


def test_facts_about_the_runs_made():
    counts = {"ok": [[0, 1]] * 8, "skipped": [[1, 0]] * 8}
    points = [({}, outcome({"a": np.full(8, INF), "b": np.ones(8)}, **counts))]
    row = one(points, runs="a", status="skipped", at_least=1.0)
    assert (row["verdict"], row["estimate"], row["scenes"]) == ("confirmed", 1.0, 8)
    assert math.isnan(row["p"])
    assert verdicts(points, runs="a", at_least=0.5) == "contradicted"
    assert verdicts(points, runs=["a", "b"], status="skipped", at_least=1.0) == "contradicted"
    assert verdicts(points, runs="b", at_least=1.0) == "confirmed"


# the family


def test_holm_over_all_claims_without_the_facts():
    points = swept({"a": [1], "b": [1.35], "c": [1]}, n=12, sigma=0.2, seed=3)
    clear = {"better": "a", "worse": "b"}
    rows = judged(points, clear)
    assert rows[0]["p"] == rows[0]["p_holm"]
    many = judged(points, clear, *[{"better": "a", "worse": "c"}] * 9, {"runs": "a", "at_least": 0.0})
    assert many[0]["p_holm"] == pytest.approx(10 * many[0]["p"])
    assert many[1]["p_holm"] >= many[1]["p"]


def test_failures_are_never_dropped():
    """b fails in most scenes, and is slightly better in the others."""
    a, b = np.ones(20), np.where(np.arange(20) < 12, INF, 0.9)
    row = one([({}, outcome({"a": a, "b": b}))], better="a", worse="b")
    assert row["verdict"] == "confirmed"
    assert (row["estimate"], row["high"]) == (0, 0)


def test_nothing_is_decided_without_scenes():
    assert verdicts([], better="a", worse="b") == "not decided by 0 scenes"
    points = [({}, outcome({"a": np.empty(0), "b": np.empty(0)}))]
    assert verdicts(points, better="a", worse="b") == "not decided by 0 scenes"
    assert verdicts(points, fails="a", at_most=0.5) == "not decided by 0 scenes"
    assert judge_claims([], []).empty


# errors


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"better": "a", "worse": "z"}, "methods: expected some of a, b, got z"),
        ({"grows": "a", "key": "scenario.snr"}, r"key: expected a swept key \(scenario.snr_db\), got scenario.snr"),
        ({"better": "a", "worse": "b", "key": SNR, "values": [7]}, r"expected one of its swept values \(0, 1\), got 7"),
        ({"better": "a", "worse": "b", "measure": "gap"}, "measure: expected one of error, .*, runtime_s, got gap"),
    ],
)
def test_claims_that_the_outcomes_cannot_answer(table, text):
    with pytest.raises(ValueError, match=f"claim 'claim 0': .*{text}"):
        judged(swept({"a": [1, 2], "b": [1, 2]}), table)


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({}, "expected one of better, equal, .*, runs, got none"),
        ({"better": "a", "grows": "a"}, "expected one of .*, got better, grows"),
        ({"better": "a"}, "worse: expected a value, as better compares with it, got none"),
        ({"grows": "a"}, "key: expected a value"),
        ({"floor": "a", "key": SNR, "start": 1}, "stop: expected a value"),
        ({"equal": ["a", "b"]}, "factor: expected a number above 1 for equal, got None"),
        ({"equal": ["a"], "factor": 1.1}, "equal: expected two methods, got 1"),
        ({"fails": "a"}, "at_least, at_most: expected a limit for fails, got none"),
        ({"fails": "a", "at_least": 1.5}, "expected shares from 0 to 1, got 1.5"),
        ({"degrades": "a", "more_than": "b"}, "key: expected the swept key along which the methods degrade"),
        ({"degrades": ["a", "b"], "more_than": "b"}, "more_than: expected one .* got 2 and 1"),
        ({"equal": ["a", "b"], "factor": 1.1, "measure": "hits"}, "measure: expected hits only for better and fails"),
    ],
)
def test_tables_that_contradict_themselves(table, text):
    with pytest.raises(OptionError, match=text):
        build(Compare, table)


def test_the_examples_of_the_documentation_are_valid():
    lines = [line.strip() for line in module.__doc__.splitlines() if line.strip().startswith("compare = {")]
    assert len(lines) >= 14
    kinds = {build(Compare, tomllib.loads(line)["compare"]).kind for line in lines}
    assert kinds == set(module.Compare.__dataclass_fields__) & kinds
    assert len(kinds) == 10


# the claims of results/paper/ledger.py

SOURCES, IMBALANCE = "scenario.sources", {"key": SNR, "start": [20, 20, 20], "stop": [0, 20, 40]}
MATCHED = {"measure": "gospa_m", "over": "everywhere"}
TIME = {"measure": "runtime_s"}
PAPER = [
    {"better": "NEMO-DE", "worse": "2D MUSIC"},
    {"better": "NEMO-DE", "worse": "2D MUSIC fine"},
    {"degrades": ["2D MUSIC fine", "2D MUSIC"], "more_than": ["modified fine", "modified"], "over": "overall"},
    {"grows": "all", "key": SOURCES},
    {"grows": ["NEMO-DE", "2D MUSIC", "2D MUSIC fine"], "key": SOURCES},
    {"runs": "modified fine", "status": "skipped", "at_least": 1.0},
    {"equal": ["NEMO-DE", "3D MUSIC"], "factor": 1.25},
    {"equal": ["NEEF-DE", "3D MUSIC"], "factor": 1.25},
    {"better": "NEEF-DE", "worse": "NEMO-DE", "key": SNR, "values": [[0, 20, 40], [10, 20, 30]]},
    {"changes": "NEMO-DE", **IMBALANCE, "at_least": 1.0},
    {"changes": "NEEF-DE", **IMBALANCE, "at_most": 2.0},
    {"better": "NEEF-DE", "worse": "NEMO-DE", "key": SNR, "values": [[0, 20, 40]]},
    {"changes": "modified fine", **IMBALANCE, "at_least": 2.0},
    {"better": "NEMO-DE", "worse": "NEEF-DE", **TIME},
    {"better": "NEEF-DE", "worse": "3D MUSIC", **TIME},
    {"better": "NEMO-DE", "worse": "NEEF-DE", "factor": 1.25},
    {"degrades": ["NEEF K=3", "NEEF K=2"], "more_than": ["NEMO K=3", "NEMO K=2"], **MATCHED},
    {"exponent": "NEMO-DE", "key": "scenario.array.elements", **TIME, "at_least": 0.75, "at_most": 1.25},
    {"exponent": "NEEF-DE", "key": "scenario.array.elements", **TIME, "at_least": 0.75, "at_most": 1.25},
    {"exponent": "2D MUSIC", "key": "scenario.array.elements", **TIME, "at_least": 1.75, "at_most": 2.25},
    {"better": "paper", "worse": "others", "factor": 1.0526},
    {"better": "paper: α = 1000", "worse": "none: α = 0"},
]


@pytest.mark.parametrize("table", PAPER, ids=lambda table: " ".join(map(str, table.values()))[:40])
def test_the_claims_of_the_paper_can_be_stated(table):
    """Each claim is judged on made-up outcomes that have its methods, key and measure."""
    compare = build(Compare, table)
    labels = [table.get(name, ()) for name in (compare.kind, "worse", "more_than")]
    listed = itertools.chain.from_iterable([each] if isinstance(each, str) else each for each in labels)
    methods = {m: [1.0, 1.0] for m in listed if m not in ("all", "others")} | {"another": [1.0, 1.0]}
    keys = {SNR: ["[20.0, 20.0, 20.0]", "[0.0, 20.0, 40.0]", "[10.0, 20.0, 30.0]"], "": [0, 1]}
    values = keys.get(compare.key, [64, 128])
    points = swept({m: [1.0] * len(values) for m in methods}, key=compare.key or SNR, keys=values)
    points = [
        (at, Outcomes(**{**vars(each), "columns": {**each.columns, "gospa_m": each.error}})) for at, each in points
    ]
    row = judged(points, table)[0]
    assert row["verdict"] in ("confirmed", "contradicted", "not decided by 20 scenes")
    assert row["scenes"] == 20


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"better": "a", "worse": "b"}, "error: better ÷ worse, below 1"),
        ({"better": "a", "worse": "b", "factor": 0.5, "measure": "seconds"}, "seconds: better ÷ worse, below 0.5"),
        (
            {"better": "a", "worse": "b", "measure": "hits"},
            "share of runs of the better method that reach the first target",
        ),
        ({"equal": ["a", "b"], "factor": 1.25}, "error: first ÷ second, above 0.8 and below 1.25"),
        ({"grows": "a", "key": SNR}, f"error: at the last ÷ first {SNR}, above 1"),
        ({"falls": "a", "key": SNR, "every_step": True}, "error: next ÷ previous value, below 1"),
        ({"floor": "a", "key": SNR, "start": 20, "stop": 30}, "error: at 30 ÷ at 20, at least 0.8"),
        ({"exponent": "a", "key": SNR, "at_most": 2}, f"error: exponent of its growth with {SNR}, at most 2"),
        ({"fails": "a", "measure": "hits", "at_most": 0.1}, "share of runs that miss the first target, at most 0.1"),
        ({"runs": "a", "status": "skipped", "at_least": 1}, "share of runs with the status skipped, at least 1"),
    ],
)
def test_what_an_estimate_is_of_is_said_in_words(table, words):
    assert quantity(build(Compare, table)) == words
