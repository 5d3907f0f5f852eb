"""GPS positions of frames as evidence on the scale of a reconstruction."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyproj
import pytest
from support.flights import UNIT, found_by
from support.models import make_model, save
from support.photos import write_photo

import orthoscale
from orthoscale.core.claims import metric_claim, perhaps_metric
from orthoscale.core.control import LEVEL_SD
from orthoscale.core.evidence import Evidence
from orthoscale.core.gps import FEWEST_POSITIONS, bend, by_positions, mirrored
from orthoscale.core.normal import Z90
from orthoscale.core.pooling.combining import combined
from orthoscale.core.pooling.posterior import Posterior
from orthoscale.core.scale import Scale
from orthoscale.errors import EvidenceDisagrees, TooLittleEvidence, UsageError
from orthoscale.formats.detections.own import save_detections
from orthoscale.sources import positions
from orthoscale.sources.colmap import ColmapSource
from orthoscale.sources.opening import open_source

SCALE = 8.0  # [m per unit]
DISTANCE = "0,0,0 4,0,0 {:.3f}"  # of two points 4 units apart, in metres


def lawnmower(count, extent):
    """(count, 2) along strips to and fro [m]."""
    strips = round(np.sqrt(count / 2))
    along = np.linspace(0, extent, -(-count // strips))
    rows = [np.stack([along[:: (-1) ** k], np.full(len(along), k * extent / strips)], 1) for k in range(strips)]
    return np.concatenate(rows)[:count]


def circle(count, extent):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return extent / 2 * np.stack([np.cos(angle), np.sin(angle)], 1)


def times(path, speed=5.0):
    return np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))] / speed


def wandering(rng, seconds, sd, memory):
    """(N, 2) Gauss-Markov errors [m]; a random walk of `sd` metres per root of a second where `memory` is infinite."""
    steps = np.diff(seconds, prepend=seconds[0])
    keep = np.exp(-steps / memory)
    sds = sd * np.sqrt(steps if np.isinf(memory) else 1 - keep**2)
    out = np.zeros((len(seconds), 2))
    out[0] = rng.normal(0, 0.0 if np.isinf(memory) else sd, 2)
    for k in range(1, len(seconds)):
        out[k] = keep[k] * out[k - 1] + rng.normal(0, sds[k], 2)
    return out


def units_of(path):
    """The path in units, turned and shifted."""
    return path / SCALE @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + (3.0, -40.0)


@pytest.mark.slow
def test_nine_of_ten_intervals_hold_whatever_the_errors_are():
    """Lawnmower and circle, errors that wander in seconds or in minutes, little or much; ground that is not level. Of
    1,440 others 92.3 % hold, of each kind of error 88 to 98 %; chance makes 1.2 % (one sigma) of the 480 here."""
    rng = np.random.default_rng(0)
    errors = [(0.5, 60, 0.1), (1.0, 120, 0.1), (1.0, 600, 0.3), (1.5, 300, 0.1), (0.5, 30, 0.5), (0.1, np.inf, 0.2)]
    holds = []
    for sd, memory, white in errors * 20:
        for path in (lawnmower(20, 100), lawnmower(40, 150), circle(20, 80), circle(40, 150)):
            seconds = times(path)
            seen = path + wandering(rng, seconds, sd, memory) + rng.normal(0, white, path.shape)
            units = units_of(path) * np.exp(rng.normal(0, LEVEL_SD))
            found, why = by_positions(units, seen, np.floor(seconds))
            assert found is not None, why
            holds.append(abs(np.log(found.value / SCALE)) < Z90 * found.relative_sd)
    assert 0.87 <= np.mean(holds) <= 0.95


def test_exact_positions_give_the_scale_however_the_model_lies():
    path = lawnmower(20, 100)
    found, why = by_positions(units_of(path), path, times(path))
    assert found.value == pytest.approx(SCALE) and not why and not found.doubt
    assert LEVEL_SD < found.relative_sd < 0.01
    assert found.says == "GPS positions of 20 frames"


def test_the_sigma_grows_as_the_flight_gets_smaller_and_in_the_end_positions_say_nothing():
    sds = [by_positions(units_of(p), p, times(p))[0].relative_sd for p in (circle(20, size) for size in (400, 100, 30))]
    assert sds[0] < sds[1] < sds[2]
    hover = circle(20, 6.0)
    assert by_positions(units_of(hover), hover, times(hover)) == (None, "they lie within 6 m")


def test_errors_that_no_receiver_makes_do_not_average_out():
    """As of `weedon`: 2.6 m along each axis, a standard deviation of 55 m; the same of a receiver's size do."""
    rng = np.random.default_rng(0)
    path = lawnmower(200, 130)
    noise = rng.normal(size=path.shape)
    small, large = (by_positions(units_of(path), path + sd * noise, times(path))[0].relative_sd for sd in (1.0, 2.6))
    assert small < 0.01 and 0.03 < large < 0.06


def test_mistakes_are_left_out_and_the_others_doubted():
    path = lawnmower(20, 100)
    wrong = path.copy()
    wrong[[4, 11]] += (60.0, -30.0)
    found, _ = by_positions(units_of(path), wrong, times(path))
    assert found.value == pytest.approx(SCALE, rel=1e-3)
    assert found.doubt == pytest.approx(0.1) and found.says == "GPS positions of 18 frames"
    wrong[:8] += np.random.default_rng(0).normal(0, 60, (8, 2))
    assert by_positions(units_of(path), wrong, times(path)) == (None, "they do not fit its cameras")


def test_positions_of_another_flight_say_nothing():
    path = lawnmower(40, 100)
    other = np.random.default_rng(0).permutation(path)
    assert by_positions(units_of(path), other, times(path)) == (None, "they do not fit its cameras")


def test_positions_that_several_frames_have_are_no_evidence():
    """The last fix of a receiver, a video's one position, degrees with few digits."""
    path = lawnmower(40, 100)
    for shared in (np.zeros_like(path), np.repeat(path[::2], 2, axis=0), 30.0 * np.round(path / 30)):
        assert by_positions(units_of(path), shared, times(path)) == (None, "")
    some = path.copy()
    some[1:10] = some[0]  # take-off
    assert by_positions(units_of(path), some, times(path))[0].says == "GPS positions of 30 frames"


def test_few_positions_say_nothing():
    path = circle(FEWEST_POSITIONS - 1, 100)
    assert by_positions(units_of(path), path, times(path)) == (None, "")


def test_what_decides_the_scale_is_said():
    vehicles = Posterior.normal(np.log(8.0), 0.05)
    for sd, told in ((0.01, ["GPS positions of 9 frames have 96 % of the weight; --no-gps leaves them out"]),
                     (0.08, [])):  # fmt: skip
        gps = Evidence("GPS positions", 8.0, sd, "GPS positions of 9 frames")
        assert [remark.text for remark in combined(vehicles, {"sampling": 0.05}, [gps], "m/model-unit").remarks] == told
    far = Evidence("GPS positions", 10.0, 0.01, "GPS positions of 9 frames")
    assert combined(vehicles, {"sampling": 0.05}, [far], "m/model-unit").conflict > 3


def tagged(folder, metres_per_unit=UNIT, noise=0.2, wrong=(), longitude=8.5, bowl=0.0, altitudes=True):
    """A flight whose frames have GPS positions, at 47 degrees north, and its vehicles. wrong : numbers of the frames
    whose positions are 150 m off. bowl : curvature of what the model makes of flat ground [1/m]."""
    model, turn = make_model()
    save(model, folder / "sparse" / "0", "bin")
    source = ColmapSource.open(folder, need_images=False)
    local = pyproj.Proj(proj="aeqd", lon_0=longitude, lat_0=47.25, ellps="WGS84")
    rng = np.random.default_rng(0)
    (folder / "images").mkdir()
    for k, name in enumerate(source.picture_names):
        *aside, above = metres_per_unit * source.centre(name) @ turn
        east, north = np.array(aside) * (1 + bowl * above) + rng.normal(0, noise, 2)
        east += 150.0 * (k in wrong)
        altitude = [100 + above - bowl * (east**2 + north**2) / 2] * altitudes
        taken = {0x010F: "DJI", 0x9003: f"2026:06:01 12:{k // 12:02d}:{5 * k % 60:02d}"}
        write_photo(
            folder / "images" / name, exif=taken, gps=(*local(east, north, inverse=True), *altitude), size=(640, 480)
        )
    return found_by(folder, turn)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    save_detections(tagged(folder), folder / "boxes.json")
    return folder


def usual(folder):
    return {"fleet": "DE", "detections": folder / "boxes.json", "anchors": ("none",), "measurer": "none"}


def test_the_tags_of_frames_give_a_model_its_scale(flight):
    (found,) = open_source(flight).gps.evidence
    assert abs(np.log(found.value / UNIT)) < 2 * found.relative_sd < 0.04


@pytest.mark.parametrize(("bowl", "told"), [(2e-4, "a bowl, .* 6.. % more"), (-2e-4, "a dome, .* 5.. % less")])
def test_positions_of_a_bent_model_give_the_scale_of_its_ground(tmp_path, bowl, told):
    """Self-calibration bends flat blocks: `weedon` by 6 %, cameras at 75 m. Altitudes show it."""
    tagged(tmp_path, 25.0, bowl=bowl)
    source = open_source(tmp_path)
    source.__dict__["bend_sd"] = 0.06  # as of a flight that looks straight down
    (found,), (note,) = source.gps.evidence, source.gps.notes
    assert found.value == pytest.approx(25.0, rel=0.01) and found.relative_sd < 0.01
    assert re.search(told, note)


def test_without_altitudes_a_bend_is_a_part_of_the_uncertainty(tmp_path):
    tagged(tmp_path, 25.0, bowl=2e-4, altitudes=False)
    source = open_source(tmp_path)
    source.__dict__["bend_sd"] = 0.06
    (found,) = source.gps.evidence
    assert found.value == pytest.approx(26.5, rel=0.01) and 0.06 < found.relative_sd < 0.065 and not source.gps.notes
    source = open_source(tmp_path)
    source.__dict__["bend_sd"] = 0.2
    assert not source.gps.evidence
    assert "they give the scale at its cameras, and how far it is bent is left open" in source.gps.notes[0]


def test_altitudes_that_fall_where_the_cameras_rise_are_noticed():
    """Over a pit below the sea, from a program that lost the sign: 10 m of relief bent the model by 10 %."""
    path = lawnmower(40, 300)
    pit = 10 * ((path - path.mean(0)) ** 2).sum(1) / 150**2
    errors = np.random.default_rng(0).normal(0, 0.5, (2, 40))
    heights = 80 + pit + errors[0] + 0.1 * path[:, 0]
    assert mirrored(path, heights, 400 - pit + errors[1])
    for level in (pit, 0 * pit):
        assert not mirrored(path, heights, 400 + level + errors[1])


@pytest.mark.parametrize("sea", [0.1, 0.3, 0.5, 0.9])
def test_altitudes_across_the_level_of_the_sea_without_a_sign(sea):
    """Of a flight down a slope: they fall with the cameras, and rise again where these go on falling."""
    path, rng = lawnmower(40, 150), np.random.default_rng(5)
    slope = 0.2 * path[:, 0] + 0.1 * path[:, 1] + 4 * np.sin(path[:, 0] / 20)
    tilt = path @ (0.02, -0.03)
    true = slope - np.quantile(slope, sea) + rng.normal(0, 0.2, len(path))
    assert mirrored(path, 60 + slope + tilt, np.abs(true))
    assert not mirrored(path, 60 + slope + tilt, true), "with their signs"
    assert not mirrored(path, 60 + slope + tilt, np.abs(true - true.min())), "above the sea"
    assert not mirrored(path, 60 + rng.normal(0, 1, len(path)), np.abs(rng.normal(0, 1, len(path)))), "errors alone"


def test_mirrored_altitudes_do_not_count(tmp_path, monkeypatch):
    monkeypatch.setattr(positions, "mirrored", lambda *flight: True)
    tagged(tmp_path, 25.0, bowl=2e-4)
    for bend_sd, notes in ((0.06, 1), (0.2, 2), (0.0, 0)):
        source = open_source(tmp_path)
        source.__dict__["bend_sd"] = bend_sd
        assert len(source.gps.notes) == notes and source.gps.notes[:1] == (positions.UPSIDE_DOWN,) * (notes > 0)
        for found in source.gps.evidence:
            assert found.value == pytest.approx(26.5, rel=0.01) and found.relative_sd >= bend_sd


def test_altitudes_say_as_much_of_a_bend_as_they_are_exact():
    path = lawnmower(40, 150)
    rng = np.random.default_rng(0)
    bowl = 60 + 1e-3 * ((path - path.mean(0)) ** 2).sum(1) / 2
    for noise, least, most in ((0.1, 0.0, 0.01), (1.0, 0.003, 0.02), (20.0, 0.04, 0.0501)):
        told = 300 + rng.normal(0, noise, len(path))
        value, sd = bend(path, bowl, told, times(path), 60.0, 0.05)
        assert least < sd < most and abs(value - 0.06) < 2 * sd
    for nothing in (None, np.zeros(len(path))):
        assert bend(path, bowl, nothing, times(path), 60.0, 0.05) == (0.0, 0.05)
    told = rng.normal(0, 0.1, len(path))
    ring, line = circle(40, 150), path * (1, 0)
    assert bend(ring, told, told, times(ring), 60.0, 0.05) == (0.0, 0.05), "a circle has one distance from its middle"
    assert bend(line, told, told[::-1], np.arange(40.0), 60.0, 0.05)[1] < 0.04, "on a line"


def test_a_flight_over_the_180th_meridian_goes_on(tmp_path):
    """It went around the Earth: of positions on both sides the middle one was in Greenwich."""
    tagged(tmp_path, longitude=180.0)
    (found,) = open_source(tmp_path).gps.evidence
    assert found.doubt == 0 and abs(np.log(found.value / UNIT)) < 2 * found.relative_sd < 0.04


def test_frames_without_tags_are_silent(tmp_path):
    model, _ = make_model()
    save(model, tmp_path / "sparse" / "0", "bin")
    (tmp_path / "images").mkdir()
    for image in model.images.values():
        write_photo(tmp_path / "images" / image.name, exif={0x010F: "DJI"}, size=(640, 480))
    gps = open_source(tmp_path).gps
    assert not gps.evidence and not gps.notes


@pytest.mark.slow
def test_they_count_beside_the_vehicles_unless_they_are_left_out(flight):
    both, alone = (orthoscale.estimate(flight, **usual(flight), gps=gps) for gps in (True, False))
    assert [e.kind for e in both.scale.evidence] == ["GPS positions"] and not alone.scale.evidence
    assert both.scale.relative_sd < 0.6 * alone.scale.relative_sd
    low, high = both.scale.interval90
    assert low < UNIT < high
    assert any("of the weight; --no-gps" in remark.text for remark in both.remarks)
    assert alone.settings == {**both.settings, "gps": False}


@pytest.mark.slow
def test_a_frame_whose_position_is_wrong_is_no_end_of_it(tmp_path):
    """Its receiver had no fix yet."""
    save_detections(tagged(tmp_path, wrong=(3,)), tmp_path / "boxes.json")
    found = orthoscale.estimate(tmp_path, **usual(tmp_path))
    (gps,) = found.scale.evidence
    assert gps.kind == "GPS positions" and gps.doubt == pytest.approx(1 / 12)
    low, high = found.scale.interval90
    assert low < UNIT < high


@pytest.mark.slow
def test_positions_that_contradict_the_vehicles_are_not_averaged(tmp_path):
    save_detections(tagged(tmp_path, 2 * UNIT), tmp_path / "boxes.json")
    found = orthoscale.estimate(tmp_path, **usual(tmp_path))
    assert found.scale.conflict > 3 and found.scale.verdict == "unusable"


@pytest.mark.slow
def test_positions_and_a_known_distance_that_agree_give_a_scale_without_vehicles(flight, tmp_path):
    """Either alone does not: nothing would show that it is mistaken."""
    (tmp_path / "none.json").write_text("{}")
    options = {**usual(flight), "detections": tmp_path / "none.json"}
    with pytest.raises(TooLittleEvidence) as refused:
        orthoscale.estimate(flight, **options, gps=False)
    assert "two kinds of evidence that agree, such as --known-distance and --ground-control" in refused.value.hint
    with pytest.raises(TooLittleEvidence, match="0 boxes.*two kinds of evidence .*given: GPS positions"):
        orthoscale.estimate(flight, **options)
    with pytest.raises(TooLittleEvidence, match="two kinds of evidence .*given: the known distance"):
        orthoscale.estimate(flight, **options, known_distance=[DISTANCE.format(4 * UNIT)], gps=False)
    done = orthoscale.fix(flight, tmp_path / "out", **options, known_distance=[DISTANCE.format(4 * UNIT)])
    assert done.scale.value == pytest.approx(UNIT, rel=0.01) and done.scale.vehicles_used == 0
    assert any("no vehicles: the scale rests on" in remark.text for remark in done.remarks)
    assert (tmp_path / "out" / "sim3.json").exists()
    with pytest.raises(EvidenceDisagrees, match="conflict"):
        orthoscale.fix(flight, tmp_path / "far", **options, known_distance=[DISTANCE.format(5 * UNIT)])
    assert not (tmp_path / "far").exists()


@pytest.mark.slow
def test_a_note_says_why_positions_do_not_count(tmp_path):
    save_detections(tagged(tmp_path, noise=80.0), tmp_path / "boxes.json")
    found = orthoscale.estimate(tmp_path, **usual(tmp_path))
    assert not found.scale.evidence
    assert any("GPS positions of its frames do not count" in remark.text for remark in found.remarks)


@pytest.mark.slow
def test_the_papers_estimator_takes_vehicles_only(flight):
    found = orthoscale.estimate(flight, fleet="DE", detections=flight / "boxes.json", measurer="none", estimator="iqr")
    assert not found.scale.evidence
    with pytest.raises(UsageError, match="--no-gps does nothing here"):
        orthoscale.estimate(flight, gps=False, estimator="iqr")


@pytest.mark.slow
def test_a_model_that_looks_as_if_it_were_in_metres_is_said_to(tmp_path):
    """One aligned with noisy positions is metric within a few per cent: `fix` rescaled it without a word. Nothing in
    its frames tells of positions."""
    import pycolmap

    example = Path(__file__).parents[1] / "examples/sheffield"
    model = pycolmap.Reconstruction(example / "sparse")
    model.transform(pycolmap.Sim3d(14.2 / 1.04, pycolmap.Rotation3d(), np.zeros(3)))
    (tmp_path / "enu").mkdir()
    model.write(tmp_path / "enu")
    options = {"detections": example / "detections.json", "fleet": "US", "report": "none"}
    done = orthoscale.fix(tmp_path / "enu", tmp_path / "out", **options)
    (said,) = [remark for remark in done.remarks if "seems to be in metres" in remark.text]
    assert f"vehicles and parking bays give {done.scale.value:.3f} m per unit" in said.text and said.severity == "info"
    assert (tmp_path / "out" / "sim3.json").exists()


@pytest.mark.parametrize(
    "value, change, told",
    [
        (1.04, {}, "1.040 m per unit, 1.3 sigma from 1"),
        (0.92, {}, "0.920 m per unit"),
        (1.2, {}, ""),
        (14.2, {}, ""),
        (1.04, {"verdict": "unusable"}, ""),
        (1.04, {"conflict": 4.0}, ""),
    ],
)
def test_what_looks_metric(value, change, told):
    ends = (value * np.exp(-Z90 * 0.03), value * np.exp(Z90 * 0.03))
    parts = {"fleet": 0.03}
    scale = Scale(value, "m/unit", ends, parts, {}, (0.5, 0.5), 0.0, "DE", "good", np.ones(9, bool), [""] * 9)
    model = SimpleNamespace(posed=True, metric_already="")
    said = [remark.text for remark in perhaps_metric(model, replace(scale, **change))]
    assert told in said[0] if told else not said
    if "verdict" not in change:  # what it looks like, `check` compares it with
        claim = metric_claim(model, replace(scale, **change))
        assert (claim is not None) == bool(told) and (claim is None or (claim.claimed, claim.believed) == (1, False))
    for other in ({"posed": None}, {"metric_already": "orthoscale wrote it"}):
        assert not perhaps_metric(SimpleNamespace(**vars(model) | other), scale)


@pytest.mark.slow
def test_a_model_in_a_maps_coordinates_is_metric_already(tmp_path):
    """`fix` would scale it about the map's origin, and move it by kilometres."""
    import pycolmap

    from orthoscale.sources.colmap import ColmapSource
    from orthoscale.sources.colmap_check import open_model

    folder = open_model(Path(__file__).parents[1] / "examples" / "sheffield").folder
    assert ColmapSource.open(folder, need_images=False).metric_already == ""
    model = pycolmap.Reconstruction(folder)
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array([480_027.0, 4_979_967.0, 50.0])))
    (tmp_path / "on_map").mkdir()
    model.write(tmp_path / "on_map")
    source = ColmapSource.open(tmp_path / "on_map", need_images=False)
    assert "as on a map" in source.metric_already
    (tmp_path / "out").mkdir()
    source.write(tmp_path / "out", 1.01)
    assert [note.text for note in source.notes if "50,030 m away from its place" in note.text], "nothing told it"
