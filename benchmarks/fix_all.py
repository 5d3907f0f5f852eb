"""`fix`, with its report, on every reconstruction and the examples.

    python benchmarks/fix_all.py [DATA [SCENE ...]]

DATA is the folder of the real data (see CONTRIBUTING.md), SCENE names of its reconstructions. Each scene is fixed in
each measuring mode and with each order of imports, every run in a process of its own; detections are cached between
runs. The output is opened again and compared with the scale that `fix` returned. If `fix` refuses (exit code 3 or 4),
there must be no output, and the row says why. Prints Markdown, and ends with 1 if anything is missing, wrong or
different.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

HERE = Path(__file__).parents[1]
MODES = ("oblique", "planar", "both")
ORDERS = {
    "pycolmap first": "import pycolmap, cv2, orthoscale",
    "cv2 first": "import cv2, pycolmap, orthoscale",
    "orthoscale first": "import orthoscale, pycolmap, cv2",
    "torch first": "import torch, pycolmap, orthoscale",
    "open3d first": "import open3d, pycolmap, orthoscale",
}
ORDERS = {name: line for name, line in ORDERS.items() if find_spec(name.split()[0])}  # those that are installed
RUN = """
import json, sys
{imports}
source, out, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
try:
    scale = orthoscale.fix(source, out, **options).scale
except orthoscale.OrthoscaleError as why:
    if why.exit_code not in (3, 4):
        raise
    print(json.dumps({{"exit": why.exit_code, "why": why.message}}))
else:
    print(json.dumps([scale.value, *scale.interval90, scale.vehicles_used, scale.verdict]))
"""
BESIDE = ("", ".html", ".json", ".png")  # endings of the files beside an orthophoto
WRITTEN = ("report.html", "report.json", "vehicles.png", "sim3.txt", "sim3_4x4.txt", "sim3.json")


def scenes(data: Path) -> dict[str, tuple[Path, float, dict[str, str]]]:
    """Source, true metres per unit and options of each scene, by name; the example's boxes come with it."""
    example = HERE / "examples" / "sheffield"
    truth = json.loads((example / "truth.json").read_text())
    boxes = {"fleet": truth["fleet"], "detections": str(example / "detections.json")}
    town = HERE / "examples" / "town"
    drawn = json.loads((town / "truth.json").read_text())
    out = {
        "examples/town": (town / "ortho.jpg", drawn["gsd_m"], {"fleet": drawn["fleet"]}),
        "examples/sheffield": (example / "sparse", truth["metres_per_model_unit"], boxes),
    }
    for folder in sorted(p.parent for p in data.glob("reconstructions/*/truth.json")):
        truth = json.loads((folder / "truth.json").read_text())
        out[folder.name] = (folder, truth["metres_per_model_unit"], {"fleet": truth["country"]})
    return out


def fixed(source: Path, out: Path, imports: str, options: dict[str, str]) -> tuple[list | dict, str]:
    """The result of one run (scale, low, high, vehicles, verdict; exit code and reason if it refused; empty if it
    failed), and its last line of output if it failed."""
    words = [sys.executable, "-c", RUN.format(imports=imports), str(source), str(out), json.dumps(options)]
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    if done.returncode:
        return [], (done.stderr.strip().splitlines() or [f"ended by signal {-done.returncode}"])[-1]
    return json.loads(done.stdout), ""


def fault(source: Path, out: Path, scale: float) -> str:
    """What is wrong with the output: missing files, or pixels or distances of cameras that are not `scale` times as
    large; "" if nothing is."""
    names = [out.with_name(f"{out.name}{end}") for end in BESIDE] if out.suffix else [out / name for name in WRITTEN]
    if missing := [name.name for name in names if not name.is_file()]:
        return f"without {', '.join(missing)}"
    if out.suffix:
        import rasterio

        with rasterio.open(out) as picture:
            ratio = picture.res[0]
    else:
        ratio = _extent(out) / _extent(source)
    return "" if abs(ratio / scale - 1) < 1e-9 else f"the model grew {ratio:.6g} times"


def left(out: Path) -> str:
    """Which files a run that refused has left; "" if none."""
    rest = [path.name for path in out.parent.iterdir() if out.stem in path.name]
    return f"refused, but left {', '.join(rest)}" if rest else ""


def _extent(folder: Path) -> float:
    import pycolmap

    model = pycolmap.Reconstruction(str(folder / "sparse" if (folder / "sparse").is_dir() else folder))
    centres = np.array([image.projection_center() for image in model.images.values()])
    return float(np.linalg.norm(np.ptp(centres, axis=0)))


def cells(said: list | dict, truth: float, source: Path) -> tuple[str, ...]:
    """Cells of a row: scale, error, interval, vehicles, verdict, and what is written if nothing is wrong."""
    if isinstance(said, dict):
        why = said["why"].removeprefix(f"{source}: ")
        return ("", "", "", "", f"refused (exit {said['exit']}): {why}", "nothing")
    value, low, high, vehicles, verdict = said or (np.nan, np.nan, np.nan, 0, "none")
    error = f"{100 * (value / truth - 1):+.1f} %"
    return (f"{value:.4g}", error, f"{low:.4g} to {high:.4g}", str(vehicles), verdict, "all")


def main() -> int:
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "shared" / "data"
    every, wanted = scenes(data), sys.argv[2:]
    if unknown := set(wanted) - set(every):
        sys.exit(f"no such scene: {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    print("| scene | mode | m per unit | error | 90 % interval | vehicles | verdict | written | orders of import |")
    print("|---|---|---|---|---|---|---|---|---|")
    bad = 0
    with tempfile.TemporaryDirectory() as scratch:
        os.environ.setdefault("ORTHOSCALE_CACHE", f"{scratch}/cache")
        for name, (source, truth, options) in every.items():
            if wanted and name not in wanted:
                continue
            plan = source.is_file()
            for mode in (None,) if plan else MODES:
                said, faults = [], []
                for order, imports in ORDERS.items():
                    out = Path(scratch) / f"{name}-{mode}-{order}".replace("/", "-").replace(" ", "-")
                    out = out.with_suffix(".tif") if plan else out
                    one, why = fixed(source, out, imports, {**options, "mode": mode} if mode else options)
                    said.append(one)
                    wrong = why or (left(out) if isinstance(one, dict) else fault(source, out, one[0]))
                    faults += [f"{order}: {wrong}"] if wrong else []
                alike = all(one == said[0] for one in said)
                bad += bool(faults) or not alike
                *row, whole = cells(said[0], truth, source)
                row = [name, mode or "", *row, "; ".join(faults) or whole, "same" if alike else "differ"]
                print("| " + " | ".join(row) + " |", flush=True)
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
