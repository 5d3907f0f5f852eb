"""The files of a search: all results as JSON, candidates as a table, places for GIS, and the matches as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..formats.csv_table import write_csv
from ..formats.lettering import write_on
from ..formats.names import write_json
from ..formats.pictures import write_jpeg
from ..formats.vector import write_layer
from ..sources.satellite import Satellite
from .outcome import LocateOutcome, candidate_rows, foot, footprint

CANDIDATE_COLUMNS = (
    "photo", "rank", "inliers", "needed", "score", "longitude", "latitude", "x", "y", "foot_longitude", "foot_latitude",
    "heading_deg", "scale",
)  # fmt: skip
MATCHES_PANEL = 800  # [px] side of each of the two pictures of matches.jpg
CAPTION = 64  # [px] height of the lettering above them
LETTERS = 20  # [px]
LONGEST_NAME = 40  # letters of a file's name that are shown
LINES_DRAWN = 120  # matches that are drawn
FOUND_COLOUR, NOT_FOUND_COLOUR, MATCHES_QUALITY = (60, 220, 60), (230, 60, 40), 90
INK = {FOUND_COLOUR: (0, 110, 0), NOT_FOUND_COLOUR: (190, 20, 10)}  # of lettering on white, dark enough to be read


def write(
    outcomes: Sequence[LocateOutcome], text: dict[str, Any], satellite: Satellite, folder: Path, top: int
) -> None:
    """Write into the empty `folder`: located.json, candidates.csv (the best `top` of each photo), located.gpkg, and
    matches.jpg, or matches/NAME.jpg for several photos. Raises OSError, InputError."""
    write_json(text, folder / "located.json")
    searched = [outcome for outcome in outcomes if outcome.registration is not None]
    rows = [row for outcome in searched for row in candidate_rows(outcome, satellite)[:top]]
    write_csv(folder / "candidates.csv", CANDIDATE_COLUMNS, rows)
    write_places(outcomes, rows, satellite, folder / "located.gpkg")
    drawn = [outcome for outcome in searched if outcome.registration and outcome.registration.candidates]
    for number, outcome in enumerate(drawn, 1):
        place = folder / "matches.jpg"
        if len(outcomes) > 1:
            (folder / "matches").mkdir(exist_ok=True)
            place = folder / "matches" / f"{number:04d}_{Path(outcome.name).stem}.jpg"
        write_jpeg(place, matches_picture(outcome, satellite), MATCHES_QUALITY)


def write_places(
    outcomes: Sequence[LocateOutcome], rows: Sequence[dict[str, Any]], satellite: Satellite, path: Path
) -> None:
    """Write the layers footprints and cameras, of the photos located, and candidates, in the map's reference system."""
    import shapely

    located = [(outcome, best) for outcome in outcomes if (best := outcome.located) is not None]
    places = [{"photo": o.name, "heading_deg": float(np.degrees(b.heading)), "inliers": b.inliers} for o, b in located]
    outlines = [footprint(o, b) for o, b in located]
    shapes = [None if line is None else shapely.Polygon(satellite.in_crs(line)) for line in outlines]
    if located:
        write_layer(path, "footprints", shapes, places, "Polygon", satellite.crs)
        feet = [shapely.Point(satellite.in_crs(foot(b))[0]) for _, b in located]
        write_layer(path, "cameras", feet, places, "Point", satellite.crs)
    if rows:
        points = [shapely.Point(row["x"], row["y"]) for row in rows]
        write_layer(path, "candidates", points, rows, "Point", satellite.crs)


def matches_picture(outcome: LocateOutcome, satellite: Satellite) -> np.ndarray:
    """(H + CAPTION, 2 H, 3) uint8 RGB: the levelled photo left, the map around the best candidate right, and lines
    between matches; green if the photo was located, else red. Above them what they are, and whether that is the place.
    """
    assert outcome.registration is not None and outcome.claimed is not None
    best = outcome.registration.candidates[0]
    seen = outcome.claimed.levelled
    image = seen.at(float(seen.size.max()) / MATCHES_PANEL)
    left, to_left = _fitted(image.pixels)
    matches = best.matches
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * image.size + image.origin
    around = best.map_pixels(corners)
    source = satellite.source
    whole = np.array([source.width, source.height])
    low = np.clip(np.floor(around.min(0)).astype(int), 0, whole - 1)
    high = np.clip(np.ceil(around.max(0)).astype(int), low + 1, whole)
    zoom = MATCHES_PANEL / (high - low).max()
    out = np.maximum(np.rint((high - low) * zoom).astype(int), 1)
    ground = source.read(*(int(v) for v in (*low, *(high - low), *out)))
    right, to_right = _fitted(ground)
    picture = np.ascontiguousarray(np.hstack([left, right]))
    colour = FOUND_COLOUR if outcome.located else NOT_FOUND_COLOUR
    step = max(1, -(-len(matches) // LINES_DRAWN))
    for x, y, u, v in matches[::step]:
        a = (np.array([x, y]) - image.origin) / image.gsd * to_left[0] + to_left[1]
        b = (np.array([u, v]) - low) * out / (high - low) * to_right[0] + to_right[1] + (MATCHES_PANEL, 0)
        start, end = ((int(p[0]), int(p[1])) for p in (np.rint(a), np.rint(b)))
        cv2.line(picture, start, end, colour, 1, cv2.LINE_AA)
        for place in (start, end):
            cv2.circle(picture, place, 3, colour, -1, cv2.LINE_AA)
    head = np.full((CAPTION, picture.shape[1], 3), 255, np.uint8)
    write_on(head, (8, LETTERS + 4), f"photo {_short(outcome.name)}, seen from straight above", LETTERS)
    write_on(head, (MATCHES_PANEL + 8, LETTERS + 4), f"map {_short(source.path.name)}", LETTERS)
    write_on(head, (8, CAPTION - 10), _verdict(outcome, step == 1), LETTERS, INK[colour])
    return np.vstack([head, picture])


def _verdict(outcome: LocateOutcome, all_drawn: bool) -> str:
    """Whether the photo was located, and by how many matches; whether these are all drawn."""
    registration = outcome.registration
    assert registration is not None
    some = "" if all_drawn else "; not all are drawn"
    if outcome.located is None:
        return f"not located: {registration.problem}; drawn are those of the best one{some}"
    return f"located: {outcome.located.inliers} matches, {registration.needed} needed{some}"


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 3]}..."


def _fitted(pixels: np.ndarray) -> tuple[np.ndarray, tuple[float, np.ndarray]]:
    """`pixels` fitted into a white panel, and the factor and shift to its coordinates."""
    height, width = pixels.shape[:2]
    zoom = MATCHES_PANEL / max(height, width)
    size = max(1, round(width * zoom)), max(1, round(height * zoom))
    panel = np.full((MATCHES_PANEL, MATCHES_PANEL, 3), 255, np.uint8)
    shift = np.array([(MATCHES_PANEL - size[0]) // 2, (MATCHES_PANEL - size[1]) // 2])
    panel[shift[1] : shift[1] + size[1], shift[0] : shift[0] + size[0]] = cv2.resize(pixels, size)
    return panel, (zoom, shift)
