"""Ground control marked in several pictures: OpenDroneMap's gcp_list.txt, and where rays meet."""

from pathlib import Path
from unicodedata import normalize

import numpy as np
import pytest
from support.control import PLACES, marked, shows
from support.flights import UNIT

from orthoscale.actions.control import DISTANCE_HINT, _by_file_name, _in_model, read_control
from orthoscale.core.control import meeting_point, widest_angle
from orthoscale.errors import InputError, UsageError
from orthoscale.formats.control_points import read_control_file
from orthoscale.sources.opening import open_source

TOWN = Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"
FEET = "+proj=tmerc +lat_0=48 +lon_0=9 +ellps=GRS80 +units=us-ft"
SYSTEMS = {
    "EPSG:32632": "EPSG:32632",
    "WGS84 UTM 32N": "EPSG:32632",
    "wgs84 utm 32n": "EPSG:32632",
    "+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs": "EPSG:32632",
    "EPSG:4326": "EPSG:4326",
    "EPSG:3857": "EPSG:3857",  # a metre of it is 0.66 m here
    FEET: FEET,
}


@pytest.mark.parametrize("header", SYSTEMS)
def test_marks_in_many_pictures_give_the_scale_in_space_whatever_the_map(flight, tmp_path, header):
    source = open_source(flight[0])
    found = read_control(marked(tmp_path / "gcp_list.txt", source, flight[1], header, SYSTEMS[header]), source)
    assert found.value == pytest.approx(UNIT, rel=2e-5)
    assert found.says == "ground control (4 points, 4 of them from intersecting rays)"
    assert 0.0005 < found.relative_sd < 0.002  # points good to 0.05 m, some 30 m from their middle


def test_in_one_picture_they_lie_on_the_ground(flight, tmp_path):
    """Its error is known, and stated: roofs of 12 m are drawn outwards where cameras fly at 60 m."""
    source = open_source(flight[0])
    best = max(source.picture_names, key=lambda n: sum(shows(source, n, p) for p in PLACES @ flight[1].T))
    found = read_control(marked(tmp_path / "gcp_list.txt", source, flight[1], pictures=[best]), source)
    assert "intersecting rays" not in found.says
    assert abs(found.value / UNIT - 1) > 0.02


def test_a_mark_on_another_point_is_refused_and_named(flight, tmp_path):
    source = open_source(flight[0])
    path = marked(tmp_path / "gcp_list.txt", source, flight[1])
    lines = path.read_text().splitlines()
    words = lines[4].split()
    words[3] = str(float(words[3]) - 60)
    path.write_text("\n".join([*lines[:4], " ".join(words), *lines[5:]]))
    mark = f"{words[5]}@{words[3]},{words[4]}"
    with pytest.raises(InputError, match=rf"line 4: the rays of its \d marks do not meet: {mark} lies \d\d px from"):
        read_control(path, source)


def test_pictures_that_the_model_lacks_are_left_out_and_points_without_any_are_told(flight, tmp_path):
    source = open_source(flight[0])
    path = marked(tmp_path / "gcp_list.txt", source, flight[1])
    whole = read_control(path, source)
    text = path.read_text()
    known = text.splitlines()[3].split()
    more = " ".join([*known[:5], "lost.jpg"])
    elsewhere = " ".join([known[0], known[1], "999", "10", "10", "lost.jpg"])
    path.write_text(f"{text}\n{more}\n{elsewhere}\n")
    found = read_control(path, source)
    assert found.value == whole.value
    assert (
        found.says == "ground control (4 points, 4 of them from intersecting rays, 1 more in no picture of the model)"
    )


def test_marks_in_pictures_of_another_machine():
    """A model's absolute names of Windows, and marked letters as macOS writes them."""
    named = _by_file_name(["C:\\a\\1.jpg", "C:\\b\\1.jpg", normalize("NFC", "b/ä.jpg")])
    assert _in_model(["1.jpg@3,4", normalize("NFD", "ä.jpg@5,6")], named) == (normalize("NFC", "b/ä.jpg@5,6"),)
    assert _in_model(["C:\\b\\1.jpg@3,4"], named) == ("C:\\b\\1.jpg@3,4",)


def test_marks_near_the_horizon_do_not_count_beside_others(flight, tmp_path):
    source = open_source(flight[0])
    path = marked(tmp_path / "gcp_list.txt", source, flight[1])
    whole = read_control(path, source)
    assert not source.views("00.png", np.array([[1.0, 479.0]]))[2][0]
    known = path.read_text().splitlines()[3].split()[:3]
    path.write_text("\n".join([path.read_text(), " ".join([*known, "1", "479", "00.png"])]))
    assert read_control(path, source) == whole
    path.write_text("\n".join([path.read_text(), " ".join([*known, "1", "4790", "00.png"])]))
    with pytest.raises(InputError, match="line 4: 1,4790 lies outside of the picture"):
        read_control(path, source)


def test_pictures_are_found_by_their_files_names(flight, tmp_path):
    source = open_source(flight[0])
    found = read_control(marked(tmp_path / "g.txt", source, flight[1], named="/home/me/images/{}".format), source)
    assert found.value == pytest.approx(UNIT, rel=2e-5)


def test_lines_of_the_same_metres_are_one_point_in_the_plain_form_too(flight, tmp_path):
    source = open_source(flight[0])
    path = tmp_path / "control.txt"
    lines = [
        f"{name}@{column},{row} {' '.join(map(str, known))}"
        for place, known in zip(PLACES, UNIT * PLACES, strict=True)
        for name in source.picture_names
        if shows(source, name, place @ flight[1].T)
        for column, row in source.project(name, place[None] @ flight[1].T)
    ]
    path.write_text("\n".join(lines))
    found = read_control(path, source)
    assert found.value == pytest.approx(UNIT, rel=2e-5) and "4 of them from intersecting rays" in found.says
    assert len(lines) > 2 * len(read_control_file(path).points)


@pytest.mark.parametrize("name", ["cam 1/a b.jpg", r"cam1\a.jpg", "a;b;c.jpg"])
def test_names_with_spaces_or_backslashes_stand_in_quotes_and_a_hint_says_so(tmp_path, name):
    path = tmp_path / "gcp.txt"
    path.write_text(f'"{name}@10,20" 1 2 3\n')
    assert read_control_file(path).points[0].marks == (f"{name}@10,20",)
    path.write_text("cam 1/a b.jpg@10,20 1 2 3\n")
    with pytest.raises(InputError) as caught:
        read_control_file(path)
    assert "in double quotes where the name has spaces or backslashes" in caught.value.hint
    assert "in double quotes where the name has spaces or backslashes" in DISTANCE_HINT


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("1;123,45;678,9", "1 123.45 678.9"),
        ("120.5,80;500000,25;5390000,5;\n# by hand\n;;;\n300,90; 500123,456 ;5390000;",
         "120.5,80 500000.25 5390000.5\n\n\n300,90 500123.456 5390000"),
        ("id:1;1;2;3,25\nid:2;2;3;4", "id:1 1 2 3.25\nid:2 2 3 4"),
        ("1,5,2,5,0;1.25;2", "1,5,2,5,0 1.25 2"),
        ('"cam 1/a.jpg@10,20";1;2;3', '"cam 1/a.jpg@10,20" 1 2 3'),
        ("EPSG:32632;;\n500000,5;5390000;300;10,5;20;a.jpg;one, two", "EPSG:32632\n500000.5 5390000 300 10.5 20 a.jpg"),
    ],
)  # fmt: skip
def test_columns_may_end_at_semicolons_and_numbers_have_decimal_commas_then(tmp_path, text, same):
    """As spreadsheets write them in much of Europe."""
    (tmp_path / "a.txt").write_text(text)
    (tmp_path / "b.txt").write_text(same)
    assert read_control_file(tmp_path / "a.txt") == read_control_file(tmp_path / "b.txt")


def test_an_orthophoto_shows_no_project_of_pictures(flight, tmp_path):
    path = marked(tmp_path / "gcp_list.txt", open_source(flight[0]), flight[1])
    with pytest.raises(UsageError, match="it marks points in a project's pictures, and .* an orthophoto"):
        read_control(path, open_source(TOWN))


GOOD = "500000 5390000 300 10 20 a.jpg"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EPSG:999999\n" + GOOD, "line 1: 'EPSG:999999' is not a coordinate reference system on Earth"),
        ("+proj=nothing\n" + GOOD, "line 1: '.proj=nothing' is not a coordinate"),
        ("WGS84 UTM 99N\n" + GOOD, "line 1: 'WGS84 UTM 99N' is not a coordinate"),
        ("EPSG:32632\n500000 5390000 300 10 20", "line 2: 5 words, but"),
        ("EPSG:32632\n\nx 5390000 300 10 20 a.jpg", "line 3: 'x' is not a finite number"),
        ("EPSG:32632\n500000,5 5390000 300 10 20 a.jpg", "line 2: '500000,5' has a decimal comma: write 500000.5"),
        ("EPSG:32632\n500000 5390000 300 10,5 20 a.jpg", "line 2: '10,5' has a decimal comma: write 10.5"),
        ("120,80 500000,25 5390000,5", "line 1: '500000,25' has a decimal comma: write 500000.25"),
        ("1;1234,5;678.9", "line 1: '1234,5' has a decimal comma: write 1234.5"),
        ("1;1,234;678,5\n2;2;1234.5", "line 1: '1,234' is 1.234 or 1234: write which"),
        ("1;5,390,000;678,5", "line 1: '5,390,000' is not a finite number"),
        ("1;;678,5", "line 1: '' is not a finite number"),
        ("120;80;500000,25;5390000,5;1", "line 1: 4 coordinates in metres"),
        ("1;2;3\n4 5 6", "line 1: 0 coordinates in metres"),
        ("hello world", "line 1: 1 coordinate in metres"),
        ("EPSG:32632\n500000;5390000;300;10;20", "line 2: 5 words, but"),
        ("EPSG:32632\n500000 5390000 nan 10 20 a.jpg", "line 2: 'nan' is not a finite number"),
        ("EPSG:32632\n1e30 5390000 300 10 20 a.jpg", "line 2: 1e30 5390000 300 is not a place in EPSG:32632"),
    ],
)
def test_what_is_wrong_with_a_list_is_said_with_its_line(tmp_path, text, said):
    path = tmp_path / "gcp_list.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=f"gcp_list.txt, {said}"):
        read_control_file(path)


def test_where_rays_meet_and_how_well_that_is_told():
    """Rays read with noise: the told sigma is that of the places, on average over directions."""
    rng = np.random.default_rng(3)
    truth, centres = np.array([1.0, 2.0, 0.5]), np.array([[0, 0, 10.0], [4, 0, 11], [0, 5, 9]])
    sds = np.array([0.01, 0.02, 0.03])
    exact, sd = meeting_point(centres, truth - centres, sds)
    assert exact == pytest.approx(truth, abs=1e-9)
    noisy = [
        meeting_point(centres, truth - centres + rng.normal(0, 1, (3, 3)) * sds[:, None], sds) for _ in range(2000)
    ]
    errors = np.array([place for place, _ in noisy]) - truth
    assert np.sqrt((errors**2).mean()) == pytest.approx(sd, rel=0.05)
    assert np.mean([told for _, told in noisy]) == pytest.approx(sd, rel=0.01)


def test_the_widest_angle_is_that_of_any_two():
    rays = np.array([[0, 0, -1.0], [0, 0, -5], [3, 0, -3]])
    assert widest_angle(rays) == pytest.approx(np.pi / 4)
    assert widest_angle(rays[:1]) == pytest.approx(0, abs=1e-7)
