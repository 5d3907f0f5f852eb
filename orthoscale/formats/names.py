"""What files may hold: names need not be text, and in files that are UTF-8 their other bytes stand as escapes; of
numbers only those that are finite are written."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

ESCAPED = re.compile(r"\\u(dc[89a-f][0-9a-f])")  # what `in_utf8` makes of a byte that is not UTF-8 (PEP 383)
MOST_NAMED = 5  # files or folders, in a sentence


def in_utf8(text: str) -> str:
    """`text` with escapes for what UTF-8 cannot say: the names of files need not be text."""
    return text.encode(errors="backslashreplace").decode()


def out_of_utf8(text: str) -> str:
    """The name that `in_utf8` made `text` of; nothing tells one that has such escapes itself."""
    return ESCAPED.sub(lambda match: chr(int(match[1], 16)), text)


def each_text(values: Any, change: Callable[[str], str]) -> Any:
    """Plain `values` with `change` of every text and every key in them."""
    if isinstance(values, str):
        return change(values)
    if isinstance(values, Mapping):
        return {each_text(key, change): each_text(value, change) for key, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [each_text(value, change) for value in values]
    return values


def json_in_utf8(values: Any, indent: int | None = None) -> str:
    """JSON of plain `values` that strict readers take: texts as `in_utf8` has them, where json itself writes halves of
    surrogate pairs, and null for what is no finite number, where it writes NaN."""
    try:
        text = json.dumps(values, indent=indent, allow_nan=False)
    except ValueError:
        return json_in_utf8(finite(values), indent)
    return json.dumps(each_text(values, in_utf8), indent=indent) if r"\ud" in text else text


def finite(values: Any) -> Any:
    """Plain `values` with None for the numbers that are not finite: files say so by leaving them out."""
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
