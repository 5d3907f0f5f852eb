"""Camera centres of a model in any of the formats, and whether two models are the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from ..errors import InputError, UsageError
from ..formats.geometry.poses import SPLAT_CAMERAS, camera_centres, read_poses, splat_centres
from ..formats.geometry.text_models import SUFFIXES, image_names, read_text_model
from .colmap_check import open_model
from .colmap_read import images_of, read_model
from .exchange_files import find_exchange

# How far cameras of one model may stand from those of another that counts as the same, as a share of the extent of the
# cameras, or of the cameras and the origin. A model that was adjusted once more stays within it, another does not.
ANOTHER_MODEL = 0.02
SCALED_MARK = "sim3.txt"  # a folder with this file holds a model in metres


def centres_of(folder: Path) -> dict[str, np.ndarray]:
    """(3,) centre of each camera of the COLMAP model in `folder`, by the name of its image. Raises InputError."""
    model = read_model(folder, open_model(folder).format)
    return {name: image.projection_center() for name, image in images_of(model).items()}


def centres_in(path: Path) -> dict[str, np.ndarray]:
    """The same for another program's model in the file `path`; empty for other files, and if image names are missing.
    Raises InputError for a damaged model."""
    if path.name == SPLAT_CAMERAS:
        return splat_centres(path)
    if path.suffix.lower() == ".json":
        return camera_centres(read_poses(path))
    if path.suffix.lower() not in SUFFIXES:
        return {}
    text = read_text_model(path)
    try:
        names, _ = image_names(path, text)
    except InputError:  # the model can be scaled without names
        return {}
    centres = -np.einsum("nji,nj->ni", text.rotation, text.translation)
    there = text.focal > 0
    return {name: centre for name, centre, known in zip(names, centres, there, strict=True) if known}


def metric_centres(folder: Path) -> dict[str, np.ndarray]:
    """Camera centres [m] of the scaled model in `folder`, of any format; empty if there is none. Raises InputError."""
    if not (folder / SCALED_MARK).is_file():
        return {}
    if any((folder / f"images.{form}").is_file() for form in ("bin", "txt")):
        return centres_of(folder)
    other = find_exchange(folder)
    return {} if other is None else centres_in(other)


def refuse_another(
    source: Path, cameras: Mapping[str, np.ndarray], metric: Mapping[str, np.ndarray], scale: float
) -> None:
    """Raise UsageError if `cameras` of the model `source`, times `scale`, stand elsewhere than those of the same names
    in `metric` [m]. Either their positions must agree or, since programs turn and shift models, their distances from
    the middle of all."""
    names = _common(cameras, metric)
    if not names:
        return
    here = scale * np.array([cameras[name] for name in names])
    there = np.array([metric[name] for name in names.values()])
    apart = np.linalg.norm(here - there, axis=1) / np.linalg.norm(np.ptp([*metric.values(), np.zeros(3)], axis=0))
    if (extent := np.linalg.norm(np.ptp(there, axis=0))) > 0:
        out, away = (np.linalg.norm(places - places.mean(axis=0), axis=1) for places in (here, there))
        apart = min(apart, np.abs(out - away) / extent, key=np.max)
    if apart.max() > ANOTHER_MODEL:
        raise UsageError(
            f"{source} is not the model that was scaled: {list(names)[apart.argmax()]} stands elsewhere",
            "Give the sim3.json that `orthoscale fix` wrote for this model; each has a scale of its own.",
        )


def _common(one: Mapping[str, object], other: Mapping[str, object]) -> dict[str, str]:
    """Names in `one` of the images that `other` has too, and their names there: the same; or if there are no such
    names, the same without folders, which some programs add or leave out."""
    if same := {name: name for name in one if name in other}:
        return same
    mine, theirs = _without_folders(one), _without_folders(other)
    return {mine[end]: theirs[end] for end in mine if end in theirs}


def _without_folders(names: Mapping[str, object]) -> dict[str, str]:
    """`names` by their last part (without folders), as far as that is unique."""
    ends = {name: PurePosixPath(name.replace("\\", "/")).name for name in names}
    count = Counter(ends.values())
    return {end: name for name, end in ends.items() if count[end] == 1}
