"""The raster source: what it reads, what it believes, what it writes, and that it leaves its input alone."""

from __future__ import annotations

import errno
import hashlib
import http.server
import math
import os
import pickle
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import warnings
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from PIL import Image, ImageCms, PngImagePlugin
from PIL.ExifTags import IFD
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
from rasterio.rpc import RPC
from rasterio.shutil import copy as gdal_copy
from rasterio.transform import Affine

from orthoscale.core.remarks import CAUTION, Remark
from orthoscale.core.source import NO_DATA_GREY
from orthoscale.errors import InputError, OutputError, UsageError
from orthoscale.formats.degrees import to_degrees
from orthoscale.sources import gdal
from orthoscale.sources.fingerprint import Stamp
from orthoscale.sources.georeference import claim_of
from orthoscale.sources.opening import open_source
from orthoscale.sources.raster import RasterSource
from orthoscale.sources.raster_copy import Original
from orthoscale.system import scratch

W, H = 300, 200
UTM = {"crs": "EPSG:32632", "transform": Affine(0.1, 0, 500_000, 0, -0.1, 5_400_000)}


def scene(bands: int = 3, dtype: str = "uint8", high: int = 256) -> np.ndarray:
    """(bands, H, W) of smooth colour with some noise."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:H, :W]
    smooth = np.stack([(x * (b + 1) / W + y / H) / (bands + 1) for b in range(bands)])
    return ((smooth * 0.9 + rng.random((bands, H, W)) * 0.1) * (high - 1)).astype(dtype)


def make(path: Path, pixels: np.ndarray | None = None, prepare=None, **profile) -> Path:
    """A GeoTIFF of `pixels`; `prepare(dataset)` may set more before they are written."""
    pixels = scene() if pixels is None else pixels
    options = {"driver": "GTiff", "count": len(pixels), "dtype": pixels.dtype, "height": H, "width": W, **profile}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **options) as dataset:
            if prepare:
                prepare(dataset)
            dataset.write(pixels)
    return path


def converted(path: Path, driver: str, pixels: np.ndarray | None = None, **options) -> Path:
    plain = make(path.with_name("_plain.tif"), pixels)
    with rasterio.Env(GDAL_PAM_ENABLED=False):
        gdal_copy(plain, path, driver=driver, **options)
    plain.unlink()
    return path


def listing(folder: Path) -> dict[str, tuple[str, int]]:
    return {
        p.name: (hashlib.sha256(p.read_bytes()).hexdigest(), p.stat().st_mtime_ns) for p in sorted(folder.iterdir())
    }


# Reading


@pytest.mark.parametrize("driver, suffix", [("JPEG", "jpg"), ("PNG", "png"), ("JP2OpenJPEG", "jp2"), ("COG", "tif")])
def test_formats(tmp_path, driver, suffix):
    path = converted(tmp_path / f"a.{suffix}", driver)
    with RasterSource.open(path) as source:
        assert (source.width, source.height, source.name, source.unit) == (W, H, path.name, "m/px")
        assert source.pictures == [source] and source.notes == []
        image = source.read(0, 0, W, H, W, H)
    assert image.dtype == np.uint8 and image.shape == (H, W, 3) and image.flags.c_contiguous
    assert np.abs(np.moveaxis(scene(), 0, -1).astype(int) - image).mean() < 12  # JPEG loses that much in noise


def test_window_is_exact(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    assert np.array_equal(source.read(20, 30, 100, 50, 100, 50), np.moveaxis(scene()[:, 30:80, 20:120], 0, -1))


def test_shrinking_averages_and_enlarging_is_smooth(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    small = source.read(0, 0, W, H, W // 4, H // 4)
    mean = scene().reshape(3, H // 4, 4, W // 4, 4).mean((2, 4))
    assert np.abs(np.moveaxis(mean, 0, -1) - small).max() <= 1
    assert source.read(10, 10, 20, 20, 60, 60).shape == (60, 60, 3)


@pytest.mark.parametrize("window", [(-1, 0, 10, 10), (0, 195, 10, 10), (291, 0, 10, 10), (0, 0, 0, 10)])
def test_window_outside(tmp_path, window):
    with pytest.raises(ValueError, match="window"):
        RasterSource.open(make(tmp_path / "a.tif")).read(*window, 5, 5)


def test_grey(tmp_path):
    image = RasterSource.open(make(tmp_path / "a.tif", scene(1))).read(0, 0, W, H, W, H)
    assert np.array_equal(image, np.repeat(scene(1)[0][..., None], 3, 2))


def test_grey_with_alpha_shows_grey(tmp_path):
    def prepare(d):
        d.colorinterp = ColorInterp.gray, ColorInterp.alpha

    pixels = scene(2)
    pixels[1] = 255
    image = RasterSource.open(make(tmp_path / "a.tif", pixels, prepare)).read(0, 0, W, H, W, H)
    assert np.array_equal(image, np.repeat(pixels[0][..., None], 3, 2))


def test_four_bands_without_alpha_show_the_first_three(tmp_path):
    def prepare(d):
        d.colorinterp = ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.undefined

    pixels = scene(4)
    pixels[3, :, :100] = 0
    image = RasterSource.open(make(tmp_path / "a.tif", pixels, prepare)).read(0, 0, W, H, W, H)
    assert np.array_equal(image, np.moveaxis(pixels[:3], 0, -1))


def test_named_bands_are_found(tmp_path):
    def prepare(d):
        d.colorinterp = ColorInterp.blue, ColorInterp.green, ColorInterp.red

    image = RasterSource.open(make(tmp_path / "a.tif", prepare=prepare)).read(0, 0, W, H, W, H)
    assert np.array_equal(image, np.moveaxis(scene()[::-1], 0, -1))


def with_alpha(path: Path) -> Path:
    def prepare(d):
        d.colorinterp = ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha

    pixels = scene(4)
    pixels[3] = 255
    pixels[:, :, :100] = 0
    return make(path, pixels, prepare)


def with_nodata(path: Path) -> Path:
    pixels = np.maximum(scene(), 1)
    pixels[:, :, :100] = 0
    return make(path, pixels, nodata=0)


def with_mask(path: Path, internal: bool = True) -> Path:
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal):
        make(path)
        mask = np.full((H, W), 255, np.uint8)
        mask[:, :100] = 0
        with rasterio.open(path, "r+") as d:
            d.write_mask(mask)
    return path


def with_mask_file(path: Path) -> Path:
    with_mask(path, internal=False)
    assert Path(f"{path}.msk").exists()
    return path


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("build", [with_alpha, with_nodata, with_mask, with_mask_file])
def test_without_data_is_grey(tmp_path, build):
    source = RasterSource.open(build(tmp_path / "a.tif"))
    for size in ((W, H), (W // 2, H // 2), (2 * W, 2 * H)):
        image = source.read(0, 0, W, H, *size)
        edge = 100 * size[0] // W
        assert (image[:, : edge - 2] == NO_DATA_GREY).all()
        assert (image[:, edge + 2 :] != NO_DATA_GREY).any(-1).mean() > 0.9


@pytest.mark.parametrize("white", [255, 65535])
def test_white_roofs_are_no_holes_where_white_is_the_value_for_no_data(tmp_path, white):
    """The roofs of white cars were grey, and these were not found."""
    pixels = np.minimum(scene().astype(np.uint16), 250) * (white // 255)
    pixels[:, :, :100] = white
    bordered = pixels.astype(np.uint8 if white == 255 else np.uint16)
    source = RasterSource.open(make(tmp_path / "border.tif", bordered, nodata=white))
    assert (source.read(0, 0, 90, H, 90, H) == NO_DATA_GREY).all()
    roofs = [(x, y) for x in range(120, W - 20, 40) for y in range(10, H - 20, 30)]
    for x, y in roofs:
        bordered[:, y : y + 8, x : x + 16] = white
    source = RasterSource.open(make(tmp_path / "roofs.tif", bordered, nodata=white))
    assert any("is a colour of the picture too" in note.text for note in source.notes)
    for size in (1, 2):
        image = source.read(0, 0, W, H, W // size, H // size)
        for x, y in roofs:
            assert (image[(y + 2) // size : (y + 6) // size, (x + 2) // size : (x + 14) // size] >= 250).all()


def test_sixteen_bits_are_stretched(tmp_path):
    pixels = (scene(3, "uint16", 4000) + 500).astype("uint16")
    source = RasterSource.open(make(tmp_path / "a.tif", pixels))
    image = source.read(0, 0, W, H, W, H)
    assert image.min() == 0 and image.max() == 255 and 60 < image.mean() < 190
    assert "uint16 values from" in source.notes[0].text


@pytest.mark.parametrize("factor", [256, 257])
@pytest.mark.parametrize("dark", [30, 255])
def test_eight_bits_that_became_sixteen_are_shown_as_they_were(tmp_path, factor, dark):
    """Stretched, a copy of an orthophoto was measured 2.7 % off its original."""
    pixels = scene(high=dark)
    pixels[:, :, :40] = 0
    plain = RasterSource.open(make(tmp_path / "a.tif", pixels, nodata=0))
    copy = RasterSource.open(make(tmp_path / "b.tif", pixels.astype("uint16") * factor, nodata=0))
    assert f"8-bit values times {factor}" in copy.notes[0].text
    assert np.array_equal(copy.read(0, 0, W, H, W, H), plain.read(0, 0, W, H, W, H))
    half = [source.read(0, 0, W, H, W // 2, H // 2) for source in (copy, plain)]
    assert np.array_equal(*half)  # averages that end in a half, too


def test_few_values_of_other_sixteen_bits_are_stretched(tmp_path):
    """One in 256 is a multiple by chance."""
    pixels = scene(3, "uint16", 4000)
    pixels[:, ::2] = pixels[:, ::2] // 256 * 256
    source = RasterSource.open(make(tmp_path / "a.tif", pixels))
    assert "uint16 values from" in source.notes[0].text


def test_floats_with_nan(tmp_path):
    pixels = scene(3, "float32", 2)
    pixels[:, :50] = np.nan
    image = RasterSource.open(make(tmp_path / "a.tif", pixels)).read(0, 0, W, H, W, H)
    assert (image[:50] == NO_DATA_GREY).all() and image[50:].std() > 20


def test_constant_sixteen_bits(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif", np.full((1, H, W), 7, "uint16")))
    assert source.read(0, 0, W, H, W, H).std() == 0


def test_nothing_but_nodata(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif", np.zeros((3, H, W), "uint16"), nodata=0))
    assert (source.read(0, 0, W, H, W, H) == NO_DATA_GREY).all()


PALETTE = {0: (0, 0, 0, 0), 1: (255, 0, 0, 255), 2: (0, 0, 255, 255)}


def with_palette(path: Path) -> Path:
    index = np.full((1, H, W), 1, np.uint8)
    index[:, :, 1::2] = 2
    index[:, :100] = 0
    return make(path, index, lambda d: d.write_colormap(1, PALETTE), photometric="PALETTE", nodata=0)


@pytest.mark.parametrize("driver", ["GTiff", "PNG"])
def test_palette(tmp_path, driver):
    path = with_palette(tmp_path / "a.tif")
    if driver == "PNG":
        gdal_copy(path, path.with_suffix(".png"), driver="PNG")
        path = path.with_suffix(".png")
    source = RasterSource.open(path)
    image = source.read(0, 0, W, H, W, H)
    assert (image[:100] == NO_DATA_GREY).all()
    assert (image[100:, ::2] == (255, 0, 0)).all() and (image[100:, 1::2] == (0, 0, 255)).all()
    # Colours are averaged, not their numbers.
    assert np.allclose(source.read(0, 100, W, 100, W // 2, 50), (127.5, 0, 127.5), atol=1)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_parts_of_a_vrt_in_a_vrt_are_watched_and_protected(tmp_path):
    """GDAL names the inner VRT only: boxes in the cache were those of former pixels."""
    part = make(tmp_path / "a.tif", scene(3))
    outer = vrt(tmp_path / "outer.vrt", str(vrt(tmp_path / "inner.vrt", str(part))))
    with RasterSource.open(outer) as source:
        former = source.fingerprint()
        assert source.files == [outer, tmp_path / "inner.vrt", part]
        with rasterio.open(part, "r+") as file:
            file.write(255 - file.read())
        with pytest.raises(InputError, match=r"a\.tif was changed since it was opened"):
            source.content_hash()
    with RasterSource.open(outer) as source:
        assert source.fingerprint() != former


def test_vrt(tmp_path):
    tif = make(tmp_path / "a.tif", **UTM)
    gdal_copy(tif, tmp_path / "a.vrt", driver="VRT")
    source = RasterSource.open(tmp_path / "a.vrt")
    assert np.array_equal(source.read(0, 0, W, H, W, H), np.moveaxis(scene(), 0, -1))
    assert source.claimed.usable
    source.write(tmp_path / "out.tif", 0.07)
    tif.unlink()
    with pytest.raises(InputError, match="cannot be read") as caught:
        RasterSource.open(tmp_path / "a.vrt")
    assert "file that it refers to is missing" in caught.value.hint


@pytest.mark.parametrize("turned", [1, 6])
def test_a_picture_that_a_viewer_turns_says_whose_pixels_count(tmp_path, turned):
    exif = Image.Exif()
    exif[0x0112] = turned
    Image.fromarray(np.moveaxis(scene(), 0, -1)).save(tmp_path / "a.jpg", exif=exif)
    notes = [str(note) for note in RasterSource.open(tmp_path / "a.jpg").notes if "EXIF orientation" in str(note)]
    assert len(notes) == (turned == 6)


@pytest.mark.parametrize("suffix, told", [("jpg", True), ("tif", False)])
def test_a_photo_that_is_taken_for_an_orthophoto_says_what_measures_photos(tmp_path, suffix, told):
    """A folder of a drone's frames gave 18 refusals, none of which said that they were frames."""
    path = tmp_path / f"a.{suffix}"
    if suffix == "jpg":
        exif = Image.Exif()
        exif.get_ifd(IFD.Exif)[0xA405] = 20
        Image.fromarray(np.moveaxis(scene(), 0, -1)).save(path, exif=exif)
    else:
        make(path, **UTM)
        with rasterio.open(path, "r+") as file:
            file.update_tags(EXIF_FocalLength="(3.61)")
    cautions = [note for note in RasterSource.open(path).notes if "orthoscale photo" in note.text]
    assert [note.severity for note in cautions] == ["caution"] * told


def test_another_thread_may_read(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif", tiled=True, blockxsize=64, blockysize=64))
    wanted, got = source.read(0, 0, W, H, W, H), []
    threads = [threading.Thread(target=lambda: got.append(source.read(0, 0, W, H, W, H))) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(got) == 4 and all(np.array_equal(wanted, g) for g in got)


def test_content_hash(tmp_path):
    path = make(tmp_path / "a.tif")
    assert RasterSource.open(path).content_hash() == hashlib.sha256(path.read_bytes()).hexdigest()


def replaced(path: Path) -> None:
    """Put other pixels in the place of `path`, of the same size."""
    path.unlink()
    make(path, 255 - scene())


def test_no_work_on_an_image_is_cached_that_was_changed_since_it_was_opened(tmp_path):
    """It still shows the former pixels, under whatever name they are kept."""
    source = RasterSource.open(make(tmp_path / "a.tif"))
    former = source.fingerprint()
    replaced(source.path)
    with pytest.raises(InputError, match=r"a\.tif was changed since it was opened"):
        source.fingerprint()
    assert RasterSource.open(source.path).fingerprint() != former


def test_an_image_that_was_changed_since_it_was_opened_is_neither_hashed_nor_copied(tmp_path):
    """Its hash would be that of what nobody looked at."""
    (folder := tmp_path / "out").mkdir()
    source = RasterSource.open(make(tmp_path / "a.tif"))
    replaced(source.path)
    with pytest.raises(InputError, match=r"a\.tif was changed since it was opened"):
        source.content_hash()
    with pytest.raises(InputError, match=r"a\.tif was changed since it was opened"):
        source.write(folder / "b.tif", 0.1)


def test_an_image_that_is_changed_while_it_is_copied_is_said(tmp_path, monkeypatch):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    write = Original.write

    def meanwhile(self, *args):
        write(self, *args)
        os.utime(self.path, (0, 0))

    monkeypatch.setattr(Original, "write", meanwhile)
    with pytest.raises(InputError, match=r"a\.tif was changed since it was opened"):
        source.write(tmp_path / "b.tif", 0.1)


def test_a_worker_shows_what_its_sender_opened(tmp_path):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    sent = pickle.dumps(source)
    former = pickle.loads(sent).read(0, 0, W, H, W, H)
    replaced(source.path)
    again = RasterSource.open(source.path)
    there = pickle.loads(pickle.dumps(again))
    assert np.array_equal(there.read(0, 0, W, H, W, H), again.read(0, 0, W, H, W, H))
    assert not np.array_equal(there.read(0, 0, W, H, W, H), former)


def test_a_worker_refuses_another_image_than_its_sender_opened(tmp_path):
    sent = pickle.dumps(RasterSource.open(make(tmp_path / "a.tif")))
    os.utime(tmp_path / "a.tif", (0, 0))
    with pytest.raises(InputError, match=r"a\.tif differs here"):
        pickle.loads(sent)


# Bad inputs


def missing(folder):
    return folder / "none.tif"


def a_folder(folder):
    return folder


def empty(folder):
    (folder / "a.tif").touch()
    return folder / "a.tif"


def text(folder):
    (folder / "a.tif").write_text("This is not an image.\n" * 50)
    return folder / "a.tif"


def random_bytes(folder):
    (folder / "a.jpg").write_bytes(np.random.default_rng(0).bytes(10_000))
    return folder / "a.jpg"


def tiny(folder):
    return make(folder / "a.tif", np.zeros((3, 8, 8), "uint8"), width=8, height=8)


def complex_numbers(folder):
    return make(folder / "a.tif", scene(1).astype("complex64"))


def complex_integers(folder):
    """As radar has them. They gave the exit code of a bug, as NumPy does not know them."""
    return make(folder / "a.tif", scene(1).astype("int16"), dtype="complex_int16")


def only_alpha(folder):
    def prepare(d):
        d.colorinterp = (ColorInterp.alpha,)

    return make(folder / "a.tif", scene(1), prepare)


def truncated(path: Path, part: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    return path


@pytest.mark.parametrize(
    "build, says",
    [
        (missing, "does not exist"),
        (a_folder, "is a folder"),
        (empty, "is empty"),
        (text, "not an image"),
        (random_bytes, "not an image"),
        (tiny, "8 x 8 px"),
        (complex_numbers, "complex64"),
        (complex_integers, "complex_int16"),
        (only_alpha, "alpha"),
        (lambda d: truncated(make(d / "a.tif"), 0.98), "truncated"),
        (lambda d: truncated(make(d / "a.tif", tiled=True, blockxsize=64, blockysize=64), 0.6), "truncated"),
        (lambda d: truncated(make(d / "a.tif", interleave="band", compress="deflate"), 0.9), "truncated"),
        (lambda d: truncated(converted(d / "a.tif", "COG"), 0.9), "truncated"),
        (lambda d: truncated(converted(d / "a.tif", "COG"), 0.01), "truncated"),
        (lambda d: truncated(converted(d / "a.tif", "COG"), 0.0001), "not an image"),
        (lambda d: truncated(converted(d / "a.jpg", "JPEG"), 0.9), "damaged"),
        (lambda d: truncated(converted(d / "a.png", "PNG"), 0.9), "damaged"),
        (lambda d: truncated(converted(d / "a.jp2", "JP2OpenJPEG"), 0.5), "damaged"),
    ],
)
def test_bad_inputs(tmp_path, build, says):
    path = build(tmp_path)
    with pytest.raises(InputError, match=says) as caught:
        RasterSource.open(path)
    assert str(path) in caught.value.message and caught.value.hint and caught.value.exit_code == 5


@pytest.mark.parametrize(
    "build, wanted, unwanted",
    [
        (lambda d: truncated(converted(d / "a.jpg", "JPEG"), 0.9), "Premature end", "turned as a warning"),
        (text, "(not recognized as being in a supported file format)", "'"),
    ],
)
def test_a_reason_is_told_without_advice_to_programmers_and_the_name_again(tmp_path, build, wanted, unwanted):
    with pytest.raises(InputError) as caught:
        RasterSource.open(build(tmp_path))
    assert wanted in caught.value.message and unwanted not in caught.value.message


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux alone")
def test_a_name_that_is_not_utf_8_is_to_be_changed(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff.png")
    converted(tmp_path / "a.png", "PNG").rename(path)
    with pytest.raises(InputError, match="UTF-8") as caught:
        RasterSource.open(path)
    assert caught.value.hint == "Rename it."


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux alone")
def test_a_folder_that_is_not_utf_8_is_refused_before_measuring(tmp_path, monkeypatch):
    """A copy there failed when it was written: its temporary name is an absolute one."""
    (folder := tmp_path / os.fsdecode(b"\xff")).mkdir()
    monkeypatch.chdir(folder)
    with pytest.raises(UsageError, match="a.tif: GDAL takes names in UTF-8 only, of files and of folders"):
        RasterSource.check_name(Path("a.tif"))


def test_names_of_a_system_that_is_not_in_utf_8(tmp_path, monkeypatch):
    """In ISO-8859-1 GDAL does not find what Python does: it said that the file, or space, was missing."""
    monkeypatch.setattr(os, "fsencode", lambda path: str(path).encode("latin-1"))
    RasterSource.check_name(tmp_path / "massstab.tif")
    with pytest.raises(UsageError, match="UTF-8"):
        RasterSource.check_name(tmp_path / "maßstab.tif")
    (tmp_path / "maßstab.png").write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match="UTF-8"):
        RasterSource.open(tmp_path / "maßstab.png")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_damage_in_the_middle_is_found_when_reading_and_when_writing(tmp_path):
    path = make(tmp_path / "a.tif", compress="deflate", tiled=True, blockxsize=16, blockysize=16)
    with rasterio.open(path) as d:
        offset = int(d.get_tag_item("BLOCK_OFFSET_5_5", "TIFF", bidx=1))
    data = bytearray(path.read_bytes())
    data[offset : offset + 400] = b"\xff" * 400
    path.write_bytes(data)
    source = RasterSource.open(path)
    source.read(0, 0, W, 50, W, 50)
    with pytest.raises(InputError, match="damaged at x 0..300, y 0..200"):
        source.read(0, 0, W, H, W, H)
    with pytest.raises(InputError, match="damaged"):
        source.write(tmp_path / "out.tif", 0.1)


# What the georeferencing claims


@pytest.mark.parametrize(
    "crs, transform, gsd",
    [
        # UTM at its central meridian is 0.9996 of true.
        ("EPSG:32632", Affine(0.1, 0, 500_000, 0, -0.1, 5_400_000), 0.1 / 0.9996),
        # The same, rotated by 37 degrees.
        ("EPSG:32632", Affine(0.08, 0.06, 500_000, 0.06, -0.08, 5_400_000), 0.1 / 0.9996),
        # Web Mercator at 60 degrees north: twice too large (the sphere against the ellipsoid: 0.3 % more or less).
        ("EPSG:3857", Affine(0.2, 0, 1_000_000, 0, -0.2, 8_399_737.9), 0.1),
        # Ellipsoidal Mercator at 60 degrees north.
        ("EPSG:3395", Affine(0.2, 0, 1_000_000, 0, -0.2, 8_362_698.5), 0.1),
        # State plane in US survey feet (Ohio North).
        ("EPSG:3734", Affine(0.5, 0, 2_000_000, 0, -0.5, 600_000), 0.5 * 1200 / 3937),
        # An equal-area projection near its edge, Portugal: its pixels lean by 2 degrees.
        ("EPSG:3035", Affine(0.1, 0, 2_700_000, 0, -0.1, 1_700_000), 0.1),
        # Degrees on the equator: 111.32 km by 110.57 km.
        ("EPSG:4326", Affine(1e-6, 0, 10, 0, -1e-6, 0.0001), 0.1109),
    ],
)
def test_usable_claims(tmp_path, crs, transform, gsd):
    claim = RasterSource.open(make(tmp_path / "a.tif", crs=crs, transform=transform)).claimed
    assert claim.usable and claim.gsd_m == pytest.approx(gsd, rel=4e-3 if "32632" not in crs else 1e-5), claim.why


def test_a_claim_is_that_of_the_middle(tmp_path):
    """Of 300 x 200 km of Scandinavia in Web Mercator, which is 4 % larger at its upper edge than at its lower one."""
    path = make(tmp_path / "a.tif", crs="EPSG:3857", transform=Affine(1000, 0, 1_000_000, 0, -1000, 8_400_000))
    lon, lat = to_degrees("EPSG:3857").transform(1_000_000 + 500 * W, 8_400_000 - 500 * H)
    stretch = pyproj.Proj("EPSG:3857").get_factors(lon, lat).areal_scale
    assert RasterSource.open(path).claimed.gsd_m == pytest.approx(1000 / math.sqrt(stretch), rel=2.5e-3)


def test_a_unit_is_said_where_it_is_none_of_the_ground(tmp_path):
    utm, feet = (
        RasterSource.open(make(tmp_path / f"{crs[-4:]}.tif", crs=crs, transform=Affine(0.5, 0, east, 0, -0.5, north)))
        for crs, east, north in (("EPSG:32632", 500_000, 5_400_000), ("EPSG:3734", 2_000_000, 600_000))
    )
    assert "per pixel" not in utm.claimed.why and not utm.claimed.mistakes
    assert "0.5 US survey foot per pixel there" in feet.claimed.why and not feet.claimed.mistakes


def test_pixels_that_are_not_square_on_the_ground(tmp_path):
    path = make(tmp_path / "a.tif", crs="EPSG:4326", transform=Affine(1e-6, 0, 10, 0, -1e-6, 60))
    claim = RasterSource.open(path).claimed
    assert claim.usable and "wide" in claim.why
    assert claim.gsd_m == pytest.approx(math.sqrt(0.0558 * 0.1114), rel=1e-3)


@pytest.mark.parametrize(
    "latitude, wide, high, severity", [(60, 0.0558, 0.1114, "caution"), (15, 0.1075, 0.1106, "info")]
)
@pytest.mark.parametrize("rows", [-1, 1])
def test_a_copy_in_metres_has_pixels_of_the_shape_that_they_have_on_the_ground(
    tmp_path, latitude, wide, high, severity, rows
):
    """Square ones would make a town at 60 degrees twice as wide as it is."""
    path = make(tmp_path / "a.tif", crs="EPSG:4326", transform=Affine(1e-6, 0, 10, 0, rows * 1e-6, latitude))
    source = RasterSource.open(path)
    (note,) = source.notes
    assert note.severity == severity and f"{wide / high:.2g}" in note.text
    source.write(tmp_path / "b.tif", 2 * source.claimed.gsd_m)
    with rasterio.open(tmp_path / "b.tif") as copy:
        t = copy.transform
        assert (t.a, t.e, t.b, t.d) == (
            pytest.approx(2 * wide, rel=2e-3),
            pytest.approx(2 * rows * high, rel=2e-3),
            0,
            0,
        )
        assert (t.c, min(t.f, (t * (0, H))[1])) == (0, pytest.approx(0, abs=1e-9)), "origin at the lower left"
    again = RasterSource.open(tmp_path / "b.tif").claimed
    assert again.aspect == pytest.approx(wide / high, rel=2e-3) and not again.usable
    assert again.gsd_m == pytest.approx(2 * source.claimed.gsd_m)


@pytest.mark.parametrize(
    "profile, says",
    [
        ({}, "not georeferenced"),
        ({"crs": "EPSG:32630", "transform": Affine(0.1, 0, 0, 0, -0.1, 0)}, "placeholder"),
        ({"crs": "EPSG:32630"}, "not georeferenced"),
        ({"crs": "EPSG:32630", "transform": Affine(1, 0, 0, 0, -1, 0)}, "not georeferenced"),
        ({"crs": "EPSG:32630", "transform": Affine(1, 0, 0, 0, -1, H)}, "not georeferenced"),
        ({"transform": Affine(0.1, 0, 5, 0, -0.1, 7)}, "no coordinate reference system; pixels are square"),
        ({"transform": Affine(0.2, 0, 5, 0, -0.1, 7)}, "2 times as wide"),
        ({"crs": "EPSG:4326", "transform": Affine(0.1, 0, 5, 0, -0.1, 700)}, "Earth"),
        ({"crs": "ESRI:54009", "transform": Affine(0.1, 0, 6_700_000, 0, -0.1, 6_900_000)}, "rows and columns meet at"),
        ({"crs": "EPSG:4326", "transform": Affine(1e-6, 1e-6, 5, 1e-6, -1e-6, 60)}, "meet at 53 degrees on the ground"),
        ({"crs": 'LOCAL_CS["arbitrary",UNIT["metre",1]]', "transform": Affine(0.1, 0, 5, 0, -0.1, 7)}, "local"),
    ],
)
def test_unusable_claims(tmp_path, profile, says):
    claim = RasterSource.open(make(tmp_path / "a.tif", **profile)).claimed
    assert not claim.usable and says in claim.why


def test_local_feet_are_told_in_metres(tmp_path):
    crs = 'LOCAL_CS["site",UNIT["foot",0.3048]]'
    claim = RasterSource.open(make(tmp_path / "a.tif", crs=crs, transform=Affine(1, 0, 5, 0, -1, 7))).claimed
    assert claim.gsd_m == pytest.approx(0.3048) and not claim.usable


@pytest.mark.parametrize("world", ["\ufeff0.1\n0\n0\n-0.1\n5e5\n5e6\n", "0.1 0 0 -0.1 5e5 5e6\n", "0.1\n0\n0\n-0.1\n"])
def test_a_world_file_that_gdal_leaves_aside_is_told(tmp_path, world):
    """As an editor saves it, with a byte order mark; or as one line."""
    path = converted(tmp_path / "a.jpg", "JPEG")
    (tmp_path / "a.jgw").write_text(world)
    source = RasterSource.open(path)
    assert source.claimed.why == "not georeferenced: GDAL does not understand a.jgw beside it"
    assert Remark(CAUTION, source.claimed.why) in source.notes


PAM = "<PAMDataset><SRS>EPSG:32632</SRS><GeoTransform>5e5, .1, 0, 5.4e6, 0, -.1</GeoTransform></PAMDataset>"


@pytest.mark.parametrize("content", [PAM[:-9], "", "\0", '<?xml version="1.0" encoding="x"?><PAMDataset/>'])
def test_a_damaged_sidecar_is_told(tmp_path, content):
    path = converted(tmp_path / "a.jpg", "JPEG")
    (tmp_path / "a.jpg.aux.xml").write_text(content)
    why = "not georeferenced: GDAL does not understand a.jpg.aux.xml"
    assert RasterSource.open(path).claimed.why == f"{why} beside it"
    (tmp_path / "a.jgw").write_text("0.1 0 0 -0.1 5e5 5e6\n")
    assert RasterSource.open(path).claimed.why == f"{why} and a.jgw beside it"
    (tmp_path / "a.jgw").write_text("0.1\n0\n0\n-0.1\n500000\n5400000\n")  # QGIS writes the system into the sidecar
    source = RasterSource.open(path)
    assert ", and GDAL does not understand a.jpg.aux.xml beside it; pixels" in source.claimed.why
    assert Remark(CAUTION, source.claimed.why) in source.notes


def test_a_sidecar_of_statistics_is_not_told(tmp_path):
    (tmp_path / "a.tif.aux.xml").write_text("<PAMDataset><Metadata/></PAMDataset>")
    source = RasterSource.open(make(tmp_path / "a.tif"))
    assert source.claimed.why == "not georeferenced" and not source.notes


def test_world_file_alone(tmp_path):
    path = converted(tmp_path / "a.jpg", "JPEG")
    (tmp_path / "a.jgw").write_text("0.1\n0\n0\n-0.1\n500000\n5400000\n")
    claim = RasterSource.open(path).claimed
    assert not claim.usable and "a.jgw" in claim.why


def with_control_points(path: Path, corners=((0, 0), (0, W), (H, 0), (H, W)), west=10.0, epsg=4326) -> Path:
    make(path)
    there = pyproj.Transformer.from_crs(4326, epsg, always_xy=True)
    places = [there.transform((west + c * 1e-6 + 180) % 360 - 180, 50 - r * 1e-6) for r, c in corners]
    with rasterio.open(path, "r+") as d:
        points = [GroundControlPoint(r, c, x, y, 0) for (r, c), (x, y) in zip(corners, places, strict=True)]
        d.gcps = points, CRS.from_epsg(epsg)
    return path


@pytest.mark.parametrize("world", ["2 4 1 2 5 5", "1e200 0 0 -1e200 5 5"])
def test_pixels_without_an_area_or_with_an_endless_one_are_no_claim(tmp_path, world):
    path = make(tmp_path / "a.tif")
    path.with_suffix(".tfw").write_text("\n".join(world.split()))
    claimed = RasterSource.open(path).claimed
    assert (claimed.gsd_m, claimed.usable, claimed.why) == (None, False, "a geotransform without area")


@pytest.mark.parametrize("kind", ["geotransform", "control points"])
def test_a_reference_system_that_nobody_understands_is_no_claim(tmp_path, monkeypatch, kind):
    def refuse(crs):
        raise pyproj.exceptions.CRSError("a future one")

    path = tmp_path / "a.tif"
    if kind == "geotransform":
        make(path, crs="EPSG:32632", transform=Affine(0.1, 0, 5e5, 0, -0.1, 5e6))
    else:
        with_control_points(path)
    monkeypatch.setattr(pyproj.CRS, "from_user_input", refuse)
    with rasterio.open(path) as dataset:
        claim = claim_of(dataset)
    assert not claim.usable and claim.gsd_m is None and "not understood (a future one)" in claim.why


def test_pixels_without_size_are_no_claim(tmp_path):
    make(tmp_path / "a.tif", crs="EPSG:32632", transform=Affine(1e-30, 0, 5e5, 0, -1e-30, 5e6))
    with rasterio.open(tmp_path / "a.tif") as dataset:
        claim = claim_of(dataset)
    assert not claim.usable and "without size" in claim.why


ESRI_WKT = (
    'PROJCS["NAD_1983_StatePlane_California_III_FIPS_0403_Feet",GEOGCS["GCS_North_American_1983",'
    'DATUM["D_North_American_1983",SPHEROID["GRS_1980",6378137.0,298.257222101]],PRIMEM["Greenwich",0.0],'
    'UNIT["Degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic"],'
    'PARAMETER["False_Easting",6561666.666666666],PARAMETER["False_Northing",1640416.666666667],'
    'PARAMETER["Central_Meridian",-120.5],PARAMETER["Standard_Parallel_1",37.06666666666667],'
    'PARAMETER["Standard_Parallel_2",38.43333333333333],PARAMETER["Latitude_Of_Origin",36.5],'
    'UNIT["Foot_US",0.3048006096012192]]'
)


@pytest.mark.parametrize("name, world, projection", [("a.tif", "a.tfw", "a.prj"), ("a.jpg", "a.jgw", "a.PRJ")])
def test_a_world_file_has_the_reference_system_of_the_prj_beside_it(tmp_path, name, world, projection):
    make(tmp_path / name) if name == "a.tif" else converted(tmp_path / name, "JPEG")
    (tmp_path / world).write_text("0.3\n0\n0\n-0.3\n6000000\n2100000\n")
    (tmp_path / projection).write_text("\ufeff" + ESRI_WKT)
    with RasterSource.open(tmp_path / name) as source:
        claim = source.claimed
        assert claim.usable and math.isclose(claim.gsd_m, 0.3 * 0.3048006, rel_tol=1e-3)
        assert f"NAD83 / California zone 3 (ftUS) ({projection})" in claim.why and source.metric_already
        assert tmp_path / projection in source.files
        source.write(tmp_path / "b.tif", 0.1, source.place(0.1, keep_origin=True))
    with rasterio.open(tmp_path / "b.tif") as copy:
        assert copy.crs.to_epsg() == 2227


@pytest.mark.parametrize("content", [b"", b"PROJCS[", bytes(range(256)), b"Projection UTM\nZone 32\n"])
def test_a_prj_that_is_damaged_is_said(tmp_path, content):
    make(tmp_path / "a.tif")
    (tmp_path / "a.tfw").write_text("0.3\n0\n0\n-0.3\n6000000\n2100000\n")
    (tmp_path / "a.prj").write_bytes(content)
    with RasterSource.open(tmp_path / "a.tif") as source:
        claim = source.claimed
    assert not claim.usable and not claim.unit_known and "GDAL does not understand a.prj beside it" in claim.why
    assert Remark(CAUTION, claim.why) in source.notes


def test_a_prj_is_looked_for_once(tmp_path, monkeypatch):
    is_file, asked = Path.is_file, []

    def counted(path):
        asked.append(path.name)
        return is_file(path)

    path = make(tmp_path / "a.tif", transform=UTM["transform"])
    monkeypatch.setattr(Path, "is_file", counted)
    RasterSource.open(path).close()
    assert asked.count("a.prj") == 1


def test_a_prj_does_not_replace_a_reference_system_of_the_picture(tmp_path):
    make(tmp_path / "a.tif", **UTM)
    (tmp_path / "a.prj").write_text(ESRI_WKT)
    with RasterSource.open(tmp_path / "a.tif") as source:
        assert "UTM zone 32N" in source.claimed.why and tmp_path / "a.prj" not in source.files


def with_rational_polynomials(path: Path) -> Path:
    make(path)
    terms = dict.fromkeys(("line_den_coeff", "line_num_coeff", "samp_den_coeff", "samp_num_coeff"), [1.0] * 20)
    names = [f"{n}_{k}" for n in ("height", "lat", "line", "long", "samp") for k in ("off", "scale")]
    with rasterio.open(path, "r+") as d:
        d.rpcs = RPC(**terms, **dict.fromkeys(names, 1.0), err_bias=None, err_rand=None)
    return path


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(
    "build, says",
    [
        (with_rational_polynomials, "rational"),
        (lambda p: with_control_points(p, corners=((0, 0), (0, W))), "only 2 ground control points"),
        (lambda p: with_control_points(p, corners=((0, 0), (0, 100), (0, W))), "span no area"),
    ],
)
def test_polynomials_and_too_few_control_points_are_named(tmp_path, build, says):
    claim = RasterSource.open(build(tmp_path / "a.tif")).claimed
    assert not claim.usable and says in claim.why


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("west", [10.0, 179.9999])  # of these some lie beyond the 180th meridian
@pytest.mark.parametrize("epsg", [4326, 3857])
def test_control_points_give_a_scale(tmp_path, west, epsg):
    claim = RasterSource.open(with_control_points(tmp_path / "a.tif", west=west, epsg=epsg)).claimed
    assert claim.usable and "4 ground control points" in claim.why
    assert claim.gsd_m == pytest.approx(math.sqrt(0.0717 * 0.1112), rel=2e-3)  # a millionth of a degree at 50 N


@pytest.mark.parametrize(
    "name, content, says",
    [
        ("a.tfw", "0.1\n0\n0\n-0.1\n500000\n5400000\n", ""),
        ("a.tfw", "0.5\n0\n0\n-0.5\n500000\n5400000\n", "as GDAL and QGIS do, but a.tfw says 0.5002 m/px"),
        (
            "a.tif.aux.xml",
            PAM.replace(".1", ".3"),
            "0.3001 m/px is taken for its claim, as GDAL and QGIS do, but a.tif itself says 0.1 m/px",
        ),
    ],
)
def test_what_lies_beside_a_picture_and_contradicts_it_is_said(tmp_path, name, content, says):
    make(tmp_path / "a.tif", **UTM)
    (tmp_path / name).write_text(content)
    with RasterSource.open(tmp_path / "a.tif") as source:
        told = " ".join(note.text for note in source.notes)
    assert says in told and bool(told) == bool(says)


# Writing


def tagged(path: Path) -> Path:
    def prepare(d):
        d.update_tags(MISSION="12", AREA_OR_POINT="Point")
        d.update_tags(1, STATE="wet")
        d.descriptions = "r", "g", "b"

    return make(path, prepare=prepare, **UTM)


def with_overview_file(path: Path) -> Path:
    make(path, **UTM)
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open(path, "r+") as d:
        d.build_overviews([2, 4], Resampling.average)
    assert Path(f"{path}.ovr").exists()
    return path


def with_pam(path: Path) -> Path:
    """Georeferencing and nodata live in .aux.xml only, as for a JPEG that QGIS has georeferenced."""
    make(path)
    Path(f"{path}.aux.xml").write_text(
        "<PAMDataset><SRS>EPSG:32632</SRS><GeoTransform>500000, .1, 0, 5400000, 0, -.1</GeoTransform>"
        + "".join(f'<PAMRasterBand band="{b}"><NoDataValue>0</NoDataValue></PAMRasterBand>' for b in (1, 2, 3))
        + "</PAMDataset>"
    )
    return path


def with_stale_world_file(path: Path) -> Path:
    path.with_suffix(".tfw").write_text("9\n0\n0\n-9\n1\n1\n")
    return make(path, **UTM)


WRITABLE = {
    "plain": lambda p: make(p, **UTM),
    "tagged": tagged,
    "big endian": lambda p: make(p, ENDIANNESS="BIG", **UTM),
    "JPEG in TIFF": lambda p: make(
        p, compress="jpeg", photometric="YCBCR", tiled=True, blockxsize=64, blockysize=64, **UTM
    ),
    "planar": lambda p: make(p, interleave="band", compress="lzw", predictor=2, **UTM),
    "BigTIFF": lambda p: make(p, BIGTIFF="YES", **UTM),
    "COG": lambda p: converted(p, "COG", blocksize=128, overview_count=2),
    "16 bit": lambda p: make(p, scene(5, "uint16", 4000), **UTM),
    "float with NaN": lambda p: make(p, np.where(scene(1, "float32", 2) > 0.5, np.nan, 1).astype("float32"), **UTM),
    "alpha": with_alpha,
    "nodata": with_nodata,
    "mask": with_mask,
    "mask file": with_mask_file,
    "overview file": with_overview_file,
    "palette": with_palette,
    "CMYK": lambda p: make(p, scene(4), photometric="CMYK", **UTM),
    "aux.xml": with_pam,
    "stale world file": with_stale_world_file,
    "GCP": with_control_points,
    "RPC": with_rational_polynomials,
    "JPEG": lambda p: converted(p.with_suffix(".jpg"), "JPEG"),
    "PNG": lambda p: converted(p.with_suffix(".png"), "PNG"),
    "PNG with alpha": lambda p: converted(p.with_suffix(".png"), "PNG", scene(4)),
    "PNG, 16 bit": lambda p: converted(p.with_suffix(".png"), "PNG", scene(3, "uint16", 60_000)),
    "PNG, grey": lambda p: converted(p.with_suffix(".png"), "PNG", scene(1)),
    "JPEG 2000": lambda p: converted(p.with_suffix(".jp2"), "JP2OpenJPEG"),
}


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("build", WRITABLE.values(), ids=WRITABLE)
def test_written_copy_is_the_same_picture_in_metres(tmp_path, build):
    (folder := tmp_path / "in").mkdir()
    path = build(folder / "a.tif")
    before = listing(folder)
    (target := tmp_path / "out").mkdir()
    with RasterSource.open(path) as source:
        source.read(0, 0, W, H, W // 2, H // 2)
        source.write(target / "b.tif", 0.123)
        usable, shape = source.claimed.usable, math.sqrt(source.claimed.aspect)
        assert any("local metres" in n for n in map(str, source.notes))
        assert any("--keep-origin" in n for n in map(str, source.notes)) == usable
    assert listing(folder) == before, "the input's folder was touched"
    assert [p.name for p in target.iterdir()] == ["b.tif"]
    with rasterio.open(path) as a, rasterio.open(target / "b.tif") as b:
        assert b.driver == "GTiff"
        assert np.array_equal(a.read(), b.read(), equal_nan=a.dtypes[0] == "float32")
        assert np.array_equal(a.dataset_mask(), b.dataset_mask())
        assert a.mask_flag_enums == b.mask_flag_enums
        assert (a.dtypes, a.colorinterp, a.descriptions, a.nodata) == (
            b.dtypes,
            b.colorinterp,
            b.descriptions,
            b.nodata,
        )
        assert a.overviews(1) == b.overviews(1)
        assert not b.gcps[0] and not b.rpcs
        assert np.allclose(b.transform, Affine(0.123 * shape, 0, 0, 0, -0.123 / shape, 0.123 / shape * H))
        assert b.crs.units_factor == ("metre", 1.0) and not b.crs.is_projected and not b.crs.is_geographic
        tags = a.tags()
        assert tags.items() <= b.tags().items() and a.tags(1).items() <= b.tags(1).items()
        if a.colorinterp[0] == ColorInterp.palette:
            assert [a.colormap(1)[k] for k in range(3)] == [b.colormap(1)[k] for k in range(3)]


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("driver, suffix, kind", [("HFA", "img", 0), ("ENVI", "dat", 0), ("NITF", "ntf", 1)])
@pytest.mark.parametrize("bands", [1, 3])
def test_a_format_that_does_not_name_colours_is_copied(tmp_path, driver, suffix, kind, bands):
    """All bands are undefined, or all grey, as those of `gdalbuildvrt -separate`: a TIFF has one grey one at most."""
    pixels = scene(bands)
    path = make(tmp_path / f"a.{suffix}", pixels, driver=driver)
    with rasterio.open(path) as d:
        assert set(d.colorinterp) == {ColorInterp(kind)}
    with RasterSource.open(path) as source:
        source.write(tmp_path / "b.tif", 0.1)
    with rasterio.open(tmp_path / "b.tif") as d:
        assert np.array_equal(d.read(), pixels)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_a_profile_of_colours_comes_along(tmp_path, ending, cog):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(np.moveaxis(scene(), 0, -1)).save(tmp_path / f"a.{ending}", icc_profile=profile)
    with RasterSource.open(tmp_path / f"a.{ending}") as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    assert Image.open(tmp_path / "b.tif").info["icc_profile"] == profile


XMP = """<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF
xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" dc:rights="ours = yours"
xmlns:dc="http://purl.org/dc/elements/1.1/"/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>"""


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_whose_a_picture_is_stays_with_it(tmp_path, ending, cog):
    path = tmp_path / f"a.{ending}"
    image = Image.fromarray(np.moveaxis(scene(), 0, -1))
    if ending == "png":  # XMP is a text of that name there
        said = PngImagePlugin.PngInfo()
        said.add_itxt("XML:com.adobe.xmp", XMP)
        image.save(path, pnginfo=said)
    elif ending == "tif":
        image.save(path, tiffinfo={700: XMP.encode()})
    else:
        image.save(path, xmp=XMP.encode())
    with RasterSource.open(path) as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(tmp_path / "b.tif") as d:
        assert d.tags(ns="xml:XMP") == {"xml:XMP": XMP}


@pytest.mark.parametrize("cog", [False, True])
@pytest.mark.parametrize("build", [make, with_mask_file])
def test_all_that_a_picture_says_of_itself_comes_along(tmp_path, build, cog):
    path = build(tmp_path / "a.tif")
    with rasterio.open(path, "r+") as d:
        d.crs, d.transform = UTM["crs"], UTM["transform"]
        d.update_tags(AREA_OR_POINT="Point")
        d.update_tags(ns="IMAGERY", SATELLITEID="kite")
        d.update_tags(2, ns="OURS", FILTER="green")
        d.scales, d.offsets, d.units = (0.1, 0.2, 0.3), (1, 2, 3), ("a", "b", "c")
    with RasterSource.open(path) as source:
        source.write(tmp_path / "b.tif", 0.1, source.place(0.1, keep_origin=True), cog)
    with rasterio.open(tmp_path / "b.tif") as d:
        assert d.tags()["AREA_OR_POINT"] == "Point"
        assert d.tags(ns="IMAGERY") == {"SATELLITEID": "kite"} and d.tags(2, ns="OURS") == {"FILTER": "green"}
        assert (d.scales, d.offsets, d.units) == ((0.1, 0.2, 0.3), (1, 2, 3), ("a", "b", "c"))
        assert (d.transform.c, d.transform.f) == (UTM["transform"].c, UTM["transform"].f)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
def test_the_metadata_of_bands_come_along(tmp_path, cog):
    """GDAL leaves them out of a COG if it is to copy all domains."""
    path = make(tmp_path / "a.tif", prepare=lambda d: d.update_tags(2, FILTER="green"))
    with RasterSource.open(path) as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(tmp_path / "b.tif") as d:
        assert d.tags(2)["FILTER"] == "green"


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("alpha, lost", [(None, 0), (bytes([255, 0]), 0), (bytes([128]), 1), (bytes([128, 0, 64]), 2)])
def test_transparent_colours_of_a_palette_are_named(tmp_path, alpha, lost):
    """A GeoTIFF holds one of them, as its nodata value; the others became opaque without a word."""
    picture = Image.fromarray(np.moveaxis(scene(), 0, -1)).quantize(100)
    picture.save(tmp_path / "a.png", **({} if alpha is None else {"transparency": alpha}))
    with RasterSource.open(tmp_path / "a.png") as source:
        source.write(tmp_path / "b.tif", 0.1)
    said = [note.text for note in source.notes if "transparent there, wholly or in part" in note.text]
    assert len(said) == bool(lost) and all(f"({lost})" in text for text in said)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
def test_metadata_that_a_cog_cannot_keep_are_named(tmp_path, cog):
    """GDAL copies the bands' own or the other domains' metadata; the former were lost without a word."""

    def prepare(dataset):
        dataset.update_tags(2, FILTER="green", GSD="0.31")
        dataset.update_tags(ns="IMAGERY", SATELLITEID="kite")

    with RasterSource.open(make(tmp_path / "a.tif", prepare=prepare)) as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(tmp_path / "b.tif") as d:
        kept = d.tags(2).get("FILTER") == "green"
        assert d.tags(ns="IMAGERY") == {"SATELLITEID": "kite"}
    said = [note.text for note in source.notes]
    assert any("lacks the bands' metadata of a.tif (FILTER, GSD)" in text for text in said) is not kept
    assert any("keeps GSD=0.31" in text for text in said) is kept is not cog


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
def test_no_geolocation_array_stays(tmp_path, cog):
    """It is former georeferencing; the direct copy of a TIFF kept it."""
    array = {"X_DATASET": "lon.tif", "Y_DATASET": "lat.tif", "X_BAND": "1", "Y_BAND": "1"}
    path = make(tmp_path / "a.tif", prepare=lambda d: d.update_tags(ns="GEOLOCATION", **array))
    with RasterSource.open(path) as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(path) as a, rasterio.open(tmp_path / "b.tif") as b:
        assert a.tags(ns="GEOLOCATION") and not b.tags(ns="GEOLOCATION")
        assert np.array_equal(a.read(), b.read())


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_metadata_that_may_tell_the_former_scale_are_named(tmp_path):
    def prepare(dataset):
        dataset.update_tags(GSD="0.31", TIFFTAG_XRESOLUTION="72", AUTHOR="me")
        dataset.update_tags(2, Pixel_Size="31 cm")
        dataset.update_tags(ns="IMD", productGSD="0.31")

    with RasterSource.open(make(tmp_path / "a.tif", prepare=prepare)) as source:
        source.write(tmp_path / "b.tif", 0.1)
    told = "keeps GSD=0.31, productGSD=0.31, Pixel_Size=31 cm in its metadata, which may tell the former scale"
    assert f"b.tif {told}" in [note.text for note in source.notes]
    with RasterSource.open(make(tmp_path / "plain.tif")) as source:
        source.write(tmp_path / "c.tif", 0.1)
    assert not any("former scale" in note.text for note in source.notes)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
@pytest.mark.parametrize("mask_file", [False, True])
def test_a_negative_stays_one(tmp_path, mask_file, cog):
    pixels = scene(1)
    path = make(tmp_path / "a.tif", pixels, photometric="MINISWHITE")
    if mask_file:
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as d:
            d.write_mask(np.full((H, W), 255, np.uint8))
    with RasterSource.open(path) as source:
        shown = source.read(0, 0, W, H, W, H)
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(tmp_path / "b.tif") as d:
        negative = d.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES"
        assert negative or d.colormap(1)[0] == (255, 255, 255, 255)
        assert np.array_equal(d.read(), pixels)
    if not cog:  # a COG has the colours of its values in a table
        with RasterSource.open(tmp_path / "b.tif") as copy:
            assert np.array_equal(copy.read(0, 0, W, H, W, H), shown)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("cog", [False, True])
def test_a_transparent_colour_stays_so(tmp_path, cog):
    pixels = np.moveaxis(scene(), 0, -1).copy()
    pixels[:, :100], pixels[:, 100:110] = (1, 2, 3), (1, 9, 9)
    Image.fromarray(pixels).save(tmp_path / "a.png", transparency=(1, 2, 3))
    with RasterSource.open(tmp_path / "a.png") as source:
        source.write(tmp_path / "b.tif", 0.1, cog=cog)
    with rasterio.open(tmp_path / "a.png") as a, rasterio.open(tmp_path / "b.tif") as b:
        assert not b.dataset_mask()[:, :100].any() and b.dataset_mask()[:, 100:110].all()
        assert np.array_equal(a.dataset_mask(), b.dataset_mask()) and np.array_equal(a.read(), b.read())


@pytest.mark.parametrize("cog", [False, True])
def test_the_longest_names_are_written_and_read(tmp_path, cog):
    name = "n" * 251 + ".tif"
    with RasterSource.open(make(tmp_path / "a.tif")) as source:
        source.write(tmp_path / name, 0.1, cog=cog)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.tif", name]
    with RasterSource.open(tmp_path / name) as copy:  # the name of its .aux.xml would be too long
        assert copy.claimed.gsd_m == pytest.approx(0.1)


def test_different_nodata_per_band_becomes_a_mask(tmp_path):
    pixels = scene()
    pixels[:, :50] = [[[1]], [[2]], [[3]]]
    gdal_copy(make(tmp_path / "a.tif", pixels), tmp_path / "a.vrt", driver="VRT")
    vrt = (tmp_path / "a.vrt").read_text()
    for band in (1, 2, 3):
        vrt = re.sub(f'(band="{band}"[^>]*>)', rf"\1<NoDataValue>{band}</NoDataValue>", vrt, count=1)
    (tmp_path / "a.vrt").write_text(vrt)
    source = RasterSource.open(tmp_path / "a.vrt")
    assert (source.read(0, 0, W, H, W, H)[:50] == NO_DATA_GREY).all()
    source.write(tmp_path / "b.tif", 0.1)
    assert any("have several nodata values" in note.text for note in source.notes)
    with rasterio.open(tmp_path / "b.tif") as d:
        assert not d.dataset_mask()[:50].any() and np.array_equal(d.read(), pixels)


@pytest.mark.parametrize("cog", [False, True])
def test_no_lower_page_keeps_the_former_georeferencing(tmp_path, cog):
    path = make(tmp_path / "a.tif", **UTM)
    make(path, scene(1), APPEND_SUBDATASET="YES", **UTM)
    source = RasterSource.open(path)
    source.write(tmp_path / "b.tif", 0.2, cog=cog)
    assert any("b.tif has only the first of the 2 images" in note.text for note in source.notes)
    with rasterio.open(tmp_path / "b.tif") as copy:
        assert not copy.subdatasets and np.array_equal(copy.read(), scene())


@pytest.mark.parametrize("scale", [0, -0.1, math.nan, math.inf])
def test_senseless_scales(tmp_path, scale):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    with pytest.raises(UsageError, match="scale"):
        source.write(tmp_path / "b.tif", scale)
    assert not (tmp_path / "b.tif").exists()


def test_a_full_disk_is_told_without_names_of_temporary_files(tmp_path, monkeypatch):
    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device", str(source), None, str(target))

    monkeypatch.setattr("shutil.copyfile", full)
    with RasterSource.open(make(tmp_path / "a.tif")) as source, pytest.raises(OutputError) as failed:
        source.write(tmp_path / "b.tif", 0.1, cog=True)
    assert failed.value.message == f"{tmp_path}/b.tif could not be written (No space left on device)"


def test_senseless_targets(tmp_path):
    path = make(tmp_path / "a.tif")
    source = RasterSource.open(path)
    with pytest.raises(UsageError, match="itself"):
        source.write(path, 0.1)
    with pytest.raises(UsageError, match="GeoTIFF"):
        source.write(tmp_path / "b.jpg", 0.1)
    with pytest.raises(OutputError):
        source.write(tmp_path / "none" / "b.tif", 0.1)


def test_a_copy_that_differs_is_refused(tmp_path, monkeypatch):
    source = RasterSource.open(make(tmp_path / "a.tif"))
    other = make(tmp_path / "c.tif", scene() ^ 1)
    monkeypatch.setattr("shutil.copyfile", lambda a, b: Path(b).write_bytes(other.read_bytes()))
    with pytest.raises(OutputError, match="pixels near x 0, y 0"):
        source.write(tmp_path / "b.tif", 0.1)


def test_large_images_are_compared_by_samples(tmp_path, monkeypatch):
    monkeypatch.setattr("orthoscale.sources.raster_copy._WHOLE", 1000)
    source = RasterSource.open(make(tmp_path / "a.tif"))
    assert len(list(source._original._to_compare())) == 64
    source.write(tmp_path / "b.tif", 0.1)
    other = make(tmp_path / "c.tif", scene() ^ 1)
    monkeypatch.setattr("shutil.copyfile", lambda a, b: Path(b).write_bytes(other.read_bytes()))
    with pytest.raises(OutputError, match="pixels near x"):
        source.write(tmp_path / "d.tif", 0.1)


def test_own_copy_is_not_taken_for_evidence(tmp_path):
    RasterSource.open(make(tmp_path / "a.tif")).write(tmp_path / "b.tif", 0.1)
    claim = RasterSource.open(tmp_path / "b.tif").claimed
    assert claim.gsd_m == pytest.approx(0.1) and not claim.usable and "local" in claim.why


# Real orthophotos


@pytest.mark.real
def test_manila(data):
    """EPSG:3395 says 0.100 m/px; on the ground it is 0.0967."""
    claim = RasterSource.open(data / "orthophotos" / "manila.tif").claimed
    assert claim.usable and claim.gsd_m == pytest.approx(0.0967, rel=5e-3)


@pytest.mark.slow
@pytest.mark.real
def test_banepa(data, tmp_path):
    source = RasterSource.open(data / "orthophotos" / "banepa.jpg")
    assert not source.claimed.usable
    source.write(tmp_path / "banepa.tif", 0.132)
    with rasterio.open(tmp_path / "banepa.tif") as d:
        assert d.res == pytest.approx((0.132, 0.132))


@pytest.mark.parametrize("driver, options", [("PNG", {}), ("JPEG", {"QUALITY": 95}), ("strip", {})])
def test_unblocked_pictures_are_decoded_once(tmp_path, monkeypatch, driver, options):
    """Larger than GDAL's cache, they are read from a copy in blocks, and show the same."""
    if driver == "strip":
        # So high that GDAL shows the one strip as lines.
        pixels = np.tile(scene(), (1, 12, 1))
        path = make(tmp_path / "a.tif", pixels, height=H * 12, compress="deflate", blockysize=H * 12)
    else:
        path = converted(tmp_path / f"a.{driver.lower()}", driver, **options)
    windows = [(0, 0, 120, 90, 120, 90), (100, 60, 200, 140, 80, 56), (20, 20, 30, 30, 60, 60)]
    with RasterSource.open(path) as plain:
        expected = [plain.read(*window) for window in windows]
    monkeypatch.setattr(gdal, "_CACHE", 1000)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    decoded = []
    convert = Original.convert
    monkeypatch.setattr(Original, "convert", lambda *a, **o: decoded.append(1) or convert(*a, **o))
    with RasterSource.open(path) as source:
        for window, there in zip(windows, expected, strict=True):
            difference = np.abs(source.read(*window).astype(int) - there)
            # GDAL shrinks a JPEG from the smaller pictures that its coefficients give.
            assert difference.max() <= (8 if driver == "JPEG" else 0)
        assert len(decoded) == 1 and len(list((tmp_path / "scratch").iterdir())) == 1
    assert not list((tmp_path / "scratch").iterdir())


def test_pictures_in_blocks_are_not_copied(tmp_path, monkeypatch):
    monkeypatch.setattr(gdal, "_CACHE", 1000)
    for k, options in enumerate(({"compress": "deflate"}, {"tiled": True, "blockxsize": 64, "blockysize": 64})):
        with RasterSource.open(make(tmp_path / f"{k}.tif", **options)) as source:
            source.read(0, 0, W, H, 100, 60)
            assert source._scratch is None


def test_a_copy_that_has_no_room_is_refused(tmp_path, monkeypatch):
    path = converted(tmp_path / "a.png", "PNG")
    monkeypatch.setattr(gdal, "_CACHE", 1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 1000))
    with RasterSource.open(path) as source, pytest.raises(InputError, match="has no room for a copy") as caught:
        source.read(0, 0, W, H, 100, 60)
    assert "TMPDIR" in caught.value.hint


def test_a_copy_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise RasterioIOError("No space left on device")

    path = converted(tmp_path / "a.png", "PNG")
    monkeypatch.setattr(gdal, "_CACHE", 1000)
    monkeypatch.setattr(Original, "convert", fails)
    with RasterSource.open(path) as source, pytest.raises(InputError, match="into a temporary file .*No space left"):
        source.read(0, 0, W, H, 100, 60)


@pytest.mark.slow
def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path):
    make = "import os, signal; from orthoscale.system.scratch import Scratch; a, b = Scratch(), Scratch()"
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", f"{make}; os.kill(os.getpid(), signal.SIGKILL)"], env=environment)
    assert len(list(tmp_path.iterdir())) == 2
    code = f"{make}; print(a.folder.exists(), b.folder.exists())"
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["True", "True"] and not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="deletes no file that is open")
def test_a_new_scratch_folder_is_not_taken_for_a_leftover(tmp_path, monkeypatch):
    """Another run looks for leftovers between the making of its lock and the locking."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    locked, times = scratch._locked, []

    def late(lock):
        times.append(lock)
        if len(times) == 1:
            scratch._remove_leftovers(tmp_path)
        return locked(lock)

    monkeypatch.setattr(scratch, "_locked", late)
    mine = scratch.Scratch()
    assert (mine.folder / scratch.IN_USE).is_file()
    scratch._remove_leftovers(tmp_path)
    assert mine.folder.is_dir()
    mine.close()
    assert not list(tmp_path.iterdir())


def test_a_scratch_folder_where_the_file_system_has_no_locks(tmp_path, monkeypatch):
    """As on NFS without its lock daemon. Another's folder is not taken for a leftover there."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(scratch.fcntl, "flock", no_locks)
    mine = scratch.Scratch()
    scratch._remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [mine.folder.name]
    mine.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_statistics_that_are_written_meanwhile_do_not_end_a_run(tmp_path):
    path = make(tmp_path / "a.tif")
    (tmp_path / "a.tif.aux.xml").write_text("<PAMDataset></PAMDataset>")
    with RasterSource.open(path) as source:
        assert len(source.files) == 2
        (tmp_path / "a.tif.aux.xml").write_text("<PAMDataset> </PAMDataset>")
        source.fingerprint()
        os.utime(path, (0, 0))
        with pytest.raises(InputError, match="changed since"):
            source.fingerprint()


LISTS = {"offsets": (273, 324), "counts": (279, 325)}


def damaged_list(path: Path, which: str, how: str) -> None:
    """Change the list of where a TIFF's blocks are, or how long they are."""
    content = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", content, 4)
    entries = [at + 2 + 12 * k for k in range(struct.unpack_from("<H", content, at)[0])]
    (entry,) = (e for e in entries if struct.unpack_from("<H", content, e)[0] in LISTS[which])
    kind, count, place = struct.unpack_from("<HII", content, entry + 2)
    size = {3: 2, 4: 4}[kind]
    if how == "one lost":
        content[place + 3 * size : place + 4 * size] = bytes(size)
    elif how == "all lost":
        content[place : place + count * size] = bytes(count * size)
    elif how == "beyond":
        content[place : place + count * size] = b"\xff" * size * count
    elif how == "short":
        struct.pack_into("<I", content, entry + 4, count // 2)
    else:
        struct.pack_into("<H", content, entry + 2, 7)
    path.write_bytes(content)


@pytest.mark.parametrize("how", ["one lost", "all lost", "beyond", "short", "of no type"])
@pytest.mark.parametrize("which", LISTS)
@pytest.mark.parametrize("options", [{"blockysize": 5}, {"tiled": True, "blockxsize": 32, "blockysize": 32}])
def test_a_tiff_that_lost_where_its_blocks_are_is_damaged(tmp_path, options, which, how):
    """GDAL shows such blocks as empty, and ends in a segmentation fault when it is asked to copy them."""
    path = make(tmp_path / "a.tif", scene(high=200), height=H, compress="deflate", **options)
    damaged_list(path, which, how)
    with pytest.raises(InputError, match="is damaged|is truncated"):
        RasterSource.open(path)


@pytest.mark.parametrize("shape, mode", [((90, 120, 3), "RGB"), ((90, 120), "L"), ((1100, 1100), "1")])
def test_a_single_strip_is_whole(tmp_path, shape, mode):
    """Pillow, tifffile and ImageJ write all of an image as one strip, which GDAL shows as if it were many."""
    pixels = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    Image.fromarray(pixels).convert(mode).save(tmp_path / "a.tif")
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert 1 < dataset.block_shapes[0][0] < dataset.height, "GDAL shows it as it is: nothing is tested"
    with RasterSource.open(tmp_path / "a.tif") as source:
        seen = source.read(0, 0, source.width, source.height, source.width, source.height)
        assert np.array_equal(seen, Image.open(tmp_path / "a.tif").convert("RGB"))
        source.write(tmp_path / "out.tif", 0.1)
    cut = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(cut[: len(cut) * 3 // 4])
    with pytest.raises(InputError, match="is truncated|is damaged|cannot open"):
        RasterSource.open(tmp_path / "cut.tif")


@pytest.mark.parametrize(
    "dtype, low, high, fill", [("float32", 0, 1, -9999), ("float32", 0, 1, np.finfo("f4").min), ("float64", 0, 1, 1e30),
                               ("int16", 0, 4095, -32768), ("uint16", 0, 4095, 65535)])  # fmt: skip
def test_what_fills_borders_undeclared_leaves_the_picture_its_contrast(tmp_path, dtype, low, high, fill):
    pixels = (scene(high=4096).astype(float) / 4095 * high).astype(dtype)
    whole = RasterSource.open(make(tmp_path / "whole.tif", pixels)).read(150, 0, 100, H, 100, H)
    pixels[:, :, :120] = fill
    seen = RasterSource.open(make(tmp_path / "a.tif", pixels)).read(0, 0, W, H, W, H)
    assert np.abs(seen[:, 150:250].astype(int) - whole).max() < 40
    assert (seen[:, :120] == (255 if fill > 0 else 0)).all()


def test_bands_may_be_named_by_their_descriptions(tmp_path):
    """As a multispectral camera's are; GDAL takes the first three of 8 bit for red, green and blue."""
    pixels = scene(4)

    def describe(dataset):
        dataset.descriptions = ("Blue", "Green ", "RED", "Red edge")

    source = RasterSource.open(make(tmp_path / "a.tif", pixels, describe))
    assert np.array_equal(source.read(0, 0, W, H, W, H), np.moveaxis(pixels[2::-1], 0, -1))


def test_a_fourth_band_whose_description_is_a_colour_is_that(tmp_path):
    """Near infrared first: blue was said to be a picture of its own that is not used, or would have masked the others
    where it is saturated."""
    for number, last in enumerate((scene(4)[3], np.where(np.arange(W) < 100, 0, 255) * np.ones((H, 1), np.uint8))):
        pixels = scene(4)
        pixels[3] = last

        def describe(dataset):
            dataset.descriptions = ("NIR", "Red", "Green", "Blue")

        source = RasterSource.open(make(tmp_path / f"{number}.tif", pixels, describe))
        assert "used as that" in source.notes[0].text and len(source.notes) == 1
        assert np.array_equal(source.read(0, 0, W, H, W, H), np.moveaxis(pixels[1:], 0, -1))


def test_a_fourth_band_is_no_mask_because_it_is_called_alpha(tmp_path):
    """So GDAL calls near infrared where nobody says what it is."""
    pixels = scene(4)
    source = RasterSource.open(make(tmp_path / "a.tif", pixels))
    assert source._dataset.colorinterp[3] == ColorInterp.alpha
    assert np.array_equal(source.read(0, 0, W, H, W, H), np.moveaxis(pixels[:3], 0, -1))
    assert "near infrared" in source.notes[0].text
    pixels[3, 50:60, 50:60] = 0  # GDAL leaves these out of what it resamples
    plain, odd = (
        RasterSource.open(make(tmp_path / f"{n}.tif", pixels[:n])).read(0, 0, W, H, W * 2, H * 2) for n in (3, 4)
    )
    assert np.abs(plain.astype(int) - odd)[90:130, 90:130].max() < 30
    pixels[3] = np.where(np.arange(W) < 100, 0, 255)
    pixels[3, :, 100:110] = np.arange(10) * 25  # a soft edge
    source = RasterSource.open(make(tmp_path / "b.tif", pixels))
    assert (source.read(0, 0, W, H, W, H)[:, :100] == NO_DATA_GREY).all() and not source.notes


@pytest.mark.parametrize("dtype, high", [("uint8", 256), ("uint16", 65536)])
def test_a_tiff_whose_zero_is_white_is_shown_as_it_was_meant(tmp_path, dtype, high):
    """GDAL gives the values as they are stored, a negative, and takes minutes to average those of 16 bit."""
    grey = scene(1, dtype, high)
    plain = RasterSource.open(make(tmp_path / "plain.tif", grey)).read(0, 0, W, H, W, H)
    negative = RasterSource.open(make(tmp_path / "a.tif", high - 1 - grey, photometric="MINISWHITE"))
    small = RasterSource.open(tmp_path / "plain.tif").read(0, 0, W, H, W // 3, H // 3).astype(int)
    assert np.abs(negative.read(0, 0, W, H, W // 3, H // 3) - small).max() < 10
    assert np.abs(negative.read(0, 0, W, H, W, H).astype(int) - plain).max() <= 1
    negative.write(tmp_path / "b.tif", 0.1)
    assert np.abs(RasterSource.open(tmp_path / "b.tif").read(0, 0, W, H, W, H).astype(int) - plain).max() <= 1


def test_an_image_of_two_values_keeps_both(tmp_path):
    pixels = (scene() > 128).astype("uint16") * 7
    seen = RasterSource.open(make(tmp_path / "a.tif", pixels)).read(0, 0, W, H, W, H)
    assert np.array_equal(seen, np.moveaxis((pixels > 0) * np.uint8(255), 0, -1))


def test_blocks_that_were_never_written_show_nothing(tmp_path):
    path, name = tmp_path / "a.tif", {"driver": "GTiff", "width": W, "height": H, "count": 3, "dtype": "uint8"}
    with rasterio.open(path, "w", sparse_ok=True, tiled=True, blockxsize=64, blockysize=64, **name) as dataset:
        dataset.write(scene()[:, :64, :128] // 2 + 1, window=((0, 64), (64, 192)))
    with RasterSource.open(path) as source:
        seen = source.read(0, 0, W, H, W, H)
        assert (seen[:, :64] == NO_DATA_GREY).all() and (seen[64:] == NO_DATA_GREY).all()
        assert np.array_equal(seen[:64, 64:192], np.moveaxis(scene()[:, :64, :128] // 2 + 1, 0, -1))
        assert (source.read(60, 0, 8, 8, 4, 4)[:, :2] == NO_DATA_GREY).all()
        source.write(tmp_path / "out.tif", 0.1)


@pytest.fixture
def server():
    """A server on this machine that counts who calls."""
    calls = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            calls.append(self.path)
            self.send_error(404)

        do_HEAD = do_GET

        def log_message(self, *args):
            pass

    running = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=running.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{running.server_port}", calls
    running.shutdown()
    running.server_close()


WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>100</UpperLeftY><LowerRightX>100</LowerRightX><LowerRightY>0</LowerRightY>
<SizeX>256</SizeX><SizeY>256</SizeY><TileLevel>0</TileLevel></DataWindow><BandsCount>3</BandsCount></GDAL_WMS>"""
VRT = """<VRTDataset rasterXSize="256" rasterYSize="256">{bands}</VRTDataset>"""
BAND = """<VRTRasterBand dataType="Byte" band="{band}"><SimpleSource>
<SourceFilename relativeToVRT="0">{name}</SourceFilename>
<SourceBand>{band}</SourceBand></SimpleSource></VRTRasterBand>"""


def vrt(path: Path, name: str) -> Path:
    path.write_text(VRT.format(bands="".join(BAND.format(band=band, name=name) for band in (1, 2, 3))))
    return path


@pytest.mark.parametrize("how", ["wms", "vrt of wms", "vrt of url", "overview"])
def test_no_file_makes_the_network_be_called(tmp_path, server, how, monkeypatch):
    url, calls = server
    monkeypatch.delenv("no_proxy", raising=False)
    monkeypatch.delenv("NO_PROXY", raising=False)
    (tmp_path / "wms.xml").write_text(WMS.format(url=url))
    path = {
        "wms": lambda: tmp_path / "wms.xml",
        "vrt of wms": lambda: vrt(tmp_path / "a.vrt", str(tmp_path / "wms.xml")),
        "vrt of url": lambda: vrt(tmp_path / "a.vrt", f"/vsicurl/{url}/a.tif"),
        "overview": lambda: make(tmp_path / "a.tif"),
    }[how]()
    if how == "overview":
        item = f'<MDI key="OVERVIEW_FILE">{tmp_path / "wms.xml"}</MDI>'
        (tmp_path / "a.tif.aux.xml").write_text(
            f'<PAMDataset><Metadata domain="OVERVIEWS">{item}</Metadata></PAMDataset>'
        )
        with RasterSource.open(path) as source:
            source.read(0, 0, W, H, 40, 30)
    else:
        with pytest.raises(InputError):
            RasterSource.open(path)
    assert calls == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("nested", [False, True])
def test_a_pipe_that_a_vrt_names_is_not_waited_for(tmp_path, nested):
    os.mkfifo(tmp_path / "pipe.tif")
    path = vrt(tmp_path / "a.vrt", str(tmp_path / "pipe.tif"))
    if nested:
        path = vrt(tmp_path / "b.vrt", str(path))
    with pytest.raises(InputError, match="which is a pipe or device"):
        RasterSource.open(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize(
    "name", ["a.tif.aux.xml", "a.tif.OVR", "A.tif.msk", "a.tfw", "a_RPC.TXT", "a.tab", "a.link", "METADATA.DIM"]
)
@pytest.mark.parametrize("part", [False, True])
def test_a_pipe_beside_a_picture_is_not_waited_for(tmp_path, name, part):
    path = make(tmp_path / "a.tif")
    for other in ("another.tfw", "log.txt", "jobs.xml"):
        os.mkfifo(tmp_path / other)
    os.symlink("nowhere", tmp_path / "a.missing")
    (tmp_path / "a.folder").mkdir()
    RasterSource.open(path).close()
    os.symlink("another.tfw", tmp_path / name) if name == "a.link" else os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name} is a pipe or a device, and is read together with .*(a.tif|b.vrt)"):
        RasterSource.open(vrt(tmp_path / "b.vrt", str(path)) if part else path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize(
    "name, beside",
    [
        ("IMG_town_R1C1.tif", "DIM_town.XML"),
        ("LC08_L1TP_B4.tif", "LC08_L1TP_MTL.txt"),
        ("IMG-town.tif", "HDR-town.txt"),
        ("IMG-town.tif", "summary.txt"),
        ("po_town_pan_0000000.tif", "po_town_metadata.txt"),
        ("town.1.tif", "town.pass"),
    ],
)
def test_a_pipe_named_as_a_satellites_metadata_is_not_waited_for(tmp_path, name, beside):
    """Those have stems of their own."""
    path = make(tmp_path / name)
    os.mkfifo(tmp_path / beside)
    with pytest.raises(InputError, match=f"{beside} is a pipe or a device"):
        RasterSource.open(path)


def test_of_a_file_that_cannot_be_read_permissions_are_named_too(tmp_path):
    with pytest.raises(InputError, match="gone.tif: cannot be read") as told:
        Stamp.of(tmp_path / "gone.tif")
    assert "permissions" in told.value.hint and "moved" in told.value.hint


def test_ground_control_that_is_no_number_is_not_believed(tmp_path):
    points = [GroundControlPoint(r, c, 500_000 + c, 5_400_000 - r) for r, c in ((0, 0), (0, W), (H, 0), (H, W))]
    points[1].x = math.nan
    path = make(tmp_path / "a.tif", prepare=lambda dataset: setattr(dataset, "gcps", (points, CRS.from_epsg(32632))))
    with RasterSource.open(path) as source:
        assert not source.claimed.usable and "not all of them finite" in source.claimed.why


@pytest.mark.parametrize("wrong, says", [(0, ""), (1, "fit misses by 0.498 px"), (50, "contradict")])
def test_ground_control_of_which_a_point_is_wrong_is_said(tmp_path, wrong, says):
    points = [GroundControlPoint(r, c, 500_000 + c, 5_400_000 - r) for r, c in ((0, 0), (0, W), (H, 0), (H, W))]
    points[1].x += 2 * wrong
    path = make(tmp_path / "a.tif", prepare=lambda dataset: setattr(dataset, "gcps", (points, CRS.from_epsg(32632))))
    with RasterSource.open(path) as source:
        assert source.claimed.usable == (wrong < 50) and says in source.claimed.why
        assert ("misses" in source.claimed.why) == (wrong > 0)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "odd.txt")
    with pytest.raises(InputError, match="a pipe or a device"):
        open_source(tmp_path / "odd.txt")
