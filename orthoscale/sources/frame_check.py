"""Checks whether frames are those that a model was made from: whether they show its points in the same colours and
places.

Cameras use the same file names on every flight, so a folder of another flight has the same names and sizes. In four
real models the brightness of the points and of the frames correlates by 0.84 to 0.99 in every frame, and by 0.40 at
most if a frame is replaced by another. Files of another flight that were copied into the folder replace some frames.

Frames of the same size that were undistorted later, or that are the originals of an undistorted model, show things away
from the middle larger or smaller than the model's lens does: with a k1 of 0.1, scales are 3 to 8 % off. (Frames of
another size are refused: `PictureFile.check_size`.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..core.evenly import evenly
from ..core.remarks import CAUTION, REFUSAL, Remark
from ..errors import InputError
from .colmap_read import cameras_of, images_of
from .distortion import project
from .picture_file import PictureFile

if TYPE_CHECKING:
    import pycolmap

    from .consistency import Observations

# Places (N, 2) [px] of a model's points in the image of a name, and their brightness (N,) [0 to 255].
PointsIn = Callable[[str], tuple[np.ndarray, np.ndarray]]

FRAMES_COMPARED = 5  # that are checked for places and colours, spread over all
FRAMES_GLANCED_AT = 20  # that are checked for colours in the model's places, which is quick
GLANCE = 4  # by what factor large frames are reduced for it
PROJECTED = 50_000  # most points that are projected
LEAST_POINTS = 50  # of a frame that can be checked
LEAST_CONTRAST = 5.0  # [of 255] standard deviation: a blank frame shows nothing
OWN_FRAMES = 0.5  # median correlation of the frames from which they are the model's
# Correlation at other places from which the points surely lie there; by how much it must exceed that in the model's
# places; and the least error [relative] that is reported. An error of 1 % costs the four models 0.03 to 0.2 of the
# correlation, and their own frames fit within 0.3 %.
SURE_PLACE, GAIN, LEAST_ERROR = 0.7, 0.03, 0.01
MOST_ZOOM, MOST_BEND = 0.12, 0.4  # range of the search for other places, see `_ZoomFit`
SHARES_TRIED = np.linspace(-1, 1, 7)
GRIDS = 6  # search grids, each half as wide as the one before: in the end errors of 0.2 % show


@dataclass(frozen=True)
class _ZoomFit:
    """Where a frame shows the points: (zoom + bend * r^2) times as far from the middle as in the model, r in focal
    lengths.

    own, best : correlation in the model's places, and in those. error : how much larger things are there, relative.
    """

    own: float
    best: float
    error: float


def check_frames(model: pycolmap.Reconstruction, pictures: Sequence[PictureFile], points_in: PointsIn) -> list[Remark]:
    """Remarks on `pictures`, the frames of `model`, if they do not show its points, or show them elsewhere."""
    cameras = cameras_of(model)
    chosen = [pictures[k] for k in evenly(len(pictures), FRAMES_COMPARED)]
    fits = [fit for picture in chosen if (fit := _fitted(cameras[picture.name], points_in, picture)) is not None]
    if not fits:
        return []
    own, best, error = (float(np.median([getattr(fit, name) for fit in fits])) for name in ("own", "best", "error"))
    if best >= max(SURE_PLACE, own + GAIN) and abs(error) >= LEAST_ERROR:
        size = "larger" if error > 0 else "smaller"
        text = (
            f"the frames show things {abs(error):.1%} {size} than the model's lens does ({chosen[0].path} ...): "
            "they were undistorted or cropped since it was made, or it was made from undistorted ones; the scale is "
            "off by as much or more (give the model's own frames with --images)"
        )
        return [Remark(CAUTION, text)]
    if own < OWN_FRAMES:
        text = (
            f"the frames do not show the model's points in their colours (correlation {own:.2f}, usual is 0.9; "
            f"{chosen[0].path} ...): they may be of another flight, turned, or changed since"
        )
        return [Remark(REFUSAL, text, "Name the folder of the frames that the model was made from (--images)")]
    return _on_strangers(pictures, points_in)


def points_seen(model: pycolmap.Reconstruction, seen: Observations) -> PointsIn:
    """What the sample `seen` of the observations of `model` tells of its points; without any, see `_projected`."""
    if not len(seen.image):
        return _projected(model)
    brightness = np.array([point.color for _, point in sorted(model.points3D.items())], float).mean(1)

    def points_in(name: str) -> tuple[np.ndarray, np.ndarray]:
        pixels, number = seen.of(name)
        return pixels, brightness[number]

    return points_in


def all_points_seen(model: pycolmap.Reconstruction) -> PointsIn:
    """What the images of COLMAP's `model` tell of its points; without observations, see `_projected`."""
    images = images_of(model)
    if not any(image.num_points3D for image in images.values()):
        return _projected(model)

    def points_in(name: str) -> tuple[np.ndarray, np.ndarray]:
        seen = [point for point in images[name].points2D if point.has_point3D()]
        place = np.array([point.xy for point in seen]).reshape(-1, 2)
        colours = np.array([model.points3D[point.point3D_id].color for point in seen], float).reshape(-1, 3)
        return place, colours.mean(1)

    return points_in


def _projected(model: pycolmap.Reconstruction) -> PointsIn:
    """Where the images of `model`, which holds no observations, would show its points if nothing hid them.

    In four real models the brightness then correlates by 0.65 to 0.95 in every frame (0.89 to 0.98 where the points
    were seen), and by 0.31 at most in a turned frame or another.
    """
    numbers = sorted(model.points3D)
    points = [model.points3D[numbers[k]] for k in evenly(len(numbers), PROJECTED)]
    world = np.array([point.xyz for point in points])
    brightness = np.array([point.color for point in points], float).mean(1)
    images = images_of(model)

    def points_in(name: str) -> tuple[np.ndarray, np.ndarray]:
        camera, pose = model.camera(images[name].camera_id), images[name].cam_from_world()
        place = project(camera, world @ pose.rotation.matrix().T + pose.translation)
        with np.errstate(invalid="ignore"):
            inside = ((place >= 0) & (place < (camera.width, camera.height))).all(1)
        return place[inside], brightness[inside]

    return points_in


def _on_strangers(pictures: Sequence[PictureFile], points_in: PointsIn) -> list[Remark]:
    """A caution on single ones among the model's own frames that do not show its points."""
    chosen = [pictures[k] for k in evenly(len(pictures), FRAMES_GLANCED_AT)]
    each = [(picture, _own(points_in, picture)) for picture in chosen]
    known = [(picture, own) for picture, own in each if own is not None]
    if not (strangers := [picture for picture, own in known if own < OWN_FRAMES]):
        return []
    text = (
        f"{len(strangers)} of {len(known)} frames that were compared do not show the model's points in their colours, "
        f"the first is {strangers[0].path}: files of another flight may have replaced them; vehicles in them are "
        "measured wrongly"
    )
    return [Remark(CAUTION, text)]


def _own(points_in: PointsIn, picture: PictureFile) -> float | None:
    """How well the brightness of the model's points correlates with `picture` at their places; None if that cannot be
    found."""
    place, colours = _coloured(points_in, picture)
    if len(place) < LEAST_POINTS:
        return None
    try:
        with picture.pixels(GLANCE) as (pixels, factor):
            return _likeness(pixels, place / factor, colours)
    except InputError:  # reported by whoever needs the picture
        return None


def _fitted(camera: pycolmap.Camera, points_in: PointsIn, picture: PictureFile) -> _ZoomFit | None:
    """Where `picture` shows the points seen in it, by the brightness of both; None if that cannot be found."""
    place, colours = _coloured(points_in, picture)
    if len(place) < LEAST_POINTS:
        return None
    middle = np.array([camera.principal_point_x, camera.principal_point_y])
    place = place - middle
    r2 = ((place / camera.mean_focal_length()) ** 2).sum(1)
    try:
        with picture.pixels() as (pixels, _):

            def likeness(zoom: float, bend: float) -> float:
                found = _likeness(pixels, place * (zoom + bend * r2)[:, None] + middle, colours)
                return -1.0 if found is None else found

            own = likeness(1, 0)
            if own == -1:
                return None
            zoom, bend = _highest(likeness)
            return _ZoomFit(own, likeness(zoom, bend), zoom - 1 + 2 * bend * float(r2.mean()))
    except InputError:  # reported by whoever needs the picture
        return None


def _coloured(points_in: PointsIn, picture: PictureFile) -> tuple[np.ndarray, np.ndarray]:
    """What `points_in` has of `picture`, without black points: COLMAP's mapper leaves some points without a colour,
    which may be a third of a frame's."""
    place, colours = points_in(picture.name)
    return place[colours > 0], colours[colours > 0]


def _likeness(pixels: np.ndarray, place: np.ndarray, colours: np.ndarray) -> float | None:
    """How well brightness `colours` (N,) correlates with that of `pixels` (H, W, 3) at `place` (N, 2) [px]; None where
    less than half of them lie inside, or one has no contrast."""
    x, y = place.T
    inside = (x >= 0) & (x < pixels.shape[1]) & (y >= 0) & (y < pixels.shape[0])
    shown = pixels[y[inside].astype(int), x[inside].astype(int)].mean(1)
    if 2 * inside.sum() < len(place) or min(colours[inside].std(), shown.std()) < LEAST_CONTRAST:
        return None
    return float(np.corrcoef(colours[inside], shown)[0, 1])


def _highest(likeness: Callable[[float, float], float]) -> tuple[float, float]:
    """The zoom and bend of the highest likeness, which has one maximum; by grids, each half as wide as the last."""
    zoom, bend = 1.0, 0.0
    for part in 0.5 ** np.arange(GRIDS):
        tries = [(zoom + part * MOST_ZOOM * a, bend + part * MOST_BEND * b) for a in SHARES_TRIED for b in SHARES_TRIED]
        zoom, bend = max(tries, key=lambda each: likeness(*each))
    return zoom, bend
