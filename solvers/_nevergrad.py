"""The algorithms of Nevergrad that do not work here, and the state of the libraries that Nevergrad calls."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import threading
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any
from unittest import mock

import nlopt
import numpy as np

__all__ = ["cannot_be_used", "contained", "surrogates_fail"]

LAST_KNOWN = (1, 0, 12)  # version of Nevergrad up to which its surrogate models fail with a recent NumPy
JOIN_S = 10.0  # time for a thread of Nevergrad to end after it was told to [s]

REQUIRES = {  # modules that "pip install nevergrad" does not install
    "AX": "ax",
    "AXP": "ax",
    "BOBYQA": "pybobyqa",
    "BayesOptimBO": "bayes_optim",
    "NGOptF": "bayes_optim",
    "PCABO": "bayes_optim",
    "PCABO80": "bayes_optim",
    "PCABO95DoE20": "bayes_optim",
    "PymooBIPOP": "pymoo.factory",
    "PymooCMAES": "pymoo.factory",
    "PymooNSGA2": "pymoo.factory",
    "SMAC3": "ConfigSpace",
    "pysot": "poap",
}
EXCLUDED = {
    "DS14": "its threads draw from one generator at the same time, so that its runs cannot be repeated",
    "MultiDS": "its threads draw from one generator at the same time, so that its runs cannot be repeated",
    "NLOPT_LN_NEWUOA_BOUND": "NLopt's NEWUOA_BOUND continues forever when it is stopped",
    "NgIohLn": "it waits forever for a value that Nevergrad does not pass on",
    "NgIohMLn": "it waits forever for a value that Nevergrad does not pass on",
    "NgIohRS": "it waits forever for a value that Nevergrad does not pass on",
    "VoxelizeMetaModelOnePlusOne": "it trains for a number of seconds, so that its runs cannot be repeated",
}
# Algorithms with a surrogate model; others may choose one for some budgets and numbers of unknowns.
SURROGATE = (
    "BAR4 CMandAS2 CSEC CSEC10 CSEC11 Carola1 Carola15 Carola2 Carola3 Carola4 Carola5 Carola6 Carola7 Carola9 "
    "ChainMetaModelDSSQP ChainMetaModelPowell ChainMetaModelSQP DS2 DS4 DS5 DS6 DS9 HSMetaModel ImageMetaModel "
    "ImageMetaModelD ImageMetaModelDiagonalCMA ImageMetaModelE ImageMetaModelLengler ImageMetaModelLogNormal "
    "ImageMetaModelOnePlusOne MetaModel MetaModelDE MetaModelDSproba MetaModelDiagonalCMA MetaModelFmin2 "
    "MetaModelLogNormal MetaModelOnePlusOne MetaModelPSO MetaModelQODE MetaModelTwoPointsDE MetaNGOpt10 NGOpt10 "
    "NGOpt15 NGOpt4 NGOpt8 NGOptSingle16 NGOptSingle25 NGOptSingle9 Neural1MetaModel Neural1MetaModelD "
    "Neural1MetaModelE Neural1MetaModelLogNormal Neural1MetaModelOnePlusOne NeuralMetaModel NeuralMetaModelDE "
    "NeuralMetaModelLogNormal NeuralMetaModelTwoPointsDE NgDS NgDS11 NgDS2 NgDS3 NgIoh NgIoh10 NgIoh11 NgIoh12 "
    "NgIoh12b NgIoh13 NgIoh13b NgIoh14 NgIoh14b NgIoh15 NgIoh15b NgIoh16 NgIoh17 NgIoh18 NgIoh19 NgIoh2 NgIoh20 "
    "NgIoh21 NgIoh3 NgIoh4 NgIoh5 NgIoh6 NgIoh7 NgIoh8 NgIoh9 NgIohTuned PCarola6 Quad1MetaModel Quad1MetaModelD "
    "Quad1MetaModelE Quad1MetaModelOnePlusOne RF1MetaModel RF1MetaModelD RF1MetaModelE RF1MetaModelLogNormal "
    "RF1MetaModelOnePlusOne RFMetaModel RFMetaModelDE RFMetaModelLogNormal RFMetaModelOnePlusOne RFMetaModelPSO "
    "RFMetaModelTwoPointsDE SVM1MetaModel SVM1MetaModelD SVM1MetaModelE SVM1MetaModelLogNormal "
    "SVM1MetaModelOnePlusOne SVMMetaModel SVMMetaModelDE SVMMetaModelLogNormal SVMMetaModelPSO "
    "SVMMetaModelTwoPointsDE SplitCSEC11 Wiz pCarola6 "
)


def cannot_be_used() -> dict[str, str]:
    """Return the algorithms that do not work with the installed libraries, each with the reason.

    Nevergrad is not imported.
    """
    found = dict(EXCLUDED)
    for name, module in REQUIRES.items():
        if not _installed(module):
            hint = " of an older pymoo" if module == "pymoo.factory" else ""
            found[name] = f"it needs the module {module}{hint}, which is not installed here"
    if reason := surrogates_fail():
        found |= dict.fromkeys(SURROGATE.split(), reason)
    return dict(sorted(found.items()))


@functools.cache
def surrogates_fail() -> str:
    """Return why Nevergrad's surrogate models fail here; empty if they work."""
    installed = version("nevergrad")
    if tuple(int(part) for part in installed.split(".")[:3] if part.isdigit()) > LAST_KNOWN:
        return ""
    try:
        with contextlib.suppress(DeprecationWarning):
            float(np.ones(1))  # what Nevergrad does
    except TypeError:
        return (
            f"the surrogate models of Nevergrad {installed} fail with NumPy {np.__version__}; "
            "pip install 'numpy<2.4' or choose another algorithm"
        )
    return ""


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # its package is not installed
        return False


@contextlib.contextmanager
def contained(seed: int) -> Iterator[None]:
    """Seed the libraries that Nevergrad calls without a seed, and end the threads in which it calls them.

    pycma would draw its seed from the clock. NLopt has one generator per thread, also seeded from the clock.
    """
    from cma.options_parameters import cma_default_options

    before = set(threading.enumerate())
    # with NaN, pycma continues with NumPy's global generator
    with mock.patch.dict(cma_default_options, {"seed": np.nan}), _seeded_nlopt(seed):
        try:
            yield
        finally:
            _end_threads(before)


@contextlib.contextmanager
def _seeded_nlopt(seed: int) -> Iterator[None]:
    """Seed NLopt's generator of the current thread whenever an optimizer is constructed."""
    original = nlopt.opt

    def seeded(*arguments: Any) -> Any:
        nlopt.srand(seed)
        return original(*arguments)

    with mock.patch.object(nlopt, "opt", seeded):
        yield


def _end_threads(before: set[threading.Thread]) -> None:
    """End the threads that wait for a value of the objective, which Nevergrad leaves running when a run ends."""
    from nevergrad.optimization.recaster import _MessagingThread

    for thread in set(threading.enumerate()) - before:
        if isinstance(thread, _MessagingThread):
            thread.stop()
            thread.join(JOIN_S)
