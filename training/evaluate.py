r"""How good a detector's boxes are: which vehicles it finds, and how large their boxes are.

    python -m training.evaluate --detector orthoscale/detect/weights/small_vehicle.onnx \\
        --labels ../shared/data/vehicles/labels.json --scenes ohio \\
        --checked ../shared/data --reference sheffield=../shared/data/reconstructions/sheffield/images:BOXES.json \\
        --margin ../shared/data/orthophotos/manila.tif:0.0967:PH --json evaluation.json --picture evaluation.png

Every picture is swept as a user's would be (`orthoscale.detect.sweep`: a vehicle must show in two passes; `--looks 1`
for the network alone), at the zoom that brings the median labelled vehicle of its scene to the detector's best length.
A box that overlaps a label by half or more (intersection over union) is a hit. In ignored areas (other kinds, vehicles
cut by the picture's edge) boxes count neither way.

Scores of differently trained detectors are not comparable, so the last line counts false boxes at equal recall, over
all scenes with complete labels. ``--rendered`` are orthophotos of `orthoscale.synthetic`, with exact truth; ``--aside
1.6`` looks at 1.6 times the right zoom, as the scale search does, where hardly any box is a vehicle.

Only scenes that the detector has not seen show how good it is. In `warsaw` and `bogota` not every vehicle is labelled,
so precision is too low there. `--checked` are pictures never trained on in which a person has looked for every vehicle
(`labels/checked.json`, and `labels/places.json` if the data have that folder); boxes of the former were proposed by
detector version 2, so they are no reference for its sizes. `--by-hand` compares sizes with vehicles measured by hand
(`labels/by_hand.json`), in scenes trained on and others.
References are boxes of another detector on scenes never trained on. They are precise but incomplete, so they give only
recall and sizes, and the sizes include that detector's margin.

``--margin`` measures what the card's ruler needs: the pixels by which the detector's boxes are longer and wider than
vehicles, from near-vertical pictures of known ground sampling distance.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.angles import axis_angle
from orthoscale.core.boxes import Boxes, matched
from orthoscale.core.fleet import Fleet
from orthoscale.core.normal import median_and_sd
from orthoscale.detect.detector import CUT
from orthoscale.detect.sweep import sweep_twice
from orthoscale.detect.tiles import AnyDetector, FunctionDetector, look_twice, one_pass, tiles
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import load_detections
from orthoscale.sources.picture_file import PictureFile, stored_size

from .data import NOMINAL_LENGTH, as_stored, read_labels

CHECKED = Path(__file__).parent / "labels" / "checked.json"
PLACES = Path(__file__).parent / "labels" / "places.json"
BY_HAND = Path(__file__).parent / "labels" / "by_hand.json"
IOU = 0.5
LOWEST_SCORE = 0.05  # boxes below are left out; the precision-recall curve ends there
VISIBLE = 0.6  # visible share of a rendered vehicle from which it should be found
RECALLS = (0.7, 0.8, 0.85, 0.9, 0.95)  # at which false boxes are counted
# For the fit of margins, a box counts as a vehicle of the fleet within this factor of the expected length and width.
PLAUSIBLE = 1.5


@dataclass(frozen=True)
class Labelled:
    """A picture and what is known about it; boxes (N, 5) [px of the picture]."""

    picture: PictureFile
    vehicles: np.ndarray
    ignored: np.ndarray


@dataclass(frozen=True)
class Scene:
    """Pictures of one place at one scale. `complete`: everything without a label is background."""

    name: str
    pictures: list[Labelled]
    complete: bool = True

    @property
    def length(self) -> float:
        """Median labelled vehicle length [px]; an assumed one if there are no vehicles."""
        lengths = np.concatenate([p.vehicles[:, 2] for p in self.pictures])
        return float(np.median(lengths)) if len(lengths) else NOMINAL_LENGTH


@dataclass(frozen=True)
class Comparison:
    """One picture's boxes and labels; boxes in ignored areas are left out.

    hit : (K,) the label that box k found, -1 for none.
    """

    boxes: Boxes
    hit: np.ndarray
    vehicles: np.ndarray


@dataclass(frozen=True)
class Result:
    """Figures of one scene; None for those that cannot be determined.

    false : boxes that are not vehicles, at the card's score. length, width : median, robust spread and median absolute
    value of log(box / label). angle : median absolute difference [deg].
    """

    scene: str
    pictures: int
    vehicles: int
    zoom: float
    false: int | None
    precision: float | None
    recall: float | None
    average_precision: float | None
    length: tuple[float, float, float] | None
    width: tuple[float, float, float] | None
    angle: float | None


def compare(boxes: Boxes, vehicles: np.ndarray, ignored: np.ndarray) -> Comparison:
    """Match `boxes` to `vehicles` (N, 5); others whose centre lies in an `ignored` box (M, 5) are dropped."""
    found, label, _ = matched(boxes, Boxes(vehicles, np.ones(len(vehicles))), IOU)
    hit = np.full(len(boxes), -1)
    hit[found] = label
    keep = (hit >= 0) | ~_centred_in(boxes.centre, ignored)
    return Comparison(boxes[keep], hit[keep], vehicles)


def _centred_in(points: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(K,) whether each of the points (K, 2) lies in any of the boxes (M, 5)."""
    d = points[:, None] - boxes[None, :, :2]
    cos, sin = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    u = d[..., 0] * cos + d[..., 1] * sin
    v = d[..., 1] * cos - d[..., 0] * sin
    return ((np.abs(u) <= boxes[:, 2] / 2) & (np.abs(v) <= boxes[:, 3] / 2)).any(1)


def average_precision(score: np.ndarray, is_hit: np.ndarray, vehicles: int) -> float:
    """Area under the precision-recall curve of boxes with `score` (K,): the mean over all vehicles of the precision at
    which each is found, 0 for those never found. Precision is the best at that recall or a higher one."""
    is_hit = is_hit[np.argsort(-score, kind="stable")]
    precision = np.cumsum(is_hit) / np.arange(1, len(is_hit) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(precision[is_hit].sum() / vehicles)


def summarise(scene: Scene, comparisons: list[Comparison], zoom: float, score: float) -> Result:
    """The figures of one scene; all but the average precision are for boxes with at least `score`."""
    vehicles = sum(len(c.vehicles) for c in comparisons)
    scores = np.concatenate([c.boxes.score for c in comparisons])
    is_hit = np.concatenate([c.hit >= 0 for c in comparisons])
    hits = int((is_hit & (scores >= score)).sum())
    false = int((~is_hit & (scores >= score)).sum())
    counted = [(c.hit >= 0) & (c.boxes.score >= score) for c in comparisons]
    box = np.concatenate([c.boxes.xylwa[k] for c, k in zip(comparisons, counted, strict=True)])
    label = np.concatenate([c.vehicles[c.hit[k]] for c, k in zip(comparisons, counted, strict=True)])
    turn = axis_angle(box[:, 4] - label[:, 4])
    tell = scene.complete
    return Result(
        scene=scene.name,
        pictures=len(scene.pictures),
        vehicles=vehicles,
        zoom=zoom,
        false=false if tell else None,
        precision=hits / (hits + false) if tell and hits else None,
        recall=hits / vehicles if vehicles else None,
        average_precision=average_precision(scores, is_hit, vehicles) if tell and vehicles else None,
        length=_errors(np.log(box[:, 2] / label[:, 2])),
        width=_errors(np.log(box[:, 3] / label[:, 3])),
        angle=float(np.degrees(np.median(np.abs(turn)))) if len(turn) else None,
    )


def _errors(values: np.ndarray) -> tuple[float, float, float] | None:
    """Median, robust standard deviation, and median absolute value; None without values."""
    if not len(values):
        return None
    centre, spread = median_and_sd(values)
    return float(centre), float(spread), float(np.median(np.abs(values)))


def labelled_scenes(label_file: Path, names: Sequence[str]) -> list[Scene]:
    """The scenes `names` of a label file (all if there are none). Raises ValueError for one that is not in it."""
    images = read_labels(label_file)
    present = list(dict.fromkeys(image.scene for image in images))
    if unknown := set(names) - set(present):
        raise ValueError(f"no such scene in {label_file}: {', '.join(sorted(unknown))}; there are {', '.join(present)}")
    return [
        Scene(
            name,
            [
                Labelled(
                    PictureFile(i.path.name, i.path, i.width, i.height), i.vehicles, i.boxes[~i.is_vehicle]
                )
                for i in images
                if i.scene == name
            ],
        )
        for name in names or present
    ]  # fmt: skip


def checked_scenes(data: Path) -> list[Scene]:
    """The scenes of labels/checked.json, whose pictures lie under `data`."""
    entries = json.loads(CHECKED.read_text())["images"]
    return [
        Scene(
            name,
            [
                Labelled(
                    PictureFile(Path(file).name, data / file, *entry["size"]),
                    *(np.array(entry.get(kind, []), float).reshape(-1, 5) for kind in ("vehicle", "ignore")),
                )
                for file, entry in entries.items()
                if entry["scene"] == name
            ],
        )
        for name in dict.fromkeys(entry["scene"] for entry in entries.values())
    ]


def place_scenes(data: Path) -> list[Scene]:
    """The pictures of labels/places.json that lie in the folder ``places`` of `data`, each a scene of its own."""
    entries = json.loads(PLACES.read_text())["images"]
    return [
        Scene(
            (data / "places" / file).stem,
            [
                Labelled(
                    picture_files(data / "places" / file)[0],
                    *(np.array(entry.get(kind, []), float).reshape(-1, 5) for kind in ("vehicle", "ignore")),
                )
            ],
        )
        for file, entry in entries.items()
        if (data / "places" / file).exists()
    ]


def measured_scenes(data: Path, file: Path | None = None) -> list[Scene]:
    """The vehicles of labels/by_hand.json, or of another such file, whose pictures lie under `data`. The pictures show
    other vehicles, too."""
    scenes: dict[str, dict[Path, list[list[float]]]] = {}
    for vehicle in json.loads((file or BY_HAND).read_text())["vehicles"]:
        if (picture := data / vehicle["picture"]).exists():
            scenes.setdefault(vehicle["scene"], {}).setdefault(picture, []).append(vehicle["read"])
    return [
        Scene(
            scene,
            [Labelled(picture_files(path)[0], np.array(boxes), np.empty((0, 5))) for path, boxes in pictures.items()],
            complete=False,
        )
        for scene, pictures in scenes.items()
    ]


def rendered_scene(pictures: Sequence[Path]) -> Scene:
    """Orthophotos of one pixel size with the ``.truth.json`` that `orthoscale.synthetic` writes beside each."""
    labelled = []
    for path in pictures:
        rows = json.loads(path.with_suffix(".truth.json").read_text())["boxes"]
        boxes = np.array([[b[k] for k in ("cx", "cy", "length", "width", "angle")] for b in rows]).reshape(-1, 5)
        seen = np.array([b["visible"] > VISIBLE for b in rows], bool)
        labelled.append(Labelled(picture_files(path)[0], boxes[seen], boxes[~seen]))
    return Scene("rendered", labelled)


def reference_scene(text: str) -> Scene:
    """A scene from ``NAME=IMAGES_FOLDER_OR_IMAGE:BOXES.json``, boxes as `load_detections` reads them."""
    name, _, rest = text.partition("=")
    images, _, boxes_file = rest.rpartition(":")
    boxes = load_detections(Path(boxes_file)).boxes
    pictures = [p for p in picture_files(Path(images)) if p.name in boxes]
    if not pictures:
        raise ValueError(f"{images}: none of the pictures of {boxes_file}")
    return Scene(name, [Labelled(p, boxes[p.name].xylwa, np.empty((0, 5))) for p in pictures], complete=False)


def picture_files(path: Path) -> list[PictureFile]:
    """The picture at `path`, or all those in the folder."""
    endings = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in endings) if path.is_dir() else [path]
    return [PictureFile(f.name, f, *(stored_size(f) or _decoded_size(f))) for f in files]


def _decoded_size(path: Path) -> tuple[int, int]:
    height, width = as_stored(path).shape[:2]
    return width, height


def twice_seen(pictures: Sequence[PictureFile], zoom: float, detector: AnyDetector) -> dict[str, Boxes]:
    """Vehicles by picture name that two passes show, as in a user's sweep, with the mean score of both."""
    jobs = [(picture, tile) for picture in pictures for tile in tiles(picture, zoom)]
    looks = ((number, look_twice(*job, detector)) for number, job in enumerate(jobs))
    return sweep_twice(jobs, np.arange(len(jobs)), lambda _: looks, passes=detector.passes).boxes


def evaluate(
    scene: Scene,
    detect: Callable[[np.ndarray], Boxes],
    best_length: float,
    score: float,
    looks: int = 2,
    aside: float = 1.0,
    confirm: Callable[[np.ndarray], Boxes] | None = None,
) -> tuple[Result, list[Comparison]]:
    """Sweep a scene's pictures at `aside` times the right zoom, and compare. `detect` gives boxes of all scores; the
    figures are for boxes with at least `score` (the mean of both passes if there are two). confirm : makes the second
    pass, whose sizes then do not count; by default `detect` makes it."""
    zoom = aside * best_length / scene.length
    pictures = [p.picture for p in scene.pictures]
    twice = FunctionDetector(detect, confirm and FunctionDetector(confirm))
    found = one_pass(pictures, zoom, detect) if looks == 1 else twice_seen(pictures, zoom, twice)
    comparisons = []
    for p in scene.pictures:
        # The sweep drops boxes that the picture's edge may cut, so labels there need not be found.
        labels = Boxes(p.vehicles, np.ones(len(p.vehicles)))
        whole = labels.inside(p.picture.width, p.picture.height, CUT / zoom)
        ignored = np.concatenate([p.ignored, labels.xylwa[~whole]])
        comparisons.append(compare(found[p.picture.name], labels.xylwa[whole], ignored))
    return summarise(scene, comparisons, zoom, score), comparisons


def table(results: Iterable[Result]) -> str:
    lines = [
        f"{'':55s}average   {'log(length ratio)':^20s}   {'log(width ratio)':^20s}  angle",
        "scene      pictures vehicles zoom precision      recall precision"
        "   median spread usual   median spread usual  [deg]",
    ]
    for r in results:
        precision = "(incomplete)" if r.false is None else f"{_figure(r.precision)} ({r.false} false)"
        length, width = (
            f"{_figure(e[0], '+.3f'):>6s}  {_figure(e[1]):>5s} {_figure(e[2]):>5s}"
            for e in (r.length or (None,) * 3, r.width or (None,) * 3)
        )
        lines.append(
            f"{r.scene:10s} {r.pictures:8d} {r.vehicles:8d} {r.zoom:4.2f} {precision:16s} {_figure(r.recall):>5s}"
            f"    {_figure(r.average_precision):>5s}   {length}   {width}   {_figure(r.angle, '.1f'):>4s}"
        )
    return "\n".join(lines)


def at_equal_recall(comparisons: Sequence[Comparison]) -> str:
    """A line with the number of false boxes in all pictures at the scores at which RECALLS are reached."""
    score = np.concatenate([c.boxes.score for c in comparisons])
    is_hit = np.concatenate([c.hit >= 0 for c in comparisons])
    vehicles = sum(len(c.vehicles) for c in comparisons)
    order = np.argsort(-score, kind="stable")
    hits, false = np.cumsum(is_hit[order]), np.cumsum(~is_hit[order])
    parts = []
    for recall in RECALLS:
        k = int(np.searchsorted(hits, np.ceil(recall * vehicles)))
        parts.append(f"{recall:.2f}: {false[k]} (score {score[order][k]:.2f})" if k < len(hits) else f"{recall:.2f}: -")
    precision = average_precision(score, is_hit, vehicles)
    return f"{vehicles} vehicles, average precision {precision:.3f}; false boxes at recall {', '.join(parts)}"


def _figure(value: float | None, form: str = ".3f") -> str:
    return "-" if value is None else format(value, form)


def draw(comparisons: list[Comparison], scene: Scene, score: float, width: int = 1400) -> np.ndarray:
    """The scene's picture with the most boxes and vehicles, BGR: hits green, false boxes red, missed vehicles blue."""
    busy = [len(c.vehicles) + int((c.boxes.score >= score).sum()) for c in comparisons]
    k = int(np.argmax(busy))
    c, p = comparisons[k], scene.pictures[k].picture
    zoom = width / p.width
    canvas = cv2.cvtColor(p.read(0, 0, p.width, p.height, width, round(p.height * zoom)), cv2.COLOR_RGB2BGR)
    sure = c.boxes.score >= score
    missed = np.setdiff1d(np.arange(len(c.vehicles)), c.hit[sure])
    colours = [
        (Boxes(c.vehicles[missed], np.ones(len(missed))), (255, 120, 0)),
        (c.boxes[sure & (c.hit >= 0)], (0, 220, 0)),
    ]
    if scene.complete:
        colours.append((c.boxes[sure & (c.hit < 0)], (0, 0, 255)))
    for boxes, colour in colours:
        corners = np.round(boxes.corners * zoom * 16).astype(np.int32)  # in sixteenths of a pixel
        cv2.polylines(canvas, list(corners), True, colour, 1, cv2.LINE_AA, shift=4)
    cv2.putText(canvas, scene.name, (8, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2, cv2.LINE_AA)
    return canvas


@dataclass(frozen=True)
class Margin:
    """What a detector adds to a vehicle's length and width [detector px].

    value, sd : (2,) weighted mean over the scenes and its uncertainty, enlarged if the scenes disagree.
    scenes, scenes_sd : (S, 2) each scene's own value and uncertainty.
    left_out : (S, 2) the value from all the other scenes; nan with a single scene.
    """

    value: np.ndarray
    sd: np.ndarray
    scenes: np.ndarray
    scenes_sd: np.ndarray
    left_out: np.ndarray


def fit_margin(known: Sequence[tuple[np.ndarray, np.ndarray, float | np.ndarray, Fleet]]) -> Margin:
    """Constant margins (of length, of width) from scenes whose scale is known.

    known : per scene its boxes' lengths and widths (N,) [detector px], metres per detector pixel (one, or one per
        vehicle (N,)), and the fleet. Every vehicle votes ``box - fleet / gsd`` and a scene's median counts.

    A scene's weight depends on how well its fleet's mean is known and on its vehicles' scatter; many vehicles do not
    make up for an unknown fleet.
    """
    scenes, variances = [], []
    for length_px, width_px, gsd, fleet in known:
        expected = np.exp(fleet.log_mean) / np.reshape(gsd, (-1, 1))  # (1 or N, 2) [px]
        votes = np.column_stack([length_px, width_px]) - expected
        median, scatter = median_and_sd(votes)
        fleet_sd = np.sqrt(np.diag(fleet.log_mean_covariance)) * np.median(expected, axis=0)
        # The variance of a normal sample's median is pi/2 times that of its mean.
        variances.append(fleet_sd**2 + np.pi / 2 * scatter**2 / len(votes))
        scenes.append(median)
    values, weights = np.array(scenes), 1 / np.array(variances)
    total = weights.sum(0)
    value = (weights * values).sum(0) / total
    freedom = max(len(values) - 1, 1)
    surprise = (weights * (values - value) ** 2).sum(0) / freedom  # near 1 if the scenes agree (Birge 1932)
    with np.errstate(invalid="ignore", divide="ignore"):
        others = total - weights
        left_out = np.where(others > 1e-9 * total, ((weights * values).sum(0) - weights * values) / others, np.nan)
    return Margin(value, np.sqrt(np.maximum(surprise, 1) / total), values, np.sqrt(1 / weights), left_out)


def known_boxes(
    text: str, detect: Callable[[np.ndarray], Boxes], best_length: float, score: float
) -> tuple[np.ndarray, np.ndarray, float, Fleet]:
    """One scene for `fit_margin` from ``PICTURE_OR_FOLDER:GSD:FLEET`` (gsd: metres per pixel of the picture), swept at
    the zoom that brings the fleet's vehicles to the best length. Boxes far from the fleet's sizes are left out."""
    path, gsd, code = text.rsplit(":", 2)
    fleet = load_fleet(code)
    size = np.exp(fleet.log_mean)
    zoom = best_length * float(gsd) / size[0]
    boxes = Boxes.concatenate(list(one_pass(picture_files(Path(path)), zoom, detect).values()))
    px = boxes[boxes.score >= score].xylwa[:, 2:4] * zoom
    px = px[(np.abs(np.log(px * float(gsd) / zoom / size)) < np.log(PLAUSIBLE)).all(1)]
    if not len(px):
        raise ValueError(f"{path}: no vehicles found")
    return px[:, 0], px[:, 1], float(gsd) / zoom, fleet


def margin_table(names: Sequence[str], known: Sequence[tuple], margin: Margin) -> str:
    lines = ["margin [detector px]      vehicles   length         width          without it: length, width"]
    for name, scene, m, sd, rest in zip(names, known, margin.scenes, margin.scenes_sd, margin.left_out, strict=True):
        lines.append(
            f"{name[:24]:24s} {len(scene[0]):7d}   {m[0]:5.2f} +- {sd[0]:4.2f}  {m[1]:5.2f} +- {sd[1]:4.2f}"
            f"             {rest[0]:5.2f}  {rest[1]:5.2f}"
        )
    m, sd = margin.value, margin.sd
    lines.append(f"{'all':24s} {'':7s}   {m[0]:5.2f} +- {sd[0]:4.2f}  {m[1]:5.2f} +- {sd[1]:4.2f}")
    return "\n".join(lines)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detector", type=Path, required=True, help="ONNX file with an orthoscale card")
    parser.add_argument("--confirming", type=Path, help="detector that takes the second look")
    parser.add_argument("--labels", type=Path, help="label file")
    parser.add_argument("--scenes", default="", help="scenes of the label file, comma separated; all by default")
    parser.add_argument(
        "--checked", type=Path, metavar="DATA", help="folder of the pictures of labels/checked.json and places.json"
    )
    parser.add_argument("--by-hand", type=Path, metavar="DATA", help="folder of the pictures of labels/by_hand.json")
    parser.add_argument(
        "--looks", type=int, choices=(1, 2), default=2, help="that a vehicle must show in (%(default)s)"
    )
    parser.add_argument("--score", type=float, help="of the figures; by default the card's for so many looks")
    parser.add_argument("--reference", action="append", default=[], metavar="NAME=IMAGES:BOXES.json")
    parser.add_argument("--margin", action="append", default=[], metavar="PICTURES:GSD:FLEET")
    parser.add_argument("--rendered", type=Path, nargs="+", default=[], metavar="PICTURE", help="with .truth.json")
    parser.add_argument("--aside", type=float, default=1.0, help="times the right zoom (%(default)s)")
    parser.add_argument("--json", type=Path, help="write all figures here")
    parser.add_argument("--picture", type=Path, help="draw one picture of each scene into this image")
    options = parser.parse_args()
    sources = options.labels, options.checked, options.by_hand, options.rendered, options.reference, options.margin
    if not any(sources):
        parser.error(
            "nothing to compare with: give --labels, --checked, --by-hand, --rendered, --reference or --margin"
        )
    return options


def scenes_of(options: argparse.Namespace) -> list[Scene]:
    """All scenes that the options name."""
    scenes = labelled_scenes(options.labels, list(filter(None, options.scenes.split(",")))) if options.labels else []
    scenes += [*place_scenes(options.checked), *checked_scenes(options.checked)] if options.checked else []
    scenes += measured_scenes(options.by_hand) if options.by_hand else []
    scenes += [rendered_scene(options.rendered)] if options.rendered else []
    return scenes + [reference_scene(text) for text in options.reference]


def margins(texts: Sequence[str], detect: Callable[[np.ndarray], Boxes], best_length: float, score: float) -> dict:
    """Fit the margin to the pictures that the `texts` name (see `known_boxes`), and print it; returns its figures."""
    known = [known_boxes(text, detect, best_length, score) for text in texts]
    names = [Path(text.rsplit(":", 2)[0]).name for text in texts]
    margin = fit_margin(known)
    print(margin_table(names, known, margin))
    return {**{name: np.round(value, 3).tolist() for name, value in asdict(margin).items()}, "names": names}


def main() -> None:
    options = arguments()

    from orthoscale.detect.detector import Detector

    detector = Detector(options.detector)
    card = detector.card
    confirming = Detector(options.confirming) if options.confirming else None
    sure = (confirming or detector).card.sure
    score = options.score or (sure if options.looks == 2 else 0) or card.score
    detect = partial(detector, threshold=LOWEST_SCORE)
    confirm = confirming and partial(confirming, threshold=LOWEST_SCORE)
    results, pictures, complete = [], [], []
    for scene in scenes_of(options):
        result, comparisons = evaluate(scene, detect, card.best_length, score, options.looks, options.aside, confirm)
        results.append(result)
        complete += comparisons if scene.complete else []
        if options.picture:
            pictures.append(draw(comparisons, scene, score))
    report: dict = {"detector": detector.path.name, "sha256": detector.sha256, "score": score, "looks": options.looks}
    if results:
        print(table(results))
        if any(len(c.vehicles) for c in complete):
            print(at_equal_recall(complete))
        report["scenes"] = [asdict(result) for result in results]
    if options.margin:
        report["margin"] = margins(options.margin, detect, card.best_length, options.score or card.score)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    if pictures:
        cv2.imwrite(str(options.picture), np.concatenate(pictures))


if __name__ == "__main__":
    main()
