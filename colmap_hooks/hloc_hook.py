"""Metres for hloc (Hierarchical-Localization): its reconstruction, then the same in metres.

    import hloc_hook

    metric = hloc_hook.main(outputs / "sfm", images, pairs, features, matches, fleet="US")

It runs `hloc.reconstruction.main` and writes outputs/sfm_metric. hloc localises queries against the model that it is
given: pass outputs/sfm_metric to `hloc.localize_sfm` to get poses in metres. A second run finds the metric model and
does nothing; if outputs/sfm has changed since, it raises an error.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pycolmap
from pycolmap_hook import write_metric


def main(
    sfm_dir: Path, image_dir: Path, *args: Any, fleet: str | None = None, detections: Path | None = None, **options: Any
) -> pycolmap.Reconstruction:
    """`hloc.reconstruction.main` with the same arguments; returns the metric model.

    Raises UsageError if `sfm_dir` was changed after the metric model was made from it, OrthoscaleError.

    fleet, detections : of `orthoscale.fix`, which without a fleet takes the country from the images' GPS tags.
    """
    sfm_dir = Path(sfm_dir)
    metric = sfm_dir.with_name(sfm_dir.name + "_metric")
    if not (metric / "sim3.json").is_file() and not (sfm_dir / "images.bin").is_file():
        from hloc import reconstruction

        reconstruction.main(sfm_dir, image_dir, *args, **options)
    write_metric(sfm_dir, metric, image_dir, fleet=fleet, detections=detections)
    return pycolmap.Reconstruction(str(metric))
