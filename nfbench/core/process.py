"""The end of a process: it ends with its parent, takes the processes it started with it, and has a cause."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

__all__ = ["cause_of_end", "die_with_parent", "end_group_at_eof"]

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """End this process as soon as its parent process has ended for any reason, even by SIGKILL.

    On Linux the kernel sends SIGKILL, which native code cannot ignore. On other systems the call only covers a parent
    that has ended already; see :func:`end_group_at_eof`.

    parent: process number of the parent, as the parent itself reports it. The parent may have ended before this call.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def end_group_at_eof(descriptor: int) -> None:
    """Kill the process group of this process when the other end of a pipe is closed, for example by the parent's end.

    A process in the group waits for this, so that it also happens while this process runs native code. Call the
    function before any thread is started, in a process that leads its own group; only the process at the other end may
    hold the other end. The waiting process ends with the group.

    descriptor: file descriptor of the end of the pipe from which nothing is ever read otherwise.
    """
    if os.fork():
        os.close(descriptor)
        return
    try:
        for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
            signal.signal(number, signal.SIG_IGN)
        os.closerange(0, descriptor)  # so that nobody waits for this process to close its copies
        os.closerange(descriptor + 1, os.sysconf("SC_OPEN_MAX"))
        while os.read(descriptor, 1):
            pass
    finally:
        os.killpg(0, signal.SIGKILL)
        os._exit(1)


def cause_of_end(exitcode: int | None) -> str:
    """Describe how a process ended, given its exit code, which is negative for a signal, as in ``subprocess``."""
    if exitcode is None:
        return "an unknown cause"
    if exitcode >= 0:
        return f"exit code {exitcode}"
    return f"signal {-exitcode} ({_signal_name(-exitcode)})"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal between SIGRTMIN and SIGRTMAX, or one that Python does not know
        first, last = getattr(signal, "SIGRTMIN", 0), getattr(signal, "SIGRTMAX", -1)
        return f"SIGRTMIN+{number - first}" if first < number < last else "unknown signal"
