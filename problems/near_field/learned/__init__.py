"""Small neural networks that read sources from the spectrum of the signal subspace, one for each of two arrays.

``scenes`` has what they are trained for, and draws it. ``features`` is what they see, ``train`` trains them with
PyTorch, and ``network`` evaluates them in NumPy.
"""

from __future__ import annotations

from .features import PolarGrid, cosines, from_polar, to_polar
from .network import COMMAND, Network, load_network
from .scenes import SETTINGS, Setting

__all__ = [
    "COMMAND",
    "SETTINGS",
    "Network",
    "PolarGrid",
    "Setting",
    "cosines",
    "from_polar",
    "load_network",
    "to_polar",
]
