"""Numbers that points have besides their coordinates: those that may be lengths are named to the user."""

from __future__ import annotations

import re
from collections.abc import Iterable

# Colours, normals, texture coordinates, times, counts, and what splats and scanners add, by the names that MeshLab,
# CloudCompare, PCL, Metashape, COLMAP and Gaussian splatting write. `curvature` of PCL is a ratio of variances.
NO_LENGTH = re.compile(
    r"(diffuse_|ambient_|specular_)?(red|green|blue|alpha)|[rgba]f?|rgba?|n[xyz]|normal_?[xyz]|[stuv]|(texture_)?[uv]"
    r"|f_dc_\d+|f_rest_\d+|opacity|rot_\d+|scale_\d+|intensity|reflectivity|reflectance|ambient|confidence|curvature|ring"
    r"|label|class|classification|(scalar_)?(class(ification)?|label|intensity|confidence|(gps)?time|psz)|(gps_?)?time"
    r"|time_?stamp|t|views|visibility|(point_?)?(id|index|number)|_\d*",
    re.IGNORECASE,
)
NAMED = 4  # greatest number of names in a note


def left_as_they_are(names: Iterable[str], scale: float) -> list[str]:
    """A note on those numbers of a point, by `names`, that may be lengths and were not scaled; empty without any."""
    unknown = [name for name in names if not NO_LENGTH.fullmatch(name)]
    if not unknown:
        return []
    some = ", ".join(unknown[:NAMED]) + (" ..." if len(unknown) > NAMED else "")
    return [f"its {some} stay as they are; multiply by {scale:.9g} what of these is a length"]
