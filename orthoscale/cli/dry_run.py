"""What `--dry-run` prints: what would be done with each input, though nothing is."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from ..errors import OrthoscaleError
from .options import say, say_json

if TYPE_CHECKING:
    from ..requests import EstimateRequest

REHEARSAL_FORMAT = "orthoscale rehearsal 1"


def rehearse(
    paths: Sequence[Path],
    request: EstimateRequest,
    outs: Sequence[Path | None] | None = None,
    shown: Callable[[str], str] = str,
    leave: Callable[[Path, Path], bool] = lambda path, out: False,
    save_detections: Path | None = None,
    overwrite: bool = False,
    needs_claim: bool = False,
    as_json: bool = False,
) -> NoReturn:
    """Print what would be done with each of `paths`, whose copies would go to `outs`; exit with the worst exit code.

    shown : applied to each text before it is printed, as JSON if `as_json`. leave : whether an input's existing copy
    would be left as it is. save_detections, overwrite, needs_claim : see `rehearsal`.
    """
    from ..actions.rehearsal import rehearsal

    codes, told, request = [], [], replace(request, alone=len(paths) == 1)
    for path, out in zip(paths, outs or [None] * len(paths), strict=True):
        try:
            if out is not None and leave(path, out):
                rows = [("input", str(path)), ("is there", str(out))]
            else:
                rows = rehearsal(path, request, out, save_detections, overwrite, needs_claim)
            codes.append(0)
        except OrthoscaleError as error:
            if len(paths) == 1:
                raise
            rows = [("input", str(path)), ("error", f"{error.message} (exit code {error.exit_code})")]
            codes.append(error.exit_code)
        told.append([(label, shown(text)) for label, text in rows])
        if not as_json:
            tell_rehearsals(told[-1:])
    if as_json:
        tell_rehearsals(told, as_json)
    sys.exit(max(codes))


def tell_rehearsals(told: Sequence[Sequence[tuple[str, str]]], as_json: bool = False) -> None:
    """Print the rows of every `rehearsal`; in JSON, each label has a list of its texts."""
    if not as_json:
        for rows in told:
            say(*(f"{label:10s} {text}" for label, text in rows))
        return
    inputs: list[dict[str, list[str]]] = [{} for _ in told]
    for one, rows in zip(inputs, told, strict=True):
        for label, text in rows:
            one.setdefault(label, []).append(text)
    say_json({"format": REHEARSAL_FORMAT, "inputs": inputs})


def rehearse_in_new_folder(
    paths: Sequence[Path],
    request: EstimateRequest,
    out: Path,
    places: Callable[[Path], list[Path]],
    as_json: bool = False,
) -> NoReturn:
    """`rehearse` for copies at `places` in the folder `out`, which does not exist yet."""
    with tempfile.TemporaryDirectory() as stand_in:
        there = places(Path(stand_in))
        rehearse(paths, request, there, lambda text: text.replace(stand_in, str(out)), as_json=as_json)
