"""Handles SIGTERM, SIGHUP and Ctrl-C: from the start, deferred while files are renamed, answered with one sentence.

SIGHUP is what a closed terminal or a lost connection sends.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from ..errors import LONGEST_MESSAGE, shown

SIGNALS = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))  # not on Windows
written: list[str] = []  # outputs that are in place already
_state = {"received": 0, "held": 0, "said": 0}


class Stopped(KeyboardInterrupt):
    """A signal asks to stop. Not KeyboardInterrupt itself: if that passes through exec, as while a dataclass is being
    created, Python records it as unhandled and ends with SIGINT, whatever the exit code."""


def sentence() -> str:
    """What a stopped run has written, as a message."""
    return "stopped; " + (
        f"already written: {shown(', '.join(written), LONGEST_MESSAGE)}" if written else "nothing was written"
    )


def say(write: Callable[[str], object]) -> None:
    """Pass the sentence to `write`, unless that was done before."""
    if not _state["said"]:
        with suppress(OSError):  # the terminal may be gone
            write(sentence())
        _state["said"] = 1  # not before: another signal may end the process here


def exit_code() -> int:
    """128 plus the signal's number, as shells do."""
    return 128 + (_state["received"] or signal.SIGINT)


def leave_at_once() -> None:
    """Let a signal end the process with the sentence: before and after `listening`, when no output is being made."""

    def leave(number: int, frame: FrameType | None) -> None:
        say(lambda text: os.write(2, (text + "\n").encode("ascii", "backslashreplace")))
        os._exit(128 + number)

    _handle(leave)


@contextmanager
def listening() -> Iterator[None]:
    """In the block a signal raises Stopped, so that unfinished outputs are removed; then the former handlers return."""

    def heard(number: int, frame: FrameType | None) -> None:
        _state["received"] = number
        if not _state["held"]:
            raise Stopped

    written.clear()
    _state.update(received=0, held=0, said=0)
    former = _handle(heard)
    try:
        yield
    except Exception as error:
        if _state["received"]:  # the error was made from Stopped, as Python 3.11 does while a class is created
            raise Stopped from error
        raise
    finally:
        _state["held"] += 1  # a second signal would leave some handlers unrestored
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def held() -> Iterator[None]:
    """Defers a signal to the end of the block."""
    _state["held"] += 1
    try:
        yield
    finally:
        _state["held"] -= 1
        if not _state["held"]:
            check()


def check() -> None:
    """Raise Stopped if a signal came while signals were deferred, or a library swallowed the exception."""
    if _state["received"]:
        raise Stopped


def over() -> None:
    """Ignore signals from now on: the work is done, and Python takes some 50 ms to end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def unheard_by_libraries() -> Iterator[None]:
    """For importing a library that sets handlers behind Python's back: signals wait until ours are restored."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        for number in SIGNALS:
            if (handler := signal.getsignal(number)) is not None:  # Python's own record has the right handler
                signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _handle(handler: Any) -> dict[signal.Signals, Any]:
    """Set `handler` for signals that are not ignored (a shell's background jobs ignore Ctrl-C); returns the former
    handlers."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    former = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: before for number, before in former.items() if before not in (signal.SIG_IGN, None)}
    for number in heard:
        signal.signal(number, handler)
    return heard
