"""Of a model's many frames as many are looked at as it takes: those first that show new ground."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from support.drawings import Drawing, RectangleDetector, car_park

from orthoscale.actions import find as find_module
from orthoscale.actions.find import Sampling, VehicleSearch, find_in_model
from orthoscale.core.detections import Detections
from orthoscale.core.source import NEAR_NADIR
from orthoscale.detect.cover import ENOUGH_VIEWS, Cover, covering, places_seen, seen_from_above
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import find_vehicles
from orthoscale.sources.colmap import ColmapSource


def along(start, stop):
    return np.column_stack([np.arange(start, stop), np.zeros((stop - start, 2), int)])


def test_new_ground_comes_first_and_repeated_ground_last():
    places = [along(0, 10), along(1, 10), along(10, 20), along(2, 10), along(20, 24), along(0, 0)]
    cover = covering(places, views=1)
    assert cover.order.tolist()[:3] == [0, 2, 4], "by what is new; the second shows nothing that the first does not"
    assert cover.enough == 3 and sorted(cover.order) == list(range(6))
    twice = covering(places, views=2)
    assert twice.enough == 4 and twice.order.tolist()[3] == 1, "a second view of most of the first one's places"


def test_every_place_is_seen_as_often_as_it_takes():
    rng = np.random.default_rng(0)
    places = [along(k := int(rng.integers(0, 88)), k + 12) for _ in range(400)]
    cover = covering(places, views=5)
    seen, of_all = np.zeros(100), np.zeros(100)
    for number, each in enumerate(places):
        of_all[each[:, 0]] += 1
        seen[each[:, 0]] += number in cover.order[: cover.enough]
    assert (seen >= np.minimum(of_all, 5)).all() and cover.enough < 60


def test_places_are_those_of_the_poses(flight):
    source = ColmapSource.open(flight[0])
    places = places_seen(source, source.picture_names)
    assert list(places) == source.picture_names and min(map(len, places.values())) > 20
    both = [seen_from_above(each) for each in places.values()]
    assert all(0 < len(above) < len(each) for above, each in zip(both, places.values(), strict=True))
    name = source.picture_names[0]
    pixel = np.array([[320.0, 240.0]])
    view, world, _ = source.views(name, pixel)
    centres = np.array([source.centre(n) for n in source.picture_names])
    side = 0.25 * np.median(source.ground.height_above(centres))
    here = np.floor((source.ground.plane(world) - source.ground.plane(centres).mean(0)) / side).astype(int)
    steep = int(np.degrees(view.elevation[0]) >= NEAR_NADIR)
    assert [*here[0].tolist(), steep] in places[name].tolist()


def test_frames_show_the_same_places_wherever_the_world_begins(flight, tmp_path):
    model = pycolmap.Reconstruction(str(flight[0] / "sparse" / "0"))
    expected, found = (), ()
    for shift in ([0.0, 0.0, 0.0], [0.3, -0.7, 0.2]):
        model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array(shift)))
        model.write(str(tmp_path))
        source = ColmapSource.open(tmp_path, need_images=False)
        expected, found = found, [each.tolist() for each in places_seen(source, source.picture_names).values()]
    assert found == expected


@pytest.fixture(scope="module")
def frames():
    """Eighty frames, of which the later forty show the vehicles of the first ones again."""
    return [Drawing(1500, 600, car_park(40, 1500, 600, 4, seed=k % 40), f"{k:02d}") for k in range(80)]


COVER = Cover(np.arange(80)[::-1], 40)


def looked_at(frames, sampling, cover=COVER, **effort):
    effort = Effort(cache=False, workers=1, **effort)
    found = find_vehicles(frames, RectangleDetector(), 1.0, None, effort, sampling, cover)
    names = [name for name, _ in found.swept.tiles]
    assert all(names.count(name) == 2 for name in names), "each frame has two tiles, and is looked at as a whole"
    return sorted(set(names)), found


def test_what_shows_the_same_ground_again_is_not_looked_at(frames):
    names, found = looked_at(frames, lambda found: 0.5, target=0.001)
    assert names == [f"{k:02d}" for k in range(40, 80)], "the first forty of the order, whatever the target"
    assert found.swept.looked_at == "looked at 40 of 80 frames"
    assert found.swept.why == "the others show the same ground again"
    assert {name for name, boxes in found.boxes.items() if len(boxes)} == set(names)


def test_more_are_looked_at_while_there_is_too_little(frames):
    names, found = looked_at(frames, lambda found: 0.5 if len(found) > 100 else np.inf, Cover(COVER.order, 20))
    assert len(names) == 40 and found.swept.why, "as many again as the twenty that showed eighty vehicles"


@pytest.mark.slow
@pytest.mark.parametrize("sampling, effort", [(lambda found: np.inf, {}), (lambda found: 0.0, {"exhaustive": True})])
def test_all_are_where_it_takes_all_and_where_all_are_asked_for(frames, sampling, effort):
    names, found = looked_at(frames, sampling, **effort)
    assert len(names) == 80 and not found.swept.why


@pytest.mark.parametrize("few", [12, 13])
def test_a_model_of_many_frames_may_stop_and_one_of_few_may_not(flight, monkeypatch, few):
    """Twelve frames; pictures of the ground by what is seen from above."""
    asked = []

    def find(pictures, detector, zoom, progress, effort, sampling=None, cover=None):
        asked.append((len(pictures), sampling, cover))
        return Detections({}, 1.0, None, (0, 0), "")

    monkeypatch.setattr(find_module, "find_vehicles", find)
    monkeypatch.setattr(find_module, "FEW_FRAMES", few)
    source = ColmapSource.open(flight[0])
    sampling = Sampling(lambda found: 0.1, lambda found: 0.2)
    find_in_model(source, None, VehicleSearch(RectangleDetector(), sampling=sampling))
    assert [count for count, *_ in asked] == [12, 12]
    if few == 12:
        assert [one for _, one, _ in asked] == [sampling.in_pictures, sampling.from_above]
        assert all(sorted(cover.order) == list(range(12)) for *_, cover in asked)
        assert all(cover.enough <= 12 < ENOUGH_VIEWS + 1 for *_, cover in asked)
    else:
        assert asked == [(12, None, None)] * 2
