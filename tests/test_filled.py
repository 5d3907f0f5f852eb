"""Mosaics that are mostly empty: the search, the sweep and the search for anchors look where there is something."""

import gc
import weakref

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.enums import Resampling
from support.drawings import Windows, WithoutNetwork

from orthoscale.anchors import kinds
from orthoscale.anchors.search import Sought, search
from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Tile
from orthoscale.detect.detector import Detector
from orthoscale.detect.effort import Effort
from orthoscale.detect.filled import Filled, filled
from orthoscale.detect.find import find_vehicles
from orthoscale.detect.tiles import tiles
from orthoscale.detect.zoom import ZOOM_LEVELS, sample, search_zoom
from orthoscale.sources.raster import RasterSource

WIDTH, HEIGHT = 12000, 9000  # of a mosaic of which one block was flown, 4 % of it [px]
BLOCK = (8000, 5000, 2080)  # left, top, side


class Mosaic(Windows):
    """A picture that shows noise in some blocks (left, top, side), and is grey elsewhere; it notes what is read."""

    name = "mosaic"

    def __init__(self, *blocks):
        super().__init__(WIDTH, HEIGHT)
        self.blocks, self.reads = blocks, []
        self.noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)

    def decoded_px(self, width, height, out_width, out_height):
        return float(width * height)

    def shown(self, x, y, width, height, out_width, out_height):
        self.reads.append((x, y, width, height))
        image = np.full((out_height, out_width, 3), 114, np.uint8)
        for left, top, side in self.blocks:
            if not (x - side < left < x + width and y - side < top < y + height):
                continue
            a, b = (
                int(max((at - start) * out / size, 0))
                for at, start, out, size in ((left, x, out_width, width), (top, y, out_height, height))
            )
            c, d = (
                int(max((at + side - start) * out / size, 0))
                for at, start, out, size in ((left, x, out_width, width), (top, y, out_height, height))
            )
            part = image[b:d, a:c]
            part[:] = np.resize(self.noise, part.shape)
        return image


class Cars(WithoutNetwork):
    """A detector that sees cars 45 px long all over a block."""

    sha256, sure, name = "", 0.0, "cars"

    def __init__(self, picture, count=150):
        left, top, side = picture.blocks[0]
        rng = np.random.default_rng(1)
        centre = rng.uniform(60, side - 60, (count, 2)) + (left, top)
        length = 45 * np.exp(rng.normal(0, 0.08, count))
        angle = rng.uniform(0, 3, count)
        self.boxes = Boxes(np.column_stack([centre, length, 0.42 * length, angle]), np.full(count, 0.6))
        self.picture, self.card = picture, Detector().card

    def __call__(self, image, threshold=None):
        x, y, zoom = self.picture.window_of(image)
        shown = self.boxes.mapped(zoom, (-x * zoom, -y * zoom))
        inside = ((shown.centre > 0) & (shown.centre < image.shape[1::-1])).all(1)
        return shown[inside & (shown.length > 10) & (shown.length < 80)]


def test_the_search_looks_where_a_mosaic_shows_anything():
    picture = Mosaic(BLOCK)
    detector = Cars(picture)
    filled(picture)
    picture.reads.clear()
    choice = search_zoom([picture], detector, detector.card)
    assert choice.vehicle_px == pytest.approx(45, rel=0.05) and choice.votes > 14
    left, top, side = BLOCK
    near = [
        left - 512 < x + w and x < left + side + 512 and top - 512 < y + h and y < top + side + 512
        for x, y, w, h in picture.reads
    ]
    assert all(near)
    centres = {zoom: {(t.x + t.width // 2, t.y + t.height // 2) for _, t in sample([picture], zoom)} for zoom in (2, 4)}
    assert centres[2] & centres[4], "neighbouring zooms look at the same places"


def test_all_that_a_mosaic_shows_is_looked_at_where_the_budget_reaches():
    """Decoding costs next to nothing here, so that all of the block does at its own size."""
    picture = Mosaic(BLOCK)
    picture.decoded_px = lambda *_: 0.0
    shown = [(0, tile) for tile in tiles(picture, 1.0) if filled(picture).share(tile)]
    assert sample([picture], 1.0) == shown and 9 <= len(shown) <= 20


def test_full_pictures_are_searched_as_ever(monkeypatch):
    picture = Mosaic((0, 0, WIDTH))
    looks = [sample([picture], zoom) for zoom in ZOOM_LEVELS]
    monkeypatch.setattr("orthoscale.detect.zoom.filled", lambda p: Filled(p.width, p.height))
    assert looks == [sample([picture], zoom) for zoom in ZOOM_LEVELS]
    assert filled(picture).cells is None and filled(picture).share(Tile(0, 0, 10, 10, 10, 10)) == 1


def test_frames_are_taken_for_full_without_a_look():
    class Frame:
        width, height = 4000, 3000

    assert filled(Frame()).cells is None


@pytest.mark.parametrize("how", ["alpha", "nodata", "sparse", "white", "overviews"])
def test_nothing_is_nothing_whatever_says_so(tmp_path, how):
    """Also a border that nobody declared."""
    side, block = 4096, slice(2560, 3584)
    rgb = np.full((3, side, side), 255 if how == "white" else 0, np.uint8)
    rgb[:, block, block] = np.random.default_rng(0).integers(1, 250, (3, 1024, 1024))
    file = tmp_path / "mosaic.tif"
    profile = {"driver": "GTiff", "width": side, "height": side, "dtype": "uint8", "compress": "deflate"}
    profile |= {"tiled": True, "count": 4 if how == "alpha" else 3, "sparse_ok": how == "sparse"}
    profile |= {"nodata": 0} if how == "nodata" else {}
    with rasterio.open(file, "w", **profile) as dataset:
        if how == "sparse":
            window = rasterio.windows.Window(2560, 2560, 1024, 1024)
            dataset.write(rgb[:, block, block], window=window)
        else:
            dataset.write(rgb, [1, 2, 3])
        if how == "alpha":
            dataset.write((rgb[0] > 0).astype(np.uint8) * 255, 4)
        if how == "overviews":
            dataset.build_overviews([2, 4, 8, 16], Resampling.average)
    with RasterSource.open(file) as source:
        found = filled(source)
        assert found.cells.shape == (16, 16)
        rows, columns = np.nonzero(found.cells)
        assert (rows.min(), rows.max(), columns.min(), columns.max()) == (9, 14, 9, 14), "with one cell around"
        assert found.at(0.75, 0.75) and not found.at(0.25, 0.75)
        assert found.share(Tile(2560, 2560, 1024, 1024, 9, 9)) == 1 and not found.share(Tile(0, 0, 999, 999, 9, 9))


def test_a_picture_is_let_go_when_nobody_needs_it(tmp_path):
    """With the file that it holds open, and its copy on the disk."""
    cv2.imwrite(str(tmp_path / "a.tif"), np.zeros((300, 300, 3), np.uint8))
    source = RasterSource.open(tmp_path / "a.tif")
    assert filled(source) is filled(source), "looked at once"
    left = weakref.ref(source)
    del source
    gc.collect()
    assert left() is None


def test_a_picture_that_shows_nothing_is_searched_as_a_whole():
    assert filled(Mosaic()).cells is None


@pytest.mark.parametrize("exhaustive", [False, True])
def test_the_sweep_leaves_out_tiles_that_show_nothing(exhaustive):
    picture = Mosaic(BLOCK)
    effort = Effort(workers=1, cache=False, exhaustive=exhaustive)
    detector = Cars(picture)
    found = find_vehicles([picture], detector, 1.0, effort=effort, sampling=lambda found: np.inf)
    assert len(found.boxes["mosaic"]) > 140
    assert found.swept.total == len(found.swept.tiles)
    assert (found.swept.total > 90) == exhaustive


def test_anchors_are_looked_for_where_there_is_something():
    picture = Mosaic(BLOCK)

    class Nowhere:
        kind, extent, finest, coarsest = "tennis court", 30.0, 0.05, 0.5
        looks = 0

        def find(self, image, *_):
            self.looks += 1
            return []

    finder = Nowhere()
    filled(picture)
    picture.reads.clear()
    assert kinds.chosen(["tennis-court"]) == [finder.kind]
    assert search([Sought(finder, [(picture, 0.1)])], 0.05, effort=Effort(cache=False)) == []
    assert finder.looks >= 9, "all of the block, however little of the picture may be looked at"
    assert len(picture.reads) < 60


def test_a_strip_is_not_lost_between_the_patches():
    """A corridor 300 px wide where cells are 1,024 px: much of it is found, and none of the other side."""
    picture = Mosaic(*((20000, top, 300) for top in range(0, 65536, 300)))
    picture.width = picture.height = 65536
    cells = filled(picture).cells
    assert cells[:, 18:21].any(1).mean() > 0.5 and not cells[:, 25:].any()
