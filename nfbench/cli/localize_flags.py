"""Messages of ``localize`` in the words of the command line: flags in place of the options of a scenario."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from nfbench.core import NfbenchError, OptionError

from . import localize_options as opt

__all__ = ["in_flags", "naming_flags", "naming_method_flags"]

FLAGS = {  # by the path of the option: its flag, and its value where the option is required
    "data": ("DATA", ""),
    "array.file": ("--positions", "FILE"),
    "sources": ("--sources", opt.metavar(opt.Sources)),
    "azimuth_deg": ("--azimuth-deg", opt.metavar(opt.Azimuths)),
    "elevation_deg": ("--elevation-deg", opt.metavar(opt.Elevations)),
    "range_m": ("--range-m", opt.metavar(opt.Ranges)),
    "speed_m_s": ("--speed", "NUMBER"),
    **{f"array.{name}": (f"--{name}", "") for name in ("broadside", "up", "unit", "origin")},
    **{
        name: (f"--{name.replace('_', '-')}", "NUMBER")
        for name in ("frequency_hz", "wavelength_m", "sample_rate_hz", "snapshots", "block", "overlap", "element_axis")
    },
    **{name: (f"--{name}", "NAME") for name in ("failed", "window", "variable", "wavefront", "conjugate")},
}
KINDS = {"samples": "--sample-rate-hz NUMBER", "covariance": "--covariance"}  # values of data_kind
ARRAY = "array."
LISTED = r'(?:"[^"]*"|\[[^\]]*\]|[-+\w.]*\w)'  # a value as it is written in a manifest

_names = {path.removeprefix(ARRAY): flag for path, (flag, _) in FLAGS.items() if path not in ("data", "array.file")}
_ASSIGNED = re.compile(rf"\b(data_kind|{'|'.join(_names)}) = ({LISTED})")
_ALONE = re.compile(rf"(?<![-\w.])({'|'.join(name for name in _names if '_' in name)})(?![-\w])")


def in_flags(text: str) -> str:
    """Return a sentence with flags in place of the options that it names; one that names flags stays as it is."""
    if "(--" in text:
        return text
    text = text.replace('data_kind = "samples" and sample_rate_hz', KINDS["samples"])
    text = re.sub(r'(data_kind = "\w+"), got "\w+"', r"\1", text)
    return _ALONE.sub(lambda found: _names[found[1]], _ASSIGNED.sub(_assigned, text))


def _assigned(found: re.Match[str]) -> str:
    """``failed = [5, 19]`` becomes ``--failed 5,19``."""
    name, value = found.groups()
    bare = value.strip('"')
    if name == "data_kind":
        return KINDS.get(bare, found[0])
    if value.startswith("["):
        bare = re.sub(r"[\s\"'\[\]]", "", value)
        bare = bare.replace(",", " ") if name in ("azimuth_deg", "elevation_deg", "range_m") else bare
    return _names[name] if name == "conjugate" else f"{_names[name]} {bare}"


@contextmanager
def naming_flags() -> Iterator[None]:
    """Within this context, errors in options of the scenario name flags, one line per error."""
    try:
        yield
    except OptionError as error:
        raise _listed([_line(path, text) for path, text in error.problems]) from error


@contextmanager
def naming_method_flags(solver_options: Sequence[str]) -> Iterator[None]:
    """The same for errors in options of a method, of which ``solver_options`` are those given for the solver."""
    try:
        yield
    except OptionError as error:
        of_solver = {text.partition("=")[0] for text in solver_options}
        lines = []
        for path, text in error.problems:
            flag = "--solver-option" if re.split(r"[.\[]", path)[0] in of_solver else "--option"
            lines.append(f"{flag} {path}=VALUE is required" if _is_missing(text) else f"{flag} {path}: {text}")
        raise _listed(lines) from error


def _listed(lines: list[str]) -> NfbenchError:
    if len(lines) == 1:
        return NfbenchError(lines[0])
    return NfbenchError("\n".join([f"{len(lines)} options are missing or wrong:", *(f"  {line}" for line in lines)]))


def _is_missing(text: str) -> bool:
    return text == "is required" or text.startswith("is required: expected ")


def _line(path: str, text: str) -> str:
    """One error, with the flag in place of the path."""
    text = in_flags(text)
    name = path if path in FLAGS else re.sub(r"\[\d+\]$", "", path)
    if name not in FLAGS:
        if path.startswith(ARRAY):
            return f"--array {path.removeprefix(ARRAY)}: {text}"
        return f"--scenario-option {path}: {text}" if path else text
    flag, value = FLAGS[name]
    if _is_missing(text):
        return f"{flag} {value}".rstrip() + " is required"
    return f"{flag} {text}" if text.startswith("is required") else f"{flag}: {text}"
