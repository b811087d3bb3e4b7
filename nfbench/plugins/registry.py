"""The registry: finds scenarios, formulations and solvers by entry point and by file, and imports them when needed."""

from __future__ import annotations

import contextlib
import contextvars
import functools
import hashlib
import importlib.util
import inspect
import re
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Literal, overload

from nfbench.core import (
    Extra,
    Formulation,
    MissingExtra,
    OptionError,
    Options,
    PluginError,
    Scenario,
    Solver,
    build,
    explain,
    suggest,
)

__all__ = ["CONTRACTS", "Plugin", "Registry"]

_present: contextvars.ContextVar[Registry | None] = contextvars.ContextVar("present", default=None)

IMPORT_S = 120.0  # for a plugin file to be imported
CONTRACTS: dict[str, type[Options]] = {"solver": Solver, "formulation": Formulation, "scenario": Scenario}


@dataclass(frozen=True)
class Plugin:
    """One registered class: where it comes from, and the version that enters a run's identity."""

    kind: str
    name: str
    origin: str
    version: str
    load: EntryPoint | type[Options]

    def resolve(self) -> type[Options]:
        """The class itself. Raises PluginError, naming the plugin and the error, if it cannot be imported."""
        if isinstance(self.load, type):
            return self.load
        try:
            cls = self.load.load()
        except Exception as error:
            raise PluginError(f"{self.kind} {self.name} of {self.origin} failed to import: {explain(error)}") from error
        contract = CONTRACTS[self.kind]
        if not (isinstance(cls, type) and issubclass(cls, contract) and is_dataclass(cls)):
            raise PluginError(
                f"{self.kind} {self.name} of {self.origin}: expected a frozen dataclass derived from "
                f"nfbench.{contract.__name__}, got {cls!r}"
            )
        return cls

    def missing(self, made: Options | None = None) -> str | None:
        """Where it needs libraries that are not all installed: which, and how to install them.

        made: it with the options it shall have; None: with the default ones. Looks for the modules without importing
        them. Raises PluginError if the plugin itself cannot be imported.
        """
        extra = _extra(self.resolve(), made)
        requires = extra.requires if extra else ()
        absent = [module for module in requires if importlib.util.find_spec(module.partition(".")[0]) is None]
        if extra is None or not absent:
            return None
        package = self.origin.partition(" ")[0]
        wanted = f"'{package}[{extra.name}]'" if extra.name else " ".join(absent)
        return f"needs {', '.join(absent)}, not installed here: pip install {wanted}"


class Registry:
    """Every plugin that can be named: the installed entry points, and the classes in ``files``.

    A file that fails to import is kept in ``broken`` with its error, and the rest goes on. Two plugins of one kind
    and name raise PluginError; so does a file that does not exist.
    """

    def __init__(self, files: Iterable[str | Path] = ()) -> None:
        self.files = tuple(Path(file).resolve() for file in files)
        self.broken: dict[Path, str] = {}
        self._plugins: dict[tuple[str, str], Plugin] = {}
        for kind in CONTRACTS:
            for point in entry_points(group=f"nfbench.{kind}s"):
                origin, version = (point.dist.name, point.dist.version) if point.dist else ("unknown", "")
                self._add(Plugin(kind, point.name, f"{origin} {version}".strip(), version, point))
        for file in dict.fromkeys(self.files):
            self._add_file(file)

    def names(self, kind: str) -> list[str]:
        """The registered names of a kind (solver, formulation or scenario), sorted."""
        return sorted(name for k, name in self._plugins if k == kind)

    def find(self, kind: str, name: str) -> Plugin:
        """The plugin of this name. Raises PluginError, suggesting the nearest name, if there is none."""
        try:
            return self._plugins[kind, name]
        except KeyError:
            hint = suggest(name, self.names(kind))
            if "did you mean" not in hint:
                hint += "; your own is found by --plugin FILE, or in a manifest by plugins = [FILE]"
            raise PluginError(f"unknown {kind} {name!r}{hint}") from None

    @overload
    def make(self, kind: Literal["solver"], name: str, options: Mapping[str, Any]) -> Solver: ...
    @overload
    def make(self, kind: Literal["formulation"], name: str, options: Mapping[str, Any]) -> Formulation: ...
    @overload
    def make(self, kind: Literal["scenario"], name: str, options: Mapping[str, Any]) -> Scenario: ...
    @overload
    def make(self, kind: str, name: str, options: Mapping[str, Any]) -> Options: ...
    def make(self, kind: str, name: str, options: Mapping[str, Any]) -> Options:
        """Construct a plugin from its options. Raises PluginError, MissingExtra or OptionError."""
        plugin = self.find(kind, name)
        token = _present.set(self)
        try:
            made = build(plugin.resolve(), options)
        finally:
            _present.reset(token)
        if missing := plugin.missing(made):
            raise MissingExtra(f"{kind} {name} {missing}")
        return made

    @classmethod
    def present(cls) -> Registry:
        """The registry that is making a plugin at this moment, else that of what is installed."""
        return _present.get() or _installed()

    def _add(self, plugin: Plugin) -> None:
        other = self._plugins.setdefault((plugin.kind, plugin.name), plugin)
        if other is not plugin:
            raise PluginError(
                f"two {plugin.kind}s are named {plugin.name!r}: one from {other.origin}, one from {plugin.origin}; "
                f"rename one of them"
            )

    def _add_file(self, file: Path) -> None:
        try:
            source = file.read_bytes()
        except OSError as error:
            raise PluginError(f"plugin file {file}: {error.strerror or error}") from error
        version = hashlib.sha256(source).hexdigest()[:16]
        try:
            with _deadline(IMPORT_S):
                module = _import_file(file, version)
        except _TooLate:
            self.broken[file] = f"was not imported within {IMPORT_S:g} s; leave work to minimize, draw and solve"
            return
        except (Exception, SystemExit) as error:
            hint = "; put @dataclass(frozen=True) above its classes" if "non-frozen dataclass" in str(error) else ""
            self.broken[file] = f"{explain(error)}{hint}"
            return
        found = [cls for cls in vars(module).values() if _is_plugin(cls, module)]
        if not found:
            self.broken[file] = "defines no class derived from nfbench.Solver, Formulation or Scenario"
        for cls in found:
            kind = next(kind for kind, contract in CONTRACTS.items() if issubclass(cls, contract))
            name = vars(cls).get("name") or _kebab(cls.__name__)
            self._add(Plugin(kind, name, file.name, version, cls))


class _TooLate(BaseException):
    """An import takes too long; no Exception, which the imported file could swallow."""


@contextlib.contextmanager
def _deadline(seconds: float) -> Iterator[None]:
    """Raises _TooLate in Python code that takes longer; only a program's main thread has such a limit."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def late(number: int, frame: FrameType | None) -> None:
        raise _TooLate

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _extra(cls: type[Options], made: Options | None) -> Extra | None:
    """The extra that a plugin needs; of a scenario, where options lack that have no default, it is not known yet."""
    if issubclass(cls, Solver):
        return Extra(cls.info.extra, cls.info.requires)
    if issubclass(cls, Scenario) and cls.needed_extra is not Scenario.needed_extra:
        with contextlib.suppress(OptionError):
            scenario = made if isinstance(made, Scenario) else build(cls, {})
            return scenario.needed_extra()
    return None


@functools.cache
def _installed() -> Registry:
    return Registry()


def _import_file(file: Path, version: str) -> ModuleType:
    """Import a file under a name of its own; the module is registered, as dataclasses and pickle need it."""
    name = f"nfbench_plugin_{re.sub(r'[^0-9a-zA-Z]', '_', file.stem)}_{version}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError("expected a Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _is_plugin(cls: object, module: ModuleType) -> bool:
    return (
        inspect.isclass(cls)
        and issubclass(cls, tuple(CONTRACTS.values()))
        and cls.__module__ == module.__name__
        and not inspect.isabstract(cls)
    )


def _kebab(name: str) -> str:
    """``MyOwnSolver`` as ``my-own-solver``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", name).lower()
