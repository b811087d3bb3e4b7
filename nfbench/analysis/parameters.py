"""The parameters of sources, such as azimuth and range, for which runs have errors and bounds of their own."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Parameter", "parameters"]


@dataclass(frozen=True)
class Parameter:
    """A parameter of the sources, and the names of its columns.

    name: name of the parameter, such as ``azimuth``.
    unit: suffix that states its unit, such as ``deg``.
    """

    name: str
    unit: str

    @property
    def error(self) -> str:
        """The root mean square error over the sources of a run, and over the runs in the summary."""
        return f"{self.name}_rmse_{self.unit}"

    @property
    def bound(self) -> str:
        """The Cramér–Rao bound of that error."""
        return f"crb_{self.name}_{self.unit}"

    @property
    def bias(self) -> str:
        """The median of the signed errors, in the summary."""
        return f"{self.name}_bias_{self.unit}"

    def signed(self, columns: Iterable[str]) -> list[str]:
        """The columns of the signed errors of single sources."""
        return [name for name in columns if re.fullmatch(rf"{self.name}_error_\d+_{self.unit}", name)]

    @property
    def symbol(self) -> str:
        """The unit as it is printed."""
        return "°" if self.unit == "deg" else self.unit


def parameters(columns: Iterable[str]) -> list[Parameter]:
    """Return the parameters that have a column ``<name>_rmse_<unit>``, in the order of these columns."""
    found = (re.fullmatch(r"([a-z]+)_rmse_([a-z]+)", name) for name in columns)
    return [Parameter(*match.groups()) for match in found if match]
