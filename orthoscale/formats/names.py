"""Makes values safe to write: names of files need not be UTF-8, and their other bytes are written as escapes; numbers
that are not finite are left out."""

from __future__ import annotations

import json
import math
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ESCAPED = re.compile(r"\\u(dc[89a-f][0-9a-f])")  # what `in_utf8` makes of a byte that is not UTF-8 (PEP 383)
MOST_NAMED = 5  # most files or folders that a sentence lists


def in_utf8(text: str) -> str:
    """`text` with escapes for characters that UTF-8 cannot encode: names of files may be any bytes."""
    return text.encode(errors="backslashreplace").decode()


def out_of_utf8(text: str) -> str:
    """The name from which `in_utf8` made `text`; a name that contained such escapes itself cannot be told apart."""
    return ESCAPED.sub(lambda match: chr(int(match[1], 16)), text)


def composed(text: str) -> str:
    """`text` with each marked letter (such as an umlaut) as one character: macOS writes them as two in names of files,
    which look the same."""
    return unicodedata.normalize("NFC", text)


def each_text(values: Any, change: Callable[[str], str]) -> Any:
    """Plain `values` with `change` applied to every text and every key in them."""
    if isinstance(values, str):
        return change(values)
    if isinstance(values, Mapping):
        return {each_text(key, change): each_text(value, change) for key, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [each_text(value, change) for value in values]
    return values


def json_in_utf8(values: Any, indent: int | None = None) -> str:
    """JSON of plain `values` that strict readers accept: texts are escaped by `in_utf8`, where json itself would write
    lone surrogates, and numbers that are not finite become null, where it would write NaN."""
    try:
        text = json.dumps(values, indent=indent, allow_nan=False)
    except ValueError:
        return json_in_utf8(finite(values), indent)
    return json.dumps(each_text(values, in_utf8), indent=indent) if r"\ud" in text else text


def write_json(values: Any, path: Path) -> None:
    """Write plain `values` as `json_in_utf8`, a line for each. Raises OSError."""
    path.write_text(json_in_utf8(values, indent=1) + "\n", encoding="utf-8")


def finite(values: Any) -> Any:
    """Plain `values` with None for numbers that are not finite: in files these are missing values."""
    if isinstance(values, float):
        return values if math.isfinite(values) else None
    if isinstance(values, Mapping):
        return {key: finite(value) for key, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [finite(value) for value in values]
    return values


def first_few(names: Sequence[object], most: int = MOST_NAMED) -> str:
    """`names` in a sentence: the first `most` of them, and how many more there are."""
    more = len(names) - most
    return ", ".join(map(str, names[:most])) + (f" and {more} more" if more > 0 else "")
