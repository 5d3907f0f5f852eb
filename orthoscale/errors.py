"""The hierarchy of errors. Each states what was wrong, where, and what to do; each class has one exit code.

0 success; 2 usage; 3 too little evidence; 4 evidence disagrees; 5 input unreadable or damaged; 6 output not written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

LONGEST_MESSAGE = 1500  # [characters] of a message or a hint: names and values from a file may be of any length


def shown(text: object, most: int = 80) -> str:
    """`text` as one line that is safe to print on a terminal: control characters, line breaks and undecodable bytes are
    escaped. If it is longer than `most` characters, its middle is left out."""
    line = str(text)
    if len(line) > most:
        line = f"{line[: most - most // 3]} ... {line[-(most // 3) :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


class OrthoscaleError(Exception):
    """Base of all errors that orthoscale raises on purpose.

    `message` says what was wrong and where, `hint` what to do about it. Control characters, which names in a file may
    hold, are made visible in both.
    """

    exit_code = 1

    def __init__(self, message: str, hint: str = ""):
        message = shown(message.replace("\n", " "), LONGEST_MESSAGE)
        hint = "\n".join(shown(line, LONGEST_MESSAGE) for line in hint.split("\n"))
        super().__init__(message, hint)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}\n{self.hint}" if self.hint else self.message

    def reword(self, change: Callable[[str], str]) -> None:
        """Replace the message by `change` of it, for a caller that knows more than the code that raised the error."""
        self.message = change(self.message)


class UsageError(OrthoscaleError):
    """The request makes no sense: an unknown fleet, an output that already exists, contradictory options."""

    exit_code = 2


class MetricAlready(UsageError):
    """The input is in metres already, and the user did not ask to replace its scale."""


class TooLittleEvidence(OrthoscaleError):
    """Fewer usable vehicles than a scale needs."""

    exit_code = 3


class TooLittleRoom(OrthoscaleError):
    """Not all facilities that were asked for fit on the lot."""

    exit_code = 3


class EvidenceDisagrees(OrthoscaleError):
    """Two independent measurements of the scale contradict each other."""

    exit_code = 4


class InputError(OrthoscaleError):
    """An input is missing, unreadable or damaged."""

    exit_code = 5


class OutputError(OrthoscaleError):
    """An output could not be written, or what was read back is not what was written."""

    exit_code = 6


class Incomplete(OutputError):
    """The main output is verified and in its place; a report or another file beside it could not be made.

    result : what the call would have returned.
    """

    def __init__(self, message: str, hint: str = "", result: Any = None):
        super().__init__(message, hint)
        self.result = result


@contextmanager
def out_of_memory_told() -> Iterator[None]:
    """Raises InputError where the machine itself, not the budget, has too little memory."""
    try:
        yield
    except MemoryError as error:
        raise InputError(
            "this machine has too little memory left", "Close other programs, or do less at once (--jobs, --workers)."
        ) from error
