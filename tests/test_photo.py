"""Single photos: what their tags say, and level ground seen by cameras of known pose."""

import csv
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pyogrio
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from support import in_process
from support.bodies import CAR, VAN, VAN_CORNER, block, body
from support.camera import simple_views
from support.photos import ALTITUDE, CALIBRATIONS, CARS, FOCAL, SIZE, boxes_in, detections_of, view_from, write_photo

from orthoscale.core.boxes import Boxes
from orthoscale.core.calibration import Calibration
from orthoscale.core.detections import UNKNOWN_RULER
from orthoscale.core.fleet import WORLD
from orthoscale.core.projection.exact import BODIES
from orthoscale.core.projection.level import level_axes, level_views, up_from_gimbal, up_from_survey
from orthoscale.core.ruler import Ruler
from orthoscale.detect.detector import Passes
from orthoscale.detect.workers import worker_count
from orthoscale.errors import InputError, TooLittleEvidence, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.calibration import save_calibration
from orthoscale.formats.detections.own import load_detections, save_detections
from orthoscale.locate.claimed import claimed_scales
from orthoscale.locate.level import LevelledPhoto
from orthoscale.photos import survey, tables
from orthoscale.photos.folders import find_photos
from orthoscale.photos.footprint import footprint_of
from orthoscale.photos.looking import Looking, boxes_of
from orthoscale.photos.measure import PhotoGeometry, _assembled, measure
from orthoscale.photos.photo import open_photo
from orthoscale.photos.survey import measure_together, open_photos
from orthoscale.photos.survey import photo as survey_photos
from orthoscale.photos.tables import footprint_on_earth
from orthoscale.photos.terminal import _told
from orthoscale.sources.lens import lens_of, read_calibration
from orthoscale.sources.tags import Tags, read_tags
from orthoscale.synthetic import Pose

POOLED = 0.006  # of a scale, relative: what the mixture of classes may be off where all vehicles are as the fleet says


@pytest.mark.parametrize(
    "xmp, pitch, roll, yaw",
    [
        (
            'drone-dji:GimbalPitchDegree="-89.90" drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalYawDegree="+12.3"',
            -89.9, 0, 12.3,
        ),
        (
            "|<drone-parrot:CameraPitchDegree>-78.36</drone-parrot:CameraPitchDegree>"
            "<drone-parrot:CameraRollDegree>-0.32</drone-parrot:CameraRollDegree>",
            -78.36, -0.32, None,
        ),
        ('|<sky:CameraOrientationNED sky:Pitch="-84" sky:Roll="0.2" sky:Yaw="146.5"/>', -84, 0.2, 146.5),
        (
            '|<sky:CameraOrientationNED rdf:parseType="Resource"><sky:Pitch>-84</sky:Pitch></sky:CameraOrientationNED>',
            -84, None, None,
        ),
        ('Camera:Pitch="7.5" Camera:Roll="0" Camera:Yaw="300"', -82.5, 0, 300),  # 0 is straight down here
        ('Camera:Pitch="-85" Camera:Roll="0"', -85, 0, None),  # Autel's own reading of that schema
        (  # a camera that does not know its gimbal
            'drone-dji:GimbalPitchDegree="+0.00" drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalYawDegree="+0.00"',
            None, None, None,
        ),
        ('Camera:Pitch="steep"', None, None, None),
        ('drone-dji:GimbalPitchDegree="-600/10" drone-dji:GimbalRollDegree="0/1"', -60, 0, None),
        ('drone-dji:GimbalPitchDegree="-6/0"', None, None, None),
        ("", None, None, None),
    ],
)  # fmt: skip
def test_makers_angles_get_one_meaning(tmp_path, xmp, pitch, roll, yaw):
    tags = read_tags(write_photo(tmp_path / "a.jpg", xmp))
    assert (tags.pitch, tags.roll, tags.yaw) == (pitch, roll, yaw)


@pytest.mark.parametrize(("pitch", "roll"), [(0, 10), (7.5, -1), (-4, 12), (30, 5)])
def test_wings_that_roll_tilt_a_camera_that_looks_down(tmp_path, pitch, roll):
    xmp = f'Camera:Pitch="{pitch}" Camera:Roll="{roll}" Camera:Yaw="30"'
    tags = read_tags(write_photo(tmp_path / "a.jpg", xmp))
    up = up_from_gimbal(*np.radians([tags.pitch, tags.roll]))
    assert up == pytest.approx(up_from_survey(*np.radians([pitch, roll])), abs=1e-7)
    # Axes right, forward, up: the picture's top and the optical axis, turned by roll, pitch and yaw.
    east, north, _ = Rotation.from_euler("ZXY", [-30, pitch, roll], degrees=True).apply([0, 1, -1])
    assert np.degrees(np.arctan2(east, north)) % 360 == pytest.approx(tags.heading, abs=1e-5)


def test_xmp_without_its_outer_element(tmp_path):
    packet = (
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        'xmlns:d="http://www.dji.com/drone-dji/1.0/" d:GimbalPitchDegree="-60.0"/></rdf:RDF>'
    )
    Image.new("RGB", (8, 6)).save(tmp_path / "a.jpg", xmp=packet.encode())
    assert read_tags(tmp_path / "a.jpg").pitch == -60


@pytest.mark.parametrize(
    ("sides", "place"),
    [
        (("S", "W"), (-58.5, -34.5)),
        (("s", "w"), (-58.5, -34.5)),
        (("South", "West"), (-58.5, -34.5)),
        ((b"S\0", b"W\0"), (-58.5, -34.5)),
        (("N", "E"), (58.5, 34.5)),
        (("", ""), None),  # somewhere in four places
    ],
)
def test_sides_of_the_earth_in_any_spelling(tmp_path, sides, place):
    exif = Image.Exif()
    exif.get_ifd(0x8825).update({1: sides[0], 2: (34.0, 30.0, 0.0), 3: sides[1], 4: (58.0, 30.0, 0.0)})
    Image.new("RGB", (8, 6)).save(tmp_path / "a.jpg", exif=exif)
    assert read_tags(tmp_path / "a.jpg").lon_lat == place


@pytest.mark.parametrize("place", [(0.0, 0.0), (8.5, 90.5), (180.5, 47.0)])
def test_a_place_that_cannot_be_is_none(tmp_path, place):
    """Zeros are of a receiver that had found nothing yet."""
    assert read_tags(write_photo(tmp_path / "a.jpg", gps=place)).lon_lat is None


def test_a_height_that_other_makers_call_otherwise_is_read_too(tmp_path):
    assert read_tags(write_photo(tmp_path / "a.jpg", 'Camera:AboveGroundAltitude="52.5"')).relative_altitude == 52.5


def test_raw_photos_and_hidden_files_are_no_photos(tmp_path):
    exif = Image.Exif()
    exif[0x00FE] = 1  # a reduced picture
    Image.new("RGB", (256, 192)).save(tmp_path / "a.dng", format="TIFF", exif=exif)
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(99))
    for name in ("a.dng", "a.heic"):
        with pytest.raises(InputError, match=name) as caught:
            read_tags(tmp_path / name)
        assert "convert HEIC and raw" in caught.value.hint
    with pytest.raises(InputError, match="no readable photo in this folder"):
        find_photos([tmp_path])
    write_photo(tmp_path / "a.jpg")
    (tmp_path / "._a.jpg").write_bytes(b"\0\5\x16\7")  # macOS leaves these on cards
    for place in (".Trash-1000/files", "@eaDir/a.jpg"):  # deleted photos, thumbnails of a network drive
        (tmp_path / place).mkdir(parents=True)
        write_photo(tmp_path / place / "b.jpg")
    assert list(find_photos([tmp_path]).paths) == ["a.jpg"]


def test_files_in_a_folder_that_are_not_looked_at_are_said(tmp_path):
    """Of a flight by a phone, or with videos, a part was left out without a word."""
    with_video = write_photo(tmp_path / "a.jpg")
    for name in ("a.DNG", "a.mp4", "b.HEIC", "more/c.heic", "._d.heic", "notes.txt", "e.MOV", "f.nef", "g.webp"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = find_photos([tmp_path])
    assert found.paths == {"a.jpg": with_video}
    (told,) = found.notes
    assert told.startswith(f"{tmp_path}: not read: a.mp4, b.HEIC, e.MOV, f.nef, g.webp and 1 more. Give photos as")
    assert "convert HEIC" in told and "frames of videos" in told
    with_video.unlink()
    with pytest.raises(InputError, match="no readable photo in this folder, only a.DNG, a.mp4"):
        find_photos([tmp_path])
    assert find_photos([write_photo(tmp_path / "a.jpg")]).notes == (), "the folder was not named"


@pytest.mark.parametrize("place", [(8.5, 47.25), (-58.4, -34.6), (-91.99, 46.84)])
def test_place_altitude_and_camera(tmp_path, place):
    xmp = 'drone-dji:RelativeAltitude="+40.10" drone-dji:CalibratedFocalLength="3666.67" drone-dji:DewarpFlag="1"'
    path = write_photo(tmp_path / "a.jpg", xmp, {0x010F: "DJI", 0x0110: "FC6310"}, gps=place)
    tags = read_tags(path)
    assert (tags.make, tags.model, tags.relative_altitude, tags.calibrated_px) == ("DJI", "FC6310", 40.1, 3666.67)
    assert tags.lon_lat == pytest.approx(place, abs=1e-9) and tags.dewarped


@pytest.mark.parametrize("xmp", ['Camera:Pitch="-60,5"', 'drone-dji:GimbalPitchDegree="-60,5"'])
def test_a_pitch_that_is_no_number_is_said(tmp_path, xmp):
    assert read_tags(write_photo(tmp_path / "a.jpg", xmp)).notes == ("its pitch of '-60,5' is not a number: ignored",)


@pytest.mark.parametrize(("unit", "per_mm"), [(None, 100 / 25.4), (2, 100 / 25.4), (3, 10.0), (4, 100.0), (5, 1e5)])
def test_the_unit_of_the_resolution_on_the_sensor(tmp_path, unit, per_mm):
    """Inches where none is told, centimetres, millimetres, micrometres."""
    exif = {0xA20E: 100.0} | ({} if unit is None else {0xA210: unit})
    assert read_tags(write_photo(tmp_path / "a.jpg", exif=exif)).plane_px_per_mm == pytest.approx(per_mm)


@pytest.mark.parametrize(("turn", "told"), [(1, False), (3, False), (4, False), (5, True), (6, True), (8, True)])
def test_a_quarter_turn_that_exif_asks_for_is_said(tmp_path, turn, told):
    tags = read_tags(write_photo(tmp_path / "a.jpg", exif={0x0112: turn}))
    assert (tags.width, tags.height) == SIZE and any("quarter turn" in note for note in tags.notes) == told


def test_when_a_photo_was_taken_not_when_it_was_edited(tmp_path):
    exif = {0x9003: "2026:06:01 12:00:00", 0x9004: "2026:06:02 12:00:00"}
    assert read_tags(write_photo(tmp_path / "a.jpg", exif=exif)).taken == "2026:06:01 12:00:00"
    assert read_tags(write_photo(tmp_path / "b.jpg", exif={0x9004: "2026:06:02 12:00:00"})).taken == ""


@pytest.mark.parametrize("unknown", [(0, 0), (2**31, 1), (2**32 - 1, 1)])
def test_a_number_that_is_unknown_or_infinite_is_none(tmp_path, unknown):
    """DJI writes 0/0 where nothing is zoomed, and COLMAP's undistorter makes 80000000/1 of it."""
    exif, value = Image.Exif(), IFDRational(*unknown)
    exif.get_ifd(0x8769).update({0xA404: value, 0x920A: value, 0xA20E: value})
    Image.new("RGB", (8, 6)).save(tmp_path / "a.jpg", exif=exif)
    tags = read_tags(tmp_path / "a.jpg")
    assert (tags.digital_zoom, tags.focal_mm, tags.plane_px_per_mm) == (1.0, None, None)


def test_damaged_xmp_is_passed_over_and_said(tmp_path):
    assert "XMP is damaged" in read_tags(write_photo(tmp_path / "a.jpg", 'drone-dji:X="<"')).notes[0]


def test_tags_damaged_at_random_are_read_or_refused(tmp_path):
    xmp = 'drone-dji:GimbalPitchDegree="-89.90" drone-dji:DewarpData="x;1,2,3,4,5,6,7,8,9"'
    exif = {0x010F: "DJI", 0xA405: 24, 0x920A: 8.8, 0xA20E: 4000.0, 0xA404: 1.0}
    whole = write_photo(tmp_path / "a.jpg", xmp, exif, gps=(8.5, 47.25), size=(64, 48)).read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        damaged = bytearray(whole)
        for place in rng.integers(4, whole.find(b"xpacket end") + 20, 6):
            damaged[place] = rng.integers(256)
        (tmp_path / "b.jpg").write_bytes(damaged)
        try:
            assert read_tags(tmp_path / "b.jpg").width > 0
        except InputError as error:
            refused += 1
            assert "b.jpg" in error.message
    assert refused < 300


def tags(width=4000, height=3000, full_width=None, **values):
    return Tags(width, height, full_width or width, **values)


@pytest.mark.parametrize(
    "given, focal",
    [
        (tags(focal_35mm=20), 20 / np.hypot(36, 24) * 5000),  # by the diagonal, not by the width
        (tags(5472, 3648, focal_35mm=24), 24 / np.hypot(36, 24) * np.hypot(5472, 3648)),
        (tags(4000, 2250, focal_35mm=20), 20 / np.hypot(36, 24) * 5000),  # 16:9 out of a 4:3 sensor
        (tags(2000, 1125, 4000, focal_35mm=20), 20 / np.hypot(36, 24) * 2500),
        (tags(3000, 4000, focal_35mm=20), 20 / np.hypot(36, 24) * 5000),
        (tags(focal_mm=8.8, plane_px_per_mm=4000 / 13.2), 4000 * 8.8 / 13.2),
        (tags(2000, 1500, 4000, calibrated_px=2300.0), 1150.0),
        (tags(calibrated_px=3.61, focal_35mm=20), 20 / np.hypot(36, 24) * 5000),  # millimetres, not pixels
        (tags(2000, 1500, 4000, dewarp=(2310, 2310, -4, 6, -0.01, 0, 0, 0, 0), focal_35mm=24), 1155.0),
        (tags(2000, 1500, 4000, full_height=3000, calibrated_px=2300.0), 1150.0),
        (tags(3000, 4000, 4000, full_height=3000, calibrated_px=2300.0), 2300.0),  # turned since
        (tags(1500, 2000, 4000, full_height=3000, focal_mm=8.8, plane_px_per_mm=4000 / 13.2), 2000 * 8.8 / 13.2),
        (tags(3000, 4000, 4000, full_height=3000, dewarp=(2310, 2310, -4, 6, -0.01, 0, 0, 0, 0)), 2310.0),
        (tags(4000, 2250, 4000, full_height=3000, focal_35mm=20), 20 / np.hypot(36, 24) * 5000),  # cropped to 16:9
        (tags(4000, 2250, 4000, full_height=3000, dewarp=(2310, 2310, -4, 6, -0.01, 0, 0, 0, 0)), 2310.0),
        (tags(3600, 3000, 4000, full_height=3000, focal_35mm=20), 20 / np.hypot(36, 24) * 5000),  # 6:5 of 4:3
        (tags(4000, 3000, 160, full_height=110, calibrated_px=2300.0), 2300.0),  # EXIF tells a thumbnail's size
        (
            tags(4000, 3000, 160, full_height=120, focal_35mm=20, dewarp=(2310,) * 2 + (0,) * 7),
            20 / np.hypot(36, 24) * 5000,
        ),
        (tags(focal_mm=8.8, plane_px_per_mm=4000 / 13.2 / 25.4, focal_35mm=24), 24 / np.hypot(36, 24) * 5000),
        (tags(focal_mm=8.8, plane_px_per_mm=4000 / 13.2, digital_zoom=2.0), 2 * 4000 * 8.8 / 13.2),
    ],
)
def test_focal_length_from_tags(given, focal):
    lens = lens_of(given)
    assert lens.focal_px == pytest.approx(focal, rel=1e-9)
    assert (lens.camera.width, lens.camera.height) == (given.width, given.height)
    assert 0 < lens.sd < (0.05 if given.digital_zoom == 1 else 0.2)


@pytest.mark.parametrize(
    ("roll", "kept", "exif"),
    [
        (5, 5, {}),
        (-90.5, 0, {}),
        (180, 0, {}),  # which DJI writes for photos taken straight down
        (5, 0, {0xA002: SIZE[1], 0xA003: SIZE[0]}),  # of a photo that was turned since
    ],
)
def test_a_pitch_that_is_given_keeps_the_roll_that_is_known(tmp_path, roll, kept, exif):
    xmp = f'drone-dji:GimbalPitchDegree="-62.0" drone-dji:GimbalRollDegree="{roll}"'
    path = write_photo(tmp_path / "a.jpg", xmp, {0xA405: 24, **exif})
    photo = open_photo(path, pitch=-60)
    assert photo.up == pytest.approx(up_from_gimbal(*np.radians([-60, kept])))
    assert photo.attitude == "pitch -60, given" + (f"; roll {kept}, from XMP" if kept else "")
    both = open_photo(path, pitch=-60, roll=0)
    assert both.up == pytest.approx(up_from_gimbal(np.radians(-60))) and both.attitude == "pitch -60, given"


@pytest.mark.parametrize(("gps", "altitude"), [((380.5,), 380.5), ((380.5, b"\0"), 380.5), ((380.5, b"\1"), -380.5)])
def test_an_altitude_below_the_sea_is_negative(tmp_path, gps, altitude):
    """Over the Dead Sea a drone that climbed seemed to sink."""
    assert read_tags(write_photo(tmp_path / "a.jpg", gps=(35.5, 31.5, *gps))).altitude == altitude


def test_what_was_cropped_and_may_be_smaller_is_refused(tmp_path):
    with pytest.raises(InputError, match="1920 x 1080 px are a crop of the 4000 x 3000 px"):
        lens_of(tags(1920, 1080, 4000, full_height=3000, focal_35mm=20))
    assert lens_of(tags(1920, 1080, 4000, full_height=3000), focal_px=1000.0).focal_px == 1000


def test_a_photo_that_was_turned_has_another_pitch(tmp_path):
    exif = {0xA405: 24, 0xA002: SIZE[1], 0xA003: SIZE[0]}
    flat = write_photo(tmp_path / "a.jpg", 'drone-dji:GimbalPitchDegree="-60.0"', exif)
    with pytest.raises(InputError, match="quarter turn"):
        open_photo(flat)
    assert np.degrees(open_photo(flat, pitch=-60, roll=90).pitch) == pytest.approx(-60)
    down = write_photo(tmp_path / "b.jpg", 'drone-dji:GimbalPitchDegree="-89.9"', exif)
    assert np.degrees(open_photo(down).pitch) == pytest.approx(-89.9)


@pytest.mark.parametrize(
    "given, sd",
    [
        (tags(focal_35mm=20), [0.02, 0.29 / 20]),  # whole millimetres stray by the root of a twelfth
        (tags(focal_35mm=80), [0.02, 0.29 / 80]),
        (tags(4000, 2250, focal_35mm=20), [0.02, 0.29 / 20, 0.03]),  # of a sensor that may be cut
        (tags(focal_35mm=20, digital_zoom=2.0), [0.02, 0.29 / 20, 0.1]),
        (tags(focal_mm=10.0, plane_px_per_mm=300.0), [0.02]),
        (tags(focal_mm=10.0, plane_px_per_mm=300.0, digital_zoom=2.0), [0.02, 0.1]),
        (tags(calibrated_px=2800.0), [0.01]),
    ],
)
def test_how_well_a_focal_length_is_known_follows_from_where_it_is_from(given, sd):
    assert lens_of(given).sd == pytest.approx(np.linalg.norm(sd))


def test_dewarp_data_bends_the_lens_unless_the_camera_has_straightened_it():
    dewarp = (2310.0, 2310.0, -4.0, 6.0, -0.01, 0.0, 0.0, 0.0, 0.0)
    assert lens_of(tags(dewarp=dewarp)).camera.principal_point_x == 1996
    assert lens_of(tags(dewarp=dewarp)).camera.params[4] == -0.01
    assert lens_of(tags(dewarp=dewarp, dewarped=True)).camera.model.name == "PINHOLE"


def test_dewarp_data_are_of_the_picture_that_the_camera_wrote_axis_by_axis():
    """Of a photo made half as large its lengths are halved, the middle's offset among them; bends stay."""
    bends = [-0.01, 0.02, 0.003, 0.004, 0.05]
    camera = lens_of(tags(2000, 1500, 4000, dewarp=(2310.0, 2300.0, -4.0, 6.0, *bends))).camera
    assert camera.params.tolist() == pytest.approx([1155, 1150, 1000 - 2, 750 + 3, *bends, 0, 0, 0])


def test_every_calibration_file_says_the_same_and_follows_the_photos_size(tmp_path):
    rays = []
    for name, text in CALIBRATIONS.items():
        (tmp_path / name).write_text(text)
        camera = lens_of(tags(2000, 1500), lens_file=tmp_path / name).camera
        rays.append(camera.cam_from_img(np.array([[100.0, 200.0], [1000.0, 750.0]])))
    assert np.abs(np.array(rays) - rays[0]).max() < 1e-9
    assert lens_of(tags(2000, 1500), lens_file=tmp_path / "a.json").focal_px == pytest.approx(1150)


def test_metashapes_pixels_that_are_not_square_are_wider_by_b1(tmp_path):
    (tmp_path / "a.xml").write_text(CALIBRATIONS["a.xml"].replace("<cx>", "<b1>-5</b1><cx>"))
    camera = lens_of(tags(), lens_file=tmp_path / "a.xml").camera
    assert (camera.focal_length_x, camera.focal_length_y) == (2295, 2300)


@pytest.mark.parametrize(
    "name, text, word",
    [
        ("a.xml", "<calibration><f>1</f>", "no calibration"),
        ("a.xml", "<calibration><width>10</width><height>10</height></calibration>", "<f>"),
        ("a.json", '{"width": 4000, "height": 3000}', "focal_px"),
        ("a.json", '{"width": 4000, "height": 3000, "fx": -5}', "positive"),
        ("a.txt", "1 OPENCV 4000 3000 2300\n", "parameters"),
        ("a.txt", "1 OPENC 4000 3000 2300 2300 2000 1500 0 0 0 0\n", "no camera model is called OPENC"),
        ("a.txt", "", "0 cameras"),
        ("a.doc", "f 2300", "not a calibration"),
    ],
)
def test_bad_calibrations_are_refused(tmp_path, name, text, word):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=word):
        read_calibration(tmp_path / name)


def test_calibration_of_another_format_is_refused(tmp_path):
    (tmp_path / "a.json").write_text(CALIBRATIONS["a.json"])
    with pytest.raises(InputError, match="4000 x 3000"):
        lens_of(tags(4000, 2250), lens_file=tmp_path / "a.json")


def test_no_focal_length_is_said():
    with pytest.raises(InputError, match="no focal length"):
        lens_of(tags())


# Geometry


@pytest.mark.parametrize("pitch", [-90.0, -75.0, -50.0])
def test_level_ground_is_that_of_the_papers_geometry(pitch):
    pixels = np.random.default_rng(0).uniform([0, 0], SIZE, (50, 2))
    plain = simple_views(pixels, SIZE, FOCAL, np.radians(pitch), ALTITUDE)
    plane = (pixels - np.array(SIZE) / 2) / FOCAL
    views, ok = level_views(plane, plain.lens, up_from_gimbal(np.radians(pitch)), ALTITUDE, np.radians(5))
    assert ok.all()
    assert views.ground == pytest.approx(plain.ground) and views.normal == pytest.approx(plain.normal)


@pytest.mark.parametrize("pitch, roll, yaw", [(-90, 0, 0), (-70, 0, 40), (-60, 8, 200), (-35, -12, 300)])
def test_up_and_axes_are_those_of_a_posed_camera(pitch, roll, yaw):
    heading = np.radians(90 - yaw)
    pose = Pose.looking(np.array([0, 0, ALTITUDE]), heading, np.radians(-pitch), np.radians(roll))
    up = up_from_gimbal(np.radians(pitch), np.radians(roll))
    assert pose.rotation @ [0, 0, 1] == pytest.approx(up, abs=1e-12)
    if roll == 0:
        right, ahead = level_axes(up) @ pose.rotation
        assert ahead == pytest.approx([np.cos(heading), np.sin(heading), 0], abs=1e-9)
        assert right == pytest.approx([np.sin(heading), -np.cos(heading), 0], abs=1e-9)


@pytest.mark.parametrize(
    ("pitch", "roll", "heading"), [(-90, 0, 30), (-90, 180, 210), (-89.9, 180, 210), (-90, -90, 300), (-40, 0, 30)]
)
def test_roll_turns_the_footprint_of_a_photo_taken_straight_down(pitch, roll, heading):
    tags = Tags(8, 6, 8, lon_lat=(0.0, 0.0), pitch=pitch, roll=roll, yaw=30)
    assert tags.heading == pytest.approx(heading)
    ahead = SimpleNamespace(outline=lambda: np.array([(-1.0, 100.0), (0.0, 100.0), (1.0, 100.0)]))
    outline = footprint_on_earth(SimpleNamespace(photo=SimpleNamespace(tags=tags), measured=ahead))
    lon, lat = outline.exterior.coords[1]
    assert Tags(6, 8, 8, full_height=6, pitch=pitch, roll=roll, yaw=30).heading is None  # turned since
    assert np.degrees(np.arctan2(lon, lat)) % 360 == pytest.approx(heading, abs=0.5)  # 0.3 by the Earth's flattening


@pytest.mark.parametrize("lon", [179.9999, -179.9999])
def test_a_footprint_on_the_180th_meridian_does_not_go_around_the_earth(lon):
    tags = Tags(8, 6, 8, lon_lat=(lon, 45.0), pitch=-90, roll=0, yaw=30)
    around = SimpleNamespace(outline=lambda: 50.0 * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]))
    outline = footprint_on_earth(SimpleNamespace(photo=SimpleNamespace(tags=tags), measured=around))
    west, _, east, _ = outline.bounds
    assert abs(west) < 180.001 and abs(east) < 180.001
    assert (east - west) * np.cos(np.radians(45)) * 111_320 == pytest.approx(100 * (np.sin(np.pi / 3) + 0.5), rel=0.01)


def test_a_photo_with_the_horizon_in_view_has_no_footprint():
    tags = Tags(8, 6, 8, lon_lat=(10.0, 45.0), pitch=-5, roll=0, yaw=30)
    endless = SimpleNamespace(outline=lambda: None)
    assert footprint_on_earth(SimpleNamespace(photo=SimpleNamespace(tags=tags), measured=endless)) is None


@pytest.mark.parametrize(("pitch", "roll", "yaw"), [(-89, 178, 40), (-60, 8, 200), (-35, -12, 300), (-85, 100, 5)])
def test_the_heading_is_the_forward_of_level_axes(pitch, roll, yaw):
    angles = np.radians([90 - yaw, -pitch, roll])
    _, (east, north, _) = (
        level_axes(up_from_gimbal(*np.radians([pitch, roll]))) @ Pose.looking(np.zeros(3), *angles).rotation
    )
    assert Tags(8, 6, 8, pitch=pitch, roll=roll, yaw=yaw).heading == pytest.approx(
        np.degrees(np.arctan2(east, north)) % 360
    )


def test_survey_angles_are_gimbal_angles_from_straight_down():
    assert up_from_survey(np.radians(30), 0) == pytest.approx(up_from_gimbal(np.radians(-60)))
    assert up_from_survey(0, 0.1) == pytest.approx([-np.sin(0.1), 0, -np.cos(0.1)])


@pytest.fixture
def fleet(tmp_path):
    path = tmp_path / "cars.json"
    path.write_text(json.dumps(CARS))
    return load_fleet(path)


SHAPES = {"car": body(CAR, 1.4), "van": body(VAN, 1.4, VAN_CORNER), "cuboid": block(1.4)}


@pytest.mark.parametrize("body", BODIES)
def test_vehicles_have_the_body_of_the_detectors_card(tmp_path, fleet, body):
    """Whatever they are shaped like, the altitude comes out; measured as another body, it does not."""
    view, photo = view_from(-50), open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=-50)
    shape = SHAPES[body]
    found = replace(detections_of({"a.jpg": boxes_in(view, shape=shape)}), effective_height=(1.4, 1.4))
    off = {
        name: abs(measure([photo], replace(found, body=name), fleet).altitude.value / ALTITUDE - 1) for name in BODIES
    }
    assert off[body] < POOLED and all(off[name] > 0.01 for name in off if name != body)


def test_the_margin_is_left_in_the_sizes_from_which_it_is_taken_off_later(tmp_path):
    view, photo = view_from(-50), open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=-50)
    found = detections_of({"a.jpg": boxes_in(view)})
    wide = replace(found, ruler=replace(found.ruler, margin=(3.0, 2.0)))
    plain, seen = (PhotoGeometry.of([photo], each).observe(1.0) for each in (found, wide))
    assert np.array_equal(seen.size, plain.size) and seen.ruler.margin == (3.0, 2.0)


def test_a_calibration_gives_the_boxes_of_photos_its_ruler_and_is_read_once(tmp_path, fleet):
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=-50)
    found = detections_of({"a.jpg": boxes_in(view_from(-50))})
    save_detections(found, tmp_path / "boxes.json")
    for name, detector in (("own", found.detector_sha256), ("other", "ff")):
        save_calibration(Calibration(name, detector, Ruler((3.0, 2.0)), None, {}), tmp_path / f"{name}.json")
    how, other = (
        Looking(detections=tmp_path / "boxes.json", calibration=tmp_path / f"{name}.json") for name in ("own", "other")
    )
    assert how.ruler_fleet([photo.path])[0].code == WORLD
    (tmp_path / "own.json").unlink()
    assert boxes_of([photo], how, fleet).ruler == Ruler((3.0, 2.0))
    with pytest.raises(UsageError, match="measured for other"):
        boxes_of([photo], other, fleet)


def test_photos_are_looked_at_by_as_many_threads_as_there_are_cores(monkeypatch, tmp_path, fleet):
    made = []

    class Network:
        def __init__(self, path, decoder, classes, threads=0, passes=None):
            made.append((threads, passes))
            raise InterruptedError

    monkeypatch.setattr("orthoscale.detect.detector.Detector", Network)
    for module in ("workers", "effort"):
        monkeypatch.setattr(f"orthoscale.detect.{module}.cores", lambda: 32)
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL)
    for looking in (Looking(), Looking(detector=tmp_path / "own.onnx")):
        with pytest.raises(InterruptedError):
            boxes_of([photo], looking, fleet)
    assert [threads for threads, _ in made] == [4, 4] and worker_count(None) == 8
    assert [passes for _, passes in made] == [Passes.TWICE_CONFIRMED, Passes.FINE_FIRST], "one photo has no other view"


@pytest.mark.parametrize("pitch, roll", [(-90, 0), (-75, 5), (-60, 0), (-50, -4)])
def test_altitude_gsd_and_footprint_of_a_known_pose(tmp_path, fleet, pitch, roll):
    view = view_from(pitch, roll)
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=pitch, roll=roll)
    got = measure([photo], detections_of({"a.jpg": boxes_in(view)}), fleet)
    s = ALTITUDE / FOCAL
    steepness = abs(view.pose.rotation[2, 2])
    assert got.scale.value == pytest.approx(s, rel=POOLED)
    assert got.altitude.value == pytest.approx(ALTITUDE, rel=POOLED)
    assert got.gsd.value == pytest.approx(s / steepness, rel=POOLED)
    assert got.footprint[0].value == pytest.approx(s / steepness * SIZE[0], rel=POOLED)
    for measured, truth in [(got.altitude, ALTITUDE), (got.gsd, s / steepness)]:
        assert measured.low < truth < measured.high
    corners = np.array([[0, 0], [SIZE[0], 0], SIZE, [0, SIZE[1]]])
    rays = np.column_stack([(corners - np.array(SIZE) / 2) / FOCAL, np.ones(4)]) @ view.pose.rotation
    if (rays[:, 2] / np.linalg.norm(rays, axis=1) < -np.sin(np.radians(11))).all():
        truth = -rays[:, :2] * ALTITUDE / rays[:, 2:]
        sides = np.linalg.norm(np.diff(got.outline(), axis=0, append=got.outline()[:1]), axis=1)
        assert sides == pytest.approx(np.linalg.norm(np.diff(truth, axis=0, append=truth[:1]), axis=1), rel=POOLED)


def test_boxes_too_thin_for_a_higher_body_are_too_little_evidence(tmp_path, fleet):
    """Rails or poles athwart a flat view: what they would measure if boxes enclosed 0.25 m more is not known."""
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=-32)
    centre = np.column_stack([np.linspace(150, 850, 10), np.full(10, SIZE[1] / 2)])
    views, _ = photo.views(centre, ALTITUDE)
    sides = np.stack([np.full(10, 4.5), 1.5 * np.sin(views.elevation)], -1) / views.unit_per_pixel[:, None]
    boxes = Boxes(np.column_stack([centre, sides, np.zeros(10)]), np.ones(10))
    with pytest.raises(TooLittleEvidence, match="that fit a vehicle"):
        measure([photo], detections_of({"a.jpg": boxes}), fleet)


def test_altitude_and_resolution_lead_to_each_other(tmp_path):
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=1000, pitch=-30)
    assert photo.gsd_from(90.0) == pytest.approx(0.18) and photo.altitude_of(0.18) == pytest.approx(90)


@pytest.mark.parametrize("pitch, there", [(-90, True), (-35, True), (-33, False), (-10, False)])
def test_an_outline_needs_corners_that_see_the_ground_from_ten_degrees(tmp_path, pitch, there):
    """The upper corners see it from 11 degrees at a pitch of -35, from 9.2 at one of -33."""
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=pitch)
    outline = photo.outline(60.0)
    assert (outline is not None) == there
    if outline is not None:
        assert LevelledPhoto(photo, 60.0).corners == pytest.approx(outline * (1, -1))
    if pitch == -90:
        assert outline == pytest.approx(np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * np.array(SIZE) / 30)


def test_a_level_picture_shows_each_place_once(tmp_path):
    """With a lens that bends so strongly, what lies beside and behind was shown by pixels of the middle once more."""
    path = write_photo(tmp_path / "a.jpg")
    lens = {"width": SIZE[0], "height": SIZE[1], "fx": 700.0, "k1": -0.25}
    (tmp_path / "a.json").write_text(json.dumps(lens))
    photo = open_photo(path, lens_file=tmp_path / "a.json", pitch=-50)
    level = LevelledPhoto(photo, 60.0)
    y, x = np.nonzero(level.at(1.0).valid)
    places = level.shown.min(0) + np.column_stack([x, y]) + 0.5
    nearest, _ = cKDTree(level.shown).query(places)
    assert len(places) > 5000 and nearest.max() < 0.1 * level.size.max()


def test_what_is_not_known_widens_what_depends_on_it(tmp_path, fleet):
    path = write_photo(tmp_path / "a.jpg")
    (tmp_path / "a.json").write_text(json.dumps({"width": SIZE[0], "height": SIZE[1], "fx": FOCAL}))

    def width(m):
        return np.log(m.high / m.low)

    found = detections_of({"a.jpg": boxes_in(view_from(-90))})
    told = measure([open_photo(path, focal_px=FOCAL, pitch=-90.0)], found, fleet)
    calibrated = measure([open_photo(path, lens_file=tmp_path / "a.json", pitch=-90.0)], found, fleet)
    assert width(calibrated.altitude) < width(told.altitude)
    assert width(calibrated.gsd) == pytest.approx(width(told.gsd), rel=0.01)  # focal length cancels straight down
    oblique = detections_of({"a.jpg": boxes_in(view_from(-50))})
    tilted = measure([open_photo(path, focal_px=FOCAL, pitch=-50.0)], oblique, fleet)
    assert tilted.scale.parts["geometry"] > 2 * told.scale.parts["geometry"]


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_a_bent_lens_leaves_no_more_open_than_its_focal_length(tmp_path, k1):
    """Straight down a wrong focal length changes no size in pixels of the nadir view, however the lens bends."""
    (tmp_path / "a.json").write_text(json.dumps({"width": SIZE[0], "height": SIZE[1], "fx": FOCAL, "k1": k1}))
    photo = open_photo(write_photo(tmp_path / "a.jpg"), lens_file=tmp_path / "a.json", pitch=-90.0)
    seen = PhotoGeometry.of([photo], detections_of({"a.jpg": boxes_in(view_from(-90))})).observe(ALTITUDE / FOCAL)
    assert np.abs(seen.systematic.shared["focal"]).max() < photo.lens.sd / 5


@pytest.mark.parametrize("text", [CALIBRATIONS["a.txt"], "1 SIMPLE_RADIAL 4000 3000 2300 2012 1492 -0.02\n"])
def test_another_focal_length_is_of_the_same_lens(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    path = write_photo(tmp_path / "a.jpg", size=(400, 300))
    photo = open_photo(path, lens_file=tmp_path / "a.txt")
    before, after = photo.lens.camera, photo.refocused(1.5).lens.camera
    rays = np.array([[0.3, -0.2, 1.0], [0.0, 0.1, 1.0]])
    middle = np.array([before.principal_point_x, before.principal_point_y])
    assert after.img_from_cam(rays) - middle == pytest.approx(1.5 * (before.img_from_cam(rays) - middle))
    assert before.mean_focal_length() == pytest.approx(230), "the photo itself stays as it is"


def test_what_follows_from_a_skewed_scale_is_skewed_alike(tmp_path, fleet):
    """From straight above the scale of the nadir view and the GSD are one quantity, and have one interval."""
    photo = open_photo(write_photo(tmp_path / "a.jpg"), focal_px=FOCAL, pitch=-90.0)
    got = measure([photo], detections_of({"a.jpg": boxes_in(view_from(-90))}), fleet)
    skewed = replace(got.scale, interval90=(0.9 * got.scale.value, 1.4 * got.scale.value))
    told = _assembled(photo, skewed, dict.fromkeys(("focal", "pitch"), np.zeros(2)), got.boxes, got.picture, 1.0)
    assert told.gsd.value == pytest.approx(skewed.value)
    assert (told.gsd.low, told.gsd.high) == pytest.approx(skewed.interval90, rel=1e-3)
    above, below = (np.log(end / told.altitude.value) for end in (told.altitude.high, told.altitude.low))
    assert above / below == pytest.approx(np.log(1.4) / np.log(0.9))
    assert above > np.log(1.4), "the lens is not exact"


def test_photos_of_one_altitude_are_pooled_and_repeats_do_not_count_twice(tmp_path, fleet, monkeypatch):
    photos = [
        open_photo(write_photo(tmp_path / f"{k}.jpg", gps=(8.0 + 1e-7 * k, 47.0)), focal_px=FOCAL, pitch=-90.0)
        for k in range(4)
    ]
    few, found = (
        detections_of({photo.name: boxes_in(view_from(-90), each, seed=k) for k, photo in enumerate(photos)})
        for each in (3, 6)
    )
    with pytest.raises(TooLittleEvidence, match="3 usable vehicles, 5 are needed"):
        measure(photos[:1], few, fleet)
    with pytest.raises(TooLittleEvidence, match=r"12 boxes in 4 photos, but 4.0 photos .* about 3 different vehicles"):
        measure_together(photos, few, fleet)
    unplaced = [replace(photo, tags=replace(photo.tags, lon_lat=None)) for photo in photos]
    assert measure_together(unplaced, few, fleet).overlap == 4, "they may show different places"
    apart = [replace(p, tags=replace(p.tags, lon_lat=(8.0 + 0.1 * k, 47.0))) for k, p in enumerate(photos)]
    assert measure_together(apart, few, fleet).overlap == pytest.approx(1)
    got = measure_together(photos, found, fleet)
    assert got.altitude.value == pytest.approx(ALTITUDE, rel=0.005)
    assert got.overlap == pytest.approx(4, abs=0.1)  # all from one spot
    alone = measure(photos, found, fleet)
    assert got.altitude.high - got.altitude.low > alone.altitude.high - alone.altitude.low
    assert got.scale.parts["sampling"] == pytest.approx(alone.scale.parts["sampling"] * got.overlap**0.5)
    longer = open_photo(tmp_path / "0.jpg", "other.jpg", focal_px=2 * FOCAL)
    times = []
    monkeypatch.setattr(survey, "measure", lambda *told: times.append(told) or measure(*told))
    assert measure_together(photos, found, fleet).altitude == got.altitude and len(times) == 1, "no work is done twice"
    with pytest.raises(UsageError, match=rf"one lens; .* px \({photos[0].name}\) to .* px \({longer.name}\)"):
        measure_together([*photos, longer], found, fleet)


# The command


def run(*arguments):
    return in_process.run("photo", *arguments)


@pytest.fixture
def flight(tmp_path):
    """A folder of three photos, one of them without enough vehicles; its boxes, and its fleet."""
    folder = tmp_path / "flight"
    (folder / "more").mkdir(parents=True)
    xmp = (
        'drone-dji:GimbalPitchDegree="-60" drone-dji:GimbalRollDegree="0" drone-dji:GimbalYawDegree="30" '
        'drone-dji:RelativeAltitude="59.0"'
    )
    exif = {0xA405: round(FOCAL * np.hypot(36, 24) / np.hypot(*SIZE))}
    for k, name in enumerate(["a.jpg", "more/b.jpg", "c.jpg"]):
        write_photo(folder / name, xmp, exif, gps=(8.0 + 0.001 * k, 47.0))
    boxes = boxes_in(view_from(-60))
    save_detections(detections_of({"a.jpg": boxes, "more/b.jpg": boxes, "c.jpg": boxes[:4]}), tmp_path / "boxes.json")
    (tmp_path / "cars.json").write_text(json.dumps(CARS))
    return folder, ["--detections", tmp_path / "boxes.json", "--fleet", tmp_path / "cars.json"]


def test_a_folder_becomes_a_table_in_every_format(tmp_path, flight):
    folder, rules = flight
    (folder / "d.heic").touch()
    outputs = [tmp_path / f"out.{ending}" for ending in ("csv", "json", "gpkg")]
    done = run(folder, *rules, *(part for path in outputs for part in ("--out", path)), "--json")
    assert done.returncode == 0, done.stderr
    text = json.loads(done.stdout)
    assert text["notes"][0].startswith(f"{folder}: not read: d.heic. Give photos as JPEG")
    assert (text["photos"], text["measured"], text["used_ratio"]) == (3, 2, pytest.approx(2 / 3))
    assert json.loads(outputs[1].read_text()).items() >= text.items()
    first = text["rows"][0]
    assert first["photo"] == "a.jpg" and first["altitude_m"] == pytest.approx(ALTITUDE, rel=0.01)
    assert first["altitude_m_low"] < ALTITUDE < first["altitude_m_high"]
    assert first["xmp_relative_altitude_m"] == 59 and first["pitch_deg"] == -60
    assert text["rows"][1]["problem"] == "4 usable vehicles, 5 are needed" and text["rows"][1]["altitude_m"] is None
    rows = list(csv.DictReader(outputs[0].open()))
    assert [row["photo"] for row in rows] == ["a.jpg", "c.jpg", "more/b.jpg"]
    assert float(rows[0]["gsd_m"]) == first["gsd_m"] and rows[1]["gsd_m"] == ""
    assert pyogrio.list_layers(outputs[2])[:, 0].tolist() == ["photos", "footprints"]
    meta, _, places, values = pyogrio.raw.read(outputs[2], layer="photos")
    column = list(meta["fields"]).index("altitude_m")
    assert len(places) == 3 and np.isnan(values[column]).tolist() == [False, True, False]
    assert {pyogrio.read_info(outputs[2], layer=name)["crs"] for name in ("photos", "footprints")} == {"EPSG:4326"}
    import pyproj
    import shapely

    _, _, (outline, _), _ = pyogrio.raw.read(outputs[2], layer="footprints")
    area, _ = pyproj.Geod(ellps="WGS84").geometry_area_perimeter(shapely.from_wkb(outline))
    view = view_from(-60)
    corners = np.array([[0, 0], [SIZE[0], 0], SIZE, [0, SIZE[1]]])
    rays = np.column_stack([(corners - np.array(SIZE) / 2) / FOCAL, np.ones(4)]) @ view.pose.rotation
    assert abs(area) == pytest.approx(shapely.Polygon(-rays[:, :2] * ALTITUDE / rays[:, 2:]).area, rel=0.02)


@pytest.mark.parametrize("ending", ["csv", "json", "gpkg"])
def test_a_name_that_is_not_utf_8_is_written_with_escapes(tmp_path, ending):
    outcome, path = tables.PhotoOutcome("caf\udce9.jpg", None, None, "no photo"), tmp_path / f"out.{ending}"
    tables.write([outcome], {"rows": [tables.row(outcome)]}, path)
    if ending == "json":  # which strict readers take
        assert msgspec.json.decode(path.read_bytes())["rows"][0]["photo"] == r"caf\udce9.jpg"
    else:
        assert rb"caf\udce9.jpg" in path.read_bytes()


@pytest.mark.parametrize("command", ["photo", "crop", "locate"])
def test_what_is_to_be_said_of_the_boxes_is_said(tmp_path, flight, command):
    """Boxes of photos that are not there, boxes that repeat one vehicle, and boxes of a detector nobody measured."""
    folder, rules = flight
    boxes = boxes_in(view_from(-60))
    twice = Boxes.concatenate([boxes, boxes])
    found = detections_of({"a.jpg": twice, "elsewhere.jpg": boxes})
    save_detections(replace(found, ruler=UNKNOWN_RULER), tmp_path / "boxes.json")
    how = Looking(detections=rules[1], fleet=rules[3])
    if command == "photo":
        notes = survey_photos(folder / "a.jpg", **how.settings()).to_dict()["notes"]
    elif command == "crop":
        notes = footprint_of(folder / "a.jpg", None, how).told["notes"]
    else:
        notes = claimed_scales({"a.jpg": folder / "a.jpg"}, None, how)["a.jpg"].notes
    said = "; ".join(notes)
    assert "1 of its pictures are not in this model, the first is elsewhere.jpg" in said
    assert f"{len(boxes)} of its {len(twice)} boxes repeat the vehicle of another" in said
    assert "longer and wider than the vehicles is not known" in said


def test_notes_on_the_boxes_of_all_photos_are_not_told_as_those_of_one(tmp_path, flight):
    folder, rules = flight
    boxes = boxes_in(view_from(-60))
    found = detections_of({"a.jpg": boxes, "more/b.jpg": boxes, "elsewhere.jpg": boxes})
    save_detections(replace(found, ruler=UNKNOWN_RULER), tmp_path / "boxes.json")
    notes = [line for line in run(folder, *rules).stdout.splitlines() if line.startswith("note")]
    assert len(notes) == 2 and not [note for note in notes if note.endswith("photo)")]


def test_boxes_are_saved_though_they_are_too_few(tmp_path, flight):
    folder, rules = flight
    saved = tmp_path / "saved.json"
    save_detections(detections_of({"a.jpg": boxes_in(view_from(-60))[:3]}), tmp_path / "boxes.json")
    done = run(folder, *rules, "--save-detections", saved)
    assert done.returncode == 3 and {name: len(b) for name, b in load_detections(saved).boxes.items() if len(b)} == {
        "a.jpg": 3
    }
    assert f"; the boxes are saved in {saved}" in done.stderr


def test_the_scale_of_all_together_is_in_every_table(tmp_path, flight):
    """It may be the only one; counts agree in all of them and with what is said of each photo."""
    folder, rules = flight
    outputs = [tmp_path / f"out.{ending}" for ending in ("csv", "json", "gpkg")]
    done = run(folder, *rules, "--together", *(part for path in outputs for part in ("--out", path)))
    assert done.returncode == 0, done.stderr
    text = json.loads(outputs[1].read_text())
    rows = list(csv.DictReader(outputs[0].open()))
    assert [row["photo"] for row in rows] == ["a.jpg", "c.jpg", "more/b.jpg", "all together"]
    counts = [(row["boxes"], row["vehicles_used"]) for row in rows]
    each, few, _, pooled = counts
    assert {row["depth_vehicles"] for row in rows} == {""}  # nobody asked for depth
    assert few == ("4", "") and rows[1]["problem"].startswith("4 usable vehicles")
    assert pooled == (str(2 * int(each[0]) + 4), str(text["together"]["vehicles_used"]))
    assert f"{pooled[1]} of {pooled[0]} boxes used, in 3 photos" in done.stdout
    assert float(rows[3]["altitude_m"]) == text["together"]["altitude_m"] and rows[3]["longitude"] == ""
    meta, _, places, values = pyogrio.raw.read(outputs[2], layer="photos")
    table = dict(zip(meta["fields"], values, strict=True))
    assert table["photo"][3] == "all together" and places[3] is None and None not in places[:3]
    assert table["altitude_m"][3] == text["together"]["altitude_m"]
    assert len(pyogrio.raw.read(outputs[2], layer="footprints")[2]) == 2


def test_a_given_focal_length_that_is_another_cameras_is_told(tmp_path):
    """A folder may hold photos of two cameras; the altitude grows with the focal length, and nothing was said."""
    (tmp_path / "lens.json").write_text(json.dumps({"width": SIZE[0], "height": SIZE[1], "fx": 1.25 * FOCAL}))
    nominal = round(FOCAL * np.hypot(36, 24) / np.hypot(*SIZE))
    path = write_photo(tmp_path / "a.jpg", exif={0xA405: nominal})
    for given in ({"focal_px": 1.25 * FOCAL}, {"lens_file": tmp_path / "lens.json"}):
        (note,) = open_photo(path, **given).tags.notes
        assert f"({nominal} mm equivalent in EXIF), and {1.25 * FOCAL:.0f} px is given" in note
        assert note.endswith("% too large")
    assert open_photo(path, focal_px=0.7 * FOCAL).tags.notes[0].endswith("% too small")
    assert not open_photo(path, focal_px=1.05 * FOCAL).tags.notes and not open_photo(path).tags.notes
    assert not open_photo(write_photo(tmp_path / "b.jpg"), focal_px=1.25 * FOCAL).tags.notes, "it does not say"


def test_each_photo_has_one_line_whatever_its_name(flight):
    """A line break in a name is shown, not printed; and why a photo was not measured does not name it again."""
    folder, rules = flight
    (folder / "c.jpg").rename(folder / "c\nmeasured   9 of 9 photos.jpg")
    (folder / "d.jpg").write_bytes(b"")
    lines = run(folder, *rules).stdout.splitlines()
    assert [line for line in lines if line.startswith("measured")] == ["measured   2 of 4 photos (50 %)"]
    assert sum(r"c\nmeasured   9 of 9 photos.jpg" in line for line in lines) == 1
    (empty,) = [line.split(maxsplit=1) for line in lines if "d.jpg" in line]
    assert empty == ["d.jpg", "not an image that can be read"]


def test_of_many_different_texts_a_single_one_is_not_left_out():
    """It would take as many lines to say so."""
    assert len(_told("note", "abcde")) == 5 and not any("others" in line for line in _told("note", "abcde"))
    assert _told("note", "abcdef")[4:] == ["note       and 2 others"]


@pytest.mark.parametrize(
    ("original", "changed", "taken"),
    [
        ("2024:03:08 16:19:54", "2024:05:01 10:00:00", "2024:03:08 16:19:54"),
        ("    :  :     :  :  ", "2024:05:01 10:00:00", "2024:05:01 10:00:00"),
        ("0000:00:00 00:00:00", None, ""),
        (None, None, ""),
    ],
)
def test_a_time_that_exif_does_not_know_is_none(tmp_path, original, changed, taken):
    tags = {tag: text for tag, text in ((0x9003, original), (0x0132, changed)) if text is not None}
    assert read_tags(write_photo(tmp_path / "a.jpg", exif=tags)).taken == taken


def test_one_photo_is_answered_in_full(flight):
    folder, rules = flight
    done = run(folder / "a.jpg", *rules)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    value, low, high = map(float, re.fullmatch(
        r"altitude +([\d.]+) m \(90 %: ([\d.]+) to ([\d.]+)\)   \(\w+\)", lines[0]
    ).groups())  # fmt: skip
    last = 10.0 ** -len(lines[0].split()[1].partition(".")[2])
    assert 5 * last < (high - low) / 2 < 100 * last, "no more digits than its uncertainty leaves it"
    assert "from XMP" in done.stdout
    (told,) = (line.split() for line in lines if "above its take-off point" in line)
    assert told[:2] == ["drone", "59.0"] and float(told[2]) == pytest.approx(59 / ALTITUDE, rel=0.01)
    assumed = run(folder / "a.jpg", *rules, "--pitch", "-60", "--focal-px", FOCAL)
    assert ", given" in assumed.stdout


@pytest.mark.parametrize(("xmp", "code", "said"), [
    ('drone-dji:GimbalPitchDegree="-60" drone-dji:RelativeAltitude="-12.5"', 0, "drone          -12.5           the"),
    ('drone-dji:GimbalPitchDegree="+60"', 3, "seen from more than 25 degrees (pitch 60, roll 0, from XMP)"),
])  # fmt: skip
def test_a_drone_below_its_start_and_a_camera_that_looks_up(flight, xmp, code, said):
    folder, rules = flight
    exif = {0xA405: round(FOCAL * np.hypot(36, 24) / np.hypot(*SIZE))}
    done = run(write_photo(folder / "a.jpg", xmp, exif), *rules)
    assert done.returncode == code and said in done.stdout + done.stderr


def test_no_photo_is_told_from_none_that_can_be_read():
    with pytest.raises(UsageError, match="an empty list"):
        survey_photos([])


def test_where_no_photo_can_be_used_the_first_ones_remedy_is_said(tmp_path):
    for name in ("a.jpg", "b.jpg"):
        Image.new("RGB", SIZE).save(tmp_path / name)
    with pytest.raises(InputError, match="none of 2 photos can be used; .*a.jpg: no focal length") as refused:
        survey_photos(tmp_path, fleet="DE")
    assert "--focal-px" in refused.value.hint


def test_an_unknown_pitch_is_said(tmp_path, flight):
    _, rules = flight
    write_photo(tmp_path / "a.jpg", exif={0xA405: 31})
    done = run(tmp_path / "a.jpg", *rules)
    assert "nadir, assumed" in done.stdout


def bad_photo(folder, kind):
    path = folder / "x.jpg"
    if kind == "text":
        path.write_text("no photo")
    elif kind == "empty":
        path.touch()
    elif kind == "no EXIF":
        Image.new("RGB", SIZE).save(path)
    elif kind == "empty folder":
        path = folder / "nothing"
        path.mkdir()
    return path


@pytest.mark.parametrize(
    "kind, options, code, word",
    [
        ("missing", [], 5, "does not exist"),
        ("text", [], 5, "not an image"),
        ("empty", [], 5, "x.jpg"),
        ("empty folder", [], 5, "no readable photo"),
        ("no EXIF", [], 5, "no focal length"),
        ("no EXIF", ["--focal-px", "-1"], 2, "positive"),
        ("no EXIF", ["--focal-px", "900", "--pitch", "10"], 2, "--pitch"),
        ("no EXIF", ["--focal-px", "900", "--pitch", "-60", "--roll", "1e30"], 2, "--roll"),
        ("no EXIF", ["--focal-px", "900", "--out", "x.doc"], 2, "x.doc"),
        ("no EXIF", ["--focal-px", "900", "--out", "nowhere/x.csv"], 6, "nowhere"),
        ("no EXIF", ["--focal-px", "900"], 5, "none of its 3 pictures is in"),
    ],
)
def test_bad_input_ends_in_one_sentence(tmp_path, flight, kind, options, code, word):
    _, rules = flight
    done = run(bad_photo(tmp_path, kind), *rules, *options)
    assert done.returncode == code, done.stderr
    assert done.stderr.startswith("error: ") and word in done.stderr and "Traceback" not in done.stderr
    assert done.stdout == ""


def test_too_few_vehicles_are_exit_code_3_and_nothing_is_written(tmp_path, flight):
    folder, rules = flight
    done = run(folder / "c.jpg", *rules, "--out", tmp_path / "out.csv")
    assert done.returncode == 3 and "4 usable vehicles" in done.stderr
    assert not (tmp_path / "out.csv").exists()


def test_a_damaged_photo_among_many_is_a_line_of_the_table(tmp_path):
    good, bad = write_photo(tmp_path / "a.jpg"), write_photo(tmp_path / "b.jpg")
    bad.write_bytes(bad.read_bytes()[:-400])
    told = {"focal_px": FOCAL, "pitch": -90.0}
    photos, problems = open_photos({"a.jpg": good, "b.jpg": bad}, **told)
    assert [p.name for p in photos] == ["a.jpg"] and "truncated" in problems["b.jpg"]
    with pytest.raises(InputError, match="truncated"):
        open_photos({"b.jpg": bad}, **told)


@pytest.mark.real
def test_altitude_of_a_real_flight(data):
    """The drone's own figure, over its take-off point, is 40 m; boxes of a larger detector, as it gave them."""
    scene = data / "reconstructions" / "brighton"
    boxes = scene / "reference_boxes.json"
    done = run(scene / "images", "--fleet", "US", "--together", "--detections", boxes, "--json")
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)["together"]
    assert got["altitude_m"] == pytest.approx(40, rel=0.12)
    assert got["altitude_m_low"] < 40 < got["altitude_m_high"]


@pytest.mark.parametrize(
    "make, model, camera",
    [
        ("Canon", "Canon IXUS 127", "Canon IXUS 127"),
        ("DJI", "FC3411", "DJI FC3411"),
        ("", "FC3411", "FC3411"),
        ("", "", ""),
    ],
)
def test_a_camera_names_its_maker_once(make, model, camera):
    assert Tags(4, 3, 4, make, model).camera == camera
