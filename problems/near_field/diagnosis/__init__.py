"""What an estimate says about the sources in received data, how well it explains them, and what may be wrong."""

from __future__ import annotations

from .broken_elements import silent_elements
from .description import describe_sources
from .diagnose import Diagnosis, diagnose
from .eigenvalues import Spectrum, spectrum
from .goodness import Fit, fit
from .reading import Reading

__all__ = [
    "Diagnosis",
    "Fit",
    "Reading",
    "Spectrum",
    "describe_sources",
    "diagnose",
    "fit",
    "silent_elements",
    "spectrum",
]
