"""How often a frame is decoded, and how many are in memory: it holds few, and decoding takes longer than looking."""

from __future__ import annotations

import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
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


class Used:
    """How many pictures were held at once, at most; `at_once` must be."""

    def __init__(self, at_once):
        self.lock, self.now, self.most = threading.Lock(), 0, 0
        self.together = threading.Barrier(at_once, timeout=20)

    def hold(self, memory, key, size):
        with memory.holding(key, size, lambda: np.zeros(1, np.uint8)):
            with self.lock:
                self.now += 1
                self.most = max(self.most, self.now)
            self.together.wait()
            time.sleep(0.05)
            with self.lock:
                self.now -= 1


@pytest.mark.parametrize("size, at_once", [(1000, 3), (1600, 1), (3100, 1), (9000, 1)])
def test_threads_hold_no_more_pictures_than_there_is_room_for(monkeypatch, size, at_once):
    """Those larger than ALONE_SHARE one at a time."""
    monkeypatch.setattr(picture_file, "USED_SHARE", 3100 / 2**30)
    monkeypatch.setattr(picture_file, "ALONE_SHARE", 1500 / 2**30)
    memory, used = Memory(), Used(at_once)
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda k: used.hold(memory, k, size), range(6)))
    assert used.most == at_once


def test_a_picture_made_of_another_needs_no_room_of_its_own(monkeypatch):
    """Else each of two threads would wait for the other to end."""
    monkeypatch.setattr(picture_file, "USED_SHARE", 1000 / 2**30)
    memory, used = Memory(), Used(1)

    def warped():
        used.hold(memory, "frame", 1000)
        return np.ones(1, np.uint8)

    def read(k):
        with memory.holding(k, 1000, warped) as pixels:
            return int(pixels[0])

    with ThreadPoolExecutor(2) as pool:
        ends = [pool.submit(read, k) for k in range(2)]
        assert [end.result(timeout=10) for end in ends] == [1, 1]
    assert used.most == 1


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
