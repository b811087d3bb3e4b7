"""The statistics of nfbench: summaries, intervals, tests, rankings and claims, and the sentences that state them.

The functions take tables and arrays, not folders, so they can analyse rows from any source.
"""

from __future__ import annotations

from .choice import LIKELY, MEETS, MISSES
from .choice_answer import Choice, answer
from .choice_costs import Cell, Request, cells_of
from .choice_overview import Overview, overview
from .claim_parts import same_value
from .claims import judge_claims, quantity
from .distributions import (
    Axis,
    aocc_table,
    attainment,
    fixed_budget_table,
    fixed_target_table,
    performance_profile,
    runtime_distribution,
    value_at,
)
from .headline import headline, scene_table
from .intervals import (
    bounded_mean_interval,
    ecdf_band,
    ert,
    ert_interval,
    quantile_interval,
    ratio_interval,
    rms_of_solved_interval,
    share_interval,
    variance_components,
)
from .landscape import Minima, find_minima, landscape_facts
from .outcomes import Outcomes, Point, outcomes
from .paired import PairedChange, paired_change, tuning_verdict
from .parameters import Parameter, parameters
from .ranking import ALL, Block, Ranking, rank
from .sentences import sentence, sentences, time_text
from .sign_flips import holm, log_ratios, sign_flip_pvalue, signed_ranks
from .summary import default_groups, summarize
from .targets import (
    Target,
    default_targets,
    first_reached,
    parse_targets,
    reached_for_good,
    swept_columns,
    target_table,
)

__all__ = [
    "ALL",
    "LIKELY",
    "MEETS",
    "MISSES",
    "Axis",
    "Block",
    "Cell",
    "Choice",
    "Minima",
    "Outcomes",
    "Overview",
    "PairedChange",
    "Parameter",
    "Point",
    "Ranking",
    "Request",
    "Target",
    "answer",
    "aocc_table",
    "attainment",
    "bounded_mean_interval",
    "cells_of",
    "default_groups",
    "default_targets",
    "ecdf_band",
    "ert",
    "ert_interval",
    "find_minima",
    "first_reached",
    "fixed_budget_table",
    "fixed_target_table",
    "headline",
    "holm",
    "judge_claims",
    "landscape_facts",
    "log_ratios",
    "outcomes",
    "overview",
    "paired_change",
    "parameters",
    "parse_targets",
    "performance_profile",
    "quantile_interval",
    "quantity",
    "rank",
    "ratio_interval",
    "reached_for_good",
    "rms_of_solved_interval",
    "runtime_distribution",
    "same_value",
    "scene_table",
    "sentence",
    "sentences",
    "share_interval",
    "sign_flip_pvalue",
    "signed_ranks",
    "summarize",
    "swept_columns",
    "target_table",
    "time_text",
    "tuning_verdict",
    "value_at",
    "variance_components",
]
