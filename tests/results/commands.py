"""Runs the command line in this process, and fails if a command hangs or raises anything but SystemExit."""

import signal
import sys
import threading

from nfbench.cli import main

PATIENCE_S = 10


class Hang(BaseException):
    """A command took too long."""


def command(monkeypatch, capfd, *arguments, patience_s=PATIENCE_S):
    """The exit code and everything that a command prints."""

    def stop(*_):
        raise Hang(arguments)

    assert threading.current_thread() is threading.main_thread()
    monkeypatch.setattr(sys, "argv", ["nfbench", *map(str, arguments)])
    monkeypatch.setenv("COLUMNS", "200")
    capfd.readouterr()
    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(patience_s)
    try:
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code or 0
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    output, errors = capfd.readouterr()
    return code, output + errors
