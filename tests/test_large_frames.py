"""Frames larger than memory allows at once: decoded no finer than needed, checked before they are decoded."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from support.models import make_model, save

from orthoscale.errors import InputError
from orthoscale.sources import ground_picture, picture_file
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.picture_file import PictureFile


@pytest.fixture
def smooth():
    """A picture that has something to show at every size."""
    few = np.random.default_rng(0).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    return cv2.resize(few, (640, 480), interpolation=cv2.INTER_CUBIC)


@pytest.fixture
def all_large(monkeypatch):
    """Whatever is decoded counts as large."""
    monkeypatch.setattr(picture_file, "LARGE_FRAME", 0)
    for module in (picture_file, ground_picture):
        monkeypatch.setattr(module, "ALONE_SHARE", 0.0)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_a_large_frame_shows_the_same(tmp_path, smooth, all_large, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), smooth, [cv2.IMWRITE_JPEG_QUALITY, 98])
    frame = PictureFile("a", path, 640, 480)
    assert frame.large
    for x, y, width, height, out in (
        (0, 0, 640, 480, (640, 480)),
        (101, 33, 320, 240, (80, 60)),
        (64, 8, 400, 320, (50, 40)),
    ):
        wanted = cv2.resize(smooth[y : y + height, x : x + width, ::-1], out, interpolation=cv2.INTER_AREA)
        assert np.abs(frame.read(x, y, width, height, *out).astype(int) - wanted).mean() < 4


def test_what_is_no_jpeg_is_reduced_to_means(tmp_path, all_large):
    """Not to every fourth pixel or two, which would show noise that no detector was trained for."""
    noise = np.random.default_rng(0).integers(0, 255, (470, 630, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), noise)
    part = PictureFile("a", tmp_path / "a.png", 630, 470).read(0, 0, 628, 468, 157, 117)
    wanted = cv2.resize(noise[:468, :628, ::-1], (157, 117), interpolation=cv2.INTER_AREA)
    assert np.abs(part.astype(int) - wanted).max() <= 1


@pytest.mark.parametrize("suffix, whole", [("png", True), ("JPG", False)])
def test_room_is_made_for_what_decoding_takes(tmp_path, smooth, monkeypatch, suffix, whole):
    """All of a frame but a JPEG's is there before it is reduced: many threads at once would fill the memory."""
    monkeypatch.setattr(picture_file, "LARGE_FRAME", 0)
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), smooth)
    rooms = []
    with monkeypatch.context() as patched:
        room_for = picture_file.memory._room_for
        patched.setattr(picture_file.memory, "_room_for", lambda size: rooms.append(size) or room_for(size))
        with PictureFile("a", path, 640, 480).pixels(4) as (pixels, _):
            assert pixels.nbytes == 3 * 640 * 480 / 16
    assert rooms == [3 * 640 * 480 // (1 if whole else 16)]


def test_large_jpegs_are_decoded_at_the_size_needed(tmp_path, smooth, all_large):
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), smooth)
    for shrink, factor in ((1, 1), (2, 2), (3, 2), (7, 4), (50, 8)):
        with PictureFile("a", path, 640, 480).pixels(shrink) as (pixels, by):
            assert by == factor and pixels.shape == (480 // factor, 640 // factor, 3)


def test_the_ground_under_a_large_frame(tmp_path, smooth, monkeypatch):
    model, _ = make_model()
    (tmp_path / "images").mkdir()
    for image in model.images.values():
        cv2.imwrite(str(tmp_path / "images" / image.name), smooth)
    source = ColmapSource.open(save(model, tmp_path / "m", "bin"))
    picture = source.ground_pictures[0]
    size = picture.width, picture.height
    whole = picture.read(0, 0, *size, *size)
    monkeypatch.setattr(ground_picture, "ROWS_AT_ONCE", 50)
    monkeypatch.setattr(ground_picture, "ALONE_SHARE", 0.0)
    window = (37, 21, 203, 150)
    part = picture.read(*window, 203, 150)
    assert (part == whole[21:171, 37:240]).all()
    monkeypatch.setattr(picture_file, "LARGE_FRAME", 0)
    coarse = picture.read(32, 16, 240, 160, 60, 40)
    wanted = cv2.resize(whole[16:176, 32:272], (60, 40), interpolation=cv2.INTER_AREA)
    assert np.abs(coarse.astype(int) - wanted).mean() < 6


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    header = struct.pack(">IIBBBBB", 20_000, 20_000, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(InputError, match="of memory"):
        PictureFile("a", path, 20_000, 20_000).read(0, 0, 100, 100, 100, 100)


def test_the_size_of_a_tiff_is_checked_before_it_is_decoded(tmp_path, monkeypatch):
    path = tmp_path / "a.tif"
    cv2.imwrite(str(path), np.zeros((60, 80, 3), np.uint16))
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(InputError, match="image is 80 x 60 px, but its camera 640 x 480"):
        PictureFile("a", path, 640, 480).check_size()
    with pytest.raises(InputError, match="image is 80 x 60 px, but its camera 640 x 480"):
        PictureFile("a", path, 640, 480).read(0, 0, 10, 10, 10, 10)
