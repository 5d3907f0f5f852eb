"""The whole way, on synthetic scenes of exact truth and on real data, with the shipped detector."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

import orthoscale
from orthoscale.core.remarks import CAUTION, Remark
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene, write_colmap, write_ortho

KEYS = {"scale", "unit", "interval90", "vehicles_used", "fleet", "verdict"}
EXAMPLES = Path(__file__).parent.parent / "examples"
# What the first version must reach, relative to the truth, with the fleet of the country.
REAL = {
    "orthophotos/manila.tif": ("PH", 0.06),
    "orthophotos/banepa.jpg": ("NP", 0.1),
    "reconstructions/sheffield": ("US", 0.04),
    "reconstructions/brighton": ("US", 0.12),  # six vehicles
}

# Boxes of rendered scenes stray by 2 % (RMS of ten) from one to the next.
SYNTHETIC = 0.04


def files_of(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """A synthetic orthophoto of German vehicles, 0.11 m/px."""
    folder = tmp_path_factory.mktemp("town")
    scene = make_scene(seed=3, fleet=load_fleet("DE"), extent_m=70, n_vehicles=45, style="city")
    write_ortho(scene, folder / "town.png", 0.11, seed=3)
    return folder / "town.png"


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A synthetic reconstruction of German vehicles, 7.3 m per model unit, camera pitched by 70 degrees."""
    folder = tmp_path_factory.mktemp("flight")
    scene = make_scene(seed=5, fleet=load_fleet("DE"), extent_m=110, n_vehicles=80, style="suburb")
    write_colmap(scene, folder, 7.3, n_frames=9, pitch_deg=70, altitude_m=70, focal_px=1000, seed=5)
    return folder


def test_an_orthophoto_gets_its_metres(town, tmp_path):
    before = files_of(town.parent)
    out = tmp_path / "scaled.tif"
    result = orthoscale.fix(town, out, fleet="DE")
    assert files_of(town.parent) == before
    assert result.scale.value == pytest.approx(0.11, rel=SYNTHETIC)
    low, high = result.scale.interval90
    assert low < 0.11 < high

    with rasterio.open(out) as copy, rasterio.open(town) as original:
        assert (copy.read() == original.read()).all()
        assert copy.transform.a == pytest.approx(result.scale.value) and copy.transform.e == -copy.transform.a
        assert copy.crs.units_factor[1] == 1.0
    report = json.loads((tmp_path / "scaled.tif.json").read_text())
    assert report.keys() >= KEYS
    assert report["scale"] == result.scale.value and report["unit"] == "m/px"
    assert report["vehicles_used"] == sum(v["used"] for v in report["vehicles"])
    assert all(v["reason"] for v in report["vehicles"] if not v["used"])
    assert len(report["input"]["sha256"]) == 64 and report["versions"]["orthoscale"] == orthoscale.__version__
    assert (tmp_path / "scaled.tif.png").read_bytes()[:4] == b"\x89PNG"
    parts = ["scaled.tif", "scaled.tif.html", "scaled.tif.json", "scaled.tif.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == parts


@pytest.mark.slow
def test_a_reconstruction_gets_its_metres(flight, tmp_path):
    before = files_of(flight)
    result = orthoscale.fix(flight, tmp_path / "scaled", fleet="DE")
    assert files_of(flight) == before
    assert result.scale.value == pytest.approx(7.3, rel=SYNTHETIC)
    low, high = result.scale.interval90
    assert low < 7.3 < high
    assert result.votes.views.max() >= 3, "the same vehicle in several frames is one vote"

    out = tmp_path / "scaled"
    sim3 = [float(word) for word in (out / "sim3.txt").read_text().split()]
    assert sim3 == [result.scale.value, 1, 0, 0, 0, 0, 0, 0]
    assert json.loads((out / "report.json").read_text()).keys() >= KEYS
    import pycolmap

    old, new = pycolmap.Reconstruction(str(flight / "sparse")), pycolmap.Reconstruction(str(out))
    for i, image in old.images.items():
        assert np.allclose(new.images[i].projection_center(), sim3[0] * image.projection_center(), rtol=1e-12)
    with pytest.raises(UsageError, match="in metres already"):
        orthoscale.fix(out, tmp_path / "again", images=flight / "images")


@pytest.mark.parametrize("name", REAL)
@pytest.mark.real
@pytest.mark.slow
def test_real_scenes_within_what_is_promised(data, name, capsys):
    truth = json.loads((data / name / "truth.json").read_text() if (data / name).is_dir() else
                       (data / name).with_name("truth.json").read_text())  # fmt: skip
    true_scale = truth.get("metres_per_model_unit") or truth[Path(name).name]["gsd_m"]
    fleet, tolerance = REAL[name]
    posed = "metres_per_model_unit" in truth
    for options in ({}, {"gps": False}) if posed else ({},):
        result = orthoscale.estimate(data / name, fleet=fleet, **options)
        error = result.scale.value / true_scale - 1
        low, high = result.scale.interval90
        with capsys.disabled():
            print(
                f"\n{name}: {result.scale.value:.5g} {result.scale.unit}, error {100 * error:+.1f} %, 90 % {low:.5g} "
                f"to {high:.5g}, {result.scale.vehicles_used} vehicles, {result.seconds:.0f} s"
            )
        assert abs(error) <= tolerance
        # The truth of a model is known by the same positions: with them, the interval says no more than that is worth.
        known = truth["relative_uncertainty"] if posed and not options else 0.0
        assert low * (1 - known) <= true_scale <= high * (1 + known)


@pytest.mark.slow
def test_the_example_without_frames_gives_its_metres(tmp_path):
    example = EXAMPLES / "sheffield"
    truth = json.loads((example / "truth.json").read_text())["metres_per_model_unit"]
    result = orthoscale.fix(example / "sparse", tmp_path / "out", fleet="US", detections=example / "detections.json")
    assert result.scale.value == pytest.approx(truth, rel=0.08)
    assert (tmp_path / "out" / "vehicles.png").exists()


@pytest.mark.slow
def test_ground_without_vehicles_is_refused_and_nothing_is_written(tmp_path):
    park = make_scene(seed=2, fleet=load_fleet("DE"), extent_m=90, n_vehicles=0, style="park")
    write_ortho(park, tmp_path / "park.png", 0.12, seed=2)
    before = files_of(tmp_path)
    with pytest.raises(TooLittleEvidence) as refusal:
        orthoscale.fix(tmp_path / "park.png", tmp_path / "scaled.tif")
    assert files_of(tmp_path) == before
    assert "zoom" in str(refusal.value) and "--gsd-hint" in str(refusal.value)


def test_four_vehicles_are_too_few(town, tmp_path):
    found = json.dumps({
        "town.png": [{"cx": 100 + 60 * k, "cy": 100, "length": 40, "width": 16, "angle": 0} for k in range(4)]
    })  # fmt: skip
    (tmp_path / "four.json").write_text(found)
    with pytest.raises(TooLittleEvidence, match="4 usable vehicles, 5 are needed"):
        orthoscale.estimate(town, detections=tmp_path / "four.json", anchors=["none"])


def test_the_scale_says_of_which_class_most_vehicles_may_be(town, tmp_path, monkeypatch):
    given = []

    def proposed(votes, fleet, ruler, geometry, named):
        given.append((len(votes), fleet.code, named))
        yield Remark(CAUTION, "most may be minis")

    monkeypatch.setattr("orthoscale.actions.estimate.proposed_class", proposed)
    robust = orthoscale.estimate(town, fleet="Germany", anchors=["none"])
    orthoscale.save_detections(robust.detections, tmp_path / "boxes.json")
    paper = orthoscale.estimate(town, fleet="DE", detections=tmp_path / "boxes.json", estimator="iqr")
    assert given == [(len(robust.votes), "DE", "Germany")] and "most may be minis" in map(str, robust.scale.remarks)
    assert "most may be minis" not in map(str, paper.scale.remarks)


def test_detections_of_another_picture_are_refused(town, tmp_path):
    (tmp_path / "other.json").write_text('{"elsewhere.jpg": []}')
    with pytest.raises(InputError, match="its only picture is not in .*elsewhere"):
        orthoscale.estimate(town, detections=tmp_path / "other.json")


def test_an_output_that_exists_is_kept_unless_told_otherwise(town, tmp_path):
    out = tmp_path / "scaled.tif"
    out.write_text("precious")
    with pytest.raises(UsageError, match="already exists"):
        orthoscale.fix(town, out)
    assert out.read_text() == "precious"


def test_a_picture_that_is_in_metres_is_not_rescaled_behind_its_owners_back(town, tmp_path):
    with rasterio.open(town) as original:
        profile = {**original.profile, "driver": "GTiff", "crs": "EPSG:32633"}
        profile["transform"] = rasterio.Affine(0.1, 0, 400_000, 0, -0.1, 5_800_000)
        with rasterio.open(tmp_path / "utm.tif", "w", **profile) as copy:
            copy.write(original.read())
    with pytest.raises(UsageError, match=r"utm\.tif is in metres already: .*0\.1"):
        orthoscale.fix(tmp_path / "utm.tif", tmp_path / "scaled.tif")
