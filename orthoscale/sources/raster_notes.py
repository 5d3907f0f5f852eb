"""What the user should know of an image that was opened, and of its copy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rasterio.io import DatasetReader

from ..core.claims import NO_PROOF
from ..core.remarks import CAUTION, INFO, Remark, percent
from ..core.source import Placement
from ..errors import shown
from ..formats.names import first_few
from .georeference import Claim
from .raster_copy import SCALE_TAG, Original
from .raster_margin import Margin

CAMERA_TAGS = {"EXIF_FocalLength", "EXIF_FocalLengthIn35mmFilm"}  # as GDAL names them; orthophotos have none
SQUEEZED = 0.05
"""Width over height of a pixel, as a logarithm, from which its user is cautioned: what it leaves open of the scale is
about a per cent then (`core.measuring.plan.SQUEEZED_SD`)."""


def of_image(dataset: DatasetReader, claimed: Claim, others: Sequence[str]) -> Iterator[Remark]:
    """Remarks on the image that `dataset` reads. claimed, others : from `georeference.claim_of` and `other_claims`."""
    tags = dataset.tags()
    if others:
        counts = f"{claimed.gsd_m:.4g} m/px is taken for its claim, as GDAL and QGIS do, but {', '.join(others)}"
        yield Remark(CAUTION, counts)
    if claimed.unread:
        yield Remark(CAUTION, claimed.why)
    if (turned := tags.get("EXIF_Orientation", "1")) not in ("0", "1"):
        text = (
            f"the picture is to be rotated when shown (EXIF orientation {turned}): coordinates and boxes "
            "are those of the pixels as stored"
        )
        yield Remark(INFO, text)
    if not claimed.usable and CAMERA_TAGS & tags.keys():
        text = (
            "its EXIF has a camera's focal length: it is measured as an orthophoto, but seems to be a photo; "
            "`orthoscale photo` measures photos, and `orthoscale fix` the model that COLMAP makes of them"
        )
        yield Remark(CAUTION, text)
    if (told := tags.get(SCALE_TAG)) is not None:
        yield Remark(INFO, f"by its metadata ({shown(told.split(',')[0])}), {NO_PROOF}")
    if (aspect := claimed.aspect) != 1:
        text = (
            f"pixels are {aspect:.3g} times as wide as high on the ground, and vehicles appear so too: the scale, "
            "the geometric mean of both sides, is less certain (warp it to UTM first)"
        )
        yield Remark(CAUTION if abs(math.log(aspect)) > SQUEEZED else INFO, text)


def of_margin(margin: Margin) -> Remark:
    """What to say of the margin of a map sheet."""
    return Remark(INFO, f"a map sheet: its margin, {percent(margin.share)} of it, is not searched for vehicles")


def of_copy(copy: str, original: Original, place: Placement, cog: bool) -> Iterator[str]:
    """What the file named `copy` has and lacks beside its `original`. place, cog : as it was written."""
    name = original.path.name
    yield f"{copy}: {place.said}"
    if original.is_cog and not cog:
        yield f"{copy} is no longer cloud-optimised as {name} is (--cog makes it so)"
    if original.has_several_nodata:
        yield f"bands of {name} have several nodata values, a GeoTIFF has one: {copy} has a mask"
    if original.images > 1:
        yield f"{copy} has only the first of the {original.images} images in {name}"
    if count := original.transparent_colours:
        what = f"colours of the palette of {name} that are transparent there, wholly or in part ({count})"
        yield f"{what}, are opaque in {copy}: the palette of a GeoTIFF has no transparency"
    if cog and (lost := original.lost_in_cog):
        why = "GDAL leaves them out of a cloud-optimised file with other metadata; a copy without --cog has them"
        yield f"{copy} lacks the bands' metadata of {name} ({first_few(lost)}): {why}"
    if told := original.sizes_told(cog):
        yield f"{copy} keeps {', '.join(told)} in its metadata, which may tell the former scale"
