"""Do the shapes of boxes show the country? ``python benchmarks/country_from_shapes.py BOXES``.

For each orthophoto of known scale the boxes in the folder BOXES (`places.py` leaves them there) are pooled with the
fleet of every country. How probable the true country comes out depends on the share of the evidence that is believed.
SHAPES_TOLD of `core.pooling.robust` was chosen by the mean log probability for each share; the table also has the error
with the fleet `world` and whether its interval holds.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import orthoscale
from orthoscale.core.pooling import robust
from orthoscale.core.projection.planar import ground_size
from orthoscale.core.votes import Sightings, gather
from orthoscale.fleets import load_fleet

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from places import scenes  # noqa: E402
from support.simulate import table  # noqa: E402

SHARES = (1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.0)


def main(folder: Path) -> None:
    world = load_fleet("world")
    rows = []
    votes = {}
    for scene in scenes():
        found = orthoscale.load_detections(folder / f"{scene.name}.det.json")
        if scene.path.is_file():  # an orthophoto
            boxes = next(iter(found.boxes.values()))
            pixel = np.full(len(boxes), 1 / found.zoom)
            seen = gather(Sightings(ground_size(boxes), pixel, boxes.centre, boxes.score, boxes.sigma), False)
            votes[scene] = seen, found.ruler
    for share in SHARES:
        robust.SHAPES_TOLD, robust.LIKELY = share, 0.0
        probability, error, hit = [], [], []
        for scene, (seen, ruler) in votes.items():
            scale = robust.pool(seen, world, ruler, "m/px")
            probability.append(np.log(scale.fleets[scene.country]))
            error.append(np.log(scale.value / scene.truth))
            hit.append(scale.interval90[0] <= scene.truth <= scale.interval90[1])
        rms = 100 * np.sqrt(np.mean(np.square(error)))
        rows.append([f"{share:g}", f"{np.mean(probability):.2f}", f"{rms:.1f}", f"{sum(hit)} of {len(hit)}"])
    print(table(("believed", "mean log probability of the country", "RMS error [%]", "interval holds"), rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
