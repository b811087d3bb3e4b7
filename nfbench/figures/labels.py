"""Labels of axes: a swept key's name and unit, its values as text, and their places on an axis."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, final

import numpy as np

from nfbench.core import printable
from nfbench.results import from_cell

__all__ = ["Places", "name_of", "places", "plain", "setting", "short", "text_of"]

LONGEST = 400  # bytes of a line; longer ones end in an ellipsis
_NAMES = {  # swept keys whose label needs more than the name, such as a symbol
    "snr_db": "SNR [dB]",
    "rician_k": "Rician factor κ",
    "sources": "Number of sources K",
    "snapshots": "Number of snapshots T",
    "array.elements": "Number of elements M",
    "wavelength_m": "Wavelength λ [m]",
    "frequency_hz": "Frequency f [Hz]",
    "speed_m_s": "Speed of the waves c [m/s]",
    "nlos": "Scattering",
    "nlos.kind": "Scattering",
    "dimension": "Dimension n",
    "budget.evaluations": "Budget [evaluations]",
    "budget.seconds": "Budget [s]",
    "budget.target": "Target objective",
}
_UNITS = {"db": "dB", "m": "m", "deg": "°", "rad": "rad", "s": "s", "hz": "Hz", "wavelengths": "λ"}
_LINEAR_UNITS = ("[dB]", "[°]", "[rad]")


def plain(text: str) -> str:
    """Text that matplotlib prints literally, without control characters.

    There is no mathematics between dollar signs, and no label is hidden by its ``_``.
    """
    text = "\n".join(printable(line, LONGEST) for line in text.split("\n")).replace("$", r"\$")
    return f"\N{THIN SPACE}{text}" if text.startswith("_") else text


def short(name: str, most: int) -> str:
    """A method's name in at most this many characters: without the names of its options, and cut in the middle.

    The end is kept because that is where the names of similar methods differ.
    """
    if len(name) > most:
        name = re.sub(r"\b[A-Za-z_]+=", "", name)
    if len(name) > most:
        head = most // 2
        name = f"{name[: most - 1 - head].rstrip()}…{name[len(name) - head :].lstrip()}"
    return plain(name)


def name_of(key: str, given: Mapping[str, str] = MappingProxyType({})) -> str:
    """A swept key as an axis label: ``array.spacing_wavelengths`` is ``Array spacing [λ]``, unless a label is given."""
    if key in given:
        return plain(given[key])
    if key in _NAMES:
        return _NAMES[key]
    words = key.replace(".", "_").split("_")
    unit = f" [{_UNITS[words.pop()]}]" if len(words) > 1 and words[-1] in _UNITS else ""
    name = " ".join(words)
    return plain(name[:1].upper() + name[1:] + unit)


def setting(key: str, value: Any, given: Mapping[str, str] = MappingProxyType({})) -> str:
    """One value of a swept key as a heading: ``SNR = 20 dB``, or ``κ = ∞`` if the key has a symbol."""
    name, _, unit = name_of(key, given).partition(" [")
    symbol, unit = name.rpartition(" ")[2], unit.rstrip("]")
    return f"{symbol if len(symbol) == 1 else name} = {text_of(value)}{' ' * bool(unit and unit != '°')}{unit}"


def text_of(value: Any) -> str:
    """A cell of a swept column as text: ∞ for infinity, ``0, 20, 40`` for a list, kind and options for a table."""
    return _text(from_cell(value))


def _text(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | float | np.number):
        return ("∞" if value > 0 else "−∞") if math.isinf(value) else f"{value:g}".replace("-", "−")
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    if isinstance(value, dict):
        options = ", ".join(f"{key} = {_text(option)}" for key, option in value.items() if key != "kind")
        kind = str(value.get("kind", ""))
        return plain(f"{kind} ({options})" if kind and options else kind or options)
    return plain(str(value))


@final
@dataclass(frozen=True)
class Places:
    """The places of a numeric key's values on its axis. ∞ is placed one step beyond the last finite value.

    of: place of each value.
    log: whether the axis is logarithmic.
    """

    of: dict[float, float]
    log: bool

    @property
    def beyond(self) -> float | None:
        """The place of ∞; None if it is not among the values."""
        return self.of.get(math.inf)


def places(key: str, values: Sequence[Any]) -> Places | None:
    """Return the places of a key's values; None for categories: text, lists, or fewer than two finite numbers."""
    if not all(isinstance(v, int | float | np.number) and not isinstance(v, bool | np.bool_) for v in values):
        return None
    numbers = sorted({float(value) for value in values})
    finite = [number for number in numbers if math.isfinite(number)]
    if len(finite) < 2 or -math.inf in numbers:
        return None
    log = not name_of(key).endswith(_LINEAR_UNITS) and finite[0] > 0 and _geometric(finite)
    of = {number: number for number in finite}
    if math.inf in numbers:
        last, before = finite[-1], finite[-2]
        of[math.inf] = last * min(last / before, 10.0) if log else 2 * last - before
    return Places(of, log)


def _geometric(numbers: list[float]) -> bool:
    """Whether the numbers span a decade, in steps whose ratios vary less than their differences."""
    return numbers[-1] >= 10 * numbers[0] and _unevenness(np.log(numbers)) <= _unevenness(np.array(numbers))


def _unevenness(numbers: np.ndarray) -> float:
    steps = np.diff(numbers)
    return float(steps.std() / steps.mean())
