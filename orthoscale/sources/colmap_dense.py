"""The dense workspace that belongs to a COLMAP model."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ..core.remarks import Remark
from ..errors import InputError, UsageError
from ..formats.geometry.dense import find_dense, sparse_folders
from .cameras import centres_of
from .dense_cloud import check_workspace

SAME_CAMERA = 1e-4  # of the flying height: cameras of a model and of its undistorted copy are no farther apart


def dense_of(
    folder: Path, cameras: Mapping[str, np.ndarray], camera_height: Callable[[], float]
) -> tuple[Path, list[Remark]]:
    """The dense workspace of the model in `folder`, and remarks on it.

    cameras : (3,) centre of each, by the name of its image [model units]. camera_height : gives their height over the
    ground [model units], which takes a while to find. Raises UsageError if there is no workspace, InputError for one
    without cameras, or whose cameras, depth maps, cloud or meshes show that they are of another model.
    """
    dense = find_dense(folder)
    if dense is None:
        raise UsageError(
            f"{folder} has no dense workspace (dense/ with stereo/ or fused.ply in it, beside the model)",
            "Remove --dense, or convert it to metres later with `orthoscale apply`.",
        )
    undistorted = sparse_folders(dense)
    if not undistorted:
        raise InputError(
            f"{dense} has no undistorted model in sparse/ to show that its depth maps and clouds are in the "
            f"units of {folder}",
            "Run image_undistorter again; or, if you know that they are, use `orthoscale apply`.",
        )
    for sparse in undistorted:
        if os.path.realpath(sparse) == os.path.realpath(folder):
            continue
        there = centres_of(sparse)
        apart = [float(np.linalg.norm(cameras[name] - there[name])) for name in cameras if name in there]
        if not apart or max(apart) > SAME_CAMERA * camera_height():
            raise InputError(
                f"{sparse} is not the undistorted model of {folder}: its cameras stand elsewhere",
                "It may be from another run or in metres already: run image_undistorter again.",
            )
    return dense, check_workspace(dense)
