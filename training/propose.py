r"""Proposes boxes in unlabelled pictures, for a person to judge.

    python -m training.propose look --detector WEIGHTS.onnx --pictures ../shared/data/vehicles/chips --length 15 \\
        --but ../shared/data/places/truth.json --out runs/chips
    python -m training.propose look --detector A.onnx --detector B.onnx --pictures ../shared/data/places \\
        --truth ../shared/data/places/truth.json --out runs/places
    python -m training.propose keep runs/chips --as chips

Each detector looks at every picture at four zooms, plain and mirrored. A box that most looks show is proposed as a
vehicle, one that few show as `ignore`: neither vehicle nor background. Sizes are medians over the looks. Written are
``proposals.json`` and contact sheets of the proposals, numbered within each scene (pictures whose names differ only in
digits).

A person looks at the sheets and writes ``judged.txt`` beside them, with a line for each correction: ``SCENE
vehicle|ignore|background NUMBERS``, as in ``harbor background 0-17 20 23``, and missing vehicles as ``PICTURE add X Y
LENGTH WIDTH ANGLE``. `keep` writes the result to ``labels/chips.json`` or ``labels/places.json``, which
`data.read_labels` reads with the folder of that name. ``keep --add`` adds it to the existing labels, as the proposals
of `missing` need: a box that was ignored before and is judged now is no longer ignored.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from orthoscale.core.angles import axis_angle
from orthoscale.core.boxes import Boxes, overlapping, suppress
from orthoscale.detect.detector import Detector

from .data import BACKGROUND, LABELS, LabelledImage, group_of
from .missing import cell, write_sheets

LENGTHS = (27.0, 33.0, 39.0, 47.0)  # of a usual vehicle in the four looks [px]
USUAL = 4.6  # length of that vehicle [m]
SAME = 0.3  # IoU from which boxes of different looks are of one vehicle
PART = 256.0  # side of the chips that some of the pictures of places are assembled from [px]
LOWEST = 0.1  # lowest score of a box that counts
SURE, MOST = 0.4, 0.6  # a vehicle has a score of SURE in the share MOST of the looks
KINDS = ("vehicle", "ignore", BACKGROUND)
MARGIN = 0.2  # in vehicle lengths; a vehicle whose middle is closer to the picture's edge is cut too much


def looks(pixels: np.ndarray, detector: Detector, length: float) -> list[Boxes]:
    """Boxes [px of the picture] of every look at a picture, RGB (h, w, 3), with vehicles of about `length` px."""
    height, width = pixels.shape[:2]
    found = []
    for zoom in np.array(LENGTHS) / length:
        method = cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC
        seen = cv2.resize(pixels, (round(width * zoom), round(height * zoom)), interpolation=method)
        found.append(suppress(detector(seen, LOWEST)).mapped(1 / zoom))
        mirrored = suppress(detector(np.ascontiguousarray(seen[:, ::-1]), LOWEST)).mapped(1 / zoom)
        xylwa = mirrored.xylwa.copy()
        xylwa[:, 0], xylwa[:, 4] = width - xylwa[:, 0], -xylwa[:, 4]
        found.append(Boxes(xylwa, mirrored.score))
    return found


def agreed(found: list[Boxes]) -> list[dict]:
    """What the looks agree on, best first: median box, mean score over all looks (0 if a look shows nothing), and the
    share of looks with a score of SURE."""
    every = Boxes.concatenate(found)
    look = np.repeat(np.arange(len(found)), [len(b) for b in found])
    i, j, _ = overlapping(every, every, SAME)
    neighbours: list[list[int]] = [[] for _ in range(len(every))]
    for a, b in zip(i, j, strict=True):
        neighbours[a].append(int(b))
    free, out = np.ones(len(every), bool), []
    for k in np.argsort(-every.score):
        if not free[k]:
            continue
        group = np.array([m for m in neighbours[k] if free[m]])
        free[group] = False
        xylwa, score = every.xylwa[group], every.score[group]
        best = np.array([score[look[group] == n].max(initial=0.0) for n in range(len(found))])
        turn = axis_angle(xylwa[:, 4] - every.xylwa[k, 4])
        box = np.r_[np.median(xylwa[:, :4], axis=0), every.xylwa[k, 4] + np.median(turn)]
        out.append(
            {"box": np.round(box, 2).tolist(), "score": float(best.mean()), "sure": float((best >= SURE).mean())}
        )
    return sorted(out, key=lambda proposal: -proposal["score"])


def propose(pictures: dict[Path, tuple[float, float]], detectors: list[Detector], out: Path) -> None:
    """Write proposals and sheets. pictures : by file, the length of its vehicles, and the side of the parts that it is
    assembled from (inf if it is a single one) [px]."""
    out.mkdir(parents=True, exist_ok=True)
    proposals: dict[str, list[dict]] = {}
    cells: dict[str, list[np.ndarray]] = {}
    for file, (length, part) in pictures.items():
        image = LabelledImage.unlabelled(file, "")
        size = np.array([image.width, image.height], float)
        found = agreed([boxes for detector in detectors for boxes in looks(image.level(0), detector, length)])
        sheet = cells.setdefault(group_of(file.name), [])
        for proposal in found:
            place = np.array(proposal["box"][:2])
            to_edge = np.minimum(place % part, np.minimum(size, part) - place % part).min()
            vehicle = proposal["sure"] >= MOST and to_edge > MARGIN * length
            proposal["kind"] = "vehicle" if vehicle else "ignore"
            text = f"{len(sheet)}{'' if vehicle else '?'} .{proposal['score'] * 100:02.0f}"
            sheet.append(cell(image, np.array(proposal["box"]), text))
        proposals[file.name] = found
        (out / "proposals.json").write_text(json.dumps(proposals))
    write_sheets(cells, out)


def judged(proposals: dict[str, list[dict]], verdicts: str) -> dict[str, dict[str, list[list[float]]]]:
    """Boxes by picture and kind, after the corrections `verdicts` of a person (see above)."""
    by_group: dict[str, list[dict]] = {}
    for picture, found in proposals.items():
        by_group.setdefault(group_of(picture), []).extend(found)
    for line in filter(None, verdicts.splitlines()):
        name, verdict, *numbers = line.split()
        if verdict == "add":
            proposals[name].append({"box": [float(n) for n in numbers], "kind": "vehicle"})
            continue
        for text in numbers:
            first, _, last = text.partition("-")
            for n in range(int(first), int(last or first) + 1):
                by_group[name][n]["kind"] = verdict
    return {
        picture: {kind: boxes for kind in KINDS if (boxes := [p["box"] for p in found if p["kind"] == kind])}
        for picture, found in proposals.items()
    }


def added(before: dict[str, dict], kept: dict[str, dict]) -> dict[str, dict]:
    """Labels by picture and kind with those in `kept` added; boxes that these judge are no longer ignored."""
    together = {}
    for picture in dict.fromkeys([*before, *kept]):
        old, new = before.get(picture, {}), kept.get(picture, {})
        unsure = old.get("ignore", [])
        settled = overlapping(_boxes(unsure), _boxes([box for boxes in new.values() for box in boxes]), SAME)[0]
        old = {**old, "ignore": [box for k, box in enumerate(unsure) if k not in settled]}
        together[picture] = {kind: boxes for kind in KINDS if (boxes := [*old.get(kind, []), *new.get(kind, [])])}
    return together


def _boxes(rows: list[list[float]]) -> Boxes:
    return Boxes(np.array(rows, float).reshape(-1, 5), np.ones(len(rows)))


def write_kept(kept: dict[str, dict], file: Path) -> None:
    """Replace the images of a label file; each is a line."""
    labels = json.loads(file.read_text()) | {"images": None}
    lines = ",\n".join(
        f"  {json.dumps(name)}: {json.dumps(kinds, separators=(',', ':'))}" for name, kinds in kept.items()
    )
    file.write_text(json.dumps(labels, indent=1).replace('"images": null', f'"images": {{\n{lines}\n }}') + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    looking = commands.add_parser("look")
    looking.add_argument("--detector", type=Path, action="append", required=True)
    looking.add_argument("--pictures", type=Path, required=True, help="folder")
    looking.add_argument("--length", type=float, help="of vehicles in all of them [px]")
    looking.add_argument("--truth", type=Path, help="truth.json with each picture's gsd_m, instead")
    looking.add_argument(
        "--but", type=Path, help="truth.json of pictures put together from some that are to be left out"
    )
    looking.add_argument("--out", type=Path, required=True)
    keeping = commands.add_parser("keep")
    keeping.add_argument("folder", type=Path)
    keeping.add_argument("--as", dest="name", choices=("chips", "places", "judged"), required=True)
    keeping.add_argument("--add", action="store_true", help="to the labels that are there")
    options = parser.parse_args()
    if options.command == "keep":
        proposals = json.loads((options.folder / "proposals.json").read_text())
        kept = judged(proposals, (options.folder / "judged.txt").read_text())
        file = LABELS / f"{options.name}.json"
        write_kept(added(json.loads(file.read_text())["images"], kept) if options.add else kept, file)
        return
    detectors = [Detector(path, threads=1) for path in options.detector]
    if options.truth:
        entries = json.loads(options.truth.read_text())
        pictures = {
            options.pictures / name: (USUAL / entry["gsd_m"], PART if "chips" in entry else np.inf)
            for name, entry in entries.items()
        }
    else:
        of = json.loads(options.but.read_text()).values() if options.but else []
        left_out = {name for entry in of for name in entry.get("chips", [])}
        files = sorted(f for f in options.pictures.iterdir() if f.name not in left_out)
        pictures = dict.fromkeys(files, (options.length, np.inf))
    propose(pictures, detectors, options.out)


if __name__ == "__main__":
    main()
