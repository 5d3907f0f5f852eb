"""Safe reading of files from users: bytes, text, JSON, and JSON that is validated against a schema.

Every JSON that orthoscale reads is read here. A file that is not regular, is too large, too deeply nested, not UTF-8,
or of the wrong form raises InputError with one line that names the file, the place in it and what was expected there.
"""

from __future__ import annotations

import csv
import io
import os
import re
import stat
from collections.abc import Callable, Container, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError, shown
from .points import WITH_COMMA, decimal_commas, number

MIB = 1 << 20
SMALL = 4 * MIB  # a file of settings: a fleet, a card, a lens
LARGE = 256 * MIB  # a list of vehicles: two million boxes
HUGE = 1024 * MIB  # a model with its points
UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # how a text in it begins
LFS_POINTER = b"version https://git-lfs"  # how it begins
# Names, in lower case, of the metadata that GDAL reads for pictures whose names do not begin alike: of SPOT, ALOS,
# Pleiades, Landsat and IKONOS. Found by tracing what GDAL 3.10 looks for.
_OF_SATELLITES = re.compile(r"metadata\.dim|summary\.txt|(hdr|rpc|dim_).*|.*_(mtl|metadata)\.txt")
OF_DRIVES = ("@eaDir", "@Recycle", "#recycle", "$RECYCLE.BIN")  # folders of Synology's and QNAP's drives, of Windows
DEEPEST = 64  # levels of nesting; the formats read here have ten at most

NOT_FETCHED = "Only files on this computer are read: download or unpack it, and give the file."
# The beginnings of URLs, of GDAL's names of datasets within a file, and of its virtual file systems.
_NO_FILE = re.compile(r"[A-Za-z][\w+.-]+:|/vsi\w+/")

_FOR_EXCEL = re.compile(r"\A\s*sep=.?(?=[\r\n])", re.IGNORECASE)  # a first line that tells Excel the separator
DECIMAL_COMMAS = (
    "Write numbers with a point (12.5). Decimal commas (12,5) are read if ; or tabs separate the columns and no number "
    "in the table has a point."
)
INSTALL_AGAIN = "A file of orthoscale itself is damaged: install it again."
EXPORT_ANEW = "The file is damaged or was cut off: copy it or export it again."

T = TypeVar("T")

# The beginnings of Python's and numpy's own messages for errors in values.
PROGRAMMERS = (
    "could not ", "cannot ", "invalid literal", "too many values", "not enough values", "setting an array", "all the ",
    "operands", "math domain", "embedded null", "matmul", "Exceeds the limit",
)  # fmt: skip

# msgspec's names of types, and plain ones for the people who have to mend the file.
WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "object": "an object",
    "array": "a list",
    "null": "null",
}


def read_bytes(path: Path, hint: str, most: int = SMALL) -> bytes:
    """The content of the regular file `path`, which has `most` bytes or fewer. Raises InputError."""
    check_regular(path, hint)  # before it is opened: opening a pipe waits for its other end
    try:
        size, content = path.stat().st_size, b""
        if size <= most:  # a file that is too large is not read at all
            with path.open("rb") as file:  # `read` takes as much memory as it is asked for, and `most` may be a budget
                content = file.read(min(max(size, SMALL), most) + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", hint) from error
    if size > most or len(content) > most:
        raise InputError(f"{path}: larger than the {most // MIB} MiB that such a file may have", hint)
    return content


def absent(path: Path, hint: str) -> InputError:
    """The error for an input that does not exist; with another hint if `path` is a URL or lies within another file."""
    return InputError(f"{path} does not exist", NOT_FETCHED if _NO_FILE.match(str(path)) else hint)


def check_regular(path: Path, hint: str) -> None:
    """Raise InputError if `path` is no regular file: a folder, a pipe, a device, or nothing."""
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})", hint) from error
    except ValueError as error:  # a zero byte in its name
        raise InputError(f"{path}: cannot be read (no such file)", hint) from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise InputError(f"{path}: cannot be read (it is {kind}, not a file)", hint)


def refuse_pipes_beside(files: Iterable[Path]) -> None:
    """Raise InputError for a pipe or a device that lies beside one of `files` and is named as if it belonged to it,
    such as ``a.tfw`` or ``a_rpc.txt`` beside ``a.tif``, ``a.pass`` beside ``a.1.tif``, or ``METADATA.DIM``: GDAL would
    read it as well, and wait for its other end."""
    pipes = cache(_pipes_in)
    for path in files:
        for pipe in pipes(path.parent):
            name, stem = pipe.name.lower(), path.stem.lower()
            alike = name.startswith((f"{stem}.", f"{stem}_")) or stem.startswith(pipe.stem.lower())
            if alike or _OF_SATELLITES.fullmatch(name):
                raise InputError(f"{pipe} is a pipe or a device, and is read together with {path}", "Move it away.")


def _pipes_in(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as there:
            return [Path(one) for one in there if not (one.is_file() or one.is_dir()) and os.path.exists(one)]
    except OSError:  # then GDAL cannot look for them either
        return []


def refuse_pointer(path: Path) -> None:
    """Raise InputError if `path` is only a pointer of Git LFS; anything else is left to the readers of its format."""
    if not path.is_file():
        return  # opening a pipe would wait for its other end
    try:
        with path.open("rb") as file:
            pointer = file.read(len(LFS_POINTER)) == LFS_POINTER
    except OSError:
        return
    if pointer:
        raise InputError(f"{path}: only a pointer of Git LFS, not the file", "Fetch the file with `git lfs pull`.")


def is_hidden(name: str) -> bool:
    """Whether a file or folder of that name is none of its user's: hidden, or where drives keep thumbnails and what was
    deleted."""
    return name.startswith(".") or name in OF_DRIVES


def files_below(
    folder: Path, suffixes: Container[str] | None = None, onerror: Callable[[OSError], None] | None = None
) -> list[Path]:
    """The files in `folder` and the folders below it, sorted, without following links to folders; only those whose
    suffix (in lower case) is one of `suffixes`, and no hidden ones (`is_hidden`), as macOS leaves beside others. Only
    these are kept in memory, however large the folder. onerror : called for a folder that cannot be read, which is else
    left out."""
    found = []
    for place, below, names in os.walk(folder, onerror=onerror):
        below[:] = [name for name in below if not is_hidden(name)]
        for name in names:
            path = Path(place, name)
            wanted = suffixes is None or path.suffix.lower() in suffixes
            if wanted and not is_hidden(name) and path.is_file():
                found.append(path)
    return sorted(found)


def is_there(path: Path) -> bool:
    """Whether there is a file or a folder at `path`, a name read from a file; False also for impossible names."""
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a zero byte
        return False


def read_text(path: Path, hint: str, most: int = LARGE) -> str:
    """The UTF-8 text in `path`, with or without a byte order mark. Raises InputError."""
    content = read_bytes(path, hint, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:  # spreadsheets may write a national encoding, or UTF-16
        at = f" (byte {error.start}); if it is one in another encoding, save it as UTF-8"
        other = " but UTF-16: save it as UTF-8" if content[:2] in UTF_16 else at
        raise InputError(f"{path}: not UTF-8 text{other}", hint) from error


class Table(csv.DictReader):
    """The lines of a CSV file by column name, made by `read_table`. Iteration raises csv.Error, and InputError for a
    line with more cells than there are columns: with commas as separators, 12,5 is two cells.

    commas : whether its numbers have decimal commas.
    """

    def __init__(self, path: Path, lines: Iterable[str], delimiter: str, commas: bool):
        super().__init__(lines, (), skipinitialspace=True, delimiter=delimiter)
        self.path, self.commas = path, commas

    def __next__(self) -> dict[str | Any, str | Any]:
        row = super().__next__()
        if any(cell.strip() for cell in row.get(None) or ()):
            raise InputError(f"{self.path}, line {self.line_num}: has more cells than the header has", DECIMAL_COMMAS)
        return row

    def number(self, row: Mapping[str | Any, str | Any], name: str, hint: str) -> float | None:
        """The finite number in the column `name` of `row`, None for an empty cell. Raises InputError."""
        text = (row.get(name) or "").strip()
        if not text:
            return None
        comma = WITH_COMMA.fullmatch(text)
        try:
            return number(text.replace(",", ".") if comma and self.commas else text)
        except ValueError:
            said = f"{self.path}, line {self.line_num}: {name} is {shown(text)!r}, not a number"
            raise InputError(said, DECIMAL_COMMAS if comma else hint) from None


def read_table(path: Path, hint: str) -> Table:
    """The lines of a CSV file by column name, in lower case, from its first line that is not blank. The separator is
    whichever of comma, semicolon and tab that line has most of. If it is not the comma, numbers may have decimal
    commas; with semicolons a comma is never taken for a thousands separator. Raises InputError."""
    text = _FOR_EXCEL.sub("", read_text(path, hint))
    lines = io.StringIO(text, newline="")
    head = next((line for line in lines if line.strip(",; \t\r\n")), "")
    delimiter = max(",;\t", key=head.count)
    commas = False
    if delimiter != "," and "," in text:
        cells = re.split(rf"[{delimiter}\r\n]", text)
        commas = decimal_commas((cell.strip(' "') for cell in cells), sure=delimiter == ";")
    lines.seek(0)
    table = Table(path, lines, delimiter, commas)
    try:
        names = next((row for row in table.reader if any(name.strip() for name in row)), [])
    except csv.Error as error:
        raise InputError(f"{path}: not a CSV table ({error})", hint) from error
    table.fieldnames = [name.strip().lower() for name in names]
    return table


def refuse_repeated(path: Path, table: Table, wanted: Iterable[str], hint: str) -> None:
    """Raise InputError if `table`, which `read_table` read from `path`, has several columns of a `wanted` name."""
    for name in wanted:
        if list(table.fieldnames or ()).count(name) > 1:
            raise InputError(f"{path}: has several columns {shown(name)}", hint)


def read_plain(path: Path, what: str, hint: str, most: int = SMALL) -> Any:
    """The JSON in `path` as plain values; `what` it should be, for the message ("a fleet"). Raises InputError."""
    return parsed(read_bytes(path, hint, most), str(path), what, hint)


@cache
def shipped(name: str) -> Any:
    """The table ``data/NAME.json`` of the program as plain values, read once. Raises InputError."""
    return read_plain(Path(__file__).parents[1] / "data" / f"{name}.json", f"the table of {name}", INSTALL_AGAIN)


def read(path: Path, schema: type[T], what: str, hint: str, most: int = SMALL) -> T:
    """The JSON in `path` as a `schema`, a type that msgspec understands. Raises InputError."""
    return decoded(read_bytes(path, hint, most), schema, str(path), what, hint)


def decoded(content: bytes | str, schema: type[T], origin: str, what: str, hint: str) -> T:
    """JSON as a `schema`, a type that msgspec understands. Raises InputError."""
    return checked(parsed(content, origin, what, hint), schema, origin, what, hint)


def parsed(content: bytes | str, origin: str, what: str, hint: str) -> Any:
    """JSON as plain values. `origin` names its source, for the message. Raises InputError."""
    import msgspec

    try:
        values = msgspec.json.decode(content)
        _check_depth(values)
        return values
    except RecursionError:
        problem = f"nested deeper than {DEEPEST} levels"
    except UnicodeError:
        problem = "not UTF-8 text"
    except msgspec.DecodeError as error:  # includes ValidationError: a number out of range
        start = content[:3] if isinstance(content, bytes) else content[:1].encode("utf-8", "replace")
        if start == b"\xef\xbb\xbf":
            problem = "it begins with a byte order mark, which JSON may not have: save it as UTF-8 without one"
        elif start[:2] in UTF_16:
            problem = "not UTF-8 text but UTF-16"
        else:
            problem = _in_words(str(error))
    raise InputError(f"{origin}: not {what} ({problem})", hint)


def checked(values: Any, schema: type[T], origin: str, what: str, hint: str) -> T:
    """Plain values as a `schema`. Raises InputError, which names the first place that does not fit."""
    import msgspec

    try:
        return msgspec.convert(values, schema)
    except msgspec.ValidationError as error:
        place, problem = _place_and_problem(values, schema, str(error))
    raise InputError(f"{origin}: not {what} ({place}{': ' if place else ''}{problem})", hint)


def reason(error: Exception) -> str:
    """What is wrong with the values whose use raised `error`, in words.

    The text of a ValueError says so if it was raised on purpose; those of Python and numpy are for programmers.
    """
    if isinstance(error, KeyError) and error.args:
        return f"{shown(str(error.args[0]))} is missing"
    if type(error) is ValueError and not str(error).startswith(PROGRAMMERS):
        return shown(str(error), 200)
    return "values of a wrong kind"


def _check_depth(values: Any) -> None:
    """Raise RecursionError for values nested deeper than recursive functions can later follow."""
    level = [values]
    for _ in range(DEEPEST + 1):
        if not level:
            return
        level = [
            part
            for whole in level
            if isinstance(whole, (dict, list))
            for part in (whole.values() if isinstance(whole, dict) else whole)
            if isinstance(part, (dict, list))
        ]
    raise RecursionError


def _place_and_problem(values: Any, schema: Any, message: str) -> tuple[str, str]:
    text, _, where = message.partition(" - at ")
    where = where.strip("`").removeprefix("key` in `").removeprefix("$")
    try:
        keys = _keys(values, schema, message, re.findall(r"\.\w+|\[\d+\]|\[\.\.\.\]", where))
    except (KeyError, IndexError, TypeError):
        return where.lstrip("."), _in_words(text)
    place = "".join(
        f"[{key}]" if isinstance(key, int) else f".{key}" if key.isidentifier() else f'["{shown(key)}"]' for key in keys
    )
    return place.lstrip("."), _in_words(text)


def _keys(values: Any, schema: Any, message: str, path: list[str]) -> list[str | int]:
    """The keys that lead to the value that `message` is about. msgspec writes ``[...]`` for any key of a mapping; the
    key is found by bisection: the half that contains it fails with the same message."""
    import msgspec

    keys: list[str | int] = []
    here = values
    for step in path:
        if step == "[...]":
            names = list(here)
            while len(names) > 1:
                half = names[: len(names) // 2]
                try:
                    msgspec.convert(_replaced(values, keys, {name: here[name] for name in half}), schema)
                    failed = False
                except msgspec.ValidationError as error:
                    failed = str(error) == message
                names = half if failed else names[len(names) // 2 :]
            key: str | int = names[0]
        else:
            key = step[1:] if step.startswith(".") else int(step[1:-1])
        keys.append(key)
        here = here[key]
    return keys


def _replaced(values: Any, keys: list[str | int], new: Any) -> Any:
    """`values` with `new` at the place that `keys` lead to; the rest is shared, not copied."""
    if not keys:
        return new
    copy = values.copy()
    copy[keys[0]] = _replaced(values[keys[0]], keys[1:], new)
    return copy


def _in_words(message: str) -> str:
    if "truncated" in message:
        return "it ends too early"
    if match := re.search(r"malformed: .*\(byte (\d+)\)", message):
        return f"malformed JSON at byte {match[1]}"
    if "out of range" in message:
        return "a number too large"
    if match := re.match(r"Object (missing required|contains unknown) field `(.*)`", message, re.DOTALL):
        return f"{shown(match[2])} {'is missing' if 'missing' in match[1] else 'is not known here'}"
    if match := re.match(r"Invalid enum value (.*)", message, re.DOTALL):
        return f"{shown(match[1])} is not one of the values known here"
    message = message.replace("Expected", "expected").replace(", got", ", found")
    message = re.sub(r"a number > 0\.0(?!\d)", "a positive number", re.sub(r"`([^`]*)`", _kinds, message))
    return shown(message, 300)


def _kinds(match: re.Match[str]) -> str:
    return " or ".join(WORDS.get(word, word) for word in match[1].split(" | "))
