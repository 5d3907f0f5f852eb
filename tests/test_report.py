"""The report: plain values first, and a page for people that is drawn from them alone."""

import copy
import json
import os
import re
import shutil
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import rasterio
from PIL import Image, ImageDraw, ImageFont
from rasterio.shutil import copy as gdal_copy
from support.in_process import run
from support.reports import EXAMPLE, GSD, HEIGHT, MARGIN, car_park, fixed, fixed_model
from test_dense_ground import write_cloud

import orthoscale
from orthoscale.actions.finished import is_finished
from orthoscale.core.detections import Swept, ZoomChoice
from orthoscale.core.remarks import REFUSAL, Remark
from orthoscale.core.scale import interval_about
from orthoscale.core.verdicts import UNUSABLE
from orthoscale.errors import EvidenceDisagrees, Incomplete, InputError, TooLittleEvidence, UsageError
from orthoscale.formats.lettering import HALO, in_ascii, write_on
from orthoscale.formats.schemas.report import Report
from orthoscale.report import charts, files, pictures, places, terminal, wording
from orthoscale.report.charts import strength
from orthoscale.report.drift_map import regions_panel
from orthoscale.report.files import redraw
from orthoscale.report.page import page
from orthoscale.report.scene import ReportPictures
from orthoscale.report.stored import of_plan, read_json
from orthoscale.report.terminal import show
from orthoscale.requests import EstimateRequest, FixRequest, command_line
from orthoscale.sources.opening import open_source
from orthoscale.system.paths import name_of, title_of


@pytest.fixture(scope="module")
def park(tmp_path_factory):
    """The folder of a car park with its report, and the truth."""
    folder = tmp_path_factory.mktemp("park")
    truth = car_park(folder)
    fixed(folder)
    return folder, truth


@pytest.fixture(scope="module")
def report(park):
    return read_json(park[0] / "scaled.tif.json")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The folder of the reduced sheffield model in metres."""
    return fixed_model(tmp_path_factory.mktemp("model"), mode="planar").parent


def states(report):
    return {check["what"]: check["severity"] for check in report["judgements"]}


def test_means_are_not_said_to_match_where_other_evidence_counts(report):
    matches, differ = "matches best", "so the means may differ"
    plain = page({**report, "evidence": []}, ReportPictures())
    assert matches in plain and differ not in plain
    moved = {"kind": "known distance", "scale": report["scale"], "relative_sd": 0.01, "says": "a known distance"}
    with_ = page({**report, "evidence": [moved]}, ReportPictures())
    assert differ in with_ and matches not in with_


def test_what_the_used_vehicles_are_is_told(report):
    assert "of unknown kind" not in page(report, ReportPictures()), "of boxes without kinds nothing is said"
    told = copy.deepcopy(report)
    for vehicle, kind in zip(told["vehicles"], ["car"] * 50 + ["van"] * 8 + ["larger", "", "pickup"], strict=True):
        vehicle["kind"] = kind  # the last one does not count
    assert "used, 60 (50 cars, 8 vans, 1 larger, 1 of unknown kind)" in page(told, ReportPictures())


def test_vehicles_are_plain_values_in_metres(park, report):
    _, truth = park
    assert report["scale"] == pytest.approx(GSD, rel=0.05)
    vehicles = report["vehicles"]
    assert len(vehicles) == 61 and [v for v in vehicles if not v["used"]] == [vehicles[60]]
    assert vehicles[60]["reason"] == "too large for a car"
    for vehicle, size, (x, y) in zip(vehicles[:60], truth["size"], truth["centre"], strict=True):
        metres = size / GSD * report["scale"]  # the boxes' margin is not part of the vehicle
        assert [vehicle["length"], vehicle["width"]] == pytest.approx(metres, abs=1e-6)
        assert vehicle["place_m"] == pytest.approx(np.array([x, HEIGHT - y]) * report["scale"], abs=1e-3)
        (box,) = vehicle["boxes"]
        assert box["picture"] == "park.png" and box["xylwa_px"][2] == pytest.approx(size[0] / GSD + MARGIN[0], abs=2e-3)
    assert report["settings"]["fleet"] == "DE" and report["pictures"] == {"park.png": [1000, 700]}


def test_a_models_plan_keeps_distances(model):
    report = read_json(model / "report.json")
    places = np.array([v["place_unit"] for v in report["vehicles"]]) * report["scale"]
    plan = np.array([v["place_m"] for v in report["vehicles"]])
    apart, seen = (np.linalg.norm(p - p[0], axis=1) for p in (places, plan))
    assert seen == pytest.approx(apart, rel=0.05, abs=2.0), "level ground, seen from above"


def test_levels_of_report(tmp_path):
    car_park(tmp_path)
    before = {p.name for p in tmp_path.iterdir()}

    def written():
        return {p.name for p in tmp_path.iterdir()} - before

    fixed(tmp_path)
    assert written() == {"scaled.tif", "scaled.tif.json", "scaled.tif.png", "scaled.tif.html"}
    fixed(tmp_path, report="json", overwrite=True)
    assert written() == {"scaled.tif", "scaled.tif.json", "scaled.tif.png"}, "a page of the former copy would lie"
    fixed(tmp_path, report="none", overwrite=True)
    assert written() == {"scaled.tif"}
    with pytest.raises(UsageError, match="--report pdf"):
        fixed(tmp_path, report="pdf", overwrite=True)


def test_a_file_in_the_reports_place_is_kept_and_found_before_any_work(tmp_path):
    car_park(tmp_path)
    (tmp_path / "scaled.tif.html").write_text("precious")
    with pytest.raises(UsageError, match=r"scaled\.tif\.html already exists"):
        fixed(tmp_path)
    assert (tmp_path / "scaled.tif.html").read_text() == "precious" and not (tmp_path / "scaled.tif").exists()


@pytest.mark.slow
def test_a_model_without_report_is_still_known_to_be_in_metres(tmp_path):
    fixed_model(tmp_path, report="none", mode="planar")
    names = {p.name for p in (tmp_path / "scaled").iterdir()}
    assert "sim3.txt" in names and not names & {"report.json", "report.html", "vehicles.png"}
    with pytest.raises(UsageError, match="in metres already"):
        orthoscale.fix(tmp_path / "scaled", tmp_path / "again", detections=EXAMPLE / "detections.json")


def test_the_page_holds_everything_and_asks_for_nothing(park, model):
    shown = len(json.loads((model / "report.json").read_text())["vehicles"])
    for html, outlines in ((park[0] / "scaled.tif.html", 46), (model / "report.html", shown)):
        text = html.read_text()
        assert "<script" not in text and "http:" not in text and "https:" not in text and "url(" not in text
        links = re.findall(r'(?:href|src)="(.{0,30})', text)
        assert links and all(link.startswith("data:image/jpeg;base64,") for link in links)
        assert text.count("<polygon") >= outlines and "</html>" in text


def test_the_page_says_the_answer_first_with_the_digits_it_deserves(park, report):
    text = (park[0] / "scaled.tif.html").read_text()
    heading = re.sub(r"<[^>]+>|\s+", " ", re.search(r"<h1>.*?</h1>", text, re.S)[0])
    assert heading.split()[:3] == [report["verdict"], f"{100 * report['scale']:.2f}", "cm/px"]
    (value,), unit = wording.quantity({**report, "scale": 15.02, "unit": "m/model-unit", "interval90": [13.9, 16.3]},
                                        15.02)  # fmt: skip
    assert (value, unit) == ("15.0", "m per model unit")


@pytest.mark.parametrize(("given", "called"), [(".", "flight"), ("..", "site"), ("../other", "other")])
def test_what_was_given_as_this_folder_is_called_by_its_name(report, tmp_path, given, called):
    """``cd flight; orthoscale fix .`` gave a page of the "scale of ." and a picture without a name."""
    (tmp_path / "site/flight").mkdir(parents=True)
    there = {**report, "input": {**report["input"], "path": given, "folder": str(tmp_path / "site/flight")}}
    assert re.search("<title>(.*)</title>", page(there, ReportPictures()))[1].endswith(f"scale of {called}")
    assert name_of(given, tmp_path / "site/flight") == called


def test_a_model_in_a_numbered_folder_is_called_with_the_folder_above(report):
    """The picture of COLMAP's ``sparse/0`` was headed "fleet US; 0"."""
    there = {**report, "input": {**report["input"], "path": "sparse/0", "folder": "/work/site"}}
    assert re.search("<title>(.*)</title>", page(there, ReportPictures()))[1].endswith("scale of sparse/0")
    assert title_of("0", "/work/site/sparse") == title_of(".", "/work/site/sparse/0") == "sparse/0"
    assert title_of("0001.jpg") == "0001.jpg"


def test_the_page_shows_24_vehicles_from_the_shortest_to_the_longest(park, report):
    scene = ReportPictures.of(report, open_source(park[0] / "park.png"))
    assert len(scene.overviews) == 1 and len(scene.used) == 24 and len(scene.rejected) == 1
    lengths = [float(panel.title.split()[0]) for panel in scene.used]
    used = [v["length"] for v in report["vehicles"] if v["used"]]
    assert lengths == sorted(lengths) and lengths[0] == round(min(used), 2) and lengths[-1] == round(max(used), 2)
    overview = scene.overviews[0]
    assert len(overview.outlines) == 61 and overview.bar[0] == pytest.approx(overview.bar[1] * report["scale"])


def test_outlines_lie_on_their_vehicles(park, report):
    scene = ReportPictures.of(report, open_source(park[0] / "park.png"))
    assert len(scene.used) > 20
    for panel in scene.used:
        inside = panel.image[85:95, 85:95].astype(float)  # a rectangle of one colour, in the middle of its chip
        assert np.ptp(inside, axis=(0, 1)).max() <= 2
        assert panel.outlines[0].points.mean(0) == pytest.approx([90, 90], abs=4)


def test_the_page_can_be_drawn_again_from_its_json(park, tmp_path):
    folder, _ = park
    again = tmp_path / "scaled.tif.html"  # a page is signed with its name
    assert redraw(folder / "scaled.tif.json", again) == ""
    assert again.read_text() == (folder / "scaled.tif.html").read_text()


@pytest.mark.parametrize("cloud, is_there", [("dense/fused.ply", True), ("dense/fused.ply", False), ("none", True)])
def test_a_page_drawn_again_stands_on_the_ground_of_the_report(park, tmp_path, monkeypatch, cloud, is_there):
    """A model's vehicles are drawn where they were measured: on the cloud that its options named, from wherever."""
    first = tmp_path / "first"
    if is_there:
        (first / cloud).parent.mkdir(parents=True)
        (first / cloud).touch()  # a file of that name is not what "none" means
    about = json.loads((park[0] / "scaled.tif.json").read_text())
    about["input"]["folder"] = str(first)
    about["settings"]["ground_cloud"] = cloud
    (tmp_path / "report.json").write_text(json.dumps(about))
    asked = []
    monkeypatch.setattr(
        files, "open_source", lambda *_, **named: asked.append(named) or open_source(park[0] / "park.png")
    )
    redraw(tmp_path / "report.json", tmp_path / "report.html")
    expected = first / cloud if cloud != "none" and is_there else cloud
    assert [named["ground_cloud"] for named in asked] == [expected]


def test_a_page_drawn_again_from_elsewhere_finds_what_the_first_run_named_relatively(tmp_path, monkeypatch):
    (tmp_path / "work/in").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    car_park(tmp_path / "work/in")
    monkeypatch.chdir(tmp_path / "work")
    found = orthoscale.estimate("in/park.png", fleet="DE", detections="in/detections.json")
    report = tmp_path / "elsewhere/report.json"
    report.write_text(json.dumps(found.to_dict()))
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert redraw(report, report.with_suffix(".html")) == ""
    (tmp_path / "work").rename(tmp_path / "elsewhere/work")  # moved away together with the report's folder
    monkeypatch.chdir(tmp_path / "elsewhere/work")
    assert redraw(report, report.with_suffix(".png")) == ""


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux alone")
@pytest.mark.parametrize("there", [True, False])
def test_a_report_below_a_folder_whose_name_is_not_utf_8_is_drawn_again(tmp_path, there):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    shutil.copytree(EXAMPLE / "sparse", folder / "sparse")
    shutil.copy(EXAMPLE / "detections.json", folder)
    options = {"fleet": "US", "mode": "planar", "detections": folder / "detections.json"}
    request = FixRequest.of({**options, "report": "json"})
    made = orthoscale.fix(folder / "sparse", folder / "scaled", **options, report="json")
    report = folder / "scaled" / "report.json"
    assert rb"caf\\udce9/sparse" in report.read_bytes(), "an escape that strict readers take"
    assert read_json(report)["input"]["path"] == str(folder / "sparse") == made.to_dict()["input"]["path"]
    assert is_finished(folder / "sparse", folder / "scaled", request)
    if not there:
        (folder / "sparse").rename(tmp_path / "gone")
    why = redraw(report, folder / "report.html")
    assert (why == "") if there else why.endswith("sparse is not there")


def test_a_dense_cloud_made_since_does_not_change_the_model_of_a_report(tmp_path):
    """After `post_sparse.sh` follows stereo; the report of the sparse model then had no pictures."""
    work = tmp_path / "work"
    shutil.copytree(EXAMPLE / "sparse", work / "sparse/0")
    options = {"fleet": "US", "mode": "planar", "detections": EXAMPLE / "detections.json", "report": "json"}
    orthoscale.fix(work / "sparse/0", tmp_path / "scaled", **options)
    write_cloud(work / "dense/fused.ply", np.zeros((3, 3)))
    assert redraw(tmp_path / "scaled/report.json", tmp_path / "again.html") == ""
    with pytest.raises(UsageError, match="0, or the dense cloud of its ground, has changed since"):
        is_finished(work / "sparse/0", tmp_path / "scaled", FixRequest.of(options))


def test_frames_that_were_replaced_since_are_not_drawn_with_the_boxes_of_the_former(tmp_path):
    """The hash of a model is that of its own files: boxes were drawn on other pictures, and nothing was said."""
    shutil.copytree(EXAMPLE / "sparse", tmp_path / "sparse")
    (tmp_path / "images").mkdir()
    frame = tmp_path / "images/DJI_0054.jpg"
    Image.new("RGB", (800, 600)).save(frame)
    options = {"fleet": "US", "mode": "oblique", "detections": EXAMPLE / "detections.json", "anchors": ["none"]}
    orthoscale.fix(tmp_path / "sparse", tmp_path / "scaled", **options, report="json")
    report = tmp_path / "scaled/report.json"
    os.utime(frame, (0, 0))  # a copy may have another time
    assert redraw(report, tmp_path / "again.html") == ""
    Image.linear_gradient("L").resize((800, 600)).save(frame)
    assert redraw(report, tmp_path / "changed.html") == "frames have changed since: DJI_0054.jpg"
    with pytest.raises(UsageError, match="its frames have changed since: DJI_0054.jpg"):
        is_finished(tmp_path / "sparse", tmp_path / "scaled", FixRequest.of({**options, "report": "json"}))
    former = json.loads(report.read_text())
    former["frame_bytes"]["DJI_0054.jpg"] = frame.stat().st_size  # as if they were uncompressed
    (tmp_path / "scaled/report.json").write_text(json.dumps(former))
    assert redraw(report, tmp_path / "alike.html") == "frames have changed since: DJI_0054.jpg"


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_parts_of_a_mosaic_that_were_replaced_since_are_not_drawn(tmp_path):
    """The hash of a VRT is that of its text: boxes were drawn on other pictures, and nothing was said."""
    car_park(tmp_path)
    part = tmp_path / "part.tif"
    gdal_copy(tmp_path / "park.png", part, driver="GTiff")
    gdal_copy(part, tmp_path / "park.vrt", driver="VRT")
    options = {"fleet": "DE", "detections": tmp_path / "detections.json"}
    orthoscale.fix(tmp_path / "park.vrt", tmp_path / "scaled.tif", **options, report="json")
    report = tmp_path / "scaled.tif.json"
    (tmp_path / "park.vrt.aux.xml").write_text("<PAMDataset/>")  # as of statistics
    assert redraw(report, tmp_path / "again.html") == ""
    with rasterio.open(part, "r+") as file:
        file.write(255 - file.read())
    assert redraw(report, tmp_path / "changed.html") == "files have changed since: part.tif"


def test_a_report_is_drawn_as_a_page_or_a_picture_only(park, tmp_path):
    with pytest.raises(UsageError, match=r"a\.pdf: .* page or a picture"):
        redraw(park[0] / "scaled.tif.json", tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())


def test_boxes_that_are_not_drawn_are_not_counted_among_the_outlines(report):
    html = page({**report, "boxes_rejected": {"low confidence": 6}}, ReportPictures())
    (line,) = re.findall(r"<p.*rejected: .*</p>", html)
    assert "rejected: 1 too large for a car &ensp; Boxes that do not count, and are not drawn: 6 low confidence" in line
    assert "not drawn" not in page(report, ReportPictures())


@pytest.mark.parametrize("fate, why", [("gone", "not there"), ("changed", "changed since")])
def test_without_its_input_the_page_has_charts_only_and_says_so(tmp_path, fate, why):
    car_park(tmp_path)
    fixed(tmp_path)
    if fate == "gone":
        (tmp_path / "park.png").unlink()
    else:
        car_park(tmp_path, seed=2)
    assert why in redraw(tmp_path / "scaled.tif.json", tmp_path / "again.html")
    text = (tmp_path / "again.html").read_text()
    assert "pictures are not available" in text and text.count("<svg") >= 5


def test_names_from_outside_stay_text(tmp_path):
    name = "<img src=x onerror=alert(1)>.png"
    car_park(tmp_path, name)
    text = fixed(tmp_path, name).read_text()
    assert "<img" not in text and "&lt;img src=x onerror=alert(1)&gt;.png" in text


@pytest.mark.parametrize("reach", [0.02, 0.046, 0.0999, 0.1, 0.19, 0.25, 0.36, 0.42, 0.5])
@pytest.mark.parametrize("name", ["widths only", "zebra crossing", "shipping container"])
def test_labels_of_an_axis_stay_apart(reach, name):
    rows = [charts.ChartRow(name, 0.0, (-reach, reach))]
    chart = str(charts.estimates(rows, (-reach, reach), ""))
    labels = [(float(x), text) for x, text in re.findall(r'<text x="([0-9.]+)"[^>]*>([^<]*)</text>', chart)[1:]]
    assert labels[len(labels) // 2][1] == "0" and len(labels) in (3, 5, 7, 9)
    for (x, text), (x_next, text_next) in pairwise(labels):
        assert x_next - x > charts.LETTER * (len(text) + len(text_next)) / 2, (text, text_next)


def test_a_drift_across_the_picture_is_seen(tmp_path, report):
    assert states(report)["Drift neither found nor excluded"] == "info", "7 % of change, which may be chance: no tick"
    car_park(tmp_path, drift=0.25)
    drifting = read_json(fixed(tmp_path).with_suffix(".json"))
    assert states(drifting)["The scale drifts"] == "caution" and "drift" in drifting["uncertainty"]
    left, right = (
        sum(c["deviation"] for c in drifting["drift"]["cells"] if (c["x_px"] > 500) is s) for s in (False, True)
    )
    assert left < 0 < right
    found = places.regions(drifting)
    assert max(region.x for region in found) < drifting["pictures"]["park.png"][0] * drifting["scale"]
    text = page(drifting, ReportPictures())
    assert text.count('fill-opacity="') == len(found)


def test_vehicles_too_few_to_compare_places_are_said_to_be(tmp_path):
    car_park(tmp_path, count=20)
    few = read_json(fixed(tmp_path).with_suffix(".json"))
    assert states(few)["Places not compared"] == "info" and "the same everywhere?" not in page(few, ReportPictures())


OF_A_MODEL = {
    "regions": [
        {"centre_unit": [-4.5, -4.2], "scale": 14.7, "sd": 0.3, "vehicles": 10},
        {"centre_unit": [6.3, 3.1], "scale": 15.2, "sd": 0.7, "vehicles": 6},
    ],
    "trend": {"percent_across": 5.2, "chance": 0.37},
    "drifts": False,
    "frames": {
        "DJI_2.jpg": {"scale": 18.0, "sd": 0.5, "vehicles": 6},
        "DJI_1.jpg": {"scale": 15.1, "sd": 0.4, "vehicles": 8},
    },
    "odd_frames": ["DJI_2.jpg"],
}


def test_the_picture_has_the_scale_by_place_where_it_drifts(tmp_path, report):
    heights = []
    for drifts in (True, False):
        pictures.draw({**report, "drift": {**report["drift"], "drifts": drifts}}, ReportPictures(), tmp_path / "a.png")
        heights.append(Image.open(tmp_path / "a.png").height)
    assert heights[0] > heights[1]


def test_the_frames_and_places_of_a_model_are_drawn(model):
    report = {**read_json(model / "report.json"), "drift": OF_A_MODEL}
    assert [(frame.name, frame.odd) for frame in places.frames(report)] == [("DJI_1.jpg", False), ("DJI_2.jpg", True)]
    here = places.regions(report)[0]
    assert (here.x, here.y) == pytest.approx(np.array([-4.5, -4.2]) * report["scale"])
    assert here.deviation == pytest.approx(np.log(14.7 / report["scale"]))
    text = page(report, ReportPictures())
    assert text.count('fill-opacity="') == 2 and ">DJI_1.jpg</text>" in text


def test_page_and_picture_give_a_region_the_same_figures(monkeypatch):
    written = []
    monkeypatch.setattr("orthoscale.report.drift_map.write_on", lambda image, place, text, *how: written.append(text))
    corners = [{"centre_unit": [9 * k, 3 * k], "scale": 12.0 + 4 * k, "sd": 0.3, "vehicles": 9} for k in (0, 1)]
    report = {"scale": 14.0, "drift": {"regions": corners}}
    regions_panel(report["drift"], report["scale"], 600)
    chart = str(charts.place_map(np.zeros((1, 2)), places.regions(report), ""))
    for larger, half in (("-14.3", "3.5"), ("+14.3", "3.5")):
        assert f"{larger} +- {half}" in written
        assert f">{larger.replace('-', '−')}<" in chart and f">± {half}<" in chart


def test_what_the_views_said_of_the_ruler_is_told(model):
    calibration = {
        "views": 512,
        "effective_height": {"card": [0.7, 0.45], "fitted": [0.71, 0.587], "sd": [0.1, 0.06]},
        "margin_px": {"card": [-0.3, -0.2], "fitted": [0.01, -0.88], "sd": [0.7, 0.6]},
        "undercut": {"card": [0.0, 0.0], "fitted": [0.25, 0.31], "sd": [0.05, 0.04]},
        "trends": {
            "before": {"percent_per_10_degrees": [3.2, 0.6], "percent_per_pixel_doubling": [18.7, 3.4]},
            "after": {"percent_per_10_degrees": [-0.7, 0.7], "percent_per_pixel_doubling": [1.1, 3.7]},
        },
    }
    text = page({**read_json(model / "report.json"), "calibration": calibration}, ReportPictures())
    assert "512 views" in text and "<td>0.70, 0.45 m</td><td>0.71, 0.59 m</td>" in text
    assert "<td>+18.7 ± 3.4 %</td><td>+1.1 ± 3.7 %</td>" in text and "<td>−0.7 ± 0.7 %</td>" in text
    # Views of one altitude say nothing of how sizes change with distance.
    calibration["trends"]["before"]["percent_per_pixel_doubling"] = [-215.0, 160.0]
    text = page({**read_json(model / "report.json"), "calibration": calibration}, ReportPictures())
    assert "half as far" not in text and "−215" not in text and "steeper by 10 degrees" in text


@pytest.mark.slow
def test_a_model_with_few_views_gets_its_page(tmp_path):
    found = json.loads((EXAMPLE / "detections.json").read_text())
    seen = sorted(found["pictures"], key=lambda name: -len(found["pictures"][name]))
    for boxes in ("pictures", "doubtful"):  # nothing is seen from three places
        found[boxes] = {name: found[boxes][name] for name in seen[:2]}
    (tmp_path / "few.json").write_text(json.dumps(found))
    text = fixed_model(tmp_path, detections=tmp_path / "few.json", mode="oblique", force=True).read_text()
    assert read_json(tmp_path / "scaled" / "report.json")["calibration"]["trends"] is None
    assert "too few views to calibrate" in text and "steeper by 10 degrees" not in text


def test_the_page_does_without_the_parts_that_only_some_inputs_have(report, model):
    of_model = {**read_json(model / "report.json"), "drift": OF_A_MODEL}
    some = {field.name for field in msgspec.structs.fields(Report) if not field.required}
    assert some == {"without_anchors", "modes", "calibration", "agreement"} and len(some - {*report}) >= 3
    bare = {key: value for key, value in of_model.items() if key not in some}
    for each in (report, of_model, bare, {**bare, "drift": None, "claim": None}):
        assert page(each, ReportPictures.of(each, None)).rstrip().endswith("</html>")


def test_a_page_that_fails_does_not_cost_the_copy(tmp_path, monkeypatch):
    car_park(tmp_path)
    monkeypatch.setattr("orthoscale.report.files.page", lambda *_: 1 / 0)
    with pytest.raises(Incomplete, match="scaled.tif.html could not be written"):
        fixed(tmp_path)
    assert (tmp_path / "scaled.tif.json").exists() and not (tmp_path / "scaled.tif.html").exists()
    assert (tmp_path / "scaled.tif").exists()


def test_planar_and_oblique_are_drawn_where_they_are(report):
    plain = page(report, ReportPictures())
    modes = {
        "planar": {"scale": 0.0995, "interval90": [0.095, 0.104], "vehicles_used": 40},
        "oblique": {"scale": 0.1012, "interval90": [0.096, 0.106], "vehicles_used": 38},
    }
    text = page({**report, "modes": modes}, ReportPictures())
    assert "9.95 cm/px, 9.50 to 10.40 (90 %), 40 vehicles" in text and ">oblique</text>" in text
    assert "lanar" not in plain


def test_unknown_parts_of_the_uncertainty_and_far_checks_are_borne(report):
    changed = copy.deepcopy(report)
    changed["uncertainty"]["known distance"] = 0.5
    changed["checks"]["length_minus_width"] = -7.0
    changed["drift"] = None
    changed["evidence"] = [
        {"kind": "ground control", "scale": 1.01 * changed["scale"], "relative_sd": 0.01, "says": ""}
    ]
    text = page(changed, ReportPictures())
    assert (
        "the known distance itself" in text and ">ground control</text>" in text and "length − width</text>" not in text
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[1, 2]",
        '{"scale": 1}',
        '{"format": "orthoscale report 2"}',
        '{"format": "orthoscale report 99", "scale": 1}',
    ],
)
def test_what_is_no_report_is_an_input_error_and_nothing_is_written(tmp_path, text):
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(InputError, match=r"report\.json"):
        redraw(tmp_path / "report.json", tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.json"]


@pytest.mark.parametrize("key, value", [("scale", "x"), ("vehicles", 3), ("interval90", [1]), ("fleet_sizes", None)])
def test_damaged_values_are_an_input_error(tmp_path, report, key, value):
    (tmp_path / "report.json").write_text(json.dumps({**report, key: value}))
    with pytest.raises(InputError, match="not a report"):
        redraw(tmp_path / "report.json", tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_what_a_report_is_of_is_told_by_its_input(report, model):
    of_model = read_json(model / "report.json")
    for each, kind in ((report, "orthophoto"), (of_model, "reconstruction")):
        assert each["input"]["kind"] == kind and of_plan(each) == (kind == "orthophoto")


def test_the_command_draws_beside_the_json_and_keeps_what_is_there(park, tmp_path):
    path = tmp_path / "scaled.tif.json"
    path.write_bytes((park[0] / "scaled.tif.json").read_bytes())
    done = run("report", path)
    assert done.returncode == 0 and done.stdout.strip() == str(tmp_path / "scaled.tif.html"), done.stderr
    again = run("report", path)
    assert again.returncode == 2 and "already exists" in again.stderr


def test_the_command_to_reproduce_has_what_is_not_a_default():
    settings = {
        "fleet": "DE",
        "target": 0.005,
        "seed": 3,
        "cache": True,
        "exhaustive": True,
        "vehicle_classes": ["car", "a b"],
    }
    words = command_line("my ortho.tif", settings)
    assert words == (
        "orthoscale estimate 'my ortho.tif' --fleet DE --vehicle-class car --vehicle-class 'a b' --exhaustive --seed 3"
    )
    assert command_line("x.tif", {"cache": False}) == "orthoscale estimate x.tif --no-cache"
    assert command_line("x.tif", EstimateRequest(anchors=[]).settings()) == "orthoscale estimate x.tif --anchors none"
    assert command_line("x.tif", {}, "/my flights") == "cd '/my flights'\northoscale estimate x.tif"


@pytest.fixture(scope="module")
def result(park):
    folder, _ = park
    return orthoscale.estimate(folder / "park.png", fleet="DE", detections=folder / "detections.json")


def test_an_interval_that_is_not_symmetric_is_told_by_both_ends():
    assert interval_about(0.1, 0.09, 0.11) == "+-10.0 %"
    assert interval_about(0.1, 0.0978, 0.103) == "-2.2 to +3.0 %"
    assert interval_about(0.1, 0.09999, 0.10001) == "+-0.010 %" and interval_about(0.1, 0.1, 0.1) == "+-0.0 %"
    report = {"scale": 0.17, "interval90": [0.081, 0.173]}
    assert wording.within(report) == "\u221252.4 to +1.8 %"
    assert wording.metres_of(report) == "10 m in the copy are 4.8 to 10.2 m on the ground"
    report = {"scale": 14.191, "interval90": [14.125, 14.256]}
    assert wording.metres_of(report) == "10 m in the copy are 9.95 to 10.05 m on the ground", "it was 10.0 to 10.0"


def test_a_pipe_gets_plain_lines_the_answer_first(result, park, capsys):
    show(result, {"written": park[0] / "scaled.tif"})
    text = capsys.readouterr().out
    assert "\x1b" not in text and text.isascii()
    first, last = text.splitlines()[0], text.splitlines()[-1]
    words = [
        "scale",
        f"{result.scale.value:.4f}",
        "m/px",
        f"({100 * result.scale.value:.2f}",
        "cm)",
        result.scale.verdict,
    ]
    assert first.split()[:6] == words and f"(90 % within {result.scale.within})" in first
    assert last == f"written    {park[0] / 'scaled.tif'}"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
@pytest.mark.parametrize("no_color", [False, True])
def test_colours_on_a_terminal_unless_they_are_not_wanted(result, park, monkeypatch, no_color):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("NO_COLOR", "1" if no_color else "")
    parent, child = os.openpty()
    with open(child, "w") as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        show(result, {"written": park[0] / "scaled.tif"})
        terminal.flush()
        text = os.read(parent, 65536).decode()
    os.close(parent)
    assert ("\x1b[" in text) is not no_color
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()
    assert plain[0].split()[0] == "scale" and max(map(len, plain)) <= 60, "long lines are folded, not cut"
    assert str(park[0]).replace("/", "")[-12:] in re.sub(r"[\s/]", "", "".join(plain))


def test_texts_can_be_read_in_both_schemes():
    """WCAG's contrast of 4.5 between every colour of letters and every ground that they stand on."""
    css = Path(orthoscale.__file__).with_name("report").joinpath("page.html").read_text()
    schemes = [dict(re.findall(r"--(\w+): (#\w+)", line)) for line in css.splitlines() if "--ink:" in line]
    assert len(schemes) == 2 and set(schemes[0]) == set(schemes[1])

    def luminance(colour):
        digits = colour[1:] if len(colour) == 7 else "".join(2 * c for c in colour[1:])
        channels = np.array([int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)])
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        return linear @ (0.2126, 0.7152, 0.0722)

    for scheme in schemes:
        for letters in ("ink", "soft"):
            for ground in ("paper", "back"):
                dark, light = sorted(luminance(scheme[name]) for name in (letters, ground))
                assert (light + 0.05) / (dark + 0.05) > 4.5, (letters, ground)


def test_what_chance_gives_stays_pale():
    assert strength(0.1, 0.1) < 0.15 and strength(0.31, 0.1) == strength(0.5, 0.1) == 1 and strength(0.1, 0) == 0


@pytest.mark.parametrize("name, drawn", [
    ("maßstab Fläche é.tif", "massstab Flache e.tif"), ("−5 ± 2 × Łódź", "-5 +- 2 x Lodz"), ("план.tif", "????.tif"),
])  # fmt: skip
def test_letters_that_the_font_lacks_are_spelt_with_others(name, drawn):
    """They were empty boxes."""
    assert in_ascii(name) == drawn
    one, other = (np.zeros((40, 400, 3), np.uint8) for _ in range(2))
    write_on(one, (5, 30), name, 20, (255, 255, 255))
    write_on(other, (5, 30), drawn, 20, (255, 255, 255))
    assert one.any() and (one == other).all()


@pytest.mark.parametrize("place", [(40.3, 30.6), (-5.0, 20.0), (150.0, 58.5), (70.0, 3.0), (300.0, 20.0)])
@pytest.mark.parametrize("anchor, halo", [("ls", None), ("mm", (255, 255, 255))])
def test_a_word_on_a_picture_is_what_pillow_draws_on_all_of_it(place, anchor, halo):
    """Inside, over each border, and beside the picture."""
    ground = np.random.default_rng(0).integers(0, 255, (60, 160, 3), np.uint8)
    image = ground.copy()
    write_on(image, place, "Aq 4.2 m", 13, (200, 30, 10), halo, anchor)
    whole = Image.fromarray(ground)
    width = max(1, round(HALO * 13)) if halo else 0
    ImageDraw.Draw(whole).text(
        place,
        "Aq 4.2 m",
        (200, 30, 10),
        ImageFont.load_default(13),
        anchor=anchor,
        stroke_width=width,
        stroke_fill=halo or (200, 30, 10),
    )
    assert (image == np.asarray(whole)).all()
    assert (image != ground).any() == (place[0] < 160)


def test_a_source_that_refuses_its_pictures_makes_the_scale_unusable(tmp_path):
    """Such as the frames of another flight: nothing is written, and a script must not take the figure."""
    car_park(tmp_path)
    source = open_source(tmp_path / "park.png")
    options = {"fleet": "DE", "detections": tmp_path / "detections.json"}
    assert orthoscale.estimate(source, **options).disagreement is None
    source.notes.append(Remark(REFUSAL, "these are of another flight", "Name the right ones"))
    result = orthoscale.estimate(source, **options)
    assert result.scale.verdict == UNUSABLE
    with pytest.raises(EvidenceDisagrees, match="of another flight") as caught:
        result.require_useful()
    assert "Name the right ones, or write anyway" in caught.value.hint


@pytest.mark.parametrize("named", [False, True])
def test_a_scale_of_no_use_says_what_was_not_tried_yet(tmp_path, named):
    """A fleet that was named is not asked for again; where the factor was searched for, the size of a pixel helps."""
    car_park(tmp_path)
    options = {"fleet": "DE", "detections": tmp_path / "detections.json"}
    result = orthoscale.estimate(tmp_path / "park.png", **options)
    useless = replace(result.measured, scale=replace(result.scale, verdict=UNUSABLE))
    settings = {"fleet": "DE"} if named else {}
    for searched in (None, ZoomChoice(4.0, 7.0, 2.0, None, 0.0, [])):
        with pytest.raises(TooLittleEvidence) as caught:
            found = replace(result.detections, swept=Swept([], 0, zoom_choice=searched))
            replace(result, measured=useless, settings=settings, detections=found).require_useful()
        assert ("--fleet" in caught.value.hint) == (not named)
        assert ("--gsd-hint METRES_PER_PIXEL" in caught.value.hint) == (searched is not None)
        assert caught.value.hint[0].isupper() and "`orthoscale fix --force`" in caught.value.hint  # `estimate` has none
    claimed = SimpleNamespace(gsd_m=0.0967, usable=True)
    source = SimpleNamespace(path="a.tif", plan=True, notes=[], claimed=claimed)
    with pytest.raises(TooLittleEvidence) as caught:
        replace(result, source=source, measured=useless, detections=found).require_useful()
    assert "--gsd-hint 0.0967, as its georeferencing claims" in caught.value.hint


@pytest.mark.parametrize(
    "sd, total, said",
    [(0.0004, 0.03, "below 0.1 %"), (0.0006, 0.03, "0.1 %"), (0.0004, 0.001, "0.04 %"), (0.02, 0.03, "2.0 %")],
)
def test_parts_of_an_uncertainty_have_as_many_digits_as_the_others(sd, total, said):
    """Beside "sampling 0.7 %" stood "tennis court 0.04 %"; of a scale that sure, it tells."""
    assert terminal._beside_others(sd, total) == said
