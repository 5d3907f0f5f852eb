"""The paper's tables on small folders with exact truth."""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from support import in_process
from support.photos import SIZE

from orthoscale.errors import InputError
from orthoscale.evaluate.methods import METHODS
from orthoscale.evaluate.places import placed, places_of_csv
from orthoscale.evaluate.readers import DENSEUAV_FOCAL, NAMED_ALTITUDE, _read_poses, changed, read_samples
from orthoscale.evaluate.score import score, summary
from orthoscale.evaluate.surface import Surface
from orthoscale.fleets import load_fleet
from orthoscale.formats.degrees import to_degrees
from orthoscale.formats.detections import save
from orthoscale.formats.detections.own import load_detections
from orthoscale.photos.looking import Album
from orthoscale.photos.measure import measure
from orthoscale.photos.photo import RIGHT
from orthoscale.sources.lens import Lens, brown
from orthoscale.synthetic import NormalFleet, make_scene
from orthoscale.synthetic.folders import GROUND_M, LON_LAT, survey_rotation, write_csv, write_denseuav, write_visloc

# All vehicles nearly of one size, so that what is off is the method and not the luck of the draw.
MEAN = (4.45, 1.79, 1.54)
FLEET = {
    "name": "of this test",
    "source": "made for it",
    "length": [4.45, 0.05],
    "width": [1.79, 0.02],
    "height": [1.54, 0.05],
    "mean_sd": [0.02, 0.01, 0.02],
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The three forms, with grey photos and the true boxes; and the fleet."""
    base = tmp_path_factory.mktemp("sets")
    scene = make_scene(3, NormalFleet(MEAN, (0.05, 0.02, 0.05)), 110.0, 90, "carpark")
    for name, write in (("dense", write_denseuav), ("visloc", write_visloc), ("table", write_csv)):
        (base / name).mkdir()
        write(scene, base / name, pictures=False, **({"photos": 2} if name == "visloc" else {}))
    (base / "fleet.json").write_text(json.dumps(FLEET))
    return base


@pytest.mark.parametrize(
    "name, altitude",
    [
        ("000001/H80.JPG", "80"), ("000001_H90.jpg", "90"), ("H100_old.tif", "100"), ("a/000001_H_80.jpg", "80"),
        ("h82.5.png", "82.5"), ("H1000A.JPG", None), ("DJI_0080.JPG", None), ("BH80.jpg", None),
    ],
)  # fmt: skip
def test_altitudes_in_names(name, altitude):
    assert (NAMED_ALTITUDE.findall(name) or [None])[-1] == altitude


def test_a_denseuav_folder(folders):
    samples, notes = read_samples(folders / "dense")
    assert len(samples) == 9 and not notes
    assert sorted({s.altitude for s in samples}) == [80, 90, 100]
    assert samples[0].photo.lens.focal_px == pytest.approx(DENSEUAV_FOCAL * 900)
    assert pytest.approx(1080, abs=0.1) == DENSEUAV_FOCAL * 1800  # at 1440 x 1080 px
    assert {s.photo.pitch for s in samples} == {-np.pi / 2}


def test_a_visloc_folder(folders):
    for name in ("visloc/01/._region01_dsm.tif", "visloc/01/drone/._000.jpg"):
        (folders / name).write_bytes(b"\0\5\x16\7")  # macOS leaves these on disks of other systems
    samples, notes = read_samples(folders / "visloc")
    assert len(samples) == 4 and not notes and {s.region for s in samples} == {"01", "02"}
    lines = (folders / "visloc" / "01" / "reference.txt").read_text().splitlines()[1:]
    assert len(lines) == len([s for s in samples if s.region == "01"]) == 2
    for line in lines:
        label, _, _, height, yaw, pitch, roll = line.split()
        (sample,) = (s for s in samples if s.photo.name.endswith(label))
        assert sample.altitude == pytest.approx(float(height) - GROUND_M, abs=0.15)
        up = survey_rotation(*map(float, (yaw, pitch, roll))) @ [0, 0, 1]
        assert sample.photo.up == pytest.approx(up, abs=1e-6)


def test_a_visloc_region_without_photos_is_told(folders, tmp_path):
    shutil.copytree(folders / "visloc", tmp_path / "set")
    (tmp_path / "set/02/drone").rename(tmp_path / "set/02/photos")
    samples, notes = read_samples(tmp_path / "set")
    assert {s.region for s in samples} == {"01"}
    assert notes == ["region 02: no photos, for it has no drone/"]
    (tmp_path / "set/01/drone").rename(tmp_path / "set/01/photos")
    with pytest.raises(InputError, match="no region with reference.txt and drone/"):
        read_samples(tmp_path / "set", "visloc")


@pytest.mark.parametrize(("inside", "given", "name"), [("dense", ".", "dense"), ("visloc/01", ".", "01"),
                                                       ("visloc/01/drone", "..", "01")])  # fmt: skip
def test_a_region_has_its_folders_name_wherever_one_stands(folders, monkeypatch, inside, given, name):
    monkeypatch.chdir(folders / inside)
    samples, _ = read_samples(Path(given))
    assert {s.region for s in samples} == {name}


def test_ground_is_the_mean_of_the_lowest_tenth_within_100_m(folders):
    with Surface.open(folders / "visloc" / "01" / "region01_dsm.tif") as surface:
        # The lowest tenth of normal noise of 5 cm is 1.755 sigma below its middle; half of the model is roofs.
        assert surface.ground(*LON_LAT) == pytest.approx(GROUND_M - 0.05 * 1.40, abs=0.01)
        assert surface.ground(LON_LAT[0] + 1, LON_LAT[1]) is None


@pytest.mark.parametrize("lon", [179.9999, -179.9999])
@pytest.mark.parametrize("crs, unit", [("EPSG:4326", 1.0), ("EPSG:3857", 20_037_508.342789 / 180)])
def test_ground_on_the_180th_meridian(tmp_path, lon, crs, unit):
    """By a model in degrees: what is 100 m east of the place was 360 degrees west of it, and all of a row was near."""
    heights = np.full((400, 400), 10.0, np.float32)
    heights[:, :150] = 0.0  # far off
    grid = Affine(5e-5 * unit, 0, 179.99 * unit, 0, -5e-5 * unit, 0.01 * unit)
    with rasterio.open(tmp_path / "dsm.tif", "w", "GTiff", 400, 400, 1, crs, grid, "float32") as out:
        out.write(heights, 1)
    with Surface.open(tmp_path / "dsm.tif") as surface:
        assert surface.ground(lon, 0.0) == pytest.approx(10.0)


@pytest.mark.parametrize(
    "crs, told, height",
    [
        ("EPSG:2263", {}, 1000.0),
        ("EPSG:2263", {"units": ("ft",)}, 304.8),
        ("EPSG:2263", {"units": ("US survey foot",)}, 1_200_000 / 3937),
        ("EPSG:2263", {"units": ("[Meters]",)}, 1000.0),
        ("EPSG:2263+8228", {}, 304.8),  # the vertical axis in feet, those of the map in US survey feet
        ("EPSG:2263+5703", {}, 1000.0),  # the vertical axis in metres
        ("EPSG:2263+6360", {"units": ("m",)}, 1000.0),
        ("EPSG:2263", {"scales": (0.1,), "offsets": (5.0,), "units": ("ft",)}, 32.004),
    ],
)
def test_ground_in_the_unit_that_the_model_tells(tmp_path, crs, told, height):
    """Heights in feet were taken for metres, and those with a scale and an offset for what is stored of them. The map
    is in feet: of two places one is 76 m away from a pit, the other 107 m."""
    stored = np.full((600, 600), 1000.0, np.float32)
    stored[:, :120] = 0.0
    grid = Affine(2, 0, 980_000, 0, -2, 200_000)
    with rasterio.open(tmp_path / "dsm.tif", "w", "GTiff", 600, 600, 1, crs, grid, "float32") as out:
        out.write(stored, 1)
        for name, value in told.items():
            setattr(out, name, value)
    lon, lat = to_degrees("EPSG:2263").transform([980_240 + 350, 980_240 + 250], [199_400, 199_400])
    with Surface.open(tmp_path / "dsm.tif") as surface:
        assert surface.ground(lon[0], lat[0]) == pytest.approx(height, rel=1e-7)
        assert surface.ground(lon[1], lat[1]) < height / 2
        assert bool(surface.note) == ("+" not in crs and "units" not in told), "said where nothing tells the unit"
        assert not surface.note or "US survey foot" in surface.note and "taken for metres" in surface.note


@pytest.mark.parametrize("mark", [-9999, -32767, -32768])
def test_what_marks_no_height_is_known_as_it_is_stored(tmp_path, mark):
    """By a scale it became a height: -9999 is -100 m in centimetres. What it stands for may be one, of others."""
    stored = np.full((300, 300), 12_345, np.int16)
    stored[:, ::3] = mark
    stored[::4] = -1500  # 15 m below the sea
    grid = Affine(2, 0, 500_000, 0, -2, 5_000_000)
    with rasterio.open(tmp_path / "dsm.tif", "w", "GTiff", 300, 300, 1, "EPSG:32632", grid, "int16") as out:
        out.write(stored, 1)
        out.scales = (0.01,)
    lon, lat = to_degrees("EPSG:32632").transform(500_300, 4_999_700)
    with Surface.open(tmp_path / "dsm.tif") as surface:
        assert surface.ground(lon, lat) == pytest.approx(-15.0) and not surface.note


def test_an_assumed_unit_of_heights_is_said(folders, tmp_path):
    shutil.copytree(folders / "visloc", tmp_path / "v")
    path = tmp_path / "v/01/region01_dsm.tif"
    with rasterio.open(path) as model:
        heights, grid = model.read(1), model.transform
    path.unlink()
    crs = "+proj=utm +zone=32 +datum=WGS84 +units=us-ft"
    with rasterio.open(path, "w", "GTiff", *heights.shape[::-1], 1, crs, grid, "float32") as out:
        out.transform = Affine.scale(3937 / 1200) * grid
        out.write(heights, 1)
    _, notes = read_samples(tmp_path / "v")
    assert [note for note in notes if str(path) in note and "taken for metres" in note]


def test_a_model_in_an_unknown_unit_is_refused(tmp_path):
    with rasterio.open(
        tmp_path / "dsm.tif", "w", "GTiff", 9, 9, 1, "EPSG:32632", Affine(1, 0, 5e5, 0, -1, 5e6), "float32"
    ) as out:
        out.units = ("cubit",)
    with pytest.raises(InputError, match="dsm.tif: its heights are in 'cubit'"):
        Surface.open(tmp_path / "dsm.tif")


def test_a_table_with_pitch_and_focal_length(folders):
    samples, _ = read_samples(folders / "table" / "photos.csv")
    assert [round(np.degrees(s.photo.pitch)) for s in samples] == [-90, -70, -55]
    assert {s.photo.lens.focal_px for s in samples} == {900.0} and samples[0].region == "photos"


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("Image;Altitude_m;Focal_px;Longitude;Latitude", "photos/000.jpg;50;900;8.5;47.25"),  # as spreadsheets save it
        ("image, altitude_m, focal_px, longitude, latitude", "photos/000.jpg, 50, 900, 8.5, 47.25"),
        ("\ufeffimage\taltitude_m\tfocal_px\tlongitude\tlatitude", "photos/000.jpg\t50\t900\t8.5\t47.25"),
        ("sep=;\r\nImage;Altitude_m;Focal_px;Longitude;Latitude", "photos/000.jpg;50;900;8.5;47.25"),
        # Of much of Europe: a comma for the point.
        ("Image;Altitude_m;Focal_px;Longitude;Latitude", "photos/000.jpg;50,000;900;8,500;47,250"),
        ("image\taltitude_m\tfocal_px\tlongitude\tlatitude", 'photos/000.jpg\t50,0\t"900"\t8,5\t47,250'),
    ],
)
def test_tables_as_other_programs_save_them(folders, tmp_path, head, row):
    folder = tmp_path / "copy"
    shutil.copytree(folders / "table", folder)
    (folder / "photos.csv").write_text(f"{head}\n{row}\n")
    ((sample,), _) = read_samples(folder / "photos.csv")
    assert (sample.altitude, sample.photo.lens.focal_px) == (50, 900)
    assert list(places_of_csv(folder / "photos.csv").values()) == [(8.5, 47.25)]


def test_photos_of_one_name_in_two_folders_keep_their_places(folders, tmp_path):
    rows = ["north/000001/H80.JPG,80,10,50", "south/000001/H80.JPG,80,11,51"]
    for row in rows:
        photo = tmp_path / row.partition(",")[0]
        photo.parent.mkdir(parents=True)
        shutil.copy(folders / "table" / "photos" / "000.jpg", photo)
    table = tmp_path / "photos.csv"
    table.write_text("\n".join(["image,altitude_m,longitude,latitude", *rows]) + "\n")
    samples, _ = read_samples(table, focal_px=900.0)
    assert [each.lon_lat for each in placed(table, samples)[0]] == [(10, 50), (11, 51)]
    table.write_text("\n".join(["image,altitude_m,longitude,latitude", *rows, rows[0].replace("10,50", "10,51")]))
    with pytest.raises(InputError, match=r"photos.csv, line 4: north/000001/H80.JPG has another place"):
        places_of_csv(table)


def measured(folders, name):
    path = folders / name / "photos.csv" if name == "table" else folders / name
    samples, _ = read_samples(path)
    return samples, load_detections(folders / name / "detections.json"), load_fleet(folders / "fleet.json")


@pytest.mark.parametrize("name, worst", [("dense", 1.0), ("visloc", 1.0), ("table", 1.5)])
def test_true_boxes_give_true_altitudes(folders, name, worst):
    """Boxes of rectangles 0.8 m high, measured as such: what is left is the fleet's."""
    rows = score(*measured(folders, name))
    got = summary(rows, "exact")
    assert got["used_ratio"] == 1 and got["in_interval"] == 1
    assert got["mape"] < worst and got["mean_vehicles"] > 10
    if name != "table":  # three photos only, two of them slanting
        assert summary(rows, "paper")["mape"] > got["mape"], "the paper's model is approximate, above all straight down"


def test_the_shape_of_the_detectors_vehicles_counts(folders):
    """As in `photo`: boxes of a detector whose card says that they enclose bodies like vans."""
    samples, found, fleet = measured(folders, "dense")
    vans, photo = replace(found, body="van"), samples[0].photo
    got = METHODS["exact"](photo, vans, fleet, 0.0)
    truth = measure([photo], vans, fleet).altitude.value
    assert got.altitude == truth != METHODS["exact"](photo, found, fleet, 0.0).altitude


def test_figures_of_a_table_by_hand(folders):
    samples, found, fleet = measured(folders, "dense")
    rows = score(samples, found, fleet, {"exact": METHODS["exact"]})
    error = np.array([100 * (r.estimates["exact"].altitude / r.sample.altitude - 1) for r in rows])
    got = summary(rows, "exact")
    assert got["mape"] == pytest.approx(np.abs(error).mean()) and got["bias"] == pytest.approx(error.mean())
    assert got["worst_ape"] == pytest.approx(np.abs(error).max())
    vehicles = np.array([r.estimates["exact"].vehicles for r in rows])
    half = summary(rows, "exact", int(np.median(vehicles)) + 1)
    assert half["used"] == (vehicles > np.median(vehicles)).sum() and half["images"] == 9


def run(*arguments):
    return in_process.run("evaluate", *arguments)


def rules(folders, name):
    return ["--detections", folders / name / "detections.json", "--fleet", folders / "fleet.json"]


@pytest.mark.slow
def test_the_command_writes_tables_of_everything(folders, tmp_path):
    outputs = ["--out", tmp_path / "a.json", "--out", tmp_path / "a.csv"]
    more = ["--ablations", "--sensitivity"]
    done = run(folders / "visloc", *rules(folders, "visloc"), *more, *outputs)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("method") and "MAPE" in done.stdout.splitlines()[0]
    text = json.loads((tmp_path / "a.json").read_text())
    assert [line["region"] for line in text["regions"]["exact"]] == ["01", "02", "all"]
    assert len(list(csv.DictReader((tmp_path / "a.csv").open()))) == text["photos"] == 4
    ratios = {(a["min_score"], a["min_vehicles"]): a["used_ratio"] for a in text["ablations"] if a["method"] == "exact"}
    assert ratios[0.5, 5] == 1 and ratios[0.8, 5] == 1
    assert re.search(r"^exact: .* at least so many vehicles; it needs 5 in any case$", done.stdout, re.M)
    assert re.search(r"^paper: .* at least so many vehicles$", done.stdout, re.M), "it takes one, too"
    biases = {(s["wrong"], s["by"]): s["bias"] for s in text["sensitivity"] if s["method"] == "exact"}
    right = biases["focal", 0.0]
    assert right == biases["pitch_deg", 0.0]
    assert biases["focal", 0.05] - right == pytest.approx(5, abs=0.6), "near nadir, altitude goes with the focal length"
    assert abs(biases["pitch_deg", 1.0] - right) < 0.6, "and a degree of pitch hardly matters"


def test_boxes_as_the_papers_authors_keep_them(folders, tmp_path):
    """DOTA's result text; nothing is known of such boxes' margin, and the interval says so."""
    samples, found, _ = measured(folders, "dense")
    path = tmp_path / "Task1_small-vehicle.txt"
    save(found, path, Album([s.photo for s in samples]))
    done = run(folders / "dense", "--detections", path, "--fleet", folders / "fleet.json", "--json")
    assert done.returncode == 0, done.stderr
    (line,) = json.loads(done.stdout)["regions"]["exact"]
    assert line["used"] == 9 and line["mape"] < 3 and line["in_interval"] == 1


def test_oblique_photos_can_be_left_out(folders):
    done = run(folders / "table" / "photos.csv", *rules(folders, "table"), "--max-pitch", -60, "--json")
    text = json.loads(done.stdout)
    assert text["photos"] == 2 and "1 photos with a flatter pitch than -60 degrees" in text["notes"][0]


def test_a_wrong_pitch_is_towards_the_horizon(folders):
    samples, _ = read_samples(folders / "table" / "photos.csv")
    for before, after in zip(samples[1:], changed(samples, pitch_deg=2.0)[1:], strict=True):
        assert np.degrees(after.photo.pitch - before.photo.pitch) == pytest.approx(2.0)
        assert after.photo.up @ RIGHT == pytest.approx(0)


def test_a_wrong_pitch_alone_leaves_the_lens(folders):
    (sample, *_), _ = read_samples(folders / "table" / "photos.csv")
    bent = brown(SIZE, 900.0, 910.0, bend=(-0.1, 0.0, 0.0, 0.0, 0.0))
    sample = replace(sample, photo=replace(sample.photo, lens=Lens(bent, 0.003, "made for this test")))
    (after,) = changed([sample], pitch_deg=2.0)
    assert after.photo.lens.camera.params == pytest.approx(bent.params)


@pytest.mark.parametrize("change", [
    lambda text: text.replace(".", ",").replace(",jpg", ".jpg"),
    lambda text: text.replace(".", ",").replace(",jpg", ".jpg").replace(" ", ";"),
    lambda text: text.replace(" ", ";"), lambda text: text.replace(" ", ", "),
])  # fmt: skip
def test_poses_with_decimal_commas_are_the_same(folders, tmp_path, change):
    """Each comma began a new column, so the last six were not those that are meant."""
    path = folders / "visloc" / "01" / "reference.txt"
    (tmp_path / "reference.txt").write_text(change(path.read_text()))
    assert _read_poses(tmp_path / "reference.txt") == _read_poses(path)


def append(path, line):
    path.write_text(f"{path.read_text().rstrip()}\n{line}\n")


def break_csv(text):
    return lambda folder: (folder / "photos.csv").write_text(text)


@pytest.mark.parametrize(
    "name, damage, word",
    [
        ("table", break_csv("image,height\na.jpg,5\n"), "no column altitude_m"),
        ("table", break_csv("image,altitude_m\nphotos/000.jpg,high\n"), "line 2"),
        ("table", break_csv("sep=,\nimage,altitude_m\nphotos/000.jpg,high\n"), "line 3"),
        ("table", break_csv("image,altitude_m\nphotos/000.jpg,-5\n"), "positive"),
        ("table", break_csv("image,altitude_m,focal_px\nphotos/000.jpg,50,5,900\n"), "line 2: has more cells than the"),
        ("table", break_csv('image,altitude_m\nphotos/000.jpg,"50,5"\n'), "line 2: altitude_m is '50,5', not a number"),
        ("table", break_csv("image;altitude_m;focal_px\nphotos/000.jpg;50,5;900.5\n"), "altitude_m is '50,5', not"),
        ("table", break_csv("image\taltitude_m\nphotos/000.jpg\t1,234\n"), "altitude_m is '1,234', not a number"),
        ("table", break_csv("image,altitude_m,Altitude_m\nphotos/000.jpg,5,6\n"), "several columns altitude_m"),
        ("table", break_csv("image,altitude_m,focal_px\nnowhere.jpg,50,900\n"), "nowhere.jpg"),
        ("table", break_csv("image,altitude_m\nphotos/000.jpg,50\n"), "no focal length"),
        ("table", break_csv("image,altitude_m,pitch_deg\nphotos/000.jpg,50,90\n"), "line 2: pitch_deg is 90"),
        ("table", break_csv("image,altitude_m,roll_deg\nphotos/000.jpg,50,1e9\n"), r"line 2: roll_deg is 1e\+09"),
        ("visloc", lambda f: (f / "01" / "camera.xml").write_text("<calibration/>"), "camera.xml"),
        ("visloc", lambda f: (f / "01" / "camera.xml").unlink(), "no camera.xml"),
        ("visloc", lambda f: (f / "02" / "reference.txt").write_text("a b c\n"), "no pose"),
        ("visloc", lambda f: (f / "02" / "reference.txt").write_text("a.jpg 5e5 5e6 90 0 0 0\n"), "longitude"),
        (
            "visloc",
            lambda f: (f / "02" / "reference.txt").write_text("a.jpg 200 48 90 0 0 0\n"),
            "200, 48 is not a longitude",
        ),
        ("visloc", lambda f: (f / "02" / "region02_dsm.tif").write_text("no raster"), "dsm.tif"),
        ("visloc", lambda f: (f / "02" / "region02_dsm.tif").unlink(), "no surface model"),
        (
            "visloc",
            lambda f: shutil.copy(f / "02" / "region02_dsm.tif", f / "02" / "b_DSM.TIFF"),
            "b_DSM.TIFF, region02",
        ),
        ("visloc", lambda f: append(f / "02" / "reference.txt", "02_0001.JPG 9 48 200 0 0 0"), "another pose already"),
        (
            "table",
            break_csv("image,altitude_m,focal_px\n" + 2 * "photos/000.jpg,50,900\n"),
            "line 3: photos/000.jpg is in",
        ),
        ("dense", lambda f: [p.rename(p.with_name("x.jpg")) for p in f.rglob("H80.JPG")], ""),
    ],
)
def test_damaged_data_sets_are_named(folders, tmp_path, name, damage, word):
    folder = tmp_path / "copy"
    shutil.copytree(folders / name, folder)
    damage(folder)
    path = folder / "photos.csv" if name == "table" else folder
    if word:
        with pytest.raises(InputError, match=word):
            read_samples(path)
    else:
        samples, notes = read_samples(path)
        assert len(samples) == 6 and "3 photos without an altitude" in notes[0]


@pytest.mark.parametrize(
    "path, code, word", [("nowhere", 5, "does not exist"), ("empty", 5, "no photo"), ("few", 3, "none of 9 photos")]
)
def test_bad_input_ends_in_one_sentence(folders, tmp_path, path, code, word):
    (tmp_path / "empty").mkdir()
    boxes = json.loads((folders / "dense" / "detections.json").read_text())
    few = tmp_path / "few.json"
    few.write_text(json.dumps({name: found[:3] for name, found in boxes["pictures"].items()}))
    target = folders / "dense" if path == "few" else tmp_path / path
    saved = tmp_path / "saved.json"
    done = run(target, "--detections", few, "--fleet", "DE", "--save-detections", saved)
    assert done.returncode == code, done.stderr
    assert word in done.stderr and "Traceback" not in done.stderr and done.stdout == ""
    assert saved.exists() == (f"the boxes are saved in {saved}" in done.stderr) == (path == "few")
