"""Creates, locks and moves aside results folders, and writes their files whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import final

from filelock import FileLock, Timeout

from nfbench.core import StoreError

__all__ = ["FolderLock", "clean", "foreign", "locked", "network_file_system", "prepare", "whole_folder", "write_whole"]

MOUNTS = Path("/proc/mounts")
LOCK = ".lock"
_MARKS = ("runs.sqlite", "runs.csv", "study.log", "tuning.json", "trials.csv")  # a folder with one of them is ours
_READ = ("manifest.toml", "environment.json", "study.log", "trials.csv", "tuning.json")  # before they are written
_OWN = re.compile(
    r"runs\.sqlite(-wal|-shm|-journal)?|(runs|summary|targets|ranking|traces|trials)\.csv|manifest\.toml|study\.log|"
    r"(claims|references)\.csv|hits\.npz|(environment|tuning)\.json|tuned\.toml|report\.html|export-ioh|\.lock|[\w.-]+\.(svg|pdf|png)"
)
_DRAFT = re.compile(r"\.(?P<name>.+)\.(?P<process>\d+)")


def prepare(folder: Path, fresh: bool) -> None:
    """Create the folder; with ``fresh``, first move an existing one aside.

    Raises StoreError if that fails, if ``fresh`` would move something else than a results folder, or if something that
    is not a file has the name of a file that is needed.
    """
    try:
        if fresh and folder.exists():
            _refuse_to_move(folder)
            locked(folder).release()  # raises StoreError if another process is writing there
            folder.rename(_unused(folder))
        folder.mkdir(parents=True, exist_ok=True)
        for path in (folder / name for name in _READ):
            if path.exists() and not path.is_file():  # reading a named pipe would wait forever
                kind = "folder" if path.is_dir() else "device or named pipe"
                raise StoreError(f"{path}: expected a file, found a {kind}; move it away, or use --fresh")
    except OSError as error:
        raise StoreError(f"{folder}: {error.strerror or error}") from error


def foreign(folder: Path) -> list[str]:
    """The names in a folder that no command of nfbench writes there."""
    return sorted(path.name for path in folder.iterdir() if not _is_own(path.name))


def _is_own(name: str) -> bool:
    draft = _DRAFT.fullmatch(name)
    return bool(_OWN.fullmatch(draft["name"] if draft else name))


def _refuse_to_move(folder: Path) -> None:
    path = folder.resolve()
    here, home = Path.cwd().resolve(), Path("~").expanduser().resolve()
    for place, what in ((here, "the current folder"), (home, "your home folder")):
        if path == place or path in place.parents:
            which = what if path == place else f"a folder that contains {what}"
            raise StoreError(
                f"--fresh: {folder} is {which}, which is not moved aside; choose another folder with --out"
            )
    if not path.is_dir():
        return  # creating the folder will fail
    strangers, names = foreign(folder), [path.name for path in folder.iterdir()]
    if not strangers and names and not set(names) & {*_MARKS, LOCK}:
        strangers = names
    if strangers:
        named = ", ".join(strangers[:3]) + (f" and {len(strangers) - 3} more" if len(strangers) > 3 else "")
        raise StoreError(
            f"--fresh: {folder} is not moved aside, because it holds more than results: {named}; "
            f"move these elsewhere first, or choose another folder with --out"
        )


def _unused(folder: Path) -> Path:
    """A new name beside the folder, with the present time."""
    stem = f"{folder.name}.{datetime.now():%Y%m%d-%H%M%S}"
    found, number = folder.with_name(stem), 2
    while os.path.lexists(found):
        found, number = folder.with_name(f"{stem}-{number}"), number + 1
    return found


@final
class FolderLock:
    """The write lock of a folder. Its file is removed on release; after a killed process, by the next one."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self._lock = FileLock(self._path, timeout=0)
        self._lock.acquire()
        while not self._is_current():  # the previous holder has removed the file that we have locked
            self._lock.release()
            self._lock.acquire()

    def release(self) -> None:
        with contextlib.suppress(OSError):  # where open files cannot be removed
            if self._is_current():
                self._path.unlink()
        self._lock.release()

    def _is_current(self) -> bool:
        """Whether the file that is locked is the one that others will try to lock."""
        descriptor = getattr(getattr(self._lock, "_context", None), "lock_file_fd", None)
        if descriptor is None:
            return True
        try:
            return os.path.samestat(os.fstat(descriptor), self._path.stat())
        except FileNotFoundError:
            return False


def locked(folder: Path) -> FolderLock:
    """Acquire the folder's write lock and return it. Raises StoreError if another process holds the lock."""
    try:
        return FolderLock(folder)
    except Timeout:
        raise StoreError(
            f"{folder}: another nfbench process is writing to this folder; wait until it ends, or choose another "
            f"folder with --out"
        ) from None
    except OSError as error:
        reason = error.strerror or error
        raise StoreError(f"{folder / LOCK} cannot be written: {reason}; fix that, or choose --out") from error


def clean(folder: Path) -> None:
    """Remove drafts that killed processes have left; to be called with the folder's lock."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            draft = _DRAFT.fullmatch(path.name)
            if draft and _OWN.fullmatch(draft["name"]) and not _is_alive(int(draft["process"])):
                with contextlib.suppress(OSError):
                    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _is_alive(process: int) -> bool:
    """Whether there is a process with this number; drafts of this process are no leftovers either."""
    if os.name == "nt":  # where signal 0 does not ask but interrupts
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def write_whole(path: Path, make: Callable[[Path], object], kept: str = "runs.sqlite") -> None:
    """Write a file whole or not at all, even if the power fails.

    make: function that writes the file at the path it receives. kept: name of the file that keeps the finished rows,
    for the error message. Raises StoreError if writing fails; the old file is then unchanged.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        make(draft)
        with draft.open("r+b") as file:
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        reason = f"{error.strerror or error}; finished rows are kept in {kept}"
        raise StoreError(f"{path}: {reason}; fix that and run the command again") from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder. It is renamed to ``path`` at the end, or removed on any exception.

    Raises StoreError if the folder cannot be written, or if ``path`` is already in use.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    created = [parent for parent in path.parents if not parent.exists()]
    shutil.rmtree(draft, ignore_errors=True)  # of a killed process with our number
    try:
        draft.mkdir(parents=True)
        yield draft
        draft.rename(path)
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        with contextlib.suppress(OSError):  # they are not empty if all went well
            for parent in created:
                parent.rmdir()


def network_file_system(folder: Path) -> str | None:
    """The type of the network file system that holds ``folder``; None if it is local or unknown."""
    try:
        mounts = [line.split()[1:3] for line in MOUNTS.read_text(encoding="utf-8").splitlines()]
    except OSError:
        return None
    path = folder.resolve()
    holding = [(len(point), kind) for point, kind in mounts if path.is_relative_to(point.replace("\\040", " "))]
    kind = max(holding, default=(0, ""))[1]
    return kind if re.match(r"nfs|cifs|smb|9p|afs|lustre|gpfs|beegfs|ceph|glusterfs|fuse\.", kind) else None
