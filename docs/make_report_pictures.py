"""Take the screenshots of docs/report.md, and make the README's picture.

    python docs/make_report_pictures.py --data ../shared/data

The orthophoto is examples/town, with the shipped detector; the reconstruction is sheffield (public domain) with its
frames, which lie in the data folder. A browser is needed: pip install -e '.[browser]', and chromium by apt.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import orthoscale

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
OUT = HERE / "report"
DESK, PHONE = (860, 700), (360, 640)
FRONT = (1200, 850)  # of the README's picture [px]
MIN_PANEL = 200  # rows of pictures in vehicles.png; titles and single vehicles have fewer from one gap to the next
HEADS = ("town", "stretched")  # reports whose head is shown
SECTIONS = {  # picture: report, and the heading of its section
    "vehicles": ("sheffield", "Are these the vehicles?"),
    "sizes": ("sheffield", "Do they have the sizes of the fleet?"),
    "measurements": ("town", "Do the measurements agree?"),
    "places": ("town", "Is the scale the same everywhere?"),
    "frames": ("sheffield", "Is the scale the same everywhere?"),
    "uncertainty": ("town", "Where the uncertainty comes from"),
}


def reports(folder: Path, data: Path) -> dict[str, Path]:
    """An orthophoto, a reconstruction, and one whose boxes are a quarter longer than its vehicles."""
    found = json.loads((EXAMPLES / "sheffield" / "detections.json").read_text())
    for part in (found, found["planar"]):
        for box in chain.from_iterable(part["pictures"].values()):
            box["length"] *= 1.25
    (folder / "stretched.json").write_text(json.dumps(found))
    model = data / "reconstructions" / "sheffield"
    boxes = EXAMPLES / "sheffield" / "detections.json"
    orthoscale.fix(EXAMPLES / "town" / "ortho.jpg", folder / "town.tif", fleet="DE")
    orthoscale.fix(model, folder / "sheffield", fleet="US", detections=boxes)
    orthoscale.fix(model, folder / "stretched", fleet="US", detections=folder / "stretched.json", force=True)
    return {
        "town": folder / "town.tif.html",
        "sheffield": folder / "sheffield" / "report.html",
        "stretched": folder / "stretched" / "report.html",
    }


@contextmanager
def pages(paths: dict[str, Path]) -> Iterator[dict[str, Page]]:
    browser_path = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox", "--disable-gpu"])
        opened = {}
        for name, path in paths.items():
            opened[name] = browser.new_page(viewport=dict(zip(("width", "height"), DESK, strict=True)))
            opened[name].goto(path.as_uri())
        yield opened
        browser.close()


def front_page(sheet: Path, out: Path) -> None:
    """The panels of a model's vehicles.png beside each other, where it has them below one another: title on top, the
    model from above on the left, one frame and the vehicles on the right."""
    pixels = np.asarray(Image.open(sheet).convert("RGB"))
    blank = (pixels == 255).all((1, 2))
    edges = np.flatnonzero(np.diff(np.r_[True, blank, True].astype(int))).reshape(-1, 2)
    above, frame = edges[np.ptp(edges, axis=1) > MIN_PANEL][:2].tolist()
    left, top = 640, 50
    right = FRONT[0] - left
    page = Image.new("RGB", FRONT, "white")

    def paste(first: int, end: int, width: int, x: int, y: int) -> int:
        part = Image.fromarray(pixels[first:end])
        part = part.resize((width, round(part.height * width / part.width)), Image.Resampling.LANCZOS)
        page.paste(part, (x, y))
        return y + part.height

    paste(0, above[0], int(0.8 * pixels.shape[1]), 0, 0)
    paste(*above, left - 8, 0, top)
    bottom = paste(*frame, right, left, top)
    paste(frame[1] + 8, len(pixels), right, left, bottom + 6)
    page.quantize(256).save(out, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=HERE.parent.parent / "shared" / "data")
    options = parser.parse_args()
    OUT.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        paths = reports(Path(folder), options.data)
        front_page(Path(folder) / "sheffield" / "vehicles.png", HERE / "sheffield.png")
        with pages(paths) as opened:
            for name in HEADS:
                opened[name].locator("header").screenshot(path=OUT / f"{name}.png")
            for name, (report, heading) in SECTIONS.items():
                part = opened[report].locator("section", has_text=heading)
                part = part.locator(".chips").first if name == "vehicles" else part
                form = "jpeg" if name == "vehicles" else "png"
                quality = {"quality": 80} if form == "jpeg" else {}
                part.screenshot(path=OUT / f"{name}.{form}", type=form, **quality)
            phone = opened["town"]
            phone.set_viewport_size(dict(zip(("width", "height"), PHONE, strict=True)))
            phone.evaluate("scrollTo(0, 0)")
            phone.screenshot(path=OUT / "phone.png")
    for path in sorted(OUT.iterdir()):
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
