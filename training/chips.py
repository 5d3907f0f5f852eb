r"""Boxes for small pictures of known scale that nobody has labelled, for a person to judge.

    python -m training.chips propose --detector WEIGHTS.onnx --chips ../shared/data/vehicles/chips \
        --leave-out ../shared/data/places/truth.json --out runs/chips
    python -m training.chips keep --proposals runs/chips/proposals.json --judged runs/chips/judged.txt

A detector looks at each chip enlarged to several zooms and mirrored. A box that most looks show is proposed as a vehicle,
one that few show as `ignore`: neither vehicle nor background. Sizes are medians over the looks. Written are
``proposals.json`` and contact sheets of the proposals, numbered within each kind of chip (its name without digits).

A person looks at the sheets and writes ``judged.txt``, a line for each change of mind: ``KIND vehicle|ignore|background
NUMBERS``, as in ``harbor background 0-17 20 23``. `keep` writes the outcome as labels (``labels/chips.json``), which
`data.read_labels` reads with the folder of chips.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from orthoscale.boxes import Boxes, overlap, pairs_within
from orthoscale.detect.detector import Detector

from .data import LABELS, LabelledImage
from .missing import cell, write_sheets

KEPT = LABELS / "chips.json"
ZOOMS = (1.8, 2.2, 2.6, 3.1)
SAME = 0.3  # overlap of looks at one vehicle
LOWEST = 0.1  # score of a look that counts at all
SURE, LOOKS = 0.4, 5  # of the eight looks, so many with that score make a vehicle
MARGIN = 3.0  # a vehicle whose middle is closer to the chip's edge is cut too much [px]


def looks(pixels: np.ndarray, detector: Detector) -> list[Boxes]:
    """Boxes of every look at a chip, RGB (h, w, 3), in its pixels."""
    height, width = pixels.shape[:2]
    found = []
    for zoom in ZOOMS:
        for flipped in (False, True):
            seen = pixels[:, ::-1] if flipped else pixels
            seen = cv2.resize(seen, (round(width * zoom), round(height * zoom)), interpolation=cv2.INTER_CUBIC)
            xylwa = detector(np.ascontiguousarray(seen), LOWEST)
            boxes = xylwa.mapped(1 / zoom)
            if flipped:
                turned = boxes.xylwa.copy()
                turned[:, 0], turned[:, 4] = width - turned[:, 0], -turned[:, 4]
                boxes = Boxes(turned, boxes.score)
            found.append(boxes)
    return found


def agreed(found: list[Boxes]) -> list[dict]:
    """What the looks agree on, best first: median box, mean score over all looks (0 where a look shows nothing), and
    how many looks are sure."""
    every = Boxes.concatenate(found)
    look = np.repeat(np.arange(len(found)), [len(b) for b in found])
    reach = np.hypot(every.length, every.width) / 2
    i, j = pairs_within(every.centre, every.centre, reach, reach)
    near = overlap(every.xylwa[i], every.xylwa[j]) > SAME
    neighbours: list[list[int]] = [[] for _ in range(len(every))]
    for a, b in zip(i[near], j[near], strict=True):
        neighbours[a].append(int(b))
    free, out = np.ones(len(every), bool), []
    for k in np.argsort(-every.score):
        if not free[k]:
            continue
        group = np.array([m for m in neighbours[k] if free[m]])
        free[group] = False
        xylwa, score = every.xylwa[group], every.score[group]
        best = np.array([score[look[group] == n].max(initial=0.0) for n in range(len(found))])
        turn = (xylwa[:, 4] - every.xylwa[k, 4] + np.pi / 2) % np.pi - np.pi / 2
        box = np.r_[np.median(xylwa[:, :4], axis=0), every.xylwa[k, 4] + np.median(turn)]
        out.append({"box": np.round(box, 2).tolist(), "score": float(best.mean()), "sure": int((best >= SURE).sum())})
    return sorted(out, key=lambda proposal: -proposal["score"])




def kind_of(chip: str) -> str:
    return Path(chip).stem.rstrip("0123456789")


def propose(detector_file: Path, chips: Path, left_out: set[str], out: Path) -> None:
    """Write the proposals for every chip of the folder, and sheets to judge them by."""
    out.mkdir(parents=True, exist_ok=True)
    detector = Detector(detector_file, threads=1)
    proposals: dict[str, list[dict]] = {}
    cells: dict[str, list[np.ndarray]] = {}
    for file in sorted(f for f in chips.iterdir() if f.name not in left_out):
        image = LabelledImage.unlabelled(file, chips.name)
        size = np.array([image.width, image.height])
        found = agreed(looks(image.level(0), detector))
        for proposal in found:
            centre = np.array(proposal["box"][:2])
            whole = bool((centre > MARGIN).all() and (centre < size - MARGIN).all())
            proposal["kind"] = "vehicle" if proposal["sure"] >= LOOKS and whole else "ignore"
        proposals[file.name] = found
        sheet = cells.setdefault(kind_of(file.name), [])
        for proposal in found:
            mark = "" if proposal["kind"] == "vehicle" else "?"
            text = f"{len(sheet)}{mark} .{proposal['score'] * 100:02.0f}"
            sheet.append(cell(image, np.array(proposal["box"]), text))
    (out / "proposals.json").write_text(json.dumps(proposals))
    write_sheets(cells, out)


def keep(proposals: dict[str, list[dict]], judged: str) -> dict[str, dict[str, list[list[float]]]]:
    """Boxes by chip and kind (vehicle, ignore), after what a person said of the proposals (see above)."""
    by_kind: dict[str, list[dict]] = {}
    for chip, found in proposals.items():
        by_kind.setdefault(kind_of(chip), []).extend(found)
    for line in filter(None, judged.splitlines()):
        kind, verdict, *numbers = line.split()
        for text in numbers:
            first, _, last = text.partition("-")
            for n in range(int(first), int(last or first) + 1):
                by_kind[kind][n]["kind"] = verdict
    return {
        chip: {
            kind: boxes for kind in ("vehicle", "ignore") if (boxes := [p["box"] for p in found if p["kind"] == kind])
        }
        for chip, found in proposals.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    proposing = commands.add_parser("propose")
    proposing.add_argument("--detector", type=Path, required=True)
    proposing.add_argument("--chips", type=Path, required=True, help="folder")
    proposing.add_argument("--leave-out", type=Path, help="truth.json of pictures to be tested on, made of chips")
    proposing.add_argument("--out", type=Path, required=True)
    keeping = commands.add_parser("keep")
    keeping.add_argument("--proposals", type=Path, required=True)
    keeping.add_argument("--judged", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "propose":
        places = json.loads(options.leave_out.read_text()) if options.leave_out else {}
        left_out = {chip for place in places.values() for chip in place.get("chips", [])}
        propose(options.detector, options.chips, left_out, options.out)
        return
    labels = json.loads(KEPT.read_text())
    kept = keep(json.loads(options.proposals.read_text()), options.judged.read_text())
    labels["images"] = "KEPT"
    lines = ",\n".join(f"  {json.dumps(chip)}: {json.dumps(kinds, separators=(',', ':'))}" for chip, kinds in kept.items())
    KEPT.write_text(json.dumps(labels, indent=1).replace('"KEPT"', "{\n" + lines + "\n }") + "\n")


if __name__ == "__main__":
    main()
