"""Rehearses in a forked child what a plugin does, so that code that hangs or ends its process does no harm here."""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import pickle
import select
import signal
import sys
import time
import warnings
import weakref
from collections.abc import Callable, Iterable
from typing import Any, Never, final

from nfbench.core import cause_of_end, die_with_parent, explain, printable

from .containment import HIGH_DESCRIPTOR, Containment, moved_up

__all__ = ["MAKE_S", "Rehearsal", "rehearse", "rehearsing"]

MAKE_S = 6.0  # time limit for constructing or describing a plugin of a file [s]
AFTER_HANG_S = 1.0  # time limit for other topics after a hang, so that several hangs do not add up [s]
LONGEST = 2**16  # bytes of an answer
IDLE_S = 10.0  # after which a child without questions ends [s]
ENDS = 20  # deaths of the child for one topic after which it is not tried again
_in_child = False
_HEAD = 8  # bytes of the length of a question


@final
class Rehearsal:
    """A forked copy of this process that calls ``act`` on each question, before this process does the same.

    The copy is made at the first question and again after it has died. Where there is no fork, nothing is rehearsed.

    act: called with each question; it returns why this process must not do the same, or an empty text.
    doing: what ``act`` does, for the messages, e.g. ``imported``.
    advice: what to change in the plugin, for the messages.
    """

    def __init__(self, act: Callable[[Any], str], doing: str, advice: str) -> None:
        self._act, self._doing, self._advice = act, doing, advice
        self._child: _Child | None = None
        self._ends: dict[str, tuple[int, str]] = {}  # topic → number of deaths and the last reason

    def __enter__(self) -> Rehearsal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, question: Any, seconds: float, topic: str = "") -> str:
        """Return why this process must not do the same: an exception, a hang, an end of the process; or an empty text.

        question: argument of ``act``, which can be pickled.
        seconds: time limit [s].
        topic: what the question is about. After a hang, or many deaths, further questions about it get the same answer.
        """
        if not hasattr(os, "fork"):
            return ""
        ends, reason = self._ends.get(topic, (0, ""))
        if ends >= ENDS:
            return reason
        if any(count >= ENDS for count, _ in self._ends.values()):
            seconds = min(seconds, AFTER_HANG_S)
        answer, exit_code = self._answer(question, time.monotonic() + seconds)
        if answer:
            return answer[1:].decode("utf-8", "replace")
        if answer is None:
            ends, reason = ENDS, f"was not {self._doing} within {seconds:g} s; {self._advice}"
        else:
            cause = cause_of_end(exit_code)
            how = f"{'with' if cause.startswith('exit') else 'by'} {cause}"
            ends, reason = ends + 1, f"ended the process {how} while it was {self._doing}; {self._advice}"
        self._ends[topic] = ends, reason
        return reason

    def _answer(self, question: Any, deadline: float) -> tuple[bytes | None, int | None]:
        """The answer of the child, as of ``_Child.ask``, and the exit code of a child that gave none."""
        while True:
            is_new = self._child is None
            child = self._child = self._child or _Child(self._act, self._doing, self._advice)
            try:
                answer = child.ask(question, deadline)
            except BaseException:  # Ctrl-C: its answer, which may come yet, is not that to the next question
                self.close()
                raise
            if answer:
                return answer, None
            self._child, exit_code = None, child.end()
            if is_new or answer is None:
                return answer, exit_code
            # a child that has answered before may have ended between the questions, so ask a new one

    def close(self) -> None:
        """End the child."""
        if self._child is not None:
            self._child.end()
            self._child = None


def rehearse(act: Callable[[], str], doing: str, advice: str, seconds: float = MAKE_S) -> str:
    """Call ``act`` once in a forked child; see Rehearsal for the arguments and Rehearsal.ask for what is returned."""
    with Rehearsal(lambda _: act(), doing, advice) as rehearsal:
        return rehearsal.ask(None, seconds)


def rehearsing() -> bool:
    """Whether this process is a child in which something is rehearsed."""
    return _in_child


class _Child:
    """One child process and the pipes to it."""

    def __init__(self, act: Callable[[Any], str], doing: str, advice: str) -> None:
        questions, ours = os.pipe()
        answers, theirs = os.pipe()
        parent = os.getpid()
        self.pid = _fork()
        if self.pid == 0:
            _serve(act, doing, advice, parent, questions, theirs, (ours, answers))
        os.close(questions)
        os.close(theirs)
        ours, answers = moved_up(ours), moved_up(answers)  # the child, which lacks them, cannot rehearse their end
        self._questions, self._answers = ours, answers
        os.set_blocking(ours, False)
        ended = moved_up(os.pidfd_open(self.pid)) if hasattr(os, "pidfd_open") else answers
        self._ended = ended  # becomes readable also if something that the child has started holds the pipe
        self.end = weakref.finalize(self, _end, parent, self.pid, {ours, answers, ended})

    def ask(self, question: Any, deadline: float) -> bytes | None:
        """The answer; empty if the child ends without one, None if the deadline passes."""
        content = pickle.dumps(question)
        content = len(content).to_bytes(_HEAD, "big") + content
        while (remaining := deadline - time.monotonic()) > 0:
            waited = [self._answers, self._ended]
            readable, writable, _ = select.select(waited, [self._questions] * bool(content), [], remaining)
            if self._answers in readable:
                return os.read(self._answers, LONGEST)
            if readable:
                return b""
            if writable:
                try:
                    content = content[os.write(self._questions, content) :]
                except BrokenPipeError:
                    return b""
        return None


def _end(parent: int, pid: int, descriptors: Iterable[int]) -> int | None:
    """Kill the child, with whatever it has started; return its exit code. Nothing happens in copies of the parent."""
    if os.getpid() != parent:
        return None
    for descriptor in descriptors:
        os.close(descriptor)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)  # in case it has not become the leader of its group yet
    try:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    except ChildProcessError:
        return None


def _fork() -> int:
    with warnings.catch_warnings():  # Python warns of forks beside threads; the child has a deadline
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _serve(
    act: Callable[[Any], str],
    doing: str,
    advice: str,
    parent: int,
    questions: int,
    answers: int,
    theirs: tuple[int, ...],
) -> Never:
    """The child: answer each question with ``+`` and the reason, until one has changed the process."""
    global _in_child
    _in_child = True
    try:
        os.setsid()
        die_with_parent(parent)
        faulthandler.disable()  # whose report would go to the parent's terminal
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        for descriptor in theirs:
            os.close(descriptor)
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        sys.stdout = sys.stderr = os.fdopen(silence, "w", encoding="utf-8", errors="replace")
        questions, answers = moved_up(questions), moved_up(answers)
        later: list[object] = []  # calls that would end the process after the rehearsal, and change nothing before
        faulthandler.dump_traceback_later = lambda *arguments, **_: later.append(arguments)
        gc.freeze()  # files of the parent that nobody uses any more stay open, so that all must stay as they are
        state, changed = Containment(_descriptors()), None
        while changed is None and (content := _next(questions)) is not None:
            reason = _reason(act, content)
            changed = "the timer of faulthandler" if later else state.changed()
            if changed and not reason:
                reason = f"changes its process ({changed}) while it is {doing}; {advice}"
            os.write(answers, b"+" + printable(reason, LONGEST - 1).encode("utf-8"))
    finally:
        os._exit(0)


def _descriptors() -> list[int]:
    """The descriptors that are open."""
    found = []
    for descriptor in range(2 * HIGH_DESCRIPTOR):
        with contextlib.suppress(OSError):
            os.fstat(descriptor)
            found.append(descriptor)
    return found


def _reason(act: Callable[[Any], str], content: bytes) -> str:
    try:
        return act(pickle.loads(content))  # from the parent
    except BaseException as error:  # a plugin may raise any
        return explain(error)


def _next(questions: int) -> bytes | None:
    """The next question; None if there is none for a while, or if the parent has closed the pipe."""
    if not select.select([questions], [], [], IDLE_S)[0]:
        return None
    head = os.read(questions, _HEAD)
    if len(head) < _HEAD:
        return None
    parts, left = [], int.from_bytes(head, "big")
    while left:
        part = os.read(questions, min(left, 2**20))
        if not part:
            return None
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
