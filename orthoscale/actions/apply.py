"""Brings other files of a scaled model to metres by the model's similarity transform."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ..errors import UsageError
from ..formats.geometry.files import WrittenFiles
from ..formats.geometry.mark import refuse_marked
from ..formats.geometry.sim3 import Sim3
from ..formats.geometry.vertices import WITH_VERTICES
from ..sources.cameras import metric_centres
from ..sources.dense_cloud import off_metric_model
from ..sources.exchange_files import MODEL_SUFFIXES
from ..sources.scaling import points_in_metres, scale_path
from ..system.outputs import Outputs
from ..system.paths import absolute, path_of, paths_of
from ..system.signatures import written_in_metres


def apply(
    sim3: str | Path, files: str | Path | Sequence[str | Path], out: str | Path, *, overwrite: bool = False
) -> dict[Path, list[str]]:
    """Write copies in metres of `files`, which are in the units of the model that `sim3` belongs to, into `out`.

    sim3 : the sim3.json that `fix` wrote. files : PLY (cloud, mesh or splat), OBJ, GLB, glTF, transforms.json,
    reconstruction.json, LAS, LAZ, PCD, XYZ, PTS, STL, OFF, .splat, or folders of sparse models and dense workspaces,
    one or several; they are never touched. out : folder.
    Returns what was written, with notes on each; all files are written, or none. Raises UsageError, InputError,
    OutputError.
    """
    sim3, out = path_of(sim3, "the path of a sim3.json"), path_of(out, "the path of the output folder")
    given = paths_of(files, "the path of a file in the model's units")
    names = [absolute(path).name for path in given]  # a link keeps its own name
    if twice := {name for name in names if names.count(name) > 1}:
        raise UsageError(f"two FILEs are called {min(twice)}", "Write them to different folders, one after the other.")
    written = {}
    others, model = WrittenFiles(), cache(lambda: points_in_metres(sim3.parent))
    with Outputs(overwrite, (sim3, given)) as outputs:
        folder = outputs.folder(out, metres=True)
        scale = Sim3.load(sim3).scale
        with_models = any(path.is_dir() or path.suffix.lower() in MODEL_SUFFIXES for path in given)
        metric = metric_centres(sim3.parent) if with_models else {}
        for path, name in zip(given, names, strict=True):
            if written_in_metres(path):
                refuse_marked(path)
            target = folder / name
            if path.is_dir():
                target.mkdir()
            notes = written[out / name] = list(scale_path(path, target, scale, others, metric))
            if path.is_file() and target.suffix.lower() in WITH_VERTICES and (there := model()) is not None:
                notes += [text] if (text := off_metric_model(target, sim3.parent, *there)) else []
    return written
