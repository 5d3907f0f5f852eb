"""Checks by the reprojection errors of its points whether a reconstruction is consistent.

In an adjusted model points project within a pixel or two of their observations. With a damaged focal length, pose or
point, or with files of two models in one folder, they do not; vehicles would then be measured in a wrong model.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..core.remarks import CAUTION, Remark
from ..errors import InputError
from .colmap_read import images_of

if TYPE_CHECKING:
    import pycolmap

SAMPLE = 50_000  # observations that are checked, spread over the images
LEAST_EACH = 30  # of them in each image that has so many
LEAST_OBSERVATIONS = 8  # observations that an image needs to be judged
# COLMAP's mapper drops observations with an error over 4 px (filter_max_reproj_error), OpenSfM those over 0.006 of the
# longer side (bundle_outlier_fixed_threshold). An image is off if its median error is twice as large; in an image with
# many pixels only if it is also OFF_OTHERS times that of the other images.
OFF_PX, OFF_SHARE, OFF_OTHERS = 8.0, 0.012, 20.0
# Share of all observations whose error may exceed the limit by the factor OFF_FAR; a mapper keeps hardly any.
OFF_MOST, OFF_FAR = 0.25, 3.0
# Largest systematic radial error of a camera's projections; observations that it takes to judge; and their distance
# from the principal point, at least, as a share of the longer side. Adjusted images have no such error, since a longer
# focal length or a nearer camera would remove it: four real models have 0.03 % in their worst image. A focal length
# that is 2 % off makes the scale 2 % wrong.
RADIAL, RADIAL_LEAST, RADIAL_FROM = 0.02, 100, 0.1
# Extent of the cameras, as a share of the distance to the points, below which they stand in one place. COLMAP keeps no
# points with a triangulation angle under 1.5 degrees, which is 0.026 of the distance.
ONE_PLACE = 0.01
ONE_LINE = 0.01  # how far cameras on one line may stand beside it, as a share of its length
# Observations that hold a pose, at least; as a share of the usual number, if that is less. COLMAP's incremental mapper
# registers no image by fewer (abs_pose_min_num_inliers) but can lose them later; global mappers keep images with none.
LEAST_HELD, LEAST_OF_USUAL = 30, 0.1
MIXED_UP_HINT = (
    "Cameras, images and points are not of one model, or a file is damaged: copy all of it again from its origin."
)
CROPPED_HINT = (
    "The pictures were cropped or resized since the model was made, or a file is damaged. Give the model and its "
    "pictures as they were, or make a model of the new pictures."
)


@dataclass(frozen=True)
class Observations:
    """A sample of the observations of a reconstruction's images, N in all.

    names : of the images. image : (N,) index into them. pixels : (N, 2) where the points were seen, from the outer
    corner of the first pixel. points : (N, 3) their positions in the world [model units]. number : (N,) which of the
    model's points they are, in the order of its file.
    """

    names: tuple[str, ...]
    image: np.ndarray
    pixels: np.ndarray
    points: np.ndarray
    number: np.ndarray

    def without(self, names: Collection[str]) -> Observations:
        """All but those of the images `names`."""
        keep = np.array([name not in names for name in self.names], bool)
        rest = keep[self.image]
        kept = tuple(name for name, ok in zip(self.names, keep, strict=True) if ok)
        image = (np.cumsum(keep) - 1)[self.image[rest]]
        return Observations(kept, image, self.pixels[rest], self.points[rest], self.number[rest])

    def of(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Where points were seen in the image `name` (K, 2) [px], and which (K,)."""
        mine = self.image == self.names.index(name)
        return self.pixels[mine], self.number[mine]


def some_of_each(counts: Sequence[int]) -> list[np.ndarray]:
    """Indices of the observations to check, of images that have `counts` of them. Deterministic."""
    random = np.random.default_rng(0)
    most = max(LEAST_EACH, SAMPLE // max(len(counts), 1))
    return [np.arange(n) if n <= most else random.choice(n, most, replace=False) for n in counts]


def loose_images(model: pycolmap.Reconstruction, seen: Observations) -> frozenset[str]:
    """Names of the images whose places in `model` hardly any of the observations `seen` hold, so that they may stand
    anywhere. Images of one frame of a rig hold each other."""
    count = dict(zip(seen.names, np.bincount(seen.image, minlength=len(seen.names)).tolist(), strict=True))
    images = list(images_of(model).values())
    held = Counter({image.frame_id: 0 for image in images})
    for image in images:
        held[image.frame_id] += count.get(image.name, 0)
    least = min(LEAST_HELD, LEAST_OF_USUAL * float(np.median(list(held.values()))))
    return frozenset(image.name for image in images if held[image.frame_id] < least)


def check_consistency(
    where: object, model: pycolmap.Reconstruction, seen: Observations, loose: frozenset[str]
) -> list[Remark]:
    """Compare `model`, which lies at `where`, with the observations of its images; returns remarks for the user.

    Raises InputError, naming cameras or images and their errors, for a model whose points project elsewhere than they
    were seen, and for one whose cameras all stand in one place. What its `loose_images` show does not count.
    """
    every = images_of(model)
    images = {name: image for name, image in every.items() if name not in loose}
    seen = seen.without(loose)
    centres = np.array([image.projection_center() for image in images.values()])
    if len(seen.image):
        _check_projections(where, model, [images[name] for name in seen.names], seen)
        notes: list[Remark] = []
        if loose:
            text = (
                f"{len(loose)} of {len(every)} images are left out, the first is {min(loose)}: hardly any points were "
                "seen in them, so that they may stand anywhere"
            )
            notes.append(Remark(CAUTION, text))
        stand = np.array([images[name].projection_center() for name in seen.names])[seen.image]
        distance = np.median(np.linalg.norm(seen.points - stand, axis=1))
    else:
        text = (
            f"{where} holds no observations of its points: only their colours in the frames can tell whether they fit "
            "its cameras"
        )
        notes = [Remark(CAUTION, text)]
        points = np.array([point.xyz for point in model.points3D.values()])
        distance = np.median(np.linalg.norm(points - centres.mean(0), axis=1))
    return notes + _check_places(where, centres, float(distance))


def _check_projections(
    where: object, model: pycolmap.Reconstruction, images: Sequence[pycolmap.Image], seen: Observations
) -> None:
    """Raise InputError if the `images` project the points of `seen` elsewhere than they were seen."""
    camera_of = np.array([image.camera_id for image in images])
    size = np.array([(model.camera(c).width, model.camera(c).height) for c in camera_of], float)
    projected = _projected(model, images, camera_of, seen)
    error = np.linalg.norm(projected - seen.pixels, axis=1)
    error[~np.isfinite(error)] = np.inf  # behind the camera, or where its lens has no image
    side = size.max(1)
    beyond = np.maximum(-seen.pixels, seen.pixels - size[seen.image]).max(1)
    outside = beyond > np.maximum(OFF_PX, OFF_SHARE * side)[seen.image]  # of a picture of this size
    error[outside] = np.inf

    order = np.argsort(seen.image, kind="stable")
    each = np.split(error[order], np.searchsorted(seen.image[order], np.arange(1, len(images))))
    judged = np.array([len(errors) >= LEAST_OBSERVATIONS for errors in each])
    if not judged.any():
        return
    middle = np.array([np.median(errors) if ok else 0.0 for errors, ok in zip(each, judged, strict=True)])
    usual = float(np.median(middle[judged]))
    limit = np.clip(OFF_OTHERS * usual, OFF_PX, np.maximum(OFF_PX, OFF_SHARE * side))
    off = judged & (middle > limit)
    radial = _radial_remainders(model, camera_of, projected, seen)
    stretched = {camera: share for camera, share in radial.items() if abs(share) > RADIAL}
    if off.any():
        raise _off(where, model, images, seen, outside, off, judged, middle)
    if stretched:
        camera, share = max(stretched.items(), key=lambda item: abs(item[1]))
        raise InputError(
            f"{where}: camera {camera} has its points {100 * share:+.1f} % farther from the middle of its pictures "
            "than they were seen: its focal length, or the scale of cameras and points, is wrong",
            MIXED_UP_HINT,
        )
    is_far = error > OFF_FAR * limit[seen.image]
    if np.mean(is_far) > OFF_MOST:
        if 2 * outside.sum() > is_far.sum():
            text = f"{where}: {100 * np.mean(outside):.0f} % of its observations lie outside of their pictures"
            raise InputError(text, CROPPED_HINT)
        text = f"{where}: {100 * np.mean(is_far):.0f} % of its points are not where its images saw them"
        raise InputError(text, MIXED_UP_HINT)


def _projected(
    model: pycolmap.Reconstruction, images: Sequence[pycolmap.Image], camera_of: np.ndarray, seen: Observations
) -> np.ndarray:
    """(N, 2) pixels to which the images project the points, NaN where they cannot."""
    poses = [image.cam_from_world() for image in images]
    rotation = np.array([pose.rotation.matrix() for pose in poses])
    translation = np.array([pose.translation for pose in poses])
    local = np.einsum("nij,nj->ni", rotation[seen.image], seen.points) + translation[seen.image]
    pixels = np.full((len(local), 2), np.nan)
    for camera in np.unique(camera_of):
        mine = (camera_of[seen.image] == camera) & (local[:, 2] > 0)
        if mine.any():
            pixels[mine] = np.array(model.camera(camera).img_from_cam(local[mine]), float).reshape(-1, 2)
    return pixels


def _radial_remainders(
    model: pycolmap.Reconstruction, camera_of: np.ndarray, projected: np.ndarray, seen: Observations
) -> dict[int, float]:
    """By camera: by what share its points are projected farther from the principal point than they were seen."""
    found = {}
    for number in np.unique(camera_of).tolist():
        camera = model.camera(number)
        middle = np.array([camera.principal_point_x, camera.principal_point_y])
        mine = (camera_of[seen.image] == number) & np.isfinite(projected).all(1)
        was, now = seen.pixels[mine] - middle, projected[mine] - middle
        outside = np.linalg.norm(was, axis=1) > RADIAL_FROM * max(camera.width, camera.height)
        if outside.sum() >= RADIAL_LEAST:
            was, now = was[outside], now[outside]
            found[number] = float(np.median((was * now).sum(1) / (was**2).sum(1))) - 1
    return found


def _off(
    where: object,
    model: pycolmap.Reconstruction,
    images: Sequence[pycolmap.Image],
    seen: Observations,
    outside: np.ndarray,
    off: np.ndarray,
    judged: np.ndarray,
    middle: np.ndarray,
) -> InputError:
    """The error that names the cameras most of whose images are off; or the images, if only some of a camera's are.

    outside : (N,) bool, which observations lie outside of their pictures. off, judged : (C,) bool, by image. middle :
    (C,) median errors [px].
    """
    camera_of = np.array([image.camera_id for image in images])
    whole = [c for c in np.unique(camera_of[off]) if 2 * off[camera_of == c].sum() > judged[camera_of == c].sum() > 1]
    mine = off & np.isin(camera_of, whole) if whole else off
    first = images[int(np.argmax(mine))]
    if off.sum() == judged.sum() > 1 and len(np.unique(camera_of)) > 1:
        what = f"all {off.sum()} images ({first.name} ...)"
    elif whole:
        count = f"{mine.sum()} of {len(images)} images"
        what = f"camera {', '.join(map(str, whole[:3]))} ({count}, the first is {first.name})"
    else:
        what = f"image {first.name}" + (f" and {mine.sum() - 1} more of {len(images)}" if mine.sum() > 1 else "")
    share = float(np.mean(outside[mine[seen.image]]))
    if share > OFF_MOST:
        camera = model.camera(first.camera_id)
        size = f"{camera.width} x {camera.height} px"
        text = f"{where}: {100 * share:.0f} % of the observations of {what} lie outside of pictures of {size}"
        return InputError(text, CROPPED_HINT)
    apart = float(np.median(middle[mine]))
    how = f"{apart:.3g} px from" if np.isfinite(apart) else "nowhere near"
    return InputError(f"{where}: the points of {what} are projected {how} where they were seen", MIXED_UP_HINT)


def _check_places(where: object, centres: np.ndarray, distance: float) -> list[Remark]:
    """Remarks on whether the positions of cameras at `centres` (C, 3), at `distance` from what they see, suffice to
    measure a scene. Raises InputError if all stand in one place."""
    if len(centres) < 2:
        return []
    offset = centres - centres.mean(0)
    axes = np.linalg.svd(offset, full_matrices=False)[2]
    extent = np.ptp(offset @ axes.T, axis=0)
    if extent[0] < ONE_PLACE * distance:
        raise InputError(
            f"{where}: all {len(centres)} cameras stand in one place (within {100 * extent[0] / distance:.2g} % of the "
            "distance to what they see): no distance can be known",
            "Views from different places are needed. If these were, the model is damaged: copy it again.",
        )
    if len(centres) > 2 and extent[1] < ONE_LINE * extent[0]:
        text = f"all {len(centres)} cameras stand on one straight line: nothing off the line holds the model in shape"
        return [Remark(CAUTION, text)]
    return []


def observations(
    names: Sequence[str], seen: Iterable[tuple[np.ndarray, np.ndarray]], points: np.ndarray
) -> Observations:
    """Observations from pixels (K, 2) and the numbers (K,) of the points seen there, one pair for each of the images
    `names`. points : (M, 3) all of the model [units]."""
    pairs = list(seen)
    number = np.concatenate([np.empty(0, int), *(numbers for _, numbers in pairs)])
    return Observations(
        tuple(names),
        np.repeat(np.arange(len(pairs)), [len(pixels) for pixels, _ in pairs]),
        np.concatenate([np.empty((0, 2)), *(pixels for pixels, _ in pairs)]),
        points[number],
        number,
    )
