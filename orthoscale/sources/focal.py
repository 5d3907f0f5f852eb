"""How well a reconstruction's own observations determine its focal length, and whether it is bent.

From straight above flat ground, a longer focal length and a higher camera give the same pictures: bundle adjustment
cannot separate them, nor determine heights, while horizontal positions on the ground are unaffected. The normal
equations of the adjustment show whether this is the case, by the information on the focal length that is left after
poses and points were eliminated (Schur complement; Triggs et al., Bundle Adjustment: A Modern Synthesis, 2000, 6.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, islice
from typing import TYPE_CHECKING

import numpy as np

from ..core.evenly import evenly
from ..core.source import FocalDoubt
from ..errors import InputError
from .colmap_read import cameras_of

if TYPE_CHECKING:
    import pycolmap

    from .lens import Lens
    from .picture_file import PictureFile

_Track = tuple[np.ndarray, np.ndarray, float]  # place of a point, its images as numbers of the poses, error [px]

MOST_TRACKS = 1500  # points whose tracks are used, those with the longest: a second's work
MOST_IMAGES = 120  # that are used, spread evenly over the model
MOST_VIEWS = 12  # of one point
# The same for points without tracks, which other programs' files rarely have. Two real blocks that look straight down
# are then open to a bend by 0.7 and 0.8 times as much as by their tracks, two slanted ones by 0.3 and 0.9.
VIEWS_ASSUMED = 6
LEAST_TRACKS = 50  # points of three views and more that are needed for any result
LEAST_HOLDING = 6  # of them in an image whose pose counts: six unknowns, and points take half of what they tell
LEAST_PX = 0.5  # least error of an observation: they are adjusted by the thousand, so errors are not independent
HELD = 1e-9  # regularisation, as a share of each diagonal element: poses are known only up to a similarity transform
# Factor from the formal uncertainty of the focal length, that for independent errors, to the real one. Independent
# errors of thousands of observations average to hundredths of a pixel; the distortion that the lens model does not
# describe, 0.1 to 0.3 px all over the picture, does not. An assumption; on the flat block `brighton` the factor is 14,
# by EXIF.
SYSTEMATIC = 10.0
OPEN = 0.03  # relative one-sigma from which a focal length counts as open: the lean of vehicles is off by as much
FOCAL_UNKNOWN = 0.5  # from which it is as good as unknown: within two sigmas it may be anything
FOCAL_FRAMES = 12  # whose EXIF is read, spread evenly over the model: its lens may change on the way
LONGEST_LENS = 2.5  # longer sides of the picture: 90 mm on full frame; aerial cameras have two at most
LENS_UNKNOWNS = 3  # columns shared by all images of a camera: focal length, and two of radial distortion


def focal_doubt(model: pycolmap.Reconstruction, pictures: Sequence[PictureFile]) -> FocalDoubt:
    """The uncertainty of the focal length of `model`, by its tracks and by EXIF and XMP of its frames.

    If the tracks determine it, it is kept, whatever EXIF says; otherwise it is the combination of both.
    """
    told = _told(model, pictures)
    formal = focal_sd(model)
    if formal is None:
        return FocalDoubt(said=_far(told))
    sd = SYSTEMATIC * formal
    if sd < OPEN:
        return FocalDoubt(said=_far(told, "; its observations determine it, and it is taken as it is"))
    known = f"determine the focal length only to {100 * sd:.0f} % (1 sigma)"
    known = known if sd < FOCAL_UNKNOWN else "leave the focal length unknown"
    what = (
        f"the frames {known}, as is usual for flat ground, above all "
        "from straight above: vehicles are measured as footprints on the ground; do not trust heights in this model"
    )
    if not told:
        return FocalDoubt(1.0, sd, what)
    log_ratio = np.log([lens.focal_px / has for _, lens, has in told])
    by_lens = max(float(np.median([lens.sd for _, lens, _ in told])), float(np.std(log_ratio)))
    weight = sd**2 / (sd**2 + by_lens**2)
    ratio = float(np.exp(weight * np.median(log_ratio)))
    name, lens, has = told[0]
    moved = f"{100 * abs(ratio - 1):.0f} % {'higher' if ratio > 1 else 'lower'}"
    where = f"assumed {moved}" if abs(ratio - 1) >= 0.005 else "left where they are"
    what += (
        f"; cameras are {where}, since the focal length of {name} is {lens.focal_px:.0f} px ({lens.source}), and "
        f"{has:.0f} px in the model"
    )
    return FocalDoubt(ratio, sd * by_lens / float(np.hypot(sd, by_lens)), what)


def without_ground(model: pycolmap.Reconstruction, error: InputError) -> InputError:
    """The `error` that no ground was found, or, if a focal length of `model` ran away, one that names it."""
    cameras = cameras_of(model).values()
    sides, longest = max((c.mean_focal_length() / max(c.width, c.height), c.camera_id) for c in cameras)
    if sides < LONGEST_LENS:
        return error
    return InputError(
        f"{error.message}, and the focal length of camera {longest} is {sides:.0f} times the longer side of its "
        "pictures: flat ground seen from straight above does not determine it",
        "Reconstruct with the focal length of the lens, and keep it there (COLMAP: --ImageReader.camera_params and "
        "--Mapper.ba_refine_focal_length 0), or with some oblique photos.",
    )


def _told(model: pycolmap.Reconstruction, pictures: Sequence[PictureFile]) -> list[tuple[str, Lens, float]]:
    """Name, lens, and the model's focal length [px] of some frames whose tags describe their lens."""
    from .lens import lens_of
    from .tags import read_tags

    cameras = cameras_of(model)
    found = []
    for picture in (pictures[k] for k in evenly(len(pictures), FOCAL_FRAMES)):
        try:
            found.append((picture.name, lens_of(read_tags(picture.path)), cameras[picture.name].mean_focal_length()))
        except InputError:  # without a lens in its tags, or damaged, which its reader will report
            continue
    return found


def _far(
    told: list[tuple[str, Lens, float]],
    so: str = ": flat scenes leave it open; heights are then off by as much, the scale hardly",
) -> str:
    """A note if most tags give focal lengths far from the model's. so : what follows from that."""
    far = [(abs(has / lens.focal_px - 1), name, lens, has) for name, lens, has in told if lens.contradicts(has)]
    if 2 * len(far) <= len(told):
        return ""
    _, name, lens, has = max(far, key=lambda each: each[0])
    return (
        f"{name} has a focal length of {lens.focal_px:.0f} px ({lens.source}), the model {has:.0f} px "
        f"({100 * (has / lens.focal_px - 1):+.0f} %){so}"
    )


def focal_sd(model: pycolmap.Reconstruction) -> float | None:
    """Formal relative one-sigma of the focal length of `model`, from its tracks; None if there are too few.

    Each camera has its own, and radial distortion, adjusted together with poses and points; of several, the mean's.
    """
    block = _Block.of(model)
    if block is None:
        return None
    asked = np.zeros(block.unknowns)
    asked[block.of_lens(block.lens, 0)] = 1 / (block.lens.max() + 1)
    return block.sd(asked)


def bend_sd(model: pycolmap.Reconstruction, up: np.ndarray) -> float:
    """Relative one-sigma of the scale at the cameras of `model` over that at its points, both across `up` (3,), by its
    tracks; if there are too few of them, by the images that have its points in sight; 0 if there are too few of both.

    A dome or bowl spreads or crowds the cameras over the points. Straight down, radial distortion makes one of a flat
    block, and the adjustment cannot tell (James and Robson 2014, doi:10.1002/esp.3609).
    """
    block = _Block.of(model) or _Block.of(model, by_sight=True)
    if block is None:
        return 0.0
    centres = -np.einsum("nji,nj->ni", block.rotation, block.shift)
    places = np.array([xyz for xyz, _, _ in block.tracks])
    (by_centre, lean), (by_point, tilt) = (_by_spread(p, up) for p in (centres, places))
    # `up` turns with the points, or the arbitrary orientation of the model would count.
    slope = by_point @ np.linalg.pinv(by_point.T @ by_point, rcond=HELD) * (by_point**2).sum()
    by_point = by_point + np.outer(slope @ (tilt - lean), up)
    by_shift = block.distance * np.einsum("nij,nj->ni", block.rotation, by_centre)
    asked = np.zeros(block.unknowns)
    asked[: 2 * by_shift.size] = np.column_stack([np.zeros_like(by_shift), by_shift]).ravel()
    return SYSTEMATIC * block.sd(asked, by_point)


def _by_spread(points: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the logarithm of the spread of points (N, 3) across `up`: (N, 3) by the points, and (3,) by a tilt
    of `up` with its sign reversed."""
    out = points - points.mean(0)
    height = out @ up
    out -= height[:, None] * up
    by_point = out / max(float((out**2).sum()), np.finfo(float).tiny)
    return by_point, height @ by_point


@dataclass(frozen=True)
class _Block:
    """What a bundle adjustment would adjust. tracks : place, images and error [px] of each point; the images as numbers
    of the poses: rotation (N, 3, 3), shift (N, 3). focal : (N,) [px]. lens : (N,) number of its camera, from 0.
    distance : typical one of the cameras from the origin, the unit of their shifts."""

    tracks: list[_Track]
    rotation: np.ndarray
    shift: np.ndarray
    focal: np.ndarray
    lens: np.ndarray
    distance: float

    @classmethod
    def of(cls, model: pycolmap.Reconstruction, by_sight: bool = False) -> _Block | None:
        """That of `model`, or of a part of it that is quick to adjust; None for too few tracks, or, if they are
        assumed `by_sight`, for too few points in sight."""
        # Ordered by names, and by the order of observations: ids of images and points differ between programs.
        numbers = sorted(model.reg_image_ids(), key=lambda number: model.image(number).name)
        if not numbers:
            return None
        rank = {number: k for k, number in enumerate(numbers)}
        numbers = [numbers[k] for k in evenly(len(numbers), MOST_IMAGES)]
        tracks = list(islice(_in_sight(model, numbers) if by_sight else _tracked(model, numbers, rank), MOST_TRACKS))
        tracks, numbers = _held(tracks, numbers)
        if len(tracks) < LEAST_TRACKS:
            return None
        poses = [model.image(number).cam_from_world() for number in numbers]
        shift = np.array([pose.translation for pose in poses])
        cameras = [model.image(number).camera_id for number in numbers]
        focal = np.array([model.camera(camera).mean_focal_length() for camera in cameras])
        lens = np.unique(cameras, return_inverse=True)[1]
        distance = float(np.median(np.linalg.norm(shift, axis=1))) or 1.0
        return cls(tracks, np.array([pose.rotation.matrix() for pose in poses]), shift, focal, lens, distance)

    @property
    def unknowns(self) -> int:
        """Of poses and lenses, without the points: three of rotation and three of shift for each, then the lenses."""
        return 6 * len(self.rotation) + LENS_UNKNOWNS * (int(self.lens.max()) + 1)

    def of_lens(self, lens: np.ndarray, which: int | np.ndarray) -> np.ndarray:
        """Places among the unknowns of those of each `lens`: `which` of its LENS_UNKNOWNS."""
        return 6 * len(self.rotation) + LENS_UNKNOWNS * lens + which

    def sd(self, asked: np.ndarray, of_points: np.ndarray | None = None) -> float:
        """Formal one-sigma of a quantity with the derivatives `asked` (unknowns,), and `of_points` (tracks, 3)."""
        asked, size = asked.copy(), self.unknowns
        reduced = np.zeros((size, size))
        for number, (xyz, k, error) in enumerate(self.tracks):
            by_camera, by_point = _jacobians(xyz, self.rotation[k], self.shift[k], self.focal[k], self.distance)
            lenses, of = np.unique(self.lens[k], return_inverse=True)
            places = (6 * k[:, None] + np.arange(6)).ravel()
            places = np.r_[places, self.of_lens(lenses[:, None], np.arange(LENS_UNKNOWNS)).ravel()]
            whole = np.zeros((len(k), 2, len(places)))
            for n in range(len(k)):
                whole[n, :, 6 * n : 6 * n + 6] = by_camera[n, :, :6]
                first = 6 * len(k) + LENS_UNKNOWNS * of[n]
                whole[n, :, first : first + LENS_UNKNOWNS] = by_camera[n, :, 6:]
            a, b = whole.reshape(2 * len(k), -1) / error, by_point.reshape(2 * len(k), 3) / error
            q, r = np.linalg.qr(b)  # q spans the part of the information that the point takes up
            left = a - q @ (q.T @ a)
            reduced[np.ix_(places, places)] += left.T @ left
            if of_points is not None:  # the point follows the cameras by the negative of r^-1 q^T a
                asked[places] -= np.linalg.lstsq(r.T, of_points[number])[0] @ (q.T @ a)
        scale = np.sqrt(np.maximum(reduced.diagonal(), 1e-300))
        scaled = reduced / np.outer(scale, scale) + HELD * np.eye(size)
        by_scaled = asked / scale
        return float(np.sqrt(max(float(by_scaled @ np.linalg.solve(scaled, by_scaled)), 0.0)))


def _tracked(model: pycolmap.Reconstruction, numbers: list[int], rank: Mapping[int, int]) -> Iterator[_Track]:
    """The points of `model` that three or more of the images `numbers` see, by their tracks. rank : of all images."""
    column = {number: k for k, number in enumerate(numbers)}
    for point in _longest_first(model.points3D.values(), rank):
        images = {element.image_id for element in point.track.elements} & column.keys()
        if len(images) >= 3:
            views = sorted(images, key=rank.__getitem__)[:: -(-len(images) // MOST_VIEWS)]
            where = np.array([column[number] for number in views])
            yield np.array(point.xyz), where, max(float(point.error), LEAST_PX)


def _in_sight(model: pycolmap.Reconstruction, numbers: list[int]) -> Iterator[_Track]:
    """The same of points that three or more of the images have in sight, distortion aside."""
    every = sorted(model.point3D_ids())
    points = np.array([model.point3D(every[k]).xyz for k in evenly(len(every), MOST_TRACKS)]).reshape(-1, 3)
    seen = np.zeros((len(points), len(numbers)), bool)
    for k, number in enumerate(numbers):
        image = model.image(number)
        camera, pose = model.camera(image.camera_id), image.cam_from_world()
        local = points @ pose.rotation.matrix().T + pose.translation
        reach = local[:, 2:] / camera.mean_focal_length() * (camera.width / 2, camera.height / 2)
        seen[:, k] = (np.abs(local[:, :2]) < reach).all(1)
    for k, (xyz, where) in enumerate(zip(points, map(np.flatnonzero, seen), strict=True)):
        step = -(-len(where) // VIEWS_ASSUMED) or 1
        if len(views := where[k % step :: step]) >= 3:  # not of the same images every time
            yield xyz, views, LEAST_PX


def _held(tracks: list[_Track], numbers: list[int]) -> tuple[list[_Track], list[int]]:
    """Both without the images whose poses so few of the `tracks` hold that they could stand anywhere."""
    held = np.bincount([k for _, where, _ in tracks for k in where], minlength=len(numbers)) >= LEAST_HOLDING
    new = np.cumsum(held) - 1
    left = [(xyz, new[where[held[where]]], error) for xyz, where, error in tracks]
    return [each for each in left if len(each[1]) >= 3], [n for n, ok in zip(numbers, held, strict=True) if ok]


def _longest_first(points: Iterable[pycolmap.Point3D], rank: Mapping[int, int]) -> Iterator[pycolmap.Point3D]:
    """Points with long tracks before those with short ones. Points with tracks of equal length are ordered by their
    smallest observation index in any image, then by the `rank` of that image."""

    def first_view(point: pycolmap.Point3D) -> tuple[int, int]:
        return min(((e.point2D_idx, rank.get(e.image_id, len(rank))) for e in point.track.elements), default=(0, 0))

    for _, alike in groupby(sorted(points, key=lambda p: -p.track.length()), lambda p: p.track.length()):
        yield from sorted(alike, key=first_view)


def _jacobians(
    xyz: np.ndarray, rotation: np.ndarray, shift: np.ndarray, focal: np.ndarray, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the pixels of one point in N images: (N, 2, 6 + LENS_UNKNOWNS) by rotation, shift, log focal
    length and distortion, and (N, 2, 3) by the point."""
    local = rotation @ xyz + shift  # (N, 3)
    u, v, z = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2], local[:, 2]
    zero = np.zeros_like(u)
    by_local = np.stack([np.stack([1 / z, zero, -u / z], -1), np.stack([zero, 1 / z, -v / z], -1)], 1)  # (N, 2, 3)
    turn = np.stack([np.stack([-u * v, 1 + u**2, -v], -1), np.stack([-(1 + v**2), u * v, u], -1)], 1)
    square = u**2 + v**2
    lens = np.stack([np.stack([w, w * square, w * square**2], -1) for w in (u, v)], 1)
    f = focal[:, None, None]
    return f * np.concatenate([turn, distance * by_local, lens], 2), f * by_local @ rotation
