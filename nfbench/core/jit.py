"""Compiled functions of plugins: Numba's, kept on disk, loaded before any run is timed.

They are compiled once per machine and kept where Numba keeps them: in NUMBA_CACHE_DIR if it is set, otherwise in
``__pycache__`` next to their source, or in the user's cache folder if that is read-only. Numba's cache of a kernel
notices a change of the file that the kernel stands in, but not of the kernels and constants that it imports. So a
folder of its own is used for each state of all the sources, ``<module>.nfbench-<key>``. Of the folders of a module
the few that were used last are kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.resources
import inspect
import os
import pickle
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, Literal, TypeVar, cast

import llvmlite
import numba
import numba.core.caching
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target

from .errors import NfbenchError

__all__ = ["compiled", "load_kernels"]

_F = TypeVar("_F", bound=Callable[..., Any])

_caching: Any = numba.core.caching  # it has types in some versions only
_CHECKSUM = hashlib.sha256().digest_size
FEW = 4  # kernels from which a second process helps to compile
_KEPT = 4  # folders per module, so that Python environments and types of processors may share a file system

_REMEDY = "set NUMBA_CACHE_DIR to a writable folder, or reinstall numba and llvmlite"


def compiled(fastmath: set[str] | bool = False, *, inline: bool = False) -> Callable[[_F], _F]:
    """Numba's njit with what all kernels share: no Python exceptions inside, and a cache on disk.

    fastmath: what LLVM may do to sums and products. inline: insert the code into each caller before it is typed, with
    the ``fastmath`` of the caller. The other kernels that a kernel calls are inserted by LLVM, which makes its machine
    code complete: it does not depend on which kernels were compiled or loaded before, in this process or another.

    A kernel is compiled again when a Python file changes in its package, or in the package of a kernel that its module
    imports; of a module outside packages, such as a plugin file, the file alone counts. So import constants of a
    kernel from these packages only. Raises NfbenchError where there is no writable folder for the cache.
    """

    def compiled_with(function: _F) -> _F:
        inlining: Literal["always", "never"] = "always" if inline else "never"
        try:
            options: Any = {"fastmath": fastmath, "inline": inlining, "error_model": "numpy", "forceinline": True}
            kernel: Any = numba.njit(**options)(function)
            kernel._cache = _Cache(function)  # as cache=True does, with our folder
        except (OSError, RuntimeError) as error:
            raise NfbenchError(f"kernels: Numba {numba.__version__} cannot be used here: {error}; {_REMEDY}") from error
        return cast(_F, kernel)

    return compiled_with


def load_kernels(kernels: Sequence[tuple[Any, tuple[Any, ...]]], message: str) -> None:
    """Load each (kernel, signature) from the cache, or compile it; nothing is compiled for these kernels after this.

    ``message`` is printed on stderr once the first of them, which should be the quickest, turns out not to be in the
    cache. A second process then compiles from the other end of the list. Raises NfbenchError where compiling fails.
    """
    helper = 0
    try:
        for number, (kernel, signature) in enumerate(kernels):
            kernel.compile(signature)
            kernel.disable_compile()
            if number == 0 and kernel.stats.cache_misses:
                print(f"nfbench: {message} …", file=sys.stderr, flush=True)
                helper = _compile_backwards(kernels) if len(kernels) >= FEW else 0
    except (numba.core.errors.NumbaError, OSError, RuntimeError) as error:
        raise NfbenchError(
            f"kernels: Numba {numba.__version__} cannot compile here: {error}; compiled code is kept in "
            f"{getattr(kernel, '_cache', None) and kernel._cache.cache_path}; {_REMEDY}"
        ) from error
    finally:
        if helper:  # all is compiled, or nothing can be; what it has written so far is complete
            os.kill(helper, signal.SIGKILL)
            os.waitpid(helper, 0)


def _compile_backwards(kernels: Sequence[tuple[Any, tuple[Any, ...]]]) -> int:
    """Compile into the cache in a copy of this process, from the last kernel; returns its number, 0 if there is none.

    It ends at the first kernel that it finds in the cache.
    """
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2 or threading.active_count() > 1:
        return 0
    if child := os.fork():
        return child
    try:
        for kernel, signature in reversed(kernels):
            kernel.compile(signature)
            if kernel.stats.cache_hits:
                break
    finally:  # whatever happens here, the other process compiles what is missing
        os._exit(0)


# ------------------------------------------------------------------------------------------------- the cache folder


class _KeyedFolder:
    """Added to a cache locator of Numba: one folder deeper, named after the module and the key of its kernels."""

    def __init__(self, function: FunctionType, file: str) -> None:
        super().__init__(function, file)  # type: ignore[call-arg]
        self._folder = Path(super().get_cache_path(), f"{Path(file).stem}.nfbench-{_key(function)}")  # type: ignore[misc]

    def get_cache_path(self) -> str:
        return str(self._folder)

    def ensure_cache_path(self) -> None:
        new = not self._folder.exists()
        super().ensure_cache_path()  # type: ignore[misc]  # makes it, and raises OSError where it is not writable
        with contextlib.suppress(OSError):  # another process may be removing the same folders
            os.utime(self._folder)
            if new:
                prefix = self._folder.name.rpartition("-")[0]
                siblings = [path for path in self._folder.parent.iterdir() if path.name.rpartition("-")[0] == prefix]
                for old in sorted(siblings, key=lambda path: path.stat().st_mtime)[:-_KEPT]:
                    shutil.rmtree(old, ignore_errors=True)


def _keyed(locator: Any) -> Any:
    """The class of a locator with the folder added."""
    return type(locator.__name__, (_KeyedFolder, locator), {})


class _CacheImpl(_caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Numba's order of folders, each of them keyed."""

    _locator_classes = [_keyed(locator) for locator in _caching.CacheImpl._locator_classes]  # noqa: RUF012  # Numba's

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        found: Any = self.locator
        if not isinstance(found, _KeyedFolder):  # NUMBA_CACHE_LOCATOR_CLASSES, where Numba has it, names others
            found = _keyed(type(found)).from_function(function, inspect.getfile(function))
            if found is None:
                raise RuntimeError(f"no folder of NUMBA_CACHE_LOCATOR_CLASSES for {function.__qualname__} is writable")
            self._locator = found


class _CheckedFiles(_caching.IndexDataCacheFile):  # type: ignore[misc]
    """Numba's files with a checksum: what is truncated or damaged counts as absent, and is compiled again."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except Exception:
            return {}

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        checksum, data = content[:_CHECKSUM], content[_CHECKSUM:]
        if hashlib.sha256(data).digest() != checksum:
            raise OSError(f"{self._data_path(name)} is damaged")  # for Numba, as if the file had been removed
        return pickle.loads(data)

    def _save_data(self, name: str, data: Any) -> None:
        dumped = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(dumped).digest() + dumped)


class _Cache(_caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache, with checked files.

    Numba compiles products and quotients of complex numbers as functions, once per process, with the ``fastmath`` of
    the first kernel that has one. Each kernel gets its own: they are forgotten before and after it is compiled.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        locator = self._impl.locator
        self._cache_file = _CheckedFiles(self._cache_path, self._impl.filename_base, locator.get_source_stamp())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.cached_internal_func.clear()
        return super().load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        super().save_overload(sig, data)
        cpu_target.target_context.cached_internal_func.clear()


def _key(function: FunctionType) -> str:
    """A hash of all that the compiled code depends on: sources, Numba and LLVM, the processor."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for source in _sources(function):
        digest.update(b"%d\n%s" % (len(source), source))
    # Numba's index of compiled functions has the processor too, but loses entries when two types write at once
    processor = cpu_target.target_context.codegen().magic_tuple()  # its name and features, as Numba sees them
    digest.update(repr((numba.__version__, llvmlite.__version__, processor)).encode())
    return digest.hexdigest()[:16]


def _sources(function: FunctionType) -> list[bytes]:
    """The Python files of the packages of a function and of the kernels that its module imports, directly or not."""
    packages, files, modules = set(), set(), set()
    to_visit = [function]
    while to_visit:
        current = to_visit.pop()
        if current.__module__ in modules:
            continue
        modules.add(current.__module__)
        if package := current.__globals__.get("__package__"):
            packages.add(package)
        else:
            files.add(Path(inspect.getfile(current)))
        for value in list(current.__globals__.values()):
            members = list(vars(value).values()) if inspect.ismodule(value) else [value]
            to_visit += [member.py_func for member in members if isinstance(member, Dispatcher)]
    entries: list[Any] = [file for file in sorted(files) if file.exists()]  # of a notebook, Numba hashes the cells
    for package in sorted(packages):
        inside = importlib.resources.files(package).iterdir()  # of a folder or a zip archive
        entries += sorted((entry for entry in inside if entry.name.endswith(".py")), key=lambda entry: entry.name)
    return [entry.read_bytes() for entry in entries]
