"""The files that a report is of, and whether they were replaced since."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.source import FilePicture, Source
from ..formats.names import first_few
from ..sources.fingerprint import glance
from ..system.paths import absolute


def frames_of(source: Source) -> dict[str, tuple[int, int]]:
    """What tells each frame of a reconstruction, which its hash does not cover, from another: see `glance`. Raises
    InputError."""
    files = () if source.posed is None else (p for p in source.pictures if isinstance(p, FilePicture))
    return {picture.name: glance(picture.path) for picture in files}


def other_files(source: Source, given: Sequence[Path]) -> dict[str, list[int]]:
    """What tells others of the same name, see `glance`, from the files besides `source` that its report is of: the
    parts of a VRT and whatever else an orthophoto is read with, and those `given` by options. Names start from the
    source's folder, if that is on the same drive. Raises InputError."""
    own, home = absolute(source.path), absolute(source.path).parent
    files = [absolute(path) for path in (*(source.files if source.plan is not None else ()), *given)]
    # GIS programs write statistics into .aux.xml.
    others = [path for path in files if path != own and path.is_file() and not path.name.endswith(".aux.xml")]
    return {os.path.relpath(p, home) if p.drive == home.drive else str(p): [*glance(p)] for p in others}


def replaced_inputs(report: Mapping[str, Any], source: Source, given: Sequence[Path] = ()) -> str:
    """Says which frames of `source`, or else which other files, see `other_files`, are not those that its `report` was
    made of; '' if all are. Raises InputError."""
    sizes, crcs = report["frame_bytes"], report["frame_crc32"]
    frames = [
        name
        for name, (size, crc) in frames_of(source).items()
        if sizes.get(name, size) != size or crcs.get(name, crc) != crc
    ]
    if frames:
        return f"frames have changed since: {first_few(frames)}"
    known = report["other_files"]
    files = [name for name, now in other_files(source, given).items() if known.get(name, now) != now]
    return f"files have changed since: {first_few(files)}" if files else ""
