"""The registry: finds scenarios, formulations and solvers in entry points and in plugin files, and constructs them."""

from __future__ import annotations

import contextlib
import contextvars
import functools
import hashlib
import importlib.util
import inspect
import pickle
import re
import weakref
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, is_dataclass
from importlib.metadata import EntryPoint, entry_points
from multiprocessing import parent_process
from pathlib import Path
from threading import current_thread, main_thread
from types import ModuleType
from typing import Any, Literal, overload

from nfbench.core import (
    BudgetExhausted,
    Extra,
    Formulation,
    MissingExtra,
    NfbenchError,
    OptionError,
    Options,
    PluginError,
    Scenario,
    Solver,
    SolverInfo,
    build,
    canonical,
    explain,
    printable,
    suggest,
)

from .importing import import_file
from .rehearsal import MAKE_S, Rehearsal, rehearse, rehearsing

__all__ = ["CONTRACTS", "Plugin", "Registry"]

_active: contextvars.ContextVar[Registry | None] = contextvars.ContextVar("active", default=None)

SHOWN = 200  # bytes of the options in a message
REMEMBERED = 10_000  # options of plugins that need not be tried again
_ADVICE = "slow code, and code that may end the process, belongs in minimize, draw or solve"
_harmless: set[bytes] = set()  # digests of the plugins and options that have been constructed in a child process

CONTRACTS: dict[str, type[Options]] = {"solver": Solver, "formulation": Formulation, "scenario": Scenario}
_REQUIRED: dict[str, dict[str, type]] = {  # class variables that the framework relies on
    "solver": {"info": SolverInfo},
    "formulation": {"accepts": type, "needs_solver": bool},
    "scenario": {"instance": type, "error": str},
}


@dataclass(frozen=True)
class Plugin:
    """One registered class.

    kind: "solver", "formulation" or "scenario".
    name: name under which the class is registered.
    origin: package and its version, or name of the file, that provides the class.
    version: version of the package or hash of the file's content; it is part of a run's identity.
    load: class itself, or entry point from which it is imported.
    """

    kind: str
    name: str
    origin: str
    version: str
    load: EntryPoint | type[Options]

    @property
    def foreign(self) -> bool:
        """Whether the class comes from a plugin file, and not from an installed package."""
        return isinstance(self.load, type)

    def resolve(self) -> type[Options]:
        """Import the class if necessary and return it.

        Raises PluginError, with the plugin and the cause, if the import fails or the object is not a valid plugin.
        """
        try:
            cls = self.load if isinstance(self.load, type) else self.load.load()
        except (Exception, SystemExit) as error:
            raise PluginError(f"{self.kind} {self.name} of {self.origin} failed to import: {explain(error)}") from error
        contract = CONTRACTS[self.kind]
        if not (isinstance(cls, type) and issubclass(cls, contract) and is_dataclass(cls)):
            raise PluginError(
                f"{self.kind} {self.name} of {self.origin}: expected a frozen dataclass derived from "
                f"nfbench.{contract.__name__}, got {cls!r}"
            )
        for attribute, expected in _REQUIRED[self.kind].items():
            if not isinstance(found := getattr(cls, attribute, None), expected):
                raise PluginError(
                    f"{self.kind} {self.name} of {self.origin}: expected the class variable `{attribute}` to be "
                    f"a {expected.__name__}, got {found!r}"
                )
        return cls

    def missing(self, made: Options | None = None) -> str | None:
        """Return which of the libraries that the plugin needs are not installed and how to install them; None if none.

        made: plugin object, whose options may determine which libraries it needs; None for the default options.

        The libraries are located without importing them. Raises PluginError if the plugin itself cannot be imported.
        """
        extra = _extra(self.resolve(), made)
        requires = extra.requires if extra else ()
        absent = [module for module in requires if importlib.util.find_spec(module.partition(".")[0]) is None]
        if extra is None or not absent:
            return None
        package = self.origin.partition(" ")[0]
        wanted = f"'{package}[{extra.name}]'" if extra.name else " ".join(absent)
        verb = "is" if len(absent) == 1 else "are"
        return f"needs {', '.join(absent)}, which {verb} not installed here: pip install {wanted}"


class Registry:
    """All available plugins: those of the installed entry points and the classes in ``files``.

    A file that fails to import is listed in ``broken`` with its error, and the other plugins remain available. Raises
    PluginError if two plugins of the same kind have the same name, or if a file does not exist.
    """

    def __init__(self, files: Iterable[str | Path] = ()) -> None:
        self.files = tuple(Path(file).resolve() for file in files)
        self.broken: dict[Path, str] = {}
        self._plugins: dict[tuple[str, str], Plugin] = {}
        self._rehearsal: Rehearsal | None = None
        for kind in CONTRACTS:
            for point in entry_points(group=f"nfbench.{kind}s"):
                origin, version = (point.dist.name, point.dist.version) if point.dist else ("unknown", "")
                self._add(Plugin(kind, point.name, f"{origin} {version}".strip(), version, point))
        for file in dict.fromkeys(self.files):
            self._add_file(file)

    def names(self, kind: str) -> list[str]:
        """Return the sorted names of the registered plugins of a kind: solver, formulation or scenario."""
        return sorted(name for k, name in self._plugins if k == kind)

    def find(self, kind: str, name: str) -> Plugin:
        """Return the plugin with this kind and name. If there is none, raise PluginError with the nearest name."""
        try:
            return self._plugins[kind, name]
        except KeyError:
            hint = suggest(name, self.names(kind))
            if "did you mean" not in hint:
                hint += "; to use your own, pass --plugin FILE or add plugins = [FILE] to the manifest"
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
        """Construct a plugin from its options.

        Raises PluginError if the plugin is unknown or cannot be imported, OptionError if an option is invalid, and
        MissingExtra if a library that it needs is not installed.
        """
        plugin = self.find(kind, name)
        if plugin.foreign and _contains_runs() and (reason := self._why_not(plugin, options)):
            given = ", ".join(f"{option} = {value!r}" for option, value in options.items())
            how = f" with {printable(given, SHOWN)}" if given else ""
            raise PluginError(f"{kind} {name} of {plugin.origin} cannot be made{how}: {reason}")
        return self._make(plugin, options)

    def _make(self, plugin: Plugin, options: Mapping[str, Any]) -> Options:
        token = _active.set(self)
        try:
            try:
                made = build(plugin.resolve(), options)
                missing = plugin.missing(made)
            except OptionError as error:
                raise _plain(error) from error
        except (OptionError, PluginError, MemoryError):
            raise
        except (Exception, SystemExit, GeneratorExit, BudgetExhausted) as error:  # of the plugin's own methods
            raise PluginError(f"{plugin.kind} {plugin.name} cannot be made: {explain(error)}") from error
        finally:
            _active.reset(token)
        if missing:
            raise MissingExtra(f"{plugin.kind} {plugin.name} {missing}")
        return made

    def _why_not(self, plugin: Plugin, options: Mapping[str, Any]) -> str:
        """Why a class of a file cannot be constructed here, found out in a child process; empty if it can."""
        question = (plugin.kind, plugin.name, dict(options))
        try:
            digest = hashlib.blake2b(pickle.dumps((plugin.version, question)), digest_size=16).digest()
        except Exception:  # an option that cannot be pickled, which is not from a manifest
            return rehearse(lambda: self._try(*question), "made", _ADVICE)
        if digest in _harmless:
            return ""
        if self._rehearsal is None:
            registry = weakref.ref(self)
            self._rehearsal = Rehearsal(lambda question: _try_in(registry, question), "made", _ADVICE)
        reason = self._rehearsal.ask(question, MAKE_S, f"{plugin.kind} {plugin.name}")
        if not reason:
            if len(_harmless) >= REMEMBERED:
                _harmless.clear()
            _harmless.add(digest)
        return reason

    def _try(self, kind: str, name: str, options: Mapping[str, Any]) -> str:
        """Construct a plugin and read its options, as is done with those of a manifest."""
        try:
            made = self._make(self.find(kind, name), options)
        except NfbenchError:  # raised again, and reported, in the parent process
            return ""
        canonical(made)
        canonical(made, defaults=False)
        return ""

    @classmethod
    def present(cls) -> Registry:
        """Return the registry that is currently constructing a plugin, or else that of the installed plugins."""
        return _active.get() or _installed()

    def _add(self, plugin: Plugin) -> None:
        other = self._plugins.setdefault((plugin.kind, plugin.name), plugin)
        if other is not plugin:
            raise PluginError(
                f"two {plugin.kind}s are named {plugin.name!r}: one from {other.origin} and one from {plugin.origin}; "
                f"rename one of them"
            )

    def _add_file(self, file: Path) -> None:
        try:
            source = file.read_bytes()
        except OSError as error:
            raise PluginError(f"plugin file {file}: {error.strerror or error}") from error
        version = hashlib.sha256(source).hexdigest()[:16]
        try:
            module = import_file(file, version)
        except ImportError as error:
            self.broken[file] = str(error)
            return
        found = [cls for cls in vars(module).values() if _is_plugin(cls, module)]
        if not found:
            self.broken[file] = "defines no class derived from nfbench.Solver, Formulation or Scenario"
        for cls in found:
            kind = next(kind for kind, contract in CONTRACTS.items() if issubclass(cls, contract))
            name = vars(cls).get("name") or _kebab(cls.__name__)
            self._add(Plugin(kind, name, file.name, version, cls))


def _contains_runs() -> bool:
    """Whether an end of this process would end more than one run: not in a worker process, nor in a rehearsal."""
    return parent_process() is None and current_thread() is main_thread() and not rehearsing()


def _try_in(registry: weakref.ref[Registry], question: tuple[str, str, dict[str, Any]]) -> str:
    present = registry()
    return present._try(*question) if present else ""


def _plain(error: OptionError) -> OptionError:
    """The same error with nothing but text in it. A plugin may have raised one with anything."""
    return OptionError(str(error.owner), [(str(path), str(text)) for path, text in error.problems])


def _extra(cls: type[Options], made: Options | None) -> Extra | None:
    """Return the extra that a plugin needs; None for a scenario without ``made`` if it has required options."""
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


def _is_plugin(cls: object, module: ModuleType) -> bool:
    return (
        inspect.isclass(cls)
        and issubclass(cls, tuple(CONTRACTS.values()))
        and cls.__module__ == module.__name__
        and not inspect.isabstract(cls)
    )


def _kebab(name: str) -> str:
    """Convert ``MyOwnSolver`` to ``my-own-solver``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", name).lower()
