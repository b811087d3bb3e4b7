"""Which formulations of a study have a proof of their optimum."""

from __future__ import annotations

from collections.abc import Sequence

from nfbench.core import Formulation

from .records import Method
from .resolve import Resolver

__all__ = ["provable"]


def provable(methods: Sequence[Method], resolver: Resolver) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the labels of the formulations with a solver that have a proof of their optimum, and of the others."""
    found = {method.formulation.label: method.formulation for method in methods if method.solver}
    having: list[str] = []
    lacking: list[str] = []
    for label, spec in found.items():
        made = resolver.made("formulation", spec)
        if isinstance(made, Formulation):  # the runs of one that cannot be imported fail anyway
            proof = type(made).reference
            own = callable(proof) and proof is not Formulation.reference  # it may be an option of this name
            (having if own else lacking).append(label)
    return tuple(having), tuple(lacking)
