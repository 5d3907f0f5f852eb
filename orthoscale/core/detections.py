"""The vehicles found in a source, with all that is needed to measure them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from .boxes import Boxes
from .ruler import Ruler

# Boxes from a file that does not say what ruler they are: a margin nobody has measured.
UNKNOWN_RULER = Ruler(margin=(0.0, 0.0), margin_sd=(1.5, 1.2), bias_sd=(0.02, 0.03), noise=(2.0, 1.2))
UNKNOWN_HEIGHT = (0.7, 0.6)  # of a DOTA-trained YOLO-OBB on oblique frames, for want of better [m]
UNCONFIRMED = "low confidence, or detected at only one resolution"  # why `Detections.doubtful` do not count


@dataclass(frozen=True)
class Tile:
    """A window of a picture: position and size [px of the picture], and the size it is resampled to."""

    x: int
    y: int
    width: int
    height: int
    out_width: int
    out_height: int


@dataclass(frozen=True)
class Swept:
    """Which tiles were processed. tiles : (picture name, tile) of each, in reading order. total : number of tiles that
    there are. from_cache : number of tiles whose boxes came from the cache. pictures : number of pictures. why : why
    the others were left out, in words; empty if none were."""

    tiles: list[tuple[str, Tile]] = field(repr=False)
    total: int
    from_cache: int = 0
    pictures: int = 1
    why: str = ""

    @property
    def looked_at(self) -> str:
        """Number processed and total, in words: of frames where there are several pictures, else of tiles."""
        if self.pictures == 1:
            return f"looked at {len(self.tiles):,} of {self.total:,} tiles"
        return f"looked at {len({name for name, _ in self.tiles}):,} of {self.pictures:,} frames"


@dataclass(frozen=True)
class Detections:
    """Boxes by picture name [px of the picture], with what is needed to measure with them.

    zoom : detector pixels per picture pixel; the ruler's margin and noise are in detector pixels.
    effective_height : up to where the boxes enclose a vehicle seen obliquely, along its length and its width [m].
    undercut : how far inside its outline a vehicle meets the ground, along length and width [m]; 0 for not known.
    objects : boxes of other classes than vehicles, by picture name and class, for `measuring.objects.standard_objects`.
    doubtful : boxes that one detection pass alone shows, or both without being sure (UNCONFIRMED), by picture name.
    set_aside : boxes that both passes show and that do not count all the same, by the reason and picture name.
    planar : those of a reconstruction's frames warped onto the ground, by the frame's name, in the plans' pixels.
    body : what the vehicles are shaped like, one of `core.projection.exact.BODIES`; the card's.
    swept : which tiles were looked at, where the boxes do not come from a file.

    Files of them are read and written by `orthoscale.formats.detections`.
    """

    boxes: dict[str, Boxes]
    zoom: float
    ruler: Ruler
    effective_height: tuple[float, float]
    detector: str
    detector_sha256: str = ""
    doubtful: dict[str, Boxes] = field(default_factory=dict)
    objects: dict[str, dict[str, Boxes]] = field(default_factory=dict)
    planar: Detections | None = None
    swept: Swept | None = None
    body: str = "car"
    notes: tuple[str, ...] = ()
    set_aside: dict[str, dict[str, Boxes]] = field(default_factory=dict)
    undercut: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        return sum(map(len, self.boxes.values()))

    @property
    def unconfirmed(self) -> int:
        """Number of the doubtful ones."""
        return sum(map(len, self.doubtful.values()))

    def setting_aside(self, why: str, boxes: Mapping[str, Boxes]) -> Detections:
        """The same with more boxes set aside for the reason `why`, by picture name."""
        aside = dict(self.set_aside.get(why, {}))
        for name, more in boxes.items():
            aside[name] = Boxes.concatenate([aside.get(name, Boxes.empty()), more])
        return replace(self, set_aside={**self.set_aside, why: aside}) if aside else self

    @property
    def any_boxes(self) -> bool:
        """Whether there is a vehicle, in the pictures or in those of the ground."""
        return len(self) > 0 or (self.planar is not None and self.planar.any_boxes)
