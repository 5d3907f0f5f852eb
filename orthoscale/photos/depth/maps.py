"""The source of depth maps for photos: a file, a folder of files named like the photos, or a network."""

from __future__ import annotations

from pathlib import Path

from ...core.boxes import Boxes
from ...errors import InputError, UsageError
from ...formats.reading import absent
from ...requests import PhotoRequest
from ..measure import Interval90, Photo
from .files import MAP_ENDINGS, read_depth
from .ground import DepthAltitude, DepthMap, Kind, depth_altitude
from .network import DepthNetwork
from .rules import RULES, rule_of


class Depths:
    """The metric depth of photos, from the source that a request names."""

    def __init__(self, path: Path, kind: Kind = "z", factor: str | None = None, several: bool = False):
        """Open the source of depth at `path`; see `PhotoRequest` for `kind` and `factor`.

        several : whether there are several photos. Raises InputError, UsageError.
        """
        self._path, self._kind, self._told = path, kind, factor is not None
        self._rule = rule_of(factor)
        self._network = None
        if not path.exists():
            raise absent(path, "Give a depth map, a folder of them, or a network (.onnx).")
        if path.suffix.lower() == ".onnx":
            if factor is None:
                raise UsageError(
                    f"{path.name}: nothing states the unit of this network's depth",
                    f"Name the network, --depth-factor {'|'.join(RULES)}, or give the metres per unit.",
                )
            self._network = DepthNetwork(path, self._rule)
        elif not path.is_dir():
            if path.suffix.lower() not in MAP_ENDINGS:
                raise UsageError(
                    f"{path.name} is not one of {', '.join(MAP_ENDINGS)}, .onnx", "Its ending sets its format."
                )
            if several:
                raise UsageError(
                    f"{path} is the depth of one photo, and these are several",
                    "Give a folder with a depth map for each, named as the photo is.",
                )

    @classmethod
    def asked(cls, how: PhotoRequest, several: bool) -> Depths | None:
        """The source that the request `how` names; None if it names none."""
        if how.depth is None:
            return None
        return cls(Path(how.depth), "range" if how.depth_kind == "range" else "z", how.depth_factor, several)

    def altitude(self, photo: Photo, boxes: Boxes, by_vehicles: Interval90 | None = None) -> DepthAltitude:
        """See `depth_altitude`. Raises InputError for a photo without a depth map, too."""
        return depth_altitude(photo, self.of(photo), boxes, by_vehicles)

    def of(self, photo: Photo) -> DepthMap:
        """The depth of `photo` in metres. Raises InputError."""
        if self._network is not None:
            values, shrunk = self._network(photo.picture)
            focal, origin = photo.lens.focal_px / shrunk, f"{self._path}, of {photo.name}"
        else:
            path = self._file(photo) if self._path.is_dir() else self._path
            values = read_depth(path, self._told)
            focal, origin = photo.lens.focal_px * values.shape[1] / photo.tags.width, str(path)
        return DepthMap(values * self._rule.metres(focal), self._kind, origin)

    def _file(self, photo: Photo) -> Path:
        """The map of `photo` in the folder: its name with another ending, in the same subfolder or in the folder
        itself."""
        name = Path(photo.name)
        for stem in (name.with_suffix(""), Path(name.stem)):
            for ending in MAP_ENDINGS:
                if (path := self._path / f"{stem}{ending}").is_file():
                    return path
        raise InputError(
            f"{self._path}: no depth map of {photo.name}",
            f"Expected {name.stem}{MAP_ENDINGS[0]} or the like.",
        )
