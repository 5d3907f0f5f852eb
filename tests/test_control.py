"""Known distances and ground control, through the pipeline and the command."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.flights import UNIT
from support.in_process import run

import orthoscale
from orthoscale.actions.control import read_control
from orthoscale.core.control import LEVEL_SD
from orthoscale.errors import EvidenceDisagrees, InputError, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import save_detections
from orthoscale.sources.opening import open_source

EXAMPLES = Path(__file__).parent.parent / "examples"
TOWN = EXAMPLES / "town" / "ortho.jpg"
GSD = 0.085
MODEL = EXAMPLES / "sheffield" / "sparse"
FOUND = EXAMPLES / "sheffield" / "detections.json"


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    """Vehicles of the German fleet on the town's picture, at its scale, with a tennis court among them."""
    rng = np.random.default_rng(0)
    size = load_fleet("DE").sample(rng, 60)[:, :2] / GSD
    rows = [{"cx": 40 + 90 * (k % 10), "cy": 40 + 90 * (k // 10), "length": s[0], "width": s[1],
             "angle": 0.4 + float(rng.uniform(-0.2, 0.2))} for k, s in enumerate(size)]  # fmt: skip
    path = tmp_path_factory.mktemp("found") / "boxes.json"
    path.write_text(json.dumps({TOWN.name: rows}))
    court = {"cx": 500, "cy": 700, "length": 23.77 / GSD, "width": 10.97 / GSD, "angle": 0.2, "kind": "tennis-court"}
    path.with_name("court.json").write_text(json.dumps({TOWN.name: [*rows, court]}))
    return path


def test_a_distance_narrows_the_interval_and_is_in_the_report(boxes):
    options = {"fleet": "DE", "detections": boxes, "anchors": ["none"]}
    without = orthoscale.estimate(TOWN, **options)
    given = orthoscale.estimate(TOWN, **options, known_distance=["10,20 310,420 42.5 0.4"])
    assert given.scale.value == pytest.approx(GSD, rel=0.01)
    assert given.scale.relative_sd < 0.4 * without.scale.relative_sd
    assert [e.kind for e in given.scale.evidence] == ["known distance"]
    assert given.scale.parts["known distance"] > given.scale.parts["fleet"]


def test_a_mistyped_distance_is_never_good_and_says_what_may_be_wrong(boxes):
    """A tenth off, less than contradicts the vehicles: it alone makes the answer, and would agree with itself."""
    options = {"fleet": "DE", "detections": boxes, "anchors": ["none"]}
    without = orthoscale.estimate(TOWN, **options).scale
    metres = 1000 * without.value * np.exp(2.5 * without.relative_sd)
    wrong = orthoscale.estimate(TOWN, **options, known_distance=[f"0,0 1000,0 {metres:.2f} 0.1"])
    assert not wrong.scale.conflict and wrong.scale.relative_sd < 0.002 and wrong.scale.verdict == "fair"
    (said,) = [r for r in wrong.remarks if r.severity == "caution" and "known distance" in r.text]
    assert "2.5 sigma" in said.text and "the distance may be mistyped, or not on the ground" in said.text
    checks = wrong.to_dict()["judgements"]
    assert [c["severity"] for c in checks if c["what"].startswith("Other evidence")] == ["caution"]
    right = orthoscale.estimate(TOWN, **options, known_distance=[f"0,0 1000,0 {1000 * without.value:.2f} 0.1"])
    assert right.scale.verdict == "good"


def test_a_distance_that_contradicts_the_vehicles_writes_nothing(boxes, tmp_path):
    options = {"fleet": "DE", "detections": boxes, "known_distance": ["0,0 1000,0 170 1"]}
    assert orthoscale.estimate(TOWN, **options).scale.verdict == "unusable"
    with pytest.raises(EvidenceDisagrees, match="conflict: vehicles: 0.08.*known distance of 170 m"):
        orthoscale.fix(TOWN, tmp_path / "out.tif", **options)
    assert not list(tmp_path.iterdir())
    words = ("--detections", boxes, "--fleet", "DE", "--known-distance", "0,0 1000,0 170 1")
    said = run("estimate", TOWN, *words)
    assert said.returncode == 4 and "conflict" in said.stderr and "unusable" in said.stdout


@pytest.mark.slow
def test_a_court_among_the_boxes_counts_unless_told_otherwise(boxes):
    court = boxes.with_name("court.json")
    kinds = {"anchors": ["tennis-court"]}
    seen = orthoscale.estimate(TOWN, fleet="world", detections=court, **kinds)
    assert [e.kind for e in seen.scale.evidence] == ["tennis court"]
    assert seen.scale.value == pytest.approx(GSD, rel=0.02)
    blind = orthoscale.estimate(TOWN, fleet="world", detections=court, anchors=["none"])
    assert not blind.scale.evidence and blind.scale.relative_sd > 2 * seen.scale.relative_sd
    save_detections(seen.detections, boxes.with_name("again.json"))
    again = orthoscale.estimate(TOWN, fleet="world", detections=boxes.with_name("again.json"), **kinds)
    assert again.scale.value == pytest.approx(seen.scale.value, rel=1e-3)


def test_ground_control_gives_an_orthophoto_its_scale(boxes, tmp_path):
    control = tmp_path / "control.txt"
    control.write_text("# point east north\n0,0 400000.00 5800000.00\n1000,0 400085.00 5800000.00\n"
                       "0,1000 400000.00 5799915.00\n")  # fmt: skip
    result = orthoscale.estimate(TOWN, fleet="DE", detections=boxes, ground_control=control)
    assert result.scale.value == pytest.approx(GSD, rel=0.002) and result.scale.verdict == "good"
    control.write_text("0,0 400000 5800000\n1000,0 400085\n")
    with pytest.raises(InputError, match="control.txt, line 2: 1 coordinate in metres"):
        orthoscale.estimate(TOWN, fleet="DE", detections=boxes, ground_control=control)
    with pytest.raises(InputError, match="cannot be read"):
        orthoscale.estimate(TOWN, fleet="DE", detections=boxes, ground_control=tmp_path / "none.txt")


SLOPE = np.array([[0, 0, 0], [300, 0, 60], [600, 0, 120], [900, 100, 180.0]]) * GSD  # [m] down a slope of 20 %


def written(path, points, metres):
    path.write_text("\n".join(f"{point} {' '.join(map(str, row))}" for point, row in zip(points, metres, strict=True)))
    return path


def test_an_orthophotos_distances_are_horizontal(tmp_path):
    points = [f"{x / GSD},{y / GSD}" for x, y, _ in SLOPE]
    plain, with_up = (
        read_control(written(tmp_path / "c.txt", points, rows), open_source(TOWN)) for rows in (SLOPE[:, :2], SLOPE)
    )
    assert plain == with_up and plain.value == pytest.approx(GSD, rel=1e-6)
    assert plain.says == "ground control (4 points)"


def test_a_models_are_those_in_space_or_without_up_in_the_grounds_plane(flight, tmp_path):
    """Four points of buildings of several heights, whose metres are known."""
    places = np.array([[-6, -5, 0], [5, -4, 2.5], [6, 6, 0.5], [-4, 5, 1.5]])
    source = open_source(flight[0])
    points = [",".join(map(str, place)) for place in places @ flight[1].T]
    rows = UNIT * places + [400_000, 5_800_000, 90]
    in_space, level = (read_control(written(tmp_path / "c.txt", points, r), source) for r in (rows, rows[:, :2]))
    assert in_space.value == pytest.approx(UNIT, rel=1e-6) and in_space.says == "ground control (4 points)"
    assert level.value == pytest.approx(UNIT, rel=1e-4)
    assert level.says == "ground control (4 points, the ground assumed level)"
    assert in_space.relative_sd < 0.001 and LEVEL_SD < level.relative_sd < 1.2 * LEVEL_SD
    mixed = written(tmp_path / "c.txt", points, [*rows[:2], *rows[2:, :2]])
    with pytest.raises(InputError, match="line 3: 2 coordinates in metres, but 3 above"):
        read_control(mixed, source)


@pytest.mark.slow
def test_points_of_a_model_by_coordinates_by_number_and_by_pixel():
    import pycolmap

    model = pycolmap.Reconstruction(str(MODEL))
    (first, a), (second, b) = list(model.points3D.items())[:2]
    metres = 14.157 * np.linalg.norm(a.xyz - b.xyz)
    options = {"fleet": "US", "detections": FOUND, "mode": "planar"}
    by_number = orthoscale.estimate(
        MODEL, known_distance=[f"id:{first} id:{second} {metres} {metres / 500}"], **options
    )
    assert by_number.scale.value == pytest.approx(14.157, rel=0.01)
    words = [",".join(map(str, p.xyz)) for p in (a, b)]
    by_place = orthoscale.estimate(MODEL, known_distance=[f"{' '.join(words)} {metres} {metres / 500}"], **options)
    assert by_place.scale.value == pytest.approx(by_number.scale.value, rel=1e-6)
    name = next(iter(by_place.detections.boxes))
    with pytest.raises(UsageError, match="no registered image is named nowhere"):
        orthoscale.estimate(MODEL, known_distance=[f"nowhere@10,10 {name}@400,300 5"], **options)


def test_a_distance_in_feet_contradicts_the_vehicles(flight, found, tmp_path):
    """At a third of the scale most boxes are of no vehicle; that is said, not stumbled over."""
    save_detections(replace(found, planar=None), tmp_path / "boxes.json")
    options = {"fleet": "DE", "detections": tmp_path / "boxes.json", "known_distance": ["0,0,0 10,0,0 15.2"]}
    result = orthoscale.estimate(flight[0], **options)
    assert result.scale.value == pytest.approx(1.52, rel=0.01) and result.scale.verdict == "unusable"
    with pytest.raises(EvidenceDisagrees, match="conflict: vehicles: .*known distance of 15.2 m"):
        orthoscale.fix(flight[0], tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text, why", [("1,2 3,4", "2 words, not 3 or 4"),
                                       ("1,2 3,4 five", "'five' is not a finite number"),
                                       ("1,2 1,2 5", "must differ"), ("1,2,3 4,5,6 5", "not a point of an orthophoto"),
                                       ("1,2 3,4 5 6 7", "words"), ("1,2 3,4 5 1e300", "sigma"),
                                       ("1,2 3,4 5 -1", "sigma"), ("1,2 3,4 1e300", "distance"),
                                       ("nan,2 3,4 5", "not a finite number"),
                                       ("1,2 '3,4 5", "quotation")])  # fmt: skip
def test_distances_that_make_no_sense_say_what_is_expected(boxes, text, why):
    with pytest.raises(UsageError, match=f"(?s)--known-distance .*{why}.*Expected two points"):
        orthoscale.estimate(TOWN, detections=boxes, known_distance=[text])


@pytest.mark.slow
@pytest.mark.parametrize(
    "projection, off",
    [("exact", 0.044), ("planar", -0.016), ("decoupled", -0.116), ("program", 0.043), ("naive", -0.016)],
)
def test_every_projection_measures_a_model(projection, off):
    """As far off as their formulas are there: the paper's text makes scales small."""
    result = orthoscale.estimate(MODEL, fleet="US", detections=FOUND, projection=projection)
    assert result.scale.value / 14.157 - 1 == pytest.approx(off, abs=0.01)
    assert result.projection == projection


def test_the_papers_estimator_and_what_it_cannot_take(boxes):
    result = orthoscale.estimate(TOWN, fleet="DE", detections=boxes, estimator="iqr")
    assert result.scale.value == pytest.approx(GSD, rel=0.03) and set(result.scale.parts) == {"sampling"}
    assert "paper's estimator" in result.scale.remarks[0].text
    for options, why in (
        ({"estimator": "iqr", "known_distance": ["0,0 9,9 1"]}, "for vehicles only"),
        ({"projection": "exact"}, "an orthophoto has none"),
        ({"projection": "mercator"}, "--projection mercator is not one of"),
        ({"estimator": "mode"}, "--estimator mode is not one of"),
    ):
        with pytest.raises(UsageError, match=why):
            orthoscale.estimate(TOWN, fleet="DE", detections=boxes, **options)


@pytest.mark.slow
def test_the_command_takes_them_all(boxes):
    words = ("--detections", boxes, "--fleet", "world", "--known-distance", "0,0 1000,0 85 0.5", "--json")
    done = run("estimate", TOWN, *words)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["fleet"] == "WORLD" and len(report["fleets"]) > 3
    assert report["method"] == {"projection": "planar", "estimator": "robust"}
    assert report["evidence"][0]["kind"] == "known distance"
