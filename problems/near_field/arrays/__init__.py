"""Antenna arrays: positions of the elements relative to an explicitly chosen origin, in metres.

A scenario declares its option as ``array: AnyArray``, which accepts a table of any kind.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

from nfbench import OneOf

from .axes import Axis
from .base import MAX_ELEMENTS, Array, Origin
from .custom import Custom
from .files import read_positions
from .panels import Panel, Panels
from .planar import Cross, Rings, Spiral, Sunflower
from .plausibility import unusual
from .uniform import UCA, ULA, UPA

__all__ = [
    "MAX_ELEMENTS",
    "UCA",
    "ULA",
    "UPA",
    "AnyArray",
    "Array",
    "Axis",
    "Cross",
    "Custom",
    "Origin",
    "Panel",
    "Panels",
    "Rings",
    "Spiral",
    "Sunflower",
    "read_positions",
    "unusual",
]

AnyArray: TypeAlias = Annotated[Array, OneOf(ULA, UPA, UCA, Cross, Rings, Spiral, Sunflower, Panels, Custom)]
