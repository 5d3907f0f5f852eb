"""Synthetic surveys with exact truth: an orthophoto, a COLMAP model with its frames, data sets, or training labels."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from ..errors import OrthoscaleError
from ..fleets import load_fleet
from ..system import stopping
from ..system.outputs import Outputs
from ..system.signatures import ours
from . import STYLES, Scene, make_scene, write_colmap, write_labels, write_ortho
from .folders import write_csv, write_denseuav, write_visloc

DATA_SETS: dict[str, tuple[Callable[[Scene, Path], None], str]] = {
    "denseuav": (write_denseuav, "a folder as DenseUAV has it: photos named by their altitude, and detections.json"),
    "visloc": (write_visloc, "a folder as UAV-VisLoc+ has it: regions with poses, camera.xml and a surface model"),
    "csv": (write_csv, "photos with photos.csv"),
}


def main(arguments: list[str] | None = None) -> None:
    """``python -m orthoscale.synthetic ortho|model|labels|denseuav|visloc|csv OUT``."""
    parser = argparse.ArgumentParser(prog="python -m orthoscale.synthetic", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    ortho = commands.add_parser("ortho", help="an orthophoto without georeferencing: OUT.png or .jpg")
    ortho.add_argument("--gsd", type=float, default=0.08, help="metres per pixel (%(default)s)")
    model = commands.add_parser("model", help="a folder with images/, sparse/ and truth.json")
    model.add_argument("--metres-per-unit", type=float, default=3.7, help="of the COLMAP model (%(default)s)")
    model.add_argument("--frames", type=int, default=16)
    model.add_argument("--pitch", type=float, default=90.0, help="degrees below the horizon (%(default)s)")
    model.add_argument("--altitude", type=float, default=60.0, help="metres above ground (%(default)s)")
    model.add_argument("--focal", type=float, default=900.0, help="pixels (%(default)s)")
    model.add_argument("--size", type=int, nargs=2, default=(1000, 750), metavar=("WIDTH", "HEIGHT"), help="pixels")
    model.add_argument("--k1", type=float, default=0.0, help="radial distortion")
    model.add_argument("--text", action="store_true", help="write .txt instead of .bin")
    sets = [commands.add_parser(name, help=text) for name, (_, text) in DATA_SETS.items()]
    labels = commands.add_parser("labels", help="a folder with images/ and labels.json")
    labels.add_argument("--count", type=int, default=240)
    for command in (ortho, model, *sets):
        command.add_argument("--extent", type=float, default=100.0, help="side of the scene in metres (%(default)s)")
        command.add_argument("--vehicles", type=int, default=60)
    for command in (ortho, model, labels, *sets):
        command.add_argument("--style", choices=STYLES)
        command.add_argument("out", type=Path)
        command.add_argument("--seed", type=int, default=0)
        command.add_argument(
            "--fleet", help="code of a fleet, such as world or de (a normal one, 4.45 x 1.79 x 1.54 m)"
        )
        command.add_argument("--overwrite", action="store_true", help="replace what orthoscale wrote there before")
    a = parser.parse_args(arguments)
    try:
        with stopping.listening():
            _write(a)
    except KeyboardInterrupt:
        parser.exit(stopping.exit_code(), stopping.sentence() + "\n")
    except OrthoscaleError as error:
        parser.exit(error.exit_code, f"error: {error.message}\n{error.hint}\n")


def _write(a: argparse.Namespace) -> None:
    fleet = load_fleet(a.fleet) if a.fleet else None
    a.out.absolute().parent.mkdir(parents=True, exist_ok=True)
    with Outputs(a.overwrite, Path(a.fleet) if str(a.fleet).endswith(".json") else None) as outputs:
        if a.command == "ortho":
            beside = a.out.with_suffix(".truth.json")
            # Not every picture has room for a signature; the truth beside it has.
            picture, truth = outputs.file(a.out, lambda _: ours(beside)), outputs.file(beside)
        else:
            folder = outputs.folder(a.out)
        if a.command == "labels":
            write_labels(folder, a.count, a.seed, fleet, style=a.style)
            return
        scene = make_scene(a.seed, fleet, a.extent, a.vehicles, a.style)
        if a.command == "ortho":
            write_ortho(scene, picture, a.gsd, a.seed)
            picture.with_suffix(".truth.json").replace(truth)
        elif a.command in DATA_SETS:
            write, _ = DATA_SETS[a.command]
            write(scene, folder)
        else:
            width, height = a.size
            view = (a.frames, a.pitch, a.altitude, a.focal, width, height)
            write_colmap(scene, folder, a.metres_per_unit, *view, a.seed, not a.text, k1=a.k1)


if __name__ == "__main__":
    main()
