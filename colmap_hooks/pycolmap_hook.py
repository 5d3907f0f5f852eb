"""Metres for pycolmap: after mapping, on disk or in memory.

import pycolmap, pycolmap_hook

pycolmap.incremental_mapping(database, images, work / "sparse")
pycolmap_hook.write_metric(work / "sparse", work / "sparse_metric", images, fleet="US")

result = pycolmap_hook.to_metric(reconstruction, images, fleet="US")    # in place
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

import orthoscale
from orthoscale.actions.workspace import fix_all, models_in
from orthoscale.errors import OrthoscaleError, UsageError
from orthoscale.requests import FixRequest


def write_metric(sparse: str | Path, out: str | Path, images: str | Path | None = None, **options: Any) -> bool:
    """Write the model in the folder `sparse`, or all of them (``0/``, ``1/`` ...), in metres to the folder `out`.

    options : of `orthoscale.fix`. Returns False, and does nothing, if `out` holds a metric model already, unless
    `overwrite` is one of the options. Raises UsageError if `sparse` has changed since, OrthoscaleError.
    """
    sparse, out = Path(sparse), Path(out)
    made = [out / name for name in ("sim3.json", "models.json") if (out / name).is_file()]
    if made and not options.get("overwrite"):
        when = made[0].stat().st_mtime_ns
        if any(path.stat().st_mtime_ns > when for path in sparse.rglob("*") if path.is_file()):
            raise UsageError(
                f"{sparse} was changed after {out} was made of it", f"Measure it anew with overwrite, or remove {out}."
            )
        return False
    models = models_in(sparse)
    if models:
        fix_all(models, out, FixRequest.of({"images": images, **options}))
    else:
        orthoscale.fix(sparse, out, images=images, **options)
    return True


def to_metric(reconstruction: pycolmap.Reconstruction, images: str | Path | None = None, **options: Any) -> Any:
    """Bring `reconstruction` to metres in place; returns `orthoscale.Result`. The caller must not do it twice.

    options : of `orthoscale.estimate`. Raises OrthoscaleError, also for a scale too uncertain to be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write_binary(folder)
        result = orthoscale.estimate(folder, images=images, **options)
    result.require_useful()
    reconstruction.transform(pycolmap.Sim3d(result.scale.value, pycolmap.Rotation3d(), np.zeros(3)))
    return result


def main() -> int:
    """The command line: `pycolmap_hook.py SPARSE OUT --images IMAGES --fleet US`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("sparse", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--images", type=Path)
    parser.add_argument("--fleet", help="by default the country of the images' GPS tags, else world")
    parser.add_argument("--detections", type=Path)
    parser.add_argument("--overwrite", action="store_true", help="measure anew where OUT is there already")
    given = parser.parse_args()
    try:
        more = {"fleet": given.fleet, "detections": given.detections, "overwrite": given.overwrite}
        new = write_metric(given.sparse, given.out, given.images, **more)
    except OrthoscaleError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(f"written {given.out}" if new else f"{given.out} is there already; nothing to do")
    return 0


if __name__ == "__main__":
    sys.exit(main())
