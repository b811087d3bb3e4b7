"""Imports plugin files, first in a child process, so that a file that hangs or ends its process does no harm."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from nfbench.core import explain, printable

from .rehearsal import rehearse

__all__ = ["IMPORT_S", "import_file"]

IMPORT_S = 120.0  # time limit for importing a plugin file [s]
_probed: dict[str, str] = {}  # module name → why it cannot be imported; empty if it can


def import_file(file: Path, version: str) -> ModuleType:
    """Import a file under a unique module name, registered in sys.modules because dataclasses and pickle need it.

    The working directory, environment variables and filters of warnings are restored afterwards. Raises ImportError,
    with the reason, if the file raises any exception, ends or kills its process, or takes longer than IMPORT_S.
    """
    name = f"nfbench_plugin_{re.sub(r'[^0-9a-zA-Z]', '_', file.stem)}_{version}"
    if name in sys.modules:
        return sys.modules[name]
    if name not in _probed:
        _probed[name] = _why_not(file, name)
    if _probed[name]:
        raise ImportError(_probed[name])
    return _load(file, name)


def _load(file: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError("expected a Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with _restored():
            spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        raise ImportError(_reason(error)) from error
    return module


def _reason(error: BaseException) -> str:
    hint = "; put @dataclass(frozen=True) above its classes" if "non-frozen dataclass" in str(error) else ""
    return printable(f"{explain(error)}{hint}")


@contextlib.contextmanager
def _restored() -> Iterator[None]:
    """Restore afterwards what a plugin file may change by habit, since it would hold for all plugins and their results.

    These are the working directory, environment variables, the filters of warnings and NumPy's error handling. What
    the file imports has read its variables by then; code that reads them later sets them in the plugin's methods.
    """
    before = os.getcwd()  # noqa: PTH109  # restored by name
    variables = dict(os.environ)
    try:
        with np.errstate(), warnings.catch_warnings():
            yield
    finally:
        os.chdir(before)
        for name in os.environ.keys() - variables.keys():
            del os.environ[name]
        for name, value in variables.items():
            if os.environ.get(name) != value:
                os.environ[name] = value


def _why_not(file: Path, name: str) -> str:
    """Why the file cannot be imported, found out in a child process; empty if it can, or where there is no fork."""

    def load() -> str:
        try:
            _load(file, name)
        except ImportError as error:
            return str(error)
        return ""

    advice = "a plugin file must only define classes, and slow code belongs in minimize, draw or solve"
    return rehearse(load, "imported", advice, IMPORT_S)
