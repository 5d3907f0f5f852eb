"""Dark vehicles whose shadows merge with them: told by light ones, and corrected by no more than can be believed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.drawings import Drawing
from test_enlarged import Pixels
from test_remeasure import QUIET, Sees, found, proposed

from orthoscale.core.boxes import Boxes
from orthoscale.detect.measurer import Measured, Measurer
from orthoscale.detect.remeasure import _without_shadows, remeasured
from orthoscale.detect.shade import (
    CLEAR_RANGE,
    DARK,
    LEAST_PAINTED,
    LIGHT,
    OF_PAINT_SD,
    SHADOW_CONTRAST,
    SHADOW_PX,
    larger,
    lightness,
    shadow_contrast,
    shadows,
)

SIZE = np.array([56.0, 24.0])
TYPICAL = np.array([16.0, 7.0])  # length and width of small vehicles, whose shadows cannot be separated [px]
USUAL = SHADOW_PX / TYPICAL


def crop(paint: int, shadow: int = 20, ground: int = 120) -> np.ndarray:
    """A vehicle of that paint, its shadow along one side of it, in the form of the measurer's crops."""
    grey = np.full((48, 96), ground, np.uint8)
    grey[36:46, 20:78] = shadow
    grey[12:36, 20:76] = paint
    return np.repeat(grey[..., None], 3, 2)


@pytest.mark.parametrize("paint, expected", [(20, 0.0), (70, 0.5), (120, 1.0), (220, 2.0)])
def test_paint_is_told_between_shadow_and_ground(paint, expected):
    assert lightness(crop(paint), SIZE) == pytest.approx(expected)


def test_where_nothing_casts_a_shadow_nothing_is_told():
    assert np.isnan(lightness(crop(20, shadow=110), SIZE))


@pytest.mark.parametrize("gain, contrast", [(1.0, SHADOW_CONTRAST), (0.5, 0.5 * SHADOW_CONTRAST * 220 / CLEAR_RANGE)])
def test_haze_leaves_less_of_shadows(gain, contrast):
    """They are as much less dark as everything is; a clear picture's are what they were."""
    windows = [np.tile(np.linspace(20, 240, 111), (50, 1)) * gain + 255 * (1 - gain) / 2] * 3
    assert shadow_contrast(windows) == pytest.approx(contrast, rel=0.03)
    assert shadow_contrast([]) == SHADOW_CONTRAST


def test_in_haze_paint_is_told_as_in_clear_air():
    hazy = (crop(40, shadow=70) * 0.5 + 110).astype(np.uint8)
    assert np.isnan(lightness(hazy, SIZE, 30.0))
    assert lightness(hazy, SIZE, 20.0) == pytest.approx(lightness(crop(40, shadow=70), SIZE), abs=0.05)


class SeesThroughHaze(Sees):
    """Keeps how dark shadows had to be."""

    def __call__(self, *args: object, **options: object) -> Measured:
        self.contrast = options["contrast"]
        return super().__call__(*args, **options)


def test_how_dark_shadows_must_be_the_picture_tells():
    truth = Boxes(np.array([[150.0 * k + 100, 100, 60, 25, 0] for k in range(8)]), np.ones(8))
    clear, hazy = Drawing(1300, 300, truth), Drawing(1300, 300, truth)
    hazy.read = lambda *where: (clear.read(*where) * 0.3 + 120).astype(np.uint8)
    told = []
    for picture in (clear, hazy):
        sees = SeesThroughHaze(truth)
        remeasured([picture], found(proposed(truth)), sees, QUIET)
        told.append(sees.contrast)
    assert told[1] < 0.5 * told[0] <= 0.5 * SHADOW_CONTRAST


def test_the_measurer_tells_paint_by_how_dark_shadows_must_be():
    hazy = cv2.copyMakeBorder((crop(40, shadow=70) * 0.3 + 110).astype(np.uint8), 60, 60, 60, 60, cv2.BORDER_REPLICATE)
    boxes = Boxes(np.array([[60 + 48.0, 60 + 24.0, 56, 24, 0]]), np.ones(1))
    measurer, picture = Measurer(), Pixels(hazy)
    assert np.isnan(measurer(picture, boxes, looks=1).light[0])
    assert measurer(picture, boxes, looks=1, contrast=10.0).light[0] < 1


def scene(larger: tuple[float, float], dark: int, light: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Log sizes (N, 2) of vehicles of one fleet, the first `dark` of them enlarged, and their lightness."""
    rng = np.random.default_rng(seed)
    size = np.log(TYPICAL) + rng.normal(0, [0.07, 0.04], (dark + light, 2))
    size[:dark] += larger
    return size, np.repeat([DARK / 2, LIGHT + 0.3], [dark, light])


def test_what_shadows_add_is_found():
    assert shadows(*scene((0.05, 0.12), 300, 300)) == pytest.approx([0.05, 0.12], abs=0.02)


def test_how_far_apart_the_medians_of_few_are_is_known():
    """As if of many, the variance was a fifth too large."""
    dark, bright = np.random.default_rng(0).normal(0, (0.07, 0.04), (2, 10_000, 6, 2))
    told = [larger(*groups) for groups in zip(dark, bright, strict=True)]
    apart, variance = map(np.array, zip(*told, strict=True))
    assert variance.mean(0) == pytest.approx(apart.var(0), rel=0.04)


def test_what_is_no_vehicle_says_nothing_of_shadows():
    """Dark roofs and tanks beside the vehicles, of any size."""

    def told(size: np.ndarray, light: np.ndarray, none: np.ndarray) -> dict[str, Measured]:
        count = len(size)
        boxes = Boxes(np.c_[np.zeros((count, 2)), np.exp(size), np.zeros(count)], np.ones(count))
        kind = np.where(none[:, None], [0, 0, 0, 0, 1.0], [1.0, 0, 0, 0, 0])
        return {"a": Measured(boxes, np.ones((count, 4)), np.ones((count, 4)), kind, light)}

    size, light = scene((0.05, 0.12), 200, 200)
    roofs = size[:100] + 0.2
    vehicle, none = np.zeros(len(size), bool), np.ones(len(roofs), bool)
    _, alone = _without_shadows(told(size, light, vehicle), 1.0)
    both = told(np.r_[size, roofs], np.r_[light, np.zeros(100)], np.r_[vehicle, none])
    assert _without_shadows(both, 1.0)[1] == pytest.approx(alone, rel=1e-12)


def test_half_as_many_lorries_among_the_dark_ones_change_nothing():
    size, light = scene((0.05, 0.12), 200, 200)
    lorries = np.log([33.0, 10.0]) + np.zeros((100, 2))
    alone = shadows(size, light)
    assert shadows(np.r_[size, lorries], np.r_[light, np.zeros(100)]) == pytest.approx(alone, abs=0.015)


def test_vehicles_neither_dark_nor_light_say_nothing():
    size, light = scene((0.05, 0.12), 200, 200)
    between = np.log([16.0, 8.2]) + np.zeros((400, 2))
    assert shadows(np.r_[size, between], np.r_[light, np.full(400, 0.6)]) == pytest.approx(
        shadows(size, light), abs=0.002
    )


def test_paint_keeps_its_part_however_many_there_are():
    """White vans may be longer than black cars: some of any difference is left."""
    size, light = scene((0.1, 0.2), 20_000, 20_000)
    assert [0.1, 0.2] - shadows(size, light) == pytest.approx(OF_PAINT_SD**2 / USUAL, abs=0.0015)


def test_shadows_only_add():
    """Where dark vehicles are smaller, hardly anything is taken off, and never added."""
    left = shadows(*scene((-0.05, -0.12), 300, 300))
    assert (left > 0).all() and (left < 0.01).all()


def test_few_are_hardly_believed():
    """Against draws of a known truth: what is taken off errs by less than if nothing, all, or the usual were."""
    rng = np.random.default_rng(1)
    kept, told, all_, usual = [], [], [], []
    for seed in range(200):
        paint, truth = rng.normal(0, OF_PAINT_SD, 2), rng.exponential(USUAL)
        size, light = scene(tuple(truth + paint), 8, 8, seed)
        apart = np.median(size[:8], 0) - np.median(size[8:], 0)
        kept.append(truth)
        told.append(shadows(size, light) - truth)
        all_.append(apart - truth)
        usual.append(USUAL - truth)
    rms = [np.sqrt(np.mean(np.square(e))) for e in (told, kept, all_, usual)]
    assert rms[0] < 0.9 * min(rms[1:])
    assert abs(np.mean(told)) < 0.006, "unbiased over scenes as the prior draws them"


@pytest.mark.parametrize("dark, light", [(LEAST_PAINTED - 1, 50), (50, LEAST_PAINTED - 1), (1, 0)])
def test_where_too_few_can_be_compared_the_usual_is_taken_off(dark, light):
    size, paint = scene((0.1, 0.2), dark, light)
    usual = SHADOW_PX / np.exp(np.median(size, 0))
    assert shadows(size, paint) == pytest.approx(usual)
    assert shadows(size, paint, 2.0) == pytest.approx(2 * usual), "in pixels that show detail"
    assert shadows(size + np.log(3), paint) == pytest.approx(usual / 3), "near vehicles are separable"


@pytest.mark.parametrize("light", [0, 50])
def test_without_dark_vehicles_nothing_is_taken_off(light):
    assert (shadows(*scene((0.1, 0.2), 0, light)) == 0).all()


class SeesShadows(Sees):
    """Takes half of the vehicles, the dark ones, for 20 % wider than they are."""

    def __call__(self, *args: object, **options: object) -> Measured:
        told = super().__call__(*args, **options)
        dark = told.boxes.centre[:, 0].astype(int) % 2 == 0
        xylwa = told.boxes.xylwa.copy()
        xylwa[dark, 3] *= 1.2
        boxes = Boxes(xylwa, told.boxes.score)
        return Measured(boxes, told.sigma, told.seen, told.kind, np.where(dark, 0.0, 1.5))


def test_measured_vehicles_lose_their_shadows():
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(10) * 150 + 100, np.arange(8) * 120 + 100)
    centre = np.c_[x.ravel() + np.arange(80) % 2, y.ravel()]
    truth = Boxes(np.c_[centre, rng.normal(60, 3, 80), rng.normal(25, 0.8, 80), np.zeros(80)], np.ones(80))
    picture = Drawing(1800, 1200, truth)
    got = remeasured([picture], found(proposed(truth)), SeesShadows(truth), QUIET)
    width = got.boxes["drawing"].xylwa[:, 3]
    dark = got.boxes["drawing"].centre[:, 0].astype(int) % 2 == 0
    assert np.median(width[dark]) / np.median(width[~dark]) == pytest.approx(1.0, abs=0.03)
    assert np.median(width[~dark]) == pytest.approx(25, abs=0.3)
    assert any("dark vehicles" in note for note in got.notes)


@pytest.mark.parametrize("added, told", [(2e-4, False), (2e-3, True)])
def test_a_correction_of_nothing_is_not_told(monkeypatch, added, told):
    """ "By +0.0 % in length and +0.0 % in width: corrected" stood in the notes."""
    truth = Boxes(np.array([[100.0, 100, 60, 25, 0]]), np.ones(1))
    monkeypatch.setattr("orthoscale.detect.remeasure.shadows", lambda *_: np.array([0, added]))
    got = remeasured([Drawing(300, 200, truth)], found(proposed(truth)), Sees(truth), QUIET)
    assert any("dark vehicles" in note for note in got.notes) == told
