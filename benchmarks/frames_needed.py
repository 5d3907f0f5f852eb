"""How many views of a place are needed: the scale from some frames of a model against that from all of them.

    python benchmarks/frames_needed.py MODEL --fleet US

All frames are searched once (kept in the cache). Then the scale is measured with those that show every place 1, 2, 4
times and more (`detect.cover`). Anchors are not used: they would hide the effect on the vehicles' scale. Prints
Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from dataclasses import replace

from orthoscale.actions.estimate import estimate
from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.measurement import Measurement
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.ways import measure_source
from orthoscale.detect.cover import covering, places_seen, seen_from_above
from orthoscale.errors import OrthoscaleError

VIEWS = (1, 2, 4, 6, 8, 12, 16)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--fleet", default="world")
    asked = parser.parse_args()
    whole = estimate(asked.model, fleet=asked.fleet, exhaustive=True, anchors=["none"])
    source, found = whole.source.posed, whole.detections
    assert source is not None, "a model"
    names = [picture.name for picture in source.pictures]
    above = {view.name: view.image for view in source.ground_pictures if view.frame is not None}

    def measured(frames: Collection[str], plans: Collection[str]) -> Measurement:
        some = replace(found, boxes=_only(found.boxes, frames))
        if found.planar is not None:
            some = replace(some, planar=replace(found.planar, boxes=_only(found.planar.boxes, plans)))
        return measure_source(source, some, whole.fleet, Method())

    every = measured(names, list(above))
    seen = places_seen(source, names)
    print("| views of a place | frames | from above | oblique | planar | together | sampling |")
    print("|---|---|---|---|---|---|---|")
    for views in VIEWS:
        frames = covering([seen[name] for name in names], views)
        plans = covering([seen_from_above(seen[image]) for image in above.values()], views)
        try:
            some = measured(
                {names[k] for k in frames.order[: frames.enough]},
                {list(above)[k] for k in plans.order[: plans.enough]},
            )
        except OrthoscaleError as error:
            print(f"| {views} | {frames.enough} | {plans.enough} | {error.message} | | | |")
            continue
        print(f"| {views} | {frames.enough} | {plans.enough} | {_apart(some, every)} |")
    sampling = every.scale.parts.get("sampling", 0.0)
    print(f"\nAll {len(names)}: {every.scale.value:.5g} {source.unit}, sampling part {100 * sampling:.1f} %")


def _only(boxes: Mapping[str, Boxes], names: Collection[str]) -> dict[str, Boxes]:
    return {name: some for name, some in boxes.items() if name in names}


def _apart(some: Measurement, every: Measurement) -> str:
    """Relative differences in each measuring mode and of both together, and the sampling part."""
    cells = [
        f"{100 * (some.modes[way].scale.value / every.modes[way].scale.value - 1):+.1f} %"
        if way in some.modes and way in every.modes
        else ""
        for way in ("oblique", "planar")
    ]
    cells.append(f"{100 * (some.scale.value / every.scale.value - 1):+.1f} %")
    cells.append(f"{100 * some.scale.parts.get('sampling', 0.0):.1f} %")
    return " | ".join(cells)


if __name__ == "__main__":
    main()
