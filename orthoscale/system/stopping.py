"""SIGTERM, SIGHUP and Ctrl-C: handled from the start, deferred while files are renamed, answered with one sentence.

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

SIGNALS = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))  # not in Windows
written: list[str] = []  # outputs that are in their places already
_state = {"received": 0, "held": 0, "said": 0}


class Stopped(KeyboardInterrupt):
    """A signal asks to stop. Not KeyboardInterrupt itself: where that passes through exec, as of a dataclass that is
    being made, Python remembers it as unhandled and ends with SIGINT, whatever exit code it was given."""


def sentence() -> str:
    """What a stopped run leaves."""
    return "stopped; " + (f"already written: {', '.join(written)}" if written else "nothing was written")


def say(write: Callable[[str], object]) -> None:
    """`write` the sentence, unless it is said already."""
    if not _state["said"]:
        with suppress(OSError):  # the terminal may be gone
            write(sentence())
        _state["said"] = 1  # not before: another signal may end the process here


def exit_code() -> int:
    """As shells count: 128 and the signal's number."""
    return 128 + (_state["received"] or signal.SIGINT)


def leave_at_once() -> None:
    """Until `listening`, and after it, no output is being made: a signal ends the process with the sentence."""

    def leave(number: int, frame: FrameType | None) -> None:
        say(lambda text: os.write(2, (text + "\n").encode("ascii", "backslashreplace")))
        os._exit(128 + number)

    _handle(leave)


@contextmanager
def listening() -> Iterator[None]:
    """A signal raises Stopped, so that what was begun is cleaned away; the former handlers come back."""

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
        if _state["received"]:  # it is what something made of Stopped, as Python 3.11 of one while a class is made
            raise Stopped from error
        raise
    finally:
        _state["held"] += 1  # a second signal would leave some of them behind
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def held() -> Iterator[None]:
    """A signal waits for the end of the block."""
    _state["held"] += 1
    try:
        yield
    finally:
        _state["held"] -= 1
        if not _state["held"]:
            check()


def check() -> None:
    """Raise Stopped if a signal came while they were held, or a library swallowed the exception."""
    if _state["received"]:
        raise Stopped


def over() -> None:
    """What is done is done: while Python ends, which takes some 50 ms, a signal changes nothing."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def unheard_by_libraries() -> Iterator[None]:
    """A library is imported in the block that sets handlers behind Python's back: signals wait until ours are back."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        for number in SIGNALS:
            if (handler := signal.getsignal(number)) is not None:  # what Python knows of it is right
                signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _handle(handler: Any) -> dict[signal.Signals, Any]:
    """Set `handler` where a signal is not ignored (a shell's background jobs ignore Ctrl-C); returns the former."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    former = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: before for number, before in former.items() if before not in (signal.SIG_IGN, None)}
    for number in heard:
        signal.signal(number, handler)
    return heard
