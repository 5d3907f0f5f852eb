"""How often a frame is decoded: memory holds few of them, and decoding takes longer than looking."""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from support.drawings import CARD

from orthoscale.core.boxes import Boxes
from orthoscale.detect.zoom import search_zoom
from orthoscale.sources import picture_file
from orthoscale.sources.picture_file import Memory, PictureFile


def test_threads_that_want_the_same_picture_wait_for_the_first():
    memory, made = Memory(), []

    def make():
        time.sleep(0.1)
        made.append(1)
        return np.zeros((10, 10, 3), np.uint8)

    def read(_):
        with memory.holding("a", 300, make) as pixels:
            return pixels

    with ThreadPoolExecutor(4) as pool:
        first, *others = pool.map(read, range(4))
    assert made == [1]
    assert all(pixels is first for pixels in others)


def test_if_the_first_thread_fails_the_next_one_tries():
    memory, tries = Memory(), []

    def make():
        tries.append(1)
        if len(tries) == 1:
            raise OSError
        return np.zeros((10, 10, 3), np.uint8)

    def read(_):
        with memory.holding("a", 300, make) as pixels:
            return pixels

    with ThreadPoolExecutor(4) as pool:
        results = [pool.submit(read, k) for k in range(4)]
    assert sorted(result.exception() is None for result in results) == [False, True, True, True]
    assert len(tries) == 2


def test_the_scale_search_decodes_each_frame_once_for_all_factors(tmp_path, monkeypatch):
    frames = []
    for k in range(6):
        path = tmp_path / f"{k}.jpg"
        cv2.imwrite(str(path), np.random.default_rng(k).integers(0, 255, (900, 1200, 3), dtype=np.uint8))
        frames.append(PictureFile(path.name, path, 1200, 900))
    decoded = Counter()
    decode = picture_file._decode

    def counted(path, factor):
        decoded[path.name] += 1
        return decode(path, factor)

    monkeypatch.setattr(picture_file, "_decode", counted)
    monkeypatch.setattr(picture_file, "KEPT_SHARE", 4e6 / 2**30)  # one frame
    assert search_zoom(frames, lambda image: Boxes.empty(), CARD).vehicle_px is None
    assert decoded == {frame.name: 1 for frame in frames}
