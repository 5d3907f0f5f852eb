"""Damage: what disks, transfers, editors and enemies do to files. It all follows from the generator of chance."""

from __future__ import annotations

import json
import random
import re
import struct
from collections.abc import Callable
from copy import deepcopy
from typing import Any

DEPTH = 100_000  # of nested JSON
NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.])")
WORDS = (
    *(b"nan", b"inf", b"-inf", b"-1", b"0", b"-0.0", b"1e308", b"-1e300", b"1e-320", b"1e38", b"65536", b"2147483648"),
    *(b"-2147483649", b"18446744073709551616", b"9" * 400, b"", b"abc", b"0x10", b"1,5", b"1e", b"\xff\xfe", b"\x00"),
    *(b"\xd9\xa3", b"1_000", b"--1", b"\x1b[31m", b"'; --", b"../../x", b"/dev/zero", b"%s%n"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 0.5, -0.0, 1e308, -1e300, 1e-320, 1e38, 2**31, 2**63, 2**64, -(2**63), 10**400),
    *(
        float("nan"),
        float("inf"),
        -float("inf"),
        "",
        "x",
        "nan",
        "1e3",
        "\ud800",
        "\x1b[31mred\n",
        "../../x",
        "y" * 4096,
    ),
    *([], {}, [[]], [None], {"": {}}, [1, 2, 3], [0, 0], [float("nan")] * 4, [1e308] * 16, list(range(2000))),
)


def binary(data: bytes, rng: random.Random, donor: bytes = b"") -> bytes:
    """One to three of: bits flipped, bytes overwritten, cut off, lengthened, moved, spliced, numbers made extreme.

    donor : bytes of another file, from which parts may come.
    """
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(BINARY)(data, rng, donor)
    return data


def text(data: bytes, rng: random.Random, donor: bytes = b"") -> bytes:
    """One to three of: numbers replaced, lines lost, doubled or moved, cut off, foreign bytes; or `binary`."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(TEXT)(data, rng, donor)
    return data


def json_text(data: bytes, rng: random.Random, donor: bytes = b"") -> bytes:
    """One to three values of the document replaced, lost, renamed, doubled or nested; now and then `text`."""
    if rng.random() < 0.2:
        return text(data, rng, donor)
    document = json.loads(data)
    deep = rng.random() < 0.04
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        document = _edited(document, rng)
    if deep:  # json.dumps would not get through it
        document = _replaced(document, rng, "\0deep")
    out = json.dumps(document, ensure_ascii=rng.random() < 0.9).encode("utf-8", "surrogatepass")
    return out.replace(b'"\\u0000deep"', nested(rng.choice("[{"))).replace(b'"\0deep"', nested("["))


def nested(bracket: str = "[", depth: int = DEPTH) -> bytes:
    """JSON that is nested `depth` levels deep."""
    return b"[" * depth + b"]" * depth if bracket == "[" else b'{"a":' * depth + b"1" + b"}" * depth


def extreme(rng: random.Random) -> bytes:
    """The bytes of a number at the edge of what its type holds."""
    kind, values = rng.choice(
        (
            ("<I", (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 10**8)),
            (">I", (1, 2**31, 2**32 - 1)),
            ("<Q", (0, 1, 2**31, 2**32, 2**40, 2**63 - 1, 2**63, 2**64 - 1)),
            ("<f", (float("nan"), float("inf"), -1.0, 0.0, 3e38, 1e-40)),
            ("<d", (float("nan"), float("inf"), -float("inf"), -1.0, 0.0, 1e308, 1e-310, 1e9)),
            ("<H", (0, 1, 2**15, 2**16 - 1)),
        )
    )
    return struct.pack(kind, rng.choice(values))


def _place(data: bytes, rng: random.Random) -> int:
    """Anywhere, and half the time among the first 128 bytes, where formats keep what they count on."""
    return rng.randrange(max(1, min(len(data), 128) if rng.random() < 0.5 else len(data)))


def _flip(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        out[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(out)


def _overwrite(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    at = _place(data, rng)
    junk = rng.randbytes(rng.choice((1, 2, 4, 16, 256)))
    return data[:at] + junk + data[at + len(junk) :]


def _number(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    at = _place(data, rng)
    at -= at % rng.choice((1, 2, 4, 8))
    value = extreme(rng)
    return data[:at] + value + data[at + len(value) :]


def _cut(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    return data[: rng.choice((0, 1, _place(data, rng), rng.randrange(len(data) + 1), max(0, len(data) - 1)))]


def _longer(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    return data + rng.choice((b"\0", rng.randbytes(64), data[: 1 << 16], b"\0" * 65536))


def _lost(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + rng.choice((1, 4, 8, 64, 4096)) :]


def _doubled(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    at, size = _place(data, rng), rng.choice((1, 8, 64, 4096))
    return data[: at + size] + data[at:]


def _blanked(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    at, size = _place(data, rng), rng.choice((4, 64, 512, 4096))
    gone = data[at : at + size]
    return data[:at] + rng.choice((b"\0", b"\xff")) * len(gone) + data[at + size :]


def _spliced(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    donor = donor or data
    here, there = rng.randrange(len(data) + 1), rng.randrange(len(donor) + 1)
    size = rng.choice((16, 512, 8192))
    return data[:here] + donor[there : there + size] + data[here + size :]


def _token(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    numbers = list(NUMBER.finditer(data[: 2000 if rng.random() < 0.5 else None]))
    if not numbers:
        return _flip(data, rng, donor)
    found = rng.choice(numbers)
    word = rng.choice(WORDS)
    if rng.random() < 0.3:
        word = repr(float(found.group()) * rng.choice((-1, 0.1, 0.5, 2, 10, 1e6))).encode()
    return data[: found.start()] + word + data[found.end() :]


def _lines(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, rng.choice(lines))
    elif what == 2:
        rng.shuffle(lines)
    elif what == 3:
        words = lines[at].split()
        lines[at] = b" ".join(words[: rng.randrange(len(words) + 1)] + words[:1] * rng.randrange(2))
    else:
        lines[at] = rng.choice(
            (b"", b"#", b"1 " * 3000, b"x" * 100_000, b"\xef\xbb\xbf", lines[at] + b"\r", b"\xff\xfe\0")
        )
    return b"\n".join(lines)


def _edited(document: Any, rng: random.Random) -> Any:
    return _replaced(document, rng, deepcopy(rng.choice(VALUES))) if rng.random() < 0.7 else _rebuilt(document, rng)


def _containers(document: Any) -> list[Any]:
    """All lists and objects that hold something, outermost first."""
    found, waiting = [], [document]
    while waiting:
        node = waiting.pop(0)
        if isinstance(node, dict | list) and node:
            found.append(node)
            waiting += list(node.values() if isinstance(node, dict) else node)[:200]
    return found


def _chosen(document: Any, rng: random.Random) -> tuple[Any, Any] | None:
    """A list or object and one of its keys; outer ones are as likely as the many inner ones."""
    nodes = _containers(document)
    if not nodes:
        return None
    node = rng.choice(nodes[:12] if rng.random() < 0.5 else nodes)
    return node, rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))


def _replaced(document: Any, rng: random.Random, value: Any) -> Any:
    place = _chosen(document, rng)
    if place is None or rng.random() < 0.02:
        return value
    node, key = place
    old = node[key]
    if type(old) in (int, float) and abs(old) < 1e300 and rng.random() < 0.3 and value != "\0deep":
        value = old * rng.choice((-1, 0, 0.1, 0.5, 2, 10, 1000))
    node[key] = value
    return document


def _rebuilt(document: Any, rng: random.Random) -> Any:
    place = _chosen(document, rng)
    if place is None:
        return document
    node, key = place
    if isinstance(node, dict):
        old = node.pop(key)
        if rng.random() < 0.6:
            return document
        node[rng.choice((key + "x", key.upper(), "", "\x1b[2J", "n" * 300, "__proto__"))] = old
    else:
        old = node.pop(key)
        node += [old] * rng.choice((0, 0, 2, 300))
    return document


BINARY: tuple[Callable[[bytes, random.Random, bytes], bytes], ...] = (
    *(_flip, _flip, _overwrite, _number, _number, _number, _cut, _longer, _lost, _doubled, _blanked, _spliced),
)
TEXT: tuple[Callable[[bytes, random.Random, bytes], bytes], ...] = (
    *(_token, _token, _token, _token, _lines, _lines, _cut, _spliced, _flip, _lost),
)
