"""Scales any file or folder that is in a model's units to metres."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..errors import InputError, UsageError
from ..formats.geometry.dense import is_dense
from ..formats.geometry.files import WrittenFiles, scale_file
from ..formats.reading import absent
from .cameras import SCALED_MARK, centres_in, refuse_another
from .colmap import ColmapSource, scale_model, scale_workspace
from .colmap_find import model_folders
from .dense_cloud import check_workspace
from .opening import NO_CLOUD, open_source


def points_in_metres(folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """`ColmapSource.points_and_cameras` of the model in metres, of any format, that lies in `folder`; None without one
    that can be read."""
    if not (folder / SCALED_MARK).is_file():
        return None
    try:
        model = open_source(folder, need_images=False, ground_cloud=NO_CLOUD, compare_frames=False)
    except InputError:
        return None
    if not isinstance(model, ColmapSource) or not os.path.samefile(model.folder, folder):  # it is in a folder below
        return None
    return model.points_and_cameras


def scale_path(
    source: Path,
    target: Path,
    scale: float,
    others: WrittenFiles | None = None,
    metric: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> list[str]:
    """Write `source`, in model units, to `target`, in metres: all lengths times `scale`; returns notes for the user.

    A folder is a sparse model or a dense workspace of COLMAP; `target` is then an empty folder. Files that a file
    refers to (materials, buffers, point clouds) are written beside `target`, too. others : files written before.
    metric : cameras [m] of the model for which the scale was measured, by image name; other models are compared with
    them. Raises InputError for a missing, damaged or unknown file; UsageError for one that is in metres already, for
    several models in one folder, and for a model whose cameras stand elsewhere.
    """
    if not os.path.exists(source):  # noqa: PTH110  pathlib's raises for names that are too long
        raise absent(source, "Give files in the units of the model.")
    if not source.is_dir():
        notes = scale_file(source, target, scale, others)
        if metric:
            refuse_another(source, centres_in(source), metric, scale)
        return notes
    if is_dense(source):
        remarks = [str(remark) for remark in check_workspace(source)]
        return [*scale_workspace(source, target, scale, metric), *remarks]
    if len(models := model_folders(source)) > 1:
        raise UsageError(
            f"{source} holds {len(models)} models, each with a scale of its own: {', '.join(m.name for m in models)}",
            "Give the one that the sim3.json was found for.",
        )
    scale_model(source, target, scale, metric)
    return []
