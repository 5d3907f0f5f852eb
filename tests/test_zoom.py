"""The zoom search with the shipped detector, over the range of vehicle sizes, and what it costs to find nothing."""

import cv2
import numpy as np
import pytest
from support.drawings import Windows, WithoutNetwork

import orthoscale
from orthoscale.core.boxes import Boxes
from orthoscale.detect.detector import Detector
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import find_vehicles
from orthoscale.detect.tie_break import CONTESTED
from orthoscale.detect.zoom import search_zoom
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene, write_ortho

GERMAN = 4.37  # mean length [m]


class Pixels:
    """An RGB array as a picture."""

    def __init__(self, pixels, name="pixels"):
        self.name, self.pixels = name, pixels
        self.height, self.width = pixels.shape[:2]

    def read(self, x, y, width, height, out_width, out_height):
        how = cv2.INTER_AREA if out_width < width else cv2.INTER_CUBIC
        return cv2.resize(self.pixels[y : y + height, x : x + width], (out_width, out_height), interpolation=how)


class Counting:
    """A detector that counts the pixels it is given."""

    def __init__(self, detector):
        self.detector, self.card, self.pixels = detector, detector.card, 0

    def __call__(self, image, threshold=None):
        self.pixels += image.shape[0] * image.shape[1]
        return self.detector(image, threshold)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A street at 0.07 m/px: vehicles are 62 px long."""
    file = tmp_path_factory.mktemp("street") / "street.png"
    scene = make_scene(seed=3, fleet=load_fleet("DE"), extent_m=70, n_vehicles=50, style="city")
    write_ortho(scene, file, 0.07, seed=3)
    return cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB)


@pytest.fixture(scope="module")
def detector():
    return Detector()


@pytest.mark.slow
@pytest.mark.parametrize("length", [8, 13, 30, 62, 125, 400])
def test_vehicles_of_8_to_400_px_are_found_at_their_size(street, detector, length):
    factor = length / (GERMAN / 0.07)
    half = min(int(1800 / factor), len(street) // 2)  # 3600 px at most, from the middle
    middle = slice(len(street) // 2 - half, len(street) // 2 + half)
    part = street[middle, middle]
    size = round(part.shape[1] * factor), round(part.shape[0] * factor)
    picture = Pixels(cv2.resize(part, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC))
    choice = search_zoom([picture], detector, detector.card)
    assert choice.vehicle_px == pytest.approx(length, rel=0.25), "the right octave, and better"
    assert choice.zoom == pytest.approx(min(detector.card.best_length / choice.vehicle_px, 4.0))
    assert choice.rival < 0.6


def test_a_picture_without_vehicles_is_soon_done_with():
    """Whatever its size: as much is looked at as takes some seconds, not all of it at all zooms."""

    def nothing(image, threshold=None):
        return Boxes.empty()

    nothing.card = Detector().card
    for side in (2000, 6000):
        blank = Counting(nothing)
        choice = search_zoom([Pixels(np.zeros((side, side, 3), np.uint8))], blank, blank.card)
        assert choice.vehicle_px is None and choice.zoom == 1.0
        assert blank.pixels < 150e6
        assert len(choice.looks) == 7, "all zooms were looked at"


def test_a_picture_too_small_for_any_vehicle_has_none(detector):
    """Of a photo of less than 9 px no zoom was tried, and to say so was a bug."""
    with pytest.raises(TooLittleEvidence, match="no vehicles found at any resampling factor from 4 to 4"):
        find_vehicles([Pixels(np.zeros((8, 8, 3), np.uint8))], detector, effort=Effort(cache=False))


def test_only_promising_zooms_are_looked_at_more_widely():
    """A few vehicles 40 px long in a large picture: the search goes on, but not at zooms where they are invisible."""
    rng = np.random.default_rng(0)
    spots = rng.uniform(100, 11900, (24, 2))
    cars = Boxes(np.column_stack([spots, np.tile([40, 17, 0.3], (24, 1))]), np.full(24, 0.6))
    seen = {}

    class Counted(Windows):
        def read(self, x, y, width, height, out_width, out_height):
            seen[round(out_width / width, 3)] = seen.get(round(out_width / width, 3), 0) + out_width * out_height
            return super().read(x, y, width, height, out_width, out_height)

    picture = Counted(12000, 12000)

    def detect(image, threshold=None):
        x, y, zoom = picture.window_of(image)
        usable = 12 <= 40 * zoom <= 70
        return cars.mapped(zoom, (-x * zoom, -y * zoom)) if usable else Boxes.empty()

    card = Detector().card
    choice = search_zoom([picture], detect, card)
    assert choice.vehicle_px == pytest.approx(40, rel=0.03) and choice.votes >= 6
    zooms = np.array(sorted(seen))
    pixels = np.array([seen[z] for z in zooms])
    assert pixels[(zooms > 0.3) & (zooms < 1.5)].max() > 40e6
    assert pixels[zooms > 3].sum() < 15e6


class Seen(WithoutNetwork):
    """A detector that sees boxes of a picture wherever they are usable; those with chance below 1 now and then."""

    def __init__(self, picture, boxes, chance):
        self.picture, self.boxes, self.chance = picture, boxes, np.asarray(chance)
        self.card, self.sha256 = Detector().card, ""

    def __call__(self, image, threshold=None):
        x, y, zoom = self.picture.window_of(image)
        shown = self.boxes.mapped(zoom, (-x * zoom, -y * zoom))
        usable = (shown.length > 10) & (shown.length < 80) & (shown.centre >= 0).all(1)
        luck = np.random.default_rng(round(1000 * zoom)).uniform(size=len(shown))  # the same from window to window
        return shown[usable & (luck < self.chance)]


def scattered(seed, side, length, count, scatter=0.08):
    rng = np.random.default_rng(seed)
    lengths = length * np.exp(rng.normal(0, scatter, count))
    centre = rng.uniform(length, side - length, (count, 2))
    return Boxes(np.column_stack([centre, lengths, 0.42 * lengths, rng.uniform(0, 3, count)]), np.full(count, 0.55))


@pytest.mark.parametrize("count, luck", [(2500, 0.25), (120, 0.6)])
def test_many_mistakes_in_a_large_picture_do_not_outvote_few_vehicles(count, luck):
    side = 4000
    picture = Windows(side, side)
    vehicles, glints = scattered(1, side, 160, 10), scattered(2, side, 20, count)
    chance = np.r_[np.full(10, 0.95), np.full(count, luck)]
    detector = Seen(picture, Boxes.concatenate([vehicles, glints]), chance)
    choice = search_zoom([picture], detector, detector.card)
    assert choice.vehicle_px == pytest.approx(160, rel=0.15) and choice.as_likely is None


@pytest.mark.parametrize("count, found", [(1, False), (12, True)])
def test_one_thing_that_two_zooms_agree_on_is_no_size_of_vehicles(count, found):
    picture = Windows(1700, 1700)
    detector = Seen(picture, scattered(1, 1700, 60, count), np.ones(count))
    choice = search_zoom([picture], detector, detector.card)
    assert (choice.vehicle_px is not None) == found and choice.votes > 0


@pytest.mark.parametrize("scatter, contested", [(0.08, False), (0.3, True)])
def test_lengths_that_scatter_more_than_those_of_vehicles_are_contested(scatter, contested):
    picture = Windows(1700, 1700)
    detector = Seen(picture, scattered(1, 1700, 60, 60, scatter), np.ones(60))
    choice = search_zoom([picture], detector, detector.card)
    assert choice.vehicle_px == pytest.approx(60, rel=0.15) and (choice.rival > CONTESTED) == contested


@pytest.mark.parametrize("other", [20, 90])
def test_two_sizes_as_likely_are_not_guessed_between_unless_distance_explains_them(other):
    side = 1700  # small enough to be looked at as a whole
    picture = Windows(side, side)
    both = Boxes.concatenate([scattered(1, side, 180, 8), scattered(2, side, other, 20)])
    detector = Seen(picture, both, np.ones(len(both)))
    with pytest.raises(EvidenceDisagrees, match=r"vehicles may be \d+ px long, or \d+ px") as refusal:
        find_vehicles([picture], detector, effort=Effort(workers=1, cache=False))
    assert "--zoom 0.2" in refusal.value.hint and "--gsd-hint" in refusal.value.hint
    if other == 90:  # frames from two altitudes show that
        assert search_zoom([picture, picture], detector, detector.card).as_likely is None


@pytest.mark.parametrize("wish", [{"zoom": 1e6}, {"gsd_hint": 50}])
def test_zooms_at_which_no_vehicle_could_be_seen_are_refused(tmp_path, wish):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((200, 200, 3), np.uint8))
    with pytest.raises(UsageError, match="would search for vehicles .* px long"):
        orthoscale.estimate(tmp_path / "a.png", **wish)
