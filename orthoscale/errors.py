"""One tree of errors. Each says what was wrong, where, and what to do; each class has one exit code.

0 scaled; 2 usage; 3 too little evidence; 4 evidence disagrees; 5 input unreadable or damaged; 6 output not written.
"""

from __future__ import annotations

LONGEST = 1500  # characters of a message or a hint


def shown(text: str, most: int = 80) -> str:
    """`text` of a file as a terminal may show it: without control characters, its middle left out where it is long."""
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return plain if len(plain) <= most else f"{plain[: most - most // 3]} ... {plain[-most // 3 :]}"


class OrthoscaleError(Exception):
    """Base of all errors that orthoscale raises on purpose.

    `message` says what was wrong and where, `hint` what to do about it. Control characters, which names in a file may
    hold, are made visible in both.
    """

    exit_code = 1

    def __init__(self, message: str, hint: str = ""):
        message = shown(message.replace("\n", " "), LONGEST)
        hint = "\n".join(shown(line, LONGEST) for line in hint.split("\n"))
        super().__init__(f"{message}\n{hint}" if hint else message)
        self.message = message
        self.hint = hint


class UsageError(OrthoscaleError):
    """The request makes no sense: an unknown fleet, an output that already exists, options that contradict."""

    exit_code = 2


class TooLittleEvidence(OrthoscaleError):
    """Fewer usable vehicles than a scale needs."""

    exit_code = 3


class EvidenceDisagrees(OrthoscaleError):
    """Two independent measurements of the scale contradict each other."""

    exit_code = 4


class InputError(OrthoscaleError):
    """An input is missing, unreadable or damaged."""

    exit_code = 5


class OutputError(OrthoscaleError):
    """An output could not be written, or did not read back as it was meant."""

    exit_code = 6
