"""Standard output and error that take any text and survive a full disk, a closed pipe, and any encoding."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

__all__ = ["tolerant_streams"]


@final
class _Tolerant(io.TextIOBase):
    """Writes to a stream until that fails; what comes later is dropped, so that a study that only reports goes on."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        if self.error is None:
            try:
                self._stream.write(text)
            except OSError as error:
                self._fail(error)
            except ValueError:  # the stream was closed
                self._fail(BrokenPipeError())
        return len(text)

    def flush(self) -> None:
        if self.error is None:
            try:
                self._stream.flush()
            except OSError as error:
                self._fail(error)
            except ValueError:
                self._fail(BrokenPipeError())

    def _fail(self, error: OSError) -> None:
        self.error = error
        with contextlib.suppress(OSError, ValueError):  # what is buffered must not fail again when Python ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return str(getattr(self._stream, "encoding", None) or "ascii")

    @property
    def errors(self) -> str:  # type: ignore[override]
        return str(getattr(self._stream, "errors", None) or "replace")

    @property
    def buffer(self) -> Any:
        return self._stream.buffer

    def fileno(self) -> int:
        return int(self._stream.fileno())

    def isatty(self) -> bool:
        return bool(self._stream.isatty())

    def writable(self) -> bool:
        return True


@contextlib.contextmanager
def tolerant_streams() -> Iterator[None]:
    """Within this context, printing never raises; characters that the encoding lacks are replaced.

    At the end, a failure to write standard output, other than a reader that closed its pipe, is reported on standard
    error.
    """
    _fill_closed_descriptors()
    before = sys.stdout or _open_nothing(), sys.stderr or _open_nothing()  # None where they were closed at the start
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    output = _Tolerant(before[0])
    sys.stdout, sys.stderr = output, _Tolerant(before[1])
    try:
        yield
    finally:
        output.flush()
        if output.error is not None and not isinstance(output.error, BrokenPipeError):
            reason = output.error.strerror or output.error
            sys.stderr.write(f"nfbench: standard output could not be written: {reason}; stored rows are not affected\n")
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


def _fill_closed_descriptors() -> None:
    """Open what is closed of the standard descriptors, so that no file of ours takes their numbers."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)


def _open_nothing() -> io.TextIOWrapper:
    """A stream that drops what is written."""
    return Path(os.devnull).open("w", encoding="utf-8")
