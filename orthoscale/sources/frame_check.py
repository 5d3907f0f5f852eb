"""Whether frames are those that a model was made from: they show its points in the points' colours.

Cameras number their files alike on every flight: a folder of another flight has the same names and sizes. In four real
models brightness and colours correlate by 0.90 to 0.98 in every frame, and by 0.40 at most in frames of another name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..core.remarks import CAUTION, Remark
from ..errors import InputError
from .picture_file import PictureFile

if TYPE_CHECKING:
    import pycolmap

FRAMES_COMPARED = 5  # that are looked at, spread over all
LEAST_POINTS = 50  # of a frame
LEAST_CONTRAST = 5.0  # [of 255] standard deviation: points without colours are black, and a blank frame shows nothing
OWN_FRAMES = 0.5  # correlation, in the middle of the frames, from which they are the model's


def check_frames(model: pycolmap.Reconstruction, pictures: Sequence[PictureFile]) -> list[Remark]:
    """What to say of `pictures`, the frames of `model`, if they do not show what it saw."""
    images = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    count = min(FRAMES_COMPARED, len(pictures))
    chosen = [pictures[int(k)] for k in np.linspace(0, len(pictures) - 1, count)]
    found = [_likeness(model, images[picture.name], picture) for picture in chosen]
    known = [likeness for likeness in found if likeness is not None]
    if not known or np.median(known) >= OWN_FRAMES:
        return []
    text = (
        f"the frames do not show the model's points in their colours (correlation {np.median(known):.2f}, usual is "
        f"0.9; {chosen[0].path} ...): they may be of another flight, turned, or changed since"
    )
    return [Remark(CAUTION, text)]


def _likeness(model: pycolmap.Reconstruction, image: pycolmap.Image, picture: PictureFile) -> float | None:
    """Correlation of the brightness of `image`'s points and of `picture` where they were seen; None if not known."""
    seen = [point for point in image.points2D if point.has_point3D()]
    if len(seen) < LEAST_POINTS:
        return None
    colours = np.array([model.points3D[point.point3D_id].color for point in seen], float).mean(1)
    try:
        with picture.pixels() as (pixels, _):
            last = np.array([picture.width, picture.height]) - 1
            x, y = np.clip(np.array([point.xy for point in seen]), 0, last).astype(int).T
            shown = pixels[y, x].astype(float).mean(1)
    except InputError:  # said by whoever needs it
        return None
    if min(colours.std(), shown.std()) < LEAST_CONTRAST:
        return None
    return float(np.corrcoef(colours, shown)[0, 1])
