"""The vehicles found in a source, with all that is needed to measure them."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from .boxes import Boxes
from .confirmed import AS_LIKELY
from .ruler import Ruler
from .source import GROUND_FOLDER, Pictures

# For boxes from a file that has no ruler: nobody has measured their margin.
UNKNOWN_RULER = Ruler(margin=(0.0, 0.0), margin_sd=(1.5, 1.2), bias_sd=(0.02, 0.03), noise=(2.0, 1.2))
UNKNOWN_HEIGHT = (0.7, 0.6)  # their effective heights: those of a DOTA-trained YOLO-OBB on oblique frames [m]
UNCONFIRMED = "low confidence, or detected at only one resolution"  # why `Detections.doubtful` do not count
NEAR_AND_FAR = 4.0  # lengths within this factor may be those of the same vehicles, in frames from nearer and farther


@dataclass(frozen=True)
class Tile:
    """A window of a picture: position and size [px of the picture], and the size it is resampled to."""

    x: int
    y: int
    width: int
    height: int
    out_width: int
    out_height: int


class ZoomLook(NamedTuple):
    """What the scale search saw at one `zoom`: number of boxes, and of those that the next lower zoom confirms."""

    zoom: float
    boxes: int
    confirmed: int


@dataclass(frozen=True)
class ZoomChoice:
    """The result of the scale search. zoom : detector pixels per picture pixel. vehicle_px : the vehicles' length in
    picture pixels, None if not found.

    one_scale : a vehicle has the same length wherever it stands, as in an orthophoto.
    votes : weighted boxes behind the choice. rival_px : the second best length [px of the picture]. rival : the
    significance of its votes as a share of the best one's.
    looks : at all zooms, from the lowest.
    """

    zoom: float
    vehicle_px: float | None
    votes: float
    rival_px: float | None
    rival: float
    looks: list[ZoomLook] = field(repr=False)
    one_scale: bool = False

    @property
    def as_likely(self) -> float | None:
        """Another length, quite different, that is about as likely [px of the picture]; None if there is none."""
        if self.vehicle_px is None or self.rival_px is None:
            return None
        apart = max(self.vehicle_px / self.rival_px, self.rival_px / self.vehicle_px)
        return self.rival_px if self.rival > AS_LIKELY and (self.one_scale or apart > NEAR_AND_FAR) else None


@dataclass(frozen=True)
class Swept:
    """Which tiles were processed. tiles : (picture name, tile) of each, in reading order. total : number of all tiles.
    from_cache : number of tiles whose boxes came from the cache. pictures : number of pictures. why : the reason for
    which the others were left out, in words; empty if none were. zoom_choice : how their zoom was searched for; None if
    the user gave it."""

    tiles: list[tuple[str, Tile]] = field(repr=False)
    total: int
    from_cache: int = 0
    pictures: int = 1
    why: str = ""
    zoom_choice: ZoomChoice | None = None

    @property
    def looked_at(self) -> str:
        """The number processed and the total, in words: of frames if there are several pictures, else of tiles."""
        if self.pictures == 1:
            return f"looked at {len(self.tiles):,} of {self.total:,} tiles"
        return f"looked at {len({name for name, _ in self.tiles}):,} of {self.pictures:,} frames"


@dataclass(frozen=True)
class Detections:
    """Boxes by picture name [px of the picture], with what is needed to measure with them.

    zoom : detector pixels per picture pixel; the ruler's margin and noise are in detector pixels.
    effective_height : height up to which boxes enclose a vehicle seen obliquely, for its length and its width [m].
    undercut : how far inside its outline a vehicle meets the ground, along length and width [m]; 0 for not known.
    body : the vehicles' shape by the detector's card, one of `core.projection.exact.BODIES`.
    doubtful : boxes that only one detection pass finds, or both with low confidence (UNCONFIRMED), by picture name.
    set_aside : boxes that both passes find but that do not count, by the reason and picture name.
    objects : boxes of other classes than vehicles, by picture name and class, for `measuring.objects.standard_objects`.
    planar : the detections in a reconstruction's ground pictures, by the frame's name [px of the ground picture].
    sizes : width and height of the pictures on which the boxes were made [px], where they are known.
    zoom_given : whether the user gave the zoom, or the size of a pixel, and so how large vehicles are; files keep it.
    swept : how the boxes were found just now; None for boxes from a file.
    notes : remarks for the user on what was found; files do not keep them.

    `orthoscale.formats.detections` reads and writes files of them.
    """

    boxes: dict[str, Boxes]
    zoom: float
    ruler: Ruler
    effective_height: tuple[float, float]
    detector: str
    detector_sha256: str = ""
    undercut: tuple[float, float] = (0.0, 0.0)
    body: str = "car"
    doubtful: dict[str, Boxes] = field(default_factory=dict)
    set_aside: dict[str, dict[str, Boxes]] = field(default_factory=dict)
    objects: dict[str, dict[str, Boxes]] = field(default_factory=dict)
    planar: Detections | None = None
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    zoom_given: bool = False
    swept: Swept | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return sum(map(len, self.boxes.values()))

    @property
    def unconfirmed(self) -> int:
        """Number of `doubtful` boxes."""
        return sum(map(len, self.doubtful.values()))

    @property
    def uncounted(self) -> dict[str, int]:
        """Number of boxes that were detected but do not count, by reason."""
        aside = {why: sum(map(len, boxes.values())) for why, boxes in self.set_aside.items()}
        return {UNCONFIRMED: self.unconfirmed, **aside}

    def setting_aside(self, why: str, boxes: Mapping[str, Boxes]) -> Detections:
        """The same with more `boxes` set aside, by picture name, for the reason `why`."""
        aside = dict(self.set_aside.get(why, {}))
        for name, more in boxes.items():
            aside[name] = Boxes.concatenate([aside.get(name, Boxes.empty()), more])
        return replace(self, set_aside={**self.set_aside, why: aside}) if aside else self

    def only_in(self, pictures: Container[str]) -> Detections:
        """The same, restricted to these `pictures`, except for `planar`."""
        return self._each(lambda some: {name: each for name, each in some.items() if name in pictures})

    def renamed(self, new: Callable[[str], str]) -> Detections:
        """The same with the name `new(name)` for each picture, and for the frame of each ground picture in `planar`."""

        def above(name: str) -> str:
            frame = name.removeprefix(GROUND_FOLDER)
            return new(name) if frame == name else GROUND_FOLDER + new(frame)

        planar = None if self.planar is None else self.planar.renamed(above)
        return replace(self._each(lambda some: {new(name): each for name, each in some.items()}), planar=planar)

    def _each(self, change: Callable[[Mapping[str, Any]], dict[str, Any]]) -> Detections:
        """The same with `change` applied to all that is kept by picture name, except in `planar`."""
        return replace(
            self,
            boxes=change(self.boxes),
            doubtful=change(self.doubtful),
            set_aside={why: change(some) for why, some in self.set_aside.items()},
            objects=change(self.objects),
            sizes=change(self.sizes),
        )

    @property
    def pictures(self) -> set[str]:
        """Names of the pictures that it has anything of: vehicles, other boxes, boxes in their ground pictures."""
        names = set().union(self.boxes, self.doubtful, *self.set_aside.values(), self.objects)
        return names if self.planar is None else names | self.planar.pictures

    def made_on(self, source: Pictures) -> Detections:
        """The same with the sizes of its pictures [px], which are those of `source`."""
        pictures = self.pictures
        sizes = {name: source.image_size(name) for name in source.picture_names if name in pictures}
        return replace(self, sizes=sizes)

    @property
    def assumed(self) -> tuple[str, ...]:
        """A note that nobody has measured the ruler, if so."""
        if self.ruler != UNKNOWN_RULER:
            return ()
        length, width = self.ruler.margin_sd
        return (
            "by how much these boxes are longer and wider than the vehicles is not known: "
            f"0 +- {length:g} and 0 +- {width:g} detector pixels are assumed (orthoscale calibrate measures it)",
        )

    @property
    def any_boxes(self) -> bool:
        """Whether there is any vehicle, in the pictures or in the ground pictures."""
        return len(self) > 0 or (self.planar is not None and self.planar.any_boxes)
