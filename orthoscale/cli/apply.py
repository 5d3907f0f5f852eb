"""`orthoscale apply`: brings other files of a scaled model to metres by the model's similarity transform."""

from __future__ import annotations

from pathlib import Path

import click

from .options import CONVERTING, PATH, command, debug_option, json_option, option, overwrite_option, say, say_json

APPLIED_FORMAT = "orthoscale apply 1"


@command(
    epilog="\b\nExamples:\n  orthoscale apply scaled/sim3.json splat.ply mesh.glb --out metric/\n"
    "  orthoscale apply scaled/sim3.json nerf/transforms.json --out nerf_metric/\n"
    "  orthoscale apply scaled/sim3.json work/dense --out metric/\n\n" + CONVERTING
)
@click.argument("sim3", metavar="SIM3", type=PATH)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=PATH)
@option("--out", required=True, type=PATH, group="Main", help="Folder to write; file names stay as they are.")
@overwrite_option
@json_option("what was written")
@debug_option
def apply(sim3: Path, files: tuple[Path, ...], out: Path, overwrite: bool, as_json: bool) -> None:
    """Convert other files of a scaled model to metres.

    FILEs are in the units of the model that SIM3 belongs to, and are written again in metres. SIM3 is the sim3.json
    that `orthoscale fix` wrote. FILE is a PLY (cloud, mesh or Gaussian splat), OBJ, GLB or glTF, nerfstudio's
    transforms.json, OpenSfM's reconstruction.json, a splat's cameras.json, the folder of a sparse model or dense
    workspace, LAS, LAZ, PCD, XYZ, PTS, STL, OFF or .splat. What has no length (colours, normals, rotations, intrinsics)
    stays. All files appear in --out, or none. FILEs are never touched.
    """
    from ..actions import apply as applying
    from ..formats.geometry.sim3 import Sim3

    written = applying.apply(sim3, files, out, overwrite=overwrite)
    if as_json:
        texts = {str(path): notes for path, notes in written.items()}
        say_json({"format": APPLIED_FORMAT, "scale": Sim3.load(sim3).scale, "written": texts})
        return
    for path, notes in written.items():
        say(f"written    {path}", *(f"           {note}" for note in notes))
