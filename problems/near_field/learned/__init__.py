"""A small neural network that reads sources from the spectrum of the signal subspace.

``scenes`` draws what it is trained on, ``features`` is what it sees, ``train`` trains it with PyTorch, and ``network``
evaluates it in NumPy.
"""

from __future__ import annotations

from .features import PolarGrid, from_polar, to_polar
from .network import COMMAND, Network, load_network
from .scenes import training_scenario

__all__ = ["COMMAND", "Network", "PolarGrid", "from_polar", "load_network", "to_polar", "training_scenario"]
