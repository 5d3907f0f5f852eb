"""Time and memory of `fix` by the number of frames: copies of a COLMAP model side by side as one model.

    python benchmarks/many_frames.py ../shared/data/reconstructions/sheffield --fleet US --copies 1 3 6 12
    python benchmarks/many_frames.py ../shared/data/reconstructions/sheffield --fleet US --copies 1 --times 5

Copies stand in a row along the longer axis of the ground, a tenth of their length apart; their pictures are links to
the original ones, or enlarged by cubic splines, --times as wide and high. No cache is used. Prints Markdown: frames
that were searched, seconds by the clock and of the processor, and the process's peak memory.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pycolmap

MEGABYTE = 1024  # [kB]
QUALITY = 92  # of enlarged JPEGs


def copied(model: Path, out: Path, copies: int, times: int) -> None:
    """Write `copies` of the COLMAP model in `model`/sparse as one, with links to its pictures in `model`/images, or
    with these enlarged."""
    sparse = next(iter(sorted(path.parent for path in (model / "sparse").rglob("cameras.*"))))
    whole = pycolmap.Reconstruction(sparse)
    for camera in whole.cameras.values():
        camera.rescale(times * camera.width, times * camera.height)
    for image in whole.images.values():
        for point in image.points2D:
            point.xy = times * point.xy
    points = np.array([point.xyz for point in whole.points3D.values()])
    # Along the ground: the first principal axis of the points, without stray ones.
    middle = np.median(points, axis=0)
    near = points[(np.abs(points - middle) <= 3 * np.median(np.abs(points - middle), axis=0)).all(1)]
    axis = np.linalg.svd(near - near.mean(0), full_matrices=False)[2][0]
    step = 1.1 * float(np.ptp(np.percentile(points @ axis, [1, 99]))) * axis
    (out / "sparse").mkdir(parents=True)
    (out / "images").mkdir()
    rows: dict[str, list[str]] = {"cameras": [], "images": [], "points3D": []}
    text = out / "text"
    text.mkdir()
    whole.write_text(text)
    lines = {
        name: [row for row in (text / f"{name}.txt").read_text().splitlines() if not row.startswith("#")]
        for name in rows
    }
    rows["cameras"] = lines["cameras"]
    most_images, most_points = max(whole.images) + 1, max(whole.points3D) + 1
    for k in range(copies):
        moved = k * step
        for head, tracks in zip(lines["images"][::2], lines["images"][1::2], strict=True):
            number, *pose, camera, name = head.split(maxsplit=9)
            rotation = pycolmap.Rotation3d(np.roll(np.array(pose[:4], float), -1)).matrix()
            shift = np.array(pose[4:7], float) - rotation @ moved
            rows["images"].append(
                " ".join(
                    [str(int(number) + k * most_images), *pose[:4], *map(repr, shift.tolist()), camera, f"{k}_{name}"]
                )
            )
            seen = np.array(tracks.split(), object).reshape(-1, 3)
            matched = seen[:, 2] != "-1"
            seen[matched, 2] = [str(int(point) + k * most_points) for point in seen[matched, 2]]
            rows["images"].append(" ".join(seen.ravel()))
            if not (link := out / "images" / f"{k}_{name}").exists():
                shown(model / "images" / name, link, times)
        for row in lines["points3D"]:
            number, x, y, z, *rest = row.split()
            place = (np.array([x, y, z], float) + moved).tolist()
            track = [str(int(v) + k * most_images) if n % 2 == 0 else v for n, v in enumerate(rest[4:])]
            rows["points3D"].append(
                " ".join([str(int(number) + k * most_points), *map(repr, place), *rest[:4], *track])
            )
    for name, written in rows.items():
        (text / f"{name}.txt").write_text("\n".join(written) + "\n")
    for name in ("rigs", "frames"):  # COLMAP makes one of each for every image by itself
        (text / f"{name}.txt").unlink(missing_ok=True)
    pycolmap.Reconstruction(text).write_binary(out / "sparse")


def shown(picture: Path, at: Path, times: int) -> None:
    """Make `at` a link to `picture`, or a copy `times` as wide and high."""
    if times == 1:
        at.symlink_to(picture.resolve())
    else:
        pixels = cv2.resize(cv2.imread(str(picture)), None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(at), pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def timed(model: Path, out: Path, fleet: str) -> dict[str, float]:
    """Seconds and memory [MB] of `fix` from `model` to `out`, in a process of its own."""
    command = [sys.executable, "-m", "orthoscale", "fix", str(model), "--fleet", fleet, "--out", str(out)]
    begun = time.perf_counter()
    # Copies of the same vehicles are no sample of a fleet; the scale does not matter here.
    process = subprocess.Popen([*command, "--no-cache", "--anchors", "none", "--force"], stdout=subprocess.DEVNULL)
    _, status, spent = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"fix failed on {model}")
    return {
        "wall": time.perf_counter() - begun,
        "processor": spent.ru_utime + spent.ru_stime,
        "memory": spent.ru_maxrss / MEGABYTE,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("--fleet", default="world")
    parser.add_argument("--copies", type=int, nargs="+", default=[1, 3, 6, 12])
    parser.add_argument("--times", type=int, default=1)
    asked = parser.parse_args()
    print("| frames | sweep | s | processor s | peak memory [MB] |")
    print("|---|---|---|---|---|")
    for copies in asked.copies:
        with tempfile.TemporaryDirectory() as folder:
            model, out = Path(folder) / "model", Path(folder) / "out"
            copied(asked.model, model, copies, asked.times)
            took = timed(model, out, asked.fleet)
            swept = json.loads((out / "report.json").read_text())["sweep"]
            frames = len(list((model / "images").iterdir()))
        seconds = f"{took['wall']:.0f} | {took['processor']:.0f} | {took['memory']:.0f}"
        print(f"| {frames} | {swept['looked_at']} | {seconds} |", flush=True)


if __name__ == "__main__":
    main()
