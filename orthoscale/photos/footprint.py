"""The ground that a photo covers, by the scale from its vehicles or by a given GSD."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.progress import Progress
from ..errors import TooLittleEvidence
from ..option import positive
from ..sources.picture_file import PictureFile
from ..sources.tags import read_tags
from .looking import Looking, boxes_of
from .measure import measure
from .photo import GivenCamera, open_photo

if TYPE_CHECKING:
    from typing import Unpack


@dataclass(frozen=True)
class Footprint:
    """gsd : average ground sampling distance of the photo [m/px]. told : facts for reports."""

    picture: PictureFile
    gsd: float
    told: dict[str, Any]


def footprint_of(
    path: Path, gsd: float | None, how: Looking, progress: Progress | None = None, **lens: Unpack[GivenCamera]
) -> Footprint:
    """The ground of the photo at `path`.

    Raises InputError, UsageError, TooLittleEvidence.
    """
    if gsd is not None:
        gsd = positive("--gsd", gsd)
        tags = read_tags(path)
        picture = PictureFile(path.name, path, tags.width, tags.height)
        return Footprint(picture, gsd, {"photo": str(path), "gsd": gsd})
    ruler, why = how.ruler_fleet([path])
    photo = open_photo(path, **lens)
    found = boxes_of([photo], how, ruler, progress)
    try:
        got = measure([photo], found, ruler)
    except TooLittleEvidence as error:
        raise TooLittleEvidence(
            f"{path}: {error.message}", "Give the metres per pixel of the photo (--gsd), if known."
        ) from error
    told = {
        "photo": str(path),
        "gsd": got.gsd.value,
        "gsd_interval90": [got.gsd.low, got.gsd.high],
        "altitude": got.altitude.value,
        "altitude_interval90": [got.altitude.low, got.altitude.high],
        "vehicles_used": got.scale.vehicles_used,
        "verdict": got.scale.verdict,
        "fleet": ruler.code,
        "attitude": photo.attitude,
        "focal_source": photo.lens.source,
        "notes": [*why, *found.notes],
    }
    return Footprint(photo.picture, got.gsd.value, told)
