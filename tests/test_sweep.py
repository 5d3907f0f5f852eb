"""The anytime sweep: fair at every stop, the same with any workers, and able to go on after a kill."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.drawings import RENDERED_VEHICLES, Drawing, RectangleDetector, car_park, rendered_vehicles
from test_architecture import MODULES, imports

import orthoscale
from orthoscale.actions.estimate import estimate
from orthoscale.anchors.search import CODE_OF_FINDERS
from orthoscale.core.boxes import Boxes, matched
from orthoscale.core.detections import Tile
from orthoscale.detect.cache import CODE, TileCache, cache_key, code_hash
from orthoscale.detect.coarse_pass import UNPROMISING, coarse_pass
from orthoscale.detect.detector import Detector, Passes
from orthoscale.detect.order import visiting_order
from orthoscale.detect.sweep import Stop, sweep_twice
from orthoscale.detect.tiles import FunctionDetector, Looks, look_twice, tiles
from orthoscale.detect.workers import on_threads, worker_count
from orthoscale.errors import UsageError
from orthoscale.locate.maps import FEATURE_CODE
from orthoscale.locate.retrieval import EMBEDDING_CODE
from orthoscale.sources.fingerprint import fingerprint


def grid(columns, rows, side=100):
    return [Tile(x * side, y * side, side, side, side, side) for y in range(rows) for x in range(columns)]


# The order


@pytest.mark.parametrize("count, low", [((1, 1), 1.0), ((7, 5), 1.0), ((40, 30), 0.125)])
def test_the_order_is_a_permutation_and_the_same_for_a_seed(count, low):
    places = grid(*count)
    weight = np.where(np.arange(len(places)) % 3 == 0, 1.0, low)
    order = visiting_order(places, weight, seed=4)
    assert sorted(order) == list(range(len(places)))
    assert (order == visiting_order(places, weight, seed=4)).all()
    assert len(places) == 1 or (order != visiting_order(places, weight, seed=5)).any()


def test_any_beginning_is_spread_over_the_picture():
    order = visiting_order(grid(32, 32), np.ones(1024))
    for n in (16, 64, 256):
        quarters = (order[:n] % 32 // 16) + 2 * (order[:n] // 32 // 16)
        assert np.abs(np.bincount(quarters, minlength=4) - n / 4).max() <= 1


def test_tiles_come_early_in_proportion_to_their_weight_and_to_nothing_else():
    places, weight = grid(16, 16), np.where(np.arange(256) < 64, 1.0, 0.125)
    seen = np.zeros(256)
    for seed in range(2000):
        seen[visiting_order(places, weight, seed)[:22]] += 1
    promising, others = seen[:64] / 2000, seen[64:] / 2000
    assert promising.mean() / others.mean() == pytest.approx(8, rel=0.1)
    # 22 of 88 units of weight: a quarter. Each tile alike, to what 2000 draws can tell (one sigma is 0.01).
    assert promising.mean() == pytest.approx(0.25, abs=0.01) and np.abs(promising - 0.25).max() < 0.05


# The sweep


@pytest.fixture(scope="module")
def town():
    truth = car_park(40, 5000, 4000, 150, seed=2)
    return Drawing(5000, 4000, truth), truth


def jobs_of(picture, zoom=1.0):
    return [(picture, tile) for tile in tiles(picture, zoom)]


def swept(picture, count=1, **options):
    jobs = jobs_of(picture)
    options.setdefault("order", np.arange(len(jobs)))
    return sweep_twice(jobs, visit=lambda some: on_threads(some, RectangleDetector(), count), **options)


def test_all_of_it_finds_every_vehicle_once(town):
    picture, truth = town
    found = swept(picture)
    i, _, overlaps = matched(truth, found.boxes["drawing"], 0.5)
    assert len(i) == len(truth) == len(found.boxes["drawing"]) and overlaps.min() > 0.8
    assert len(found.swept.tiles) == found.swept.total == len(jobs_of(picture))


def test_what_one_look_alone_shows_is_doubtful():
    # 15 px: in the detector's range (12 to 70 px), but no longer half an octave coarser.
    truth = Boxes([[200, 200, 15, 9, 0], [300, 200, 40, 17, 0.2]], np.ones(2))
    found = swept(Drawing(500, 400, truth))
    assert found.boxes["drawing"].centre == pytest.approx(np.array([[300, 200]]), abs=0.7)
    assert found.doubtful["drawing"].centre == pytest.approx(np.array([[200, 200]]), abs=0.7)


@pytest.mark.parametrize("count", [2, 5])
def test_workers_change_nothing_but_the_time(town, count):
    def spread(found):
        return 1 / np.sqrt(1 + len(found.boxes["drawing"]))

    order = visiting_order([t for _, t in jobs_of(town[0])], np.ones(len(jobs_of(town[0]))), seed=3)
    one, many = (swept(town[0], n, order=order, stop=Stop(spread, 0.086)) for n in (1, count))
    assert 16 <= len(one.swept.tiles) < one.swept.total
    assert one.swept.tiles == many.swept.tiles
    assert np.array_equal(one.boxes["drawing"].xylwa, many.boxes["drawing"].xylwa)


def test_it_stops_when_the_spread_is_small_enough_and_not_before(town):
    asked = []

    def spread(found):
        asked.append(len(found.swept.tiles))
        return 0.055

    steps = []
    order = np.arange(len(jobs_of(town[0])))[::-1]
    found = swept(town[0], order=order, stop=Stop(spread, 0.05), progress=lambda *s: steps.append(s))
    # 10 % above the target: a fifth more tiles, four at least; when all are seen there is nothing more to ask.
    assert asked == [16, 20, 24, 29] and len(found.swept.tiles) == found.swept.total == 30
    assert steps[-1] == (30, 30)
    assert len(swept(town[0], order=order, stop=Stop(lambda found: 0.0, 0.05)).swept.tiles) == 16


def test_an_error_in_a_thread_ends_the_sweep_at_once(town):
    seen = []

    def detect(image):
        seen.append(1)
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        list(on_threads(dict(enumerate(jobs_of(town[0]))), FunctionDetector(detect), 2))
    assert len(seen) <= 6


def test_a_tile_without_data_is_not_looked_at():
    def detect(image):
        raise AssertionError

    (tile,) = tiles(Drawing(300, 200, Boxes.empty()), 1.0)
    assert len(look_twice(Drawing(300, 200, Boxes.empty()), tile, FunctionDetector(detect)).fine) == 0


def test_a_tile_in_which_nothing_was_seen_is_not_looked_at_again():
    """Only what both looks show counts; where the first shows a vehicle, the second is asked."""
    picture = Drawing(500, 400, Boxes.empty())
    picture.read = lambda *_: np.random.default_rng(0).integers(0, 255, (400, 500, 3)).astype(np.uint8)
    (tile,) = tiles(picture, 1.0)
    asked = []

    def second(image):
        asked.append(image.shape)
        return Boxes.empty()

    nothing = FunctionDetector(lambda _: Boxes.empty(), FunctionDetector(second))
    assert not len(look_twice(picture, tile, nothing).coarse) and not asked
    one = Boxes([[200, 200, 40, 17, 0.2]], [0.9])
    look_twice(picture, tile, FunctionDetector(lambda _: one, nothing.confirming))
    assert len(asked) == 1


def test_two_networks_must_agree_and_the_first_measures():
    """One takes a shed for a vehicle, the other a pond; of both boxes of the vehicle the first one's size counts."""
    car, shed, pond = [200, 200, 40, 17, 0.2], [90, 90, 41, 18, 1.0], [300, 90, 39, 16, 0.4]
    picture = Drawing(500, 400, Boxes.empty())
    picture.read = lambda *_: np.random.default_rng(0).integers(0, 255, (400, 500, 3)).astype(np.uint8)
    (tile,) = tiles(picture, 1.0)

    def smaller(image):
        return Boxes(np.array([car, pond]) * [1, 1, 0.9, 0.8, 1], [0.5, 0.9]).mapped(image.shape[1] / 500)

    detector = FunctionDetector(lambda _: Boxes([car, shed], [0.4, 0.9]), FunctionDetector(smaller))
    looks = look_twice(picture, tile, detector)
    assert detector.passes == Passes.CONFIRMED
    found = sweep_twice([(picture, tile)], np.arange(1), lambda _: [(0, looks)], sure=0.44, passes=detector.passes)
    assert found.boxes["drawing"].xylwa == pytest.approx(np.array([car]))
    assert found.boxes["drawing"].score == pytest.approx([0.45])
    assert found.doubtful["drawing"].xylwa == pytest.approx(np.array([shed]))


class Watched(Detector):
    """The shipped detector, which remembers the sizes (height, width) of what it was shown."""

    def see(self, image, threshold=None):
        self.shown = [*getattr(self, "shown", []), image.shape[:2]]
        return super().see(image, threshold)


@pytest.fixture(scope="module")
def few_vehicles():
    """A picture with vehicles in one corner, and a tile of all of it."""
    height, width = 768, 1024
    image = np.full((height, width, 3), 90, np.uint8)
    image += np.random.default_rng(0).integers(0, 20, image.shape, np.uint8)
    vehicles = rendered_vehicles()
    image[100 : 100 + len(vehicles), 150 : 150 + vehicles.shape[1]] = vehicles
    picture = Drawing(width, height, Boxes.empty())
    picture.read = lambda *_: image
    return picture, Tile(0, 0, width, height, width, height)


@pytest.mark.parametrize("passes", [Passes.FINE_FIRST, Passes.COARSE_FIRST])
def test_the_second_pass_looks_around_what_the_first_saw_and_sees_the_same(few_vehicles, passes, monkeypatch):
    """In a part of the tile, whichever comes first; the vehicles are those of two passes over all of it."""
    picture, tile = few_vehicles
    detector = Watched(passes=passes, threads=1)
    part = sweep_twice([(picture, tile)], np.arange(1), lambda _: [(0, look_twice(picture, tile, detector))])
    first, second = detector.shown
    assert (first == (768, 1024)) == (passes == Passes.FINE_FIRST)
    assert np.prod(second) < 0.3 * np.prod({(768, 1024): (543, 724), (543, 724): (768, 1024)}[first])
    monkeypatch.setattr(Watched, "takes_parts", False)
    whole = sweep_twice([(picture, tile)], np.arange(1), lambda _: [(0, look_twice(picture, tile, detector))])
    assert len(whole.boxes["drawing"]) == RENDERED_VEHICLES
    assert part.boxes["drawing"].xylwa == pytest.approx(whole.boxes["drawing"].xylwa, rel=0.01, abs=0.01)


def test_a_network_looks_coarsely_first_where_it_is_told_to(few_vehicles):
    """And no more where that shows nothing: at half the cost of the fine pass."""
    picture, tile = few_vehicles
    empty = Drawing(1024, 768, Boxes.empty())
    empty.read = lambda *_: np.random.default_rng(0).integers(90, 110, (768, 1024, 3)).astype(np.uint8)
    for passes, size in ((Passes.COARSE_FIRST, (543, 724)), (Passes.FINE_FIRST, (768, 1024))):
        detector = Watched(passes=passes, threads=1)
        look_twice(empty, tile, detector)
        assert detector.shown == [size]


def test_what_two_passes_show_must_be_seen_by_the_finder_too_where_nothing_else_tells(few_vehicles):
    """Glints on water are vehicles to both passes of the small network; the scale was then seven times too large."""
    picture, tile = few_vehicles
    detector = Detector(passes=Passes.TWICE_CONFIRMED, threads=1)
    assert detector.sure == detector.card.sure
    twice = look_twice(picture, tile, Detector(threads=1))

    def vehicles(finder):
        detector.confirming = FunctionDetector(finder)
        looks = look_twice(picture, tile, detector)
        found = sweep_twice([(picture, tile)], np.arange(1), lambda _: [(0, looks)], passes=detector.passes)
        return len(found.boxes["drawing"]), len(found.doubtful["drawing"])

    seen = twice.coarse.mapped(724 / 1024)
    assert vehicles(lambda image: Boxes.empty()) == (0, len(twice.fine))
    assert vehicles(lambda image: seen) == (RENDERED_VEHICLES, len(twice.fine) - RENDERED_VEHICLES)
    assert vehicles(lambda image: seen[[0]]) == (1, len(twice.fine) - 1)


def test_what_the_first_pass_alone_sees_is_doubtful():
    shed, pond = [90, 90, 41, 18, 1.0], [300, 90, 39, 16, 0.4]
    looks = Looks(Boxes([shed], [0.9]), Boxes([pond], [0.9]))
    jobs = [(Drawing(500, 400, Boxes.empty()), Tile(0, 0, 500, 400, 500, 400))]
    for passes, alone in ((Passes.CONFIRMED, shed), (Passes.FINE_FIRST, shed), (Passes.COARSE_FIRST, pond)):
        found = sweep_twice(jobs, np.arange(1), lambda _: [(0, looks)], passes=passes)
        assert found.doubtful["drawing"].xylwa == pytest.approx(np.array([alone]))


def test_promising_tiles_are_those_that_show_something_from_afar():
    class Far(RectangleDetector):
        def __call__(self, image, threshold=None):
            bright = (image[..., 0] > 170).any()
            return Boxes([[20, 20, 9, 4, 0]] if bright else np.empty((0, 5)), np.ones(int(bright)))

    truth = Boxes([[500, 500, 40, 17, 0], [6500, 6500, 40, 17, 0]], np.ones(2))
    picture = Drawing(7000, 7000, truth)
    picture.FINER = 1
    jobs = jobs_of(picture)
    weight = coarse_pass(jobs, np.arange(len(jobs)), Far(), 2)
    hit = [t.x <= 500 < t.x + t.width and t.y <= 500 < t.y + t.height or t.x + t.width > 6500 and t.y + t.height > 6500
           for _, t in jobs]  # fmt: skip
    assert (weight == np.where(hit, 1.0, UNPROMISING)).all() and 0 < sum(hit) < len(jobs)


def test_few_tiles_need_no_promise(town):
    jobs = jobs_of(town[0])
    assert (coarse_pass(jobs, np.arange(len(jobs)), None, 1) == 1).all()


@pytest.mark.slow
def test_a_stopped_sweep_is_unbiased_against_all_of_it():
    """Vehicles of dense places are shorter here than those of lonely ones by 8 %, the worst case for an order that
    prefers vehicles. The order may not let that into the scale."""
    rng = np.random.default_rng(0)
    places = grid(40, 40)
    dense = np.zeros(1600, bool)
    dense[rng.choice(1600, 200, replace=False)] = True
    count = np.where(dense, 12, rng.random(1600) < 0.5)  # 2400 in dense places, 700 alone
    log_size = [rng.normal(0.0 if d else 0.08, 0.08, n) for d, n in zip(dense, count, strict=True)]
    whole = np.concatenate(log_size).mean()
    weight = np.where(count > 0, 1.0, UNPROMISING)
    errors = []
    for seed in range(300):
        taken, n = [], 0
        for k in visiting_order(places, weight, seed):
            taken.append(log_size[k])
            n += len(log_size[k])
            if n >= 250:
                break
        errors.append(np.concatenate(taken).mean() - whole)
    assert abs(np.mean(errors)) < 3 * np.std(errors) / np.sqrt(300) + 5e-4
    assert np.std(errors) < 0.009, "0.08 over the square root of 250 is 0.005; vehicles of one place are alike"


# What was seen is kept


@pytest.fixture
def picture_file(tmp_path, town):
    town[0].fingerprint = lambda: "f" * 64
    return town[0]


def test_looks_are_kept_and_used_again(tmp_path, picture_file):
    looked = []

    class Counting(RectangleDetector):
        def __call__(self, image, threshold=None):
            looked.append(1)
            return super().__call__(image)

    jobs = jobs_of(picture_file)

    def run(folder):
        with TileCache("key", folder) as cache:
            return sweep_twice(jobs, np.arange(len(jobs)), lambda some: on_threads(some, Counting(), 2), cache)

    first = run(tmp_path)
    assert len(looked) == 2 * len(jobs) and first.swept.from_cache == 0
    again = run(tmp_path)
    assert len(looked) == 2 * len(jobs) and again.swept.from_cache == len(jobs)
    assert np.array_equal(first.boxes["drawing"].xylwa, again.boxes["drawing"].xylwa)


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path, picture_file):
    jobs = jobs_of(picture_file)
    done = []

    def until_the_seventh(some):
        for item in on_threads(some, RectangleDetector(), 1):
            if len(done) == 7:
                raise KeyboardInterrupt
            done.append(item[0])
            yield item

    with pytest.raises(KeyboardInterrupt), TileCache("key", tmp_path) as cache:
        sweep_twice(jobs, np.arange(len(jobs)), until_the_seventh, cache)
    with TileCache("key", tmp_path) as cache:
        found = sweep_twice(jobs, np.arange(len(jobs)), lambda some: on_threads(some, RectangleDetector(), 1), cache)
    assert found.swept.from_cache == 7
    assert np.array_equal(found.boxes["drawing"].xylwa, swept(picture_file).boxes["drawing"].xylwa)


def test_a_damaged_cache_is_begun_anew_and_a_missing_folder_costs_nothing(tmp_path, picture_file):
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "key.sqlite").write_bytes(b"not a database at all" * 100)
    tile, looks = tiles(picture_file, 1.0)[0], Looks(Boxes([[1, 2, 4, 3, 0.5]], [0.7]), Boxes.empty())
    with TileCache("key", tmp_path) as cache:
        cache.put(picture_file, tile, looks)
        back = cache.get(picture_file, tile)
    assert back is not None and np.array_equal(back.fine.xylwa, looks.fine.xylwa) and len(back.coarse) == 0
    (tmp_path / "file").write_text("a file where a folder should be")
    with TileCache("key", tmp_path / "file") as cache:
        cache.put(picture_file, tile, looks)
        assert cache.get(picture_file, tile) is None


@pytest.mark.slow
def test_kept_looks_that_changed_on_disk_are_had_again(tmp_path, picture_file):
    """Any byte of any page: what is not as it was kept is not used, and no error reaches the sweep."""
    jobs = jobs_of(picture_file)

    def look(some):
        return on_threads(some, RectangleDetector(), 1)

    kept = TileCache("key", tmp_path)
    with kept:
        whole = sweep_twice(jobs, np.arange(len(jobs)), look, kept)
    content = kept.path.read_bytes()
    rng, again = np.random.default_rng(0), 0
    for _ in range(20):
        damaged = bytearray(content)
        for at in rng.integers(0, len(content), 8):
            damaged[at] ^= 1 << rng.integers(8)
        kept.path.write_bytes(damaged[: rng.integers(len(content) // 2, 2 * len(content))])
        with TileCache("key", tmp_path) as cache:
            found = sweep_twice(
                jobs, np.arange(len(jobs)), lambda some: on_threads(some, RectangleDetector(), 1), cache
            )
        assert np.array_equal(found.boxes["drawing"].xylwa, whole.boxes["drawing"].xylwa)
        again += found.swept.from_cache < len(jobs)
    assert again > 5


def test_caches_that_nobody_used_for_months_are_deleted(tmp_path):
    """Once in a process: a run opens eight caches, and went through a folder of 17,000 each time, in 0.1 s or more."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    for name, left in (("new", {"new.sqlite"}), ("second", {"new.sqlite", "old.sqlite", "second.sqlite"})):
        (folder / "old.sqlite").touch()
        os.utime(folder / "old.sqlite", (0, 0))
        TileCache(name, tmp_path).__exit__()
        assert {p.name for p in folder.glob("*.sqlite")} == left


def test_a_cache_of_another_user_is_read_and_stops_nothing(tmp_path, picture_file, monkeypatch):
    """In a folder that several share, a run ended with "writing failed (Permission denied)" of its output."""
    tile, looks = tiles(picture_file, 1.0)[0], Looks(Boxes([[1, 2, 4, 3, 0.5]], [0.7]), Boxes.empty())
    TileCache("old", tmp_path).__exit__()
    os.utime(tmp_path / "tiles" / "old.sqlite", (0, 0))
    with TileCache("key", tmp_path) as cache:
        cache.put(picture_file, tile, looks)

    def not_mine(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "utime", not_mine)
    monkeypatch.setattr(Path, "unlink", not_mine)
    with TileCache("key", tmp_path) as cache:
        assert cache.get(picture_file, tile) is not None


def test_without_a_key_nothing_is_kept(picture_file, tmp_path):
    with TileCache(None, tmp_path) as cache:
        cache.put(picture_file, Tile(0, 0, 10, 10, 10, 10), Looks(Boxes.empty(), Boxes.empty()))
        assert cache.get(picture_file, Tile(0, 0, 10, 10, 10, 10)) is None
    assert not (tmp_path / "tiles").exists()


@pytest.mark.parametrize("code", [CODE, CODE_OF_FINDERS, FEATURE_CODE, EMBEDDING_CODE])
def test_the_files_that_decide_over_what_is_kept_are_there(code):
    package = Path(orthoscale.__file__).parent
    assert not [pattern for pattern in code if not list(package.glob(pattern))]


def test_all_of_detect_that_tiles_and_measurer_use_is_part_of_the_key_and_nothing_else():
    """Of what is seen in a tile, and measured of a vehicle; what follows from these is computed each time."""
    used, new = set(), {"detect.tiles", "detect.measurer"}
    while new:
        used |= new
        new = {each for name in new for each in imports(name) if each.startswith("detect.")} - used
    assert {pattern for pattern in CODE if pattern.startswith("detect/")} == {
        f"{name.replace('.', '/')}.py" for name in used
    }


def test_all_of_the_core_that_finders_compute_with_is_part_of_the_key():
    """All but what only describes pictures and tiles, compares results, or makes standards, which are themselves in the
    key."""
    finders = {name for name in MODULES if name.startswith("anchors.")}
    used = {each for name in {*finders, "core.anchors"} for each in imports(name) if each.startswith("core.")}
    used -= {"core.by_value", "core.detections", "core.source", "core.measuring.parking"}
    assert {pattern for pattern in CODE_OF_FINDERS if pattern.startswith("core/")} == {
        f"{name.replace('.', '/')}.py" for name in used
    }


def test_the_key_follows_the_code_and_only_that(tmp_path):
    def hashed(constant: str, other: str) -> str:
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        (folder / "code.py").write_text(f"LIMIT = {constant}  # m")
        (folder / "other.py").write_text(other)
        return code_hash(("code.py",), folder)

    assert hashed("0.5", "x") == hashed("0.5", "y") != hashed("0.6", "x")


def test_code_of_every_kind_of_picture_is_part_of_the_key():
    package = Path(orthoscale.__file__).parent
    pictures = {path for path in package.rglob("*.py") if "def fingerprint(self)" in path.read_text()}
    assert len(pictures) >= 3
    for code in (CODE, CODE_OF_FINDERS):
        assert pictures <= {path for pattern in code for path in package.glob(pattern)}


def test_the_key_holds_the_input_and_the_settings(picture_file):
    class Other(RectangleDetector):
        sha256 = "b" * 64
        layout = None

    detector = Other()
    key = cache_key([picture_file], detector, 1.0)
    assert key == cache_key([picture_file], detector, 1.0)
    others = {cache_key([picture_file], detector, 1.1)}
    detector.sha256 = "c" * 64
    others.add(cache_key([picture_file], detector, 1.0))
    detector.sha256, detector.passes = "b" * 64, Passes.COARSE_FIRST
    others.add(cache_key([picture_file], detector, 1.0))
    detector.passes = Passes.FINE_FIRST
    picture_file.fingerprint = lambda: "0" * 64
    others.add(cache_key([picture_file], detector, 1.0))
    assert len(others) == 4 and key not in others
    assert cache_key([Drawing(100, 100, Boxes.empty())], detector, 1.0) is None, "content unknown: nothing is kept"


def test_the_fingerprint_follows_the_content_of_small_and_large_files(tmp_path):
    a, b = tmp_path / "a.tif", tmp_path / "b.tif"
    a.write_bytes(b"x" * 1000)
    b.write_bytes(b"x" * 1000)
    assert fingerprint([a]) == fingerprint([b]) != fingerprint([a, b])
    b.write_bytes(b"x" * 999 + b"y")
    assert fingerprint([a]) != fingerprint([b])
    a.write_bytes(b"x" * 10_000_000)
    before = fingerprint([a])
    a.rename(tmp_path / "moved.tif")
    assert fingerprint([tmp_path / "moved.tif"]) == before
    with (tmp_path / "moved.tif").open("r+b") as file:  # between the pieces that are read: the time of change tells
        file.seek(5_000_123)
        file.write(b"y")
    os.utime(tmp_path / "moved.tif", ns=(1, 1))
    assert fingerprint([tmp_path / "moved.tif"]) != before


def test_workers_must_be_one_or_more():
    assert worker_count(3) == 3 and 1 <= worker_count(None) <= 8
    with pytest.raises(UsageError, match="--workers"):
        worker_count(0)


# The command


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """The example town nine times, 4590 x 4590 px without compression: a few seconds of work."""
    town = cv2.imread(str(Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"))
    path = tmp_path_factory.mktemp("wide") / "wide.tif"
    cv2.imwrite(str(path), np.tile(town, (3, 3, 1)), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    return path


def command(*arguments, cache):
    environment = {**os.environ, "ORTHOSCALE_CACHE": str(cache)}
    job = [sys.executable, "-m", "orthoscale", *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    # A shell's background jobs, this test among them, start with Ctrl-C ignored, and hand that on.
    listening = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    return subprocess.Popen(job, text=True, env=environment, **pipes, **listening)


def wait_for_tiles(cache, count, process):
    """Until `count` tiles are in the cache."""
    until = time.monotonic() + 120
    while time.monotonic() < until and process.poll() is None:
        for path in cache.glob("tiles/*.sqlite"):
            try:
                with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as file:
                    if file.execute("SELECT count(*) FROM looks").fetchone()[0] >= count:
                        return
            except sqlite3.OperationalError:
                pass  # just being made
        time.sleep(0.02)
    raise AssertionError(f"no {count} tiles were kept ({process.poll()})")


@pytest.mark.slow
def test_a_killed_sweep_continues_and_ctrl_c_leaves_nothing_half_written(wide, tmp_path):
    (out := tmp_path / "out").mkdir()
    words = [wide, "--zoom", 0.7, "--fleet", "DE", "--measurer", "none", "--anchors", "none", "--exhaustive", "--json"]
    job = ["fix", *words, "--out", out / "a.tif"]
    before = wide.read_bytes()
    killed = command(*job, cache=tmp_path)
    wait_for_tiles(tmp_path, 2, killed)
    killed.kill()
    killed.wait()
    stopped = command(*job, cache=tmp_path)
    wait_for_tiles(tmp_path, 4, stopped)
    stopped.send_signal(signal.SIGINT)
    _, told = stopped.communicate()
    assert stopped.returncode == 130 and "nothing was written" in told and "Traceback" not in told
    assert list(out.iterdir()) == []

    resumed = json.loads(command(*job, cache=tmp_path).communicate()[0])
    assert 4 <= resumed["sweep"]["from_cache"] < resumed["sweep"]["tiles"] == resumed["sweep"]["of"]
    assert {p.name for p in out.iterdir()} == {"a.tif", "a.tif.json", "a.tif.png", "a.tif.html"}
    fresh = json.loads(command("estimate", *words, "--no-cache", cache=tmp_path / "no").communicate()[0])
    assert fresh["sweep"]["from_cache"] == 0 and not (tmp_path / "no").exists()
    assert fresh["scale"] == resumed["scale"]
    assert wide.read_bytes() == before


@pytest.mark.slow
def test_an_anytime_sweep_looks_at_part_and_agrees_with_all_of_it(wide, monkeypatch):
    monkeypatch.setattr("orthoscale.detect.sweep.FIRST", 4)
    options = {"fleet": "DE", "zoom": 0.7, "measurer": "none", "anchors": ["none"], "cache": False}
    part, again = (estimate(wide, **options, target=0.006, workers=n) for n in (1, 2))
    whole = estimate(wide, **options, exhaustive=True)
    assert part.scale.value == again.scale.value, "the same with any number of workers"
    swept = part.detections.swept
    assert len(swept.tiles) < swept.total == len(whole.detections.swept.tiles)
    assert part.scale.parts["sampling"] <= 0.006
    assert part.scale.value == pytest.approx(whole.scale.value, rel=3 * 0.006)
