"""The report as a browser shows it: on a phone, on a desk and in print. `.ci/run` brings the browser.

With ORTHOSCALE_SCREENSHOTS naming a folder, the screenshots stay there to be looked at.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.reports import car_park, fixed, fixed_model

from orthoscale.report.files import redraw
from orthoscale.report.page import page
from orthoscale.report.scene import Outline, Panel, ReportPictures

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
FORMS = {"phone": (360, 740), "desktop": (1280, 900)}
OVER_ITS_EDGE = ((-300, 300), (50, 300), (50, 500), (-300, 500))  # of a picture 100 px wide [px]
SMALLEST_LETTERS = 10  # height of the smallest text in a chart [CSS px]


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium, or a skip that says what is missing."""
    api = pytest.importorskip("playwright.sync_api", reason="no Playwright: pip install -e '.[browser]'")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with api.sync_playwright() as playwright:
        if path is None and not Path(playwright.chromium.executable_path).exists():
            pytest.skip(
                f"no browser: none of {', '.join(BROWSERS)} on PATH, and none from `playwright install chromium`"
            )
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Reports of an orthophoto, and of a model without its frames that has every doubt there is."""
    folders = {name: tmp_path_factory.mktemp(name) for name in ("ortho", "doubtful")}
    car_park(folders["ortho"])
    made = {"ortho": fixed(folders["ortho"])}
    report = json.loads(fixed_model(folders["doubtful"]).with_suffix(".json").read_text())
    worst = {
        "verdict": "unusable",
        "modes": {
            "planar": {"scale": 13.0, "interval90": [12, 14], "vehicles_used": 9},
            "oblique": {"scale": 16, "interval90": [15, 17], "vehicles_used": 20},
        },
        "drift": {
            "regions": [
                {"centre_unit": [x, y], "scale": s, "sd": 0.5, "vehicles": 9}
                for x, y, s in ((-4, -4, 12.0), (6, 3, 19.0), (0, 5, 15.0))
            ],
            "trend": {"percent_across": 40.0, "chance": 1e-6},
            "drifts": True,
            "frames": {f"DJI_{k:04d}.jpg": {"scale": 14 + k % 3, "sd": 0.6, "vehicles": 5} for k in range(170)},
            "odd_frames": ["DJI_0002.jpg"],
        },
        "judgements": [
            *report["judgements"],
            {"severity": "refusal", "what": "Remark", "detail": "widths are larger: " + "a_very_long_word_" * 12},
        ],
        "input": {**report["input"], "path": "no/such/" + "deep_folder/" * 20},
    }
    (folders["doubtful"] / "report.json").write_text(json.dumps({**report, **worst}))
    made["doubtful"] = folders["doubtful"] / "report.html"
    redraw(folders["doubtful"] / "report.json", made["doubtful"])
    return made


def shots(name: str, tmp_path: Path) -> Path:
    folder = Path(os.environ.get("ORTHOSCALE_SCREENSHOTS") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


def has_a_picture(path: Path) -> bool:
    return cv2.imread(str(path)).std() > 10


@pytest.mark.parametrize("name", ["ortho", "doubtful"])
@pytest.mark.parametrize("form", FORMS)
def test_a_screen_shows_it_whole_and_quietly(browser, pages, tmp_path, name, form):
    width, height = FORMS[form]
    page = browser.new_page(viewport={"width": width, "height": height})
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(pages[name].as_uri())
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [pages[name].as_uri()], "no network"
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "no scrolling to the side"

    loaded = page.evaluate(
        """async () => { const all = [...document.querySelectorAll('image')];
        for (const i of all) { const m = new Image(); m.src = i.href.baseVal; await m.decode(); }
        return all.length; }"""
    )
    assert loaded >= (25 if name == "ortho" else 1)
    texts = page.evaluate(
        """[...document.querySelectorAll('.chart text')].map(t => { const b = t.getBoundingClientRect();
        return [t.textContent, b.left, b.right, b.height]; })"""
    )
    assert len(texts) > 20
    cut = [text for text, left, right, _ in texts if left < 0 or right > width]
    small = [text for text, _, _, high in texts if high < SMALLEST_LETTERS]
    assert not cut and not small
    first_screen = page.evaluate("document.querySelector('h1').getBoundingClientRect().bottom")
    assert first_screen < height / 4, "the answer first"

    page.screenshot(path=shots(f"{name}.{form}.png", tmp_path), full_page=True)
    assert has_a_picture(shots(f"{name}.{form}.png", tmp_path))
    page.close()


def test_outlines_end_with_their_picture_and_words_stay_whole(browser, pages):
    report = json.loads(pages["doubtful"].with_suffix(".json").read_text())
    anchor = {"kind": "tennis court", "count": 1, "standard": "ITF tennis court", "metres": 23.77, "views": 17}
    anchor |= {"scale": report["scale"], "relative_sd": 0.004, "residual_cm": 1.0, "counted": True, "picture": ""}
    high = Panel("high", np.full((800, 100, 3), 255, np.uint8), [Outline(np.array(OVER_ITS_EDGE), True, "")])
    shown = page({**report, "anchors": [anchor]}, ReportPictures(overviews=[high]))
    pages["doubtful"].with_name("shown.html").write_text(shown, encoding="utf-8")
    tab = browser.new_page(viewport={"width": 360, "height": 740})
    tab.goto(pages["doubtful"].with_name("shown.html").as_uri())
    pixels = cv2.imdecode(np.frombuffer(tab.locator(".overview svg.scene").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    coloured = np.ptp(pixels.astype(int), axis=2).max(axis=0) > 50
    assert coloured.any() and not coloured[: len(coloured) // 4].any(), "the picture has less than half of the width"
    lines = tab.evaluate(
        """(() => { const words = document.createRange(); words.selectNodeContents(document.querySelector('td.name'));
        return words.getClientRects().length; })()"""
    )
    assert lines <= 2, "17 pictures: a line for each word at most"
    tab.close()


@pytest.mark.parametrize("name", ["ortho", "doubtful"])
def test_paper_holds_it_on_a_few_pages(browser, pages, tmp_path, name):
    page = browser.new_page(viewport={"width": 794, "height": 1123})  # A4 at 96 dpi
    page.emulate_media(media="print")
    page.goto(pages[name].as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 794
    page.screenshot(path=shots(f"{name}.print.png", tmp_path), full_page=True)
    assert has_a_picture(shots(f"{name}.print.png", tmp_path))
    pdf = page.pdf(path=shots(f"{name}.pdf", tmp_path), prefer_css_page_size=True, print_background=True)
    assert pdf.startswith(b"%PDF") and 2 <= pdf.count(b"/Type /Page\n") <= 6
    page.close()
