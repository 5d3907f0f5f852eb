"""The whole program on changed copies of every orthophoto of known scale, as people may have them.

    python benchmarks/changed_places.py BOXES [--detector NETWORK.onnx] [--measurer MEASURER] [--scenes NAMES]
                                              [--changes NAMES]

The scenes are those of `places.py`, with the country's fleet. Copies are PNG files without georeferencing. The boxes of
each copy are kept in the folder BOXES, so that a second run takes seconds. Printed for each change: how many copies
have an answer, the errors of the scales, how much they differ from those of the unchanged places, and how many
intervals hold.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import orthoscale
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from places import Scene, called, measured, scenes  # noqa: E402
from support.simulate import table  # noqa: E402

AS_THEY_ARE = "as they are"
WHITE, BLACK = (255, 255, 255), (0, 0, 0)
LEGEND = (
    "ORTHOPHOTO PLAN  SHEET 12 OF 40   PROJECT: NORTH PARKING AREA, PHASE II",
    "Datum WGS84 / UTM  Scale 1:500  Drawn by: A. Miller  Checked by: B. Schmidt  2024-05-11",
    "Legend: existing kerb, proposed drainage, property boundary, fire hydrant, manhole, street light",
    "All dimensions in metres unless otherwise noted. Contractor to verify all levels on site.",
)


def _resized(pixels: np.ndarray, factor: float, way: int) -> np.ndarray:
    return cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=way)


def _jpeg(pixels: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def _blurred(pixels: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(pixels, (0, 0), sigma)


def _noisy(pixels: np.ndarray, sd: float) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, sd, pixels.shape)
    return np.clip(pixels + noise, 0, 255).astype(np.uint8)


def _toned(pixels: np.ndarray, gamma: float, gain: float, shift: float) -> np.ndarray:
    levels = 255 * (np.arange(256) / 255) ** gamma * gain + shift
    return cv2.LUT(pixels, levels.clip(0, 255).round().astype(np.uint8))


def _turned(pixels: np.ndarray, degrees: float) -> np.ndarray:
    height, width = pixels.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2 - 0.5, height / 2 - 0.5), degrees, 1.0)
    return cv2.warpAffine(pixels, turn, (width, height), flags=cv2.INTER_CUBIC)


def _sharpened(pixels: np.ndarray) -> np.ndarray:
    return cv2.addWeighted(pixels, 2.5, _blurred(pixels, 1.0), -1.5, 0)


def _of_video(pixels: np.ndarray) -> np.ndarray:
    """As in the last of eight frames of a video by a moving camera, with a quarter of a bit per pixel as drones
    have."""
    even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
    height, width = even.shape[:2]
    with tempfile.TemporaryDirectory() as scratch:
        file = str(Path(scratch) / "frames.webm")
        video = cv2.VideoWriter(file, cv2.VideoWriter_fourcc(*"VP90"), 25, (width, height))
        for k in range(7, -1, -1):
            video.write(np.roll(even, 4 * k, axis=1))
        video.release()
        frames = cv2.VideoCapture(file)
        while (read := frames.read())[0]:
            last = read[1]
    return last


def _on_a_sheet(pixels: np.ndarray) -> np.ndarray:
    """On a map sheet: white paper all around, a frame, coordinates above and lines of text below."""
    height, width = pixels.shape[:2]
    sheet = cv2.copyMakeBorder(pixels, 60, 220, 60, 60, cv2.BORDER_CONSTANT, value=WHITE)
    cv2.rectangle(sheet, (20, 20), (width + 100, height + 260), BLACK, 2)
    for x in range(60, width, 100):
        _write(sheet, f"{10 * x}", x, 45)
    for line, text in enumerate(LEGEND):
        for x in range(60, width, 900):
            _write(sheet, text, x, height + 110 + 40 * line)
    return sheet


def _watermarked(pixels: np.ndarray) -> np.ndarray:
    """With pale names all over, as previews have them."""
    marked = pixels.copy()
    for row, y in enumerate(range(40, len(pixels), 160)):
        for x in range(row % 2 * 120, pixels.shape[1], 320):
            _write(marked, "(c) Imagery", x, y, WHITE, 0.7, 2)
    return cv2.addWeighted(pixels, 0.55, marked, 0.45, 0)


def _with_holes(pixels: np.ndarray) -> np.ndarray:
    """With transparent holes of 20 to 80 px over two fifths of it, which cut most vehicles, as gaps of a mosaic do."""
    random = np.random.default_rng(1)
    holes = np.zeros(pixels.shape[:2], np.uint8)
    while holes.mean() < 0.4:
        place = random.integers((pixels.shape[1], pixels.shape[0])).tolist()
        cv2.ellipse(holes, place, random.integers(10, 40, 2).tolist(), float(random.uniform(0, 180)), 0, 360, 1, -1)
    return np.dstack([pixels, 255 * (1 - holes)])


def _write(
    picture: np.ndarray,
    text: str,
    x: int,
    y: int,
    colour: tuple[int, int, int] = BLACK,
    size: float = 0.5,
    stroke: int = 1,
) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, colour, stroke, cv2.LINE_AA)


# Name: by what factor the copy is larger than the picture, and the function that makes it.
CHANGES: dict[str, tuple[float, Callable[[np.ndarray], np.ndarray]]] = {
    AS_THEY_ARE: (1, lambda p: p),
    "grey": (1, lambda p: cv2.cvtColor(cv2.cvtColor(p, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)),
    "JPEG 30": (1, lambda p: _jpeg(p, 30)),
    "frame of a video": (1, _of_video),
    "sharpened": (1, _sharpened),
    "channels exchanged": (1, lambda p: np.ascontiguousarray(p[..., [1, 2, 0]])),
    "hazy": (1, lambda p: _toned(p, 1.0, 0.5, 110)),
    "dark": (1, lambda p: _toned(p, 1.8, 0.8, 0)),
    "overexposed": (1, lambda p: _toned(p, 0.8, 1.5, 10)),
    "turned by 33 degrees": (1, lambda p: _turned(p, 33)),
    "blurred by 1 px": (1, lambda p: _blurred(p, 1.0)),
    "blurred by 2 px": (1, lambda p: _blurred(p, 2.0)),
    "blurred by 2 px and noisy": (1, lambda p: _noisy(_blurred(p, 2.0), 5.0)),
    "0.7 times as large": (0.7, lambda p: _resized(p, 0.7, cv2.INTER_AREA)),
    "half as large": (0.5, lambda p: _resized(p, 0.5, cv2.INTER_AREA)),
    "enlarged twice (linear)": (2, lambda p: _resized(p, 2, cv2.INTER_LINEAR)),
    "enlarged twice (nearest)": (2, lambda p: _resized(p, 2, cv2.INTER_NEAREST)),
    "screenshot of a screenshot": (
        1.3, lambda p: _jpeg(_resized(_jpeg(_resized(p, 0.8, cv2.INTER_LINEAR), 60), 1.625, cv2.INTER_LINEAR), 60)
    ),
    "on a map sheet": (1, _on_a_sheet),
    "with a watermark": (1, _watermarked),
    "with holes": (1, _with_holes),
}  # fmt: skip


def scale_of(scene: Scene, boxes: Path, networks: dict[str, str | Path | None]) -> tuple[float, bool] | None:
    """Error of the logarithm of a scene's scale, with its country's fleet, and whether the interval holds; None if
    there is no scale. Boxes are kept in the file `boxes`."""
    if not boxes.exists():
        try:
            found = orthoscale.estimate(scene.path, fleet=scene.country, **networks).detections
        except (EvidenceDisagrees, TooLittleEvidence):
            return None
        orthoscale.save_detections(found, boxes)
    got = measured(scene, scene.country, boxes)
    if isinstance(got, str):
        return None
    error, low, high, _ = got
    return float(np.log1p(error)), low <= 0 <= high


def main(some: list[Scene], changes: list[str], folder: Path, networks: dict[str, str | Path | None]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    got: dict[tuple[str, str], tuple[float, bool] | None] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for scene in some:
            pixels = cv2.imread(str(scene.path))
            for change in changes:
                factor, made = CHANGES[change]
                name = f"{scene.name} {change}"
                copy = replace(scene, path=Path(scratch) / f"{name}.png", truth=scene.truth / factor)
                cv2.imwrite(str(copy.path), made(pixels))
                got[scene.name, change] = scale_of(copy, folder / f"{name}.det.json", networks)
                copy.path.unlink()
    rows = []
    for change in changes:
        told = {scene.name: t for scene in some if (t := got[scene.name, change])}
        if not told:
            rows.append([change, "0", *[""] * 5])
            continue
        error = 100 * np.array([error for error, _ in told.values()])
        moved = [100 * (told[n][0] - plain[0]) for n in told if (plain := got.get((n, AS_THEY_ARE)))]
        rows.append(
            [change, f"{len(told)}", f"{np.median(np.abs(error)):.1f}", f"{np.sqrt((error**2).mean()):.1f}",
             f"{error[np.abs(error).argmax()]:+.1f}",
             f"{np.median(moved):+.1f} ({np.std(moved):.1f})" if moved else "",
             f"{sum(holds for _, holds in told.values())} of {len(told)}"]
        )  # fmt: skip
    head = ("change", "answered", "median of sizes", "root mean square", "worst [%]", "against as they are", "holds")
    print(table(head, rows))
    print("\n" + table(
        ("scene", *changes),
        [[s.name, *("" if (t := got[s.name, c]) is None else f"{100 * t[0]:+.1f}{'' if t[1] else ' out'}"
                    for c in changes)] for s in some],
    ))  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("boxes", type=Path, help="folder in which boxes are kept")
    parser.add_argument("--detector", type=Path)
    parser.add_argument("--measurer")
    parser.add_argument("--scenes", default="", help="comma separated; all by default")
    parser.add_argument("--changes", default="", help="comma separated; all by default")
    options = parser.parse_args()
    asked = set(filter(None, options.changes.split(",")))
    if unknown := asked - set(CHANGES):
        parser.error(f"no such change: {', '.join(sorted(unknown))}; there are {', '.join(CHANGES)}")
    main(
        called([scene for scene in scenes() if scene.path.is_file()], options.scenes),
        [change for change in CHANGES if not asked or change in asked],
        options.boxes,
        {"detector": options.detector, "measurer": options.measurer},
    )
