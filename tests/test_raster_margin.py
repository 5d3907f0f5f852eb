"""Map sheets: their margin, with its lettering, is no ground; pictures of the ground have no margin."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.windows import Window

import orthoscale
from orthoscale.core.source import NO_DATA_GREY
from orthoscale.sources.raster import RasterSource
from orthoscale.sources.raster_margin import Margin, margin_of

WHITE, CREAM = (255, 255, 255), (250, 240, 225)
TOWN = Path(__file__).parents[1] / "examples" / "town" / "ortho.jpg"


def ground(height: int = 500, width: int = 700, seed: int = 0) -> np.ndarray:
    """(height, width, 3) uint8 of dark ground with texture."""
    rng = np.random.default_rng(seed)
    return cv2.GaussianBlur(rng.integers(0, 200, (height, width, 3), np.uint8), (0, 0), 1.5)


def lettered(sheet: np.ndarray, left: int, top: int, lines: int, colour: tuple[int, int, int] = (0, 0, 0)) -> None:
    """Writes lines of text onto a `sheet`, 40 px apart."""
    for line in range(lines):
        at = (left, top + 40 * line)
        cv2.putText(sheet, "Sheet 12 of 40, phase II", at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv2.LINE_AA)


def sheet_of(
    picture: np.ndarray, paper: tuple[int, int, int] = WHITE, around: tuple[int, int, int, int] = (60, 220, 60, 60)
) -> np.ndarray:
    """`picture` on a sheet with margins `around` it (top, bottom, left, right), with text below."""
    sheet = cv2.copyMakeBorder(picture, *around, cv2.BORDER_CONSTANT, value=paper)
    lettered(sheet, around[2], around[0] + picture.shape[0] + 50, 4)
    return sheet


def margin(pixels: np.ndarray) -> Margin | None:
    """The margin of a sheet that is held in memory."""

    def read(window: Window, out: tuple[int, int]) -> np.ndarray:
        part = pixels[window.row_off :, window.col_off :][: window.height, : window.width]
        return cv2.resize(part, out[::-1], interpolation=cv2.INTER_AREA)

    return margin_of(pixels.shape[1], pixels.shape[0], read)


def outside(pixels: np.ndarray) -> np.ndarray:
    """(h, w) bool: which pixels of a sheet are margin."""
    found = margin(pixels)
    assert found is not None
    height, width = pixels.shape[:2]
    return found.at(Window(0, 0, width, height), (height, width))


def jpeg(pixels: np.ndarray) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 75])[1], cv2.IMREAD_COLOR)


def scanned(pixels: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(1).normal(0, 2.5, pixels.shape)
    return np.clip(0.93 * cv2.GaussianBlur(pixels, (0, 0), 0.8) + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("paper", [WHITE, CREAM])
@pytest.mark.parametrize("stored", [np.copy, jpeg, scanned])
def test_the_margin_with_its_letters_and_nothing_else_is_outside(paper, stored):
    found = outside(stored(sheet_of(ground(), paper)))
    assert not found[60:560, 60:760].any()
    found[58:562, 58:762] = True  # the ground keeps a pixel or two of paper
    assert found.all()


def test_a_large_sheet_is_outlined_in_a_reduced_picture():
    found = outside(cv2.resize(sheet_of(ground(1000, 1400)), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC))
    assert not found[180:3180, 180:4380].any()
    found[170:3190, 170:4390] = True
    assert found.all()


def test_a_panel_at_one_side_is_enough():
    sheet = cv2.copyMakeBorder(ground(), 0, 0, 0, 350, cv2.BORDER_CONSTANT, value=WHITE)
    lettered(sheet, 730, 40, 12)
    found = outside(sheet)
    assert not found[:, :700].any() and found[:, 702:].all()


def test_frames_tables_and_logos_are_margin_but_a_second_picture_is_not():
    sheet = np.full((760, 1500, 3), 255, np.uint8)
    sheet[60:560, 60:760] = ground()
    sheet[60:560, 800:1440] = ground(500, 640, seed=1)
    cv2.rectangle(sheet, (15, 15), (1484, 744), (0, 0, 0), 2)  # the sheet's frame
    cv2.rectangle(sheet, (900, 600), (1400, 720), (0, 0, 0), 2)  # the title block
    cv2.line(sheet, (900, 660), (1400, 660), (0, 0, 0), 1)
    lettered(sheet, 910, 640, 2)
    cv2.circle(sheet, (300, 660), 35, (200, 0, 0), -1)  # a logo
    found = outside(sheet)
    assert not found[60:560, 60:760].any() and not found[60:560, 800:1440].any()
    assert found[564:].all() and found[:58].all()


def test_a_page_of_text_is_all_margin():
    page = np.full((600, 500, 3), 255, np.uint8)
    lettered(page, 40, 60, 13)
    assert outside(page).all()


def plain_border(colour: tuple[int, int, int]) -> np.ndarray:
    return cv2.copyMakeBorder(ground(), 80, 80, 80, 80, cv2.BORDER_CONSTANT, value=colour)


def turned() -> np.ndarray:
    turn = cv2.getRotationMatrix2D((350, 250), 30, 0.7)
    return cv2.warpAffine(ground(), turn, (700, 500), flags=cv2.INTER_CUBIC, borderValue=WHITE)


def white_sky() -> np.ndarray:
    """A photo with a white sky above trees of uneven height."""
    picture = ground()
    height = 80 + np.random.default_rng(2).integers(0, 12, 700)
    picture[np.arange(500)[:, None] < height] = 255
    return picture


def black_letters() -> np.ndarray:
    """Dark paper with lettering: black borders are mostly areas without data."""
    sheet = plain_border((0, 0, 0))
    lettered(sheet, 80, 620, 1, (255, 255, 255))
    return sheet


@pytest.mark.parametrize(
    "pixels",
    [ground(), plain_border(WHITE), plain_border((0, 0, 0)), turned(), white_sky(), black_letters()],
    ids=["ground", "white border", "black border", "turned", "white sky", "black"],
)
def test_pictures_of_the_ground_have_no_margin(pixels):
    assert margin(pixels) is None


def test_white_things_on_the_ground_stay_though_they_touch_the_margin():
    picture = ground()
    picture[200:210, :60] = 255  # a bright street that ends at the margin
    picture[300:340, 300:380] = 255  # a roof
    assert not outside(sheet_of(picture))[60:560, 60:760].any()


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("ending", ["png", "tif", "jpg"])
def test_a_sheet_is_read_without_its_margin_and_copied_with_it(tmp_path, ending):
    sheet = sheet_of(ground())
    Image.fromarray(sheet).save(tmp_path / f"sheet.{ending}", **({"quality": 95} if ending == "jpg" else {}))
    with RasterSource.open(tmp_path / f"sheet.{ending}") as source:
        (said,) = (note.text for note in source.notes if "sheet" in note.text)
        assert "a map sheet: its margin, 44.9 % of it, is not searched" in said
        below = source.read(60, 580, 700, 180, 350, 90)
        assert (below == NO_DATA_GREY).all()
        across = source.read(60, 500, 700, 100, 700, 100)  # 60 px of ground, 40 of margin
        assert across[:60].std() > 5 and (across[63:] == NO_DATA_GREY).all()
        source.write(tmp_path / "copy.tif", 0.1)
    with rasterio.open(tmp_path / "copy.tif") as copy, rasterio.open(tmp_path / f"sheet.{ending}") as original:
        assert np.array_equal(copy.read(), original.read())


@pytest.mark.slow
def test_a_town_on_a_sheet_has_the_scale_that_it_has_alone(tmp_path):
    """The letters, taken for vehicles, once gave another scale, up to seven times the true one."""
    town = cv2.imread(str(TOWN))[:1200, :1400]
    cv2.imwrite(str(tmp_path / "town.png"), town)
    cv2.imwrite(str(tmp_path / "sheet.png"), sheet_of(town))
    alone, printed = (orthoscale.estimate(tmp_path / f"{name}.png", fleet="DE").scale for name in ("town", "sheet"))
    assert printed.value == pytest.approx(alone.value, rel=0.01)
    assert printed.vehicles_used == pytest.approx(alone.vehicles_used, rel=0.1)
