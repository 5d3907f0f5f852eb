"""What an option is, and how the value that a user gives for it is checked. Options are the fields of requests.

They become the options of the command line and the keywords in Python; messages always use the command line's name.
"""

from __future__ import annotations

import difflib
import numbers
from collections.abc import Callable, Iterable, Sequence
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from .errors import UsageError, shown

# Of options in --help, in this order. "Main" has what most runs need: required options, --fleet and --out.
GROUPS = ("Main", "Input", "Detector", "Evidence", "Output", "Advanced")
LARGEST_NUMBER = 1e12  # a positive number beyond it, or as far below 1, is a mistake, and its square may be infinite


@dataclass(frozen=True)
class Option:
    """kind : type of a value: Path, str, float, int or bool. help : text for --help. group : heading in --help, of
    GROUPS.

    choices : the allowed values; empty if any is. flag : its name on the command line, if not made from the field's.
    metavar : placeholder of the value in the help. positive : whether a number must be above 0. not_negative : whether
    it must be 0 or more. file_in : the file that a text names, None if it names none; a Path always names one.
    """

    kind: type
    help: str
    group: str
    choices: tuple[str, ...] = ()
    flag: str = ""
    metavar: str | None = None
    positive: bool = False
    not_negative: bool = False
    file_in: Callable[[str], str | None] = lambda text: None


def option(default: Any, kind: type, group: str, help: str, **more: Any) -> Any:
    """A field of a request, with its `Option` as metadata; for arguments see there."""
    return field(default=default, metadata={"option": Option(kind, help, group, **more)})


def options_in(request: Any) -> list[Field]:
    """The fields of a request, or of its class, that are options."""
    return [each for each in fields(request) if "option" in each.metadata]


def flag(of: Field) -> str:
    """The name of the field `of` a request on the command line and in every error. A switch that is on by default is
    named by what turns it off, such as --no-cache."""
    named: str = of.metadata["option"].flag
    return named or "--" + of.name.replace("_", "-")


def file_named(of: Field, value: Any) -> str | None:
    """The file or folder that `value` of the field `of` a request names, None if it names none."""
    about: Option = of.metadata["option"]
    if value is None:
        return None
    return str(value) if about.kind is Path else about.file_in(str(value))


_KINDS: dict[type, tuple[tuple[type, ...], str]] = {  # the types that each kind of option accepts, and their name
    Path: ((str, Path), "a path"),
    str: ((str, Path), "a text"),
    float: ((int, float), "a number"),
    int: ((int,), "a whole number"),
    bool: ((bool,), "True or False"),
}


def checked(of: Field, value: Any) -> Any:
    """`value` as the field `of` a request stores it, lists as tuples. Raises UsageError for an invalid value."""
    about: Option = of.metadata["option"]
    if value is None and of.default is None:
        return None
    if not isinstance(of.default, tuple):
        return _check(flag(of), about, value)
    return tuple(_check(flag(of), about, each) for each in listed(flag(of), value))


def listed(name: str, value: Any) -> Sequence[Any]:
    """`value` of the option `name`, which takes a list. Raises UsageError for anything else, such as a single text."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
        raise UsageError(f"{name} takes a list of values, not {shown(repr(value))}")
    return value


def number(name: str, value: Any, kind: type = float) -> Any:
    """`value` of the option `name` as a Python number, also if it is one of numpy's; integers stay integers.

    kind : float, or int if it must be an integer. Raises UsageError for anything else.
    """
    if not isinstance(value, bool):
        if isinstance(value, numbers.Integral):
            return int(value)
        if kind is float and isinstance(value, numbers.Real):
            return float(value)
    raise UsageError(f"{name} takes {_KINDS[kind][1]}, not {shown(repr(value))}")


def positive(name: str, value: Any, kind: type = float) -> Any:
    """`number`, which must be positive, and neither so large nor so small that computing with it overflows. Raises
    UsageError."""
    value = number(name, value, kind)
    if not 1 / LARGEST_NUMBER <= value <= LARGEST_NUMBER:
        raise UsageError(
            f"{name} must be a positive number, from {1 / LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}, not {value}"
        )
    return value


def _check(name: str, about: Option, value: Any) -> Any:
    wanted, called = _KINDS[about.kind]
    if about.kind in (float, int):
        value = number(name, value, about.kind)
    elif not isinstance(value, wanted):
        raise UsageError(f"{name} takes {called}, not {shown(repr(value))}")
    if about.choices and value not in about.choices:
        raise UsageError(f"{name} {value} is not one of {', '.join(about.choices)}", nearest(value, about.choices))
    if about.positive:
        value = positive(name, value, about.kind)
    if about.not_negative and value < 0:
        raise UsageError(f"{name} must be 0 or more, not {value}")
    return value


def nearest(name: str, known: Iterable[str]) -> str:
    """A sentence with the name, of those `known`, that `name` may have been meant to be; or ''."""
    near = difflib.get_close_matches(str(name), list(known), 1)
    return f"Did you mean {near[0]!r}?" if near else ""
