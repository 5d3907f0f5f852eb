"""Make the examples that lie in this folder.

    python examples/make_examples.py --data ../shared/data

`town/` is an orthophoto of a synthetic scene. `sheffield/` is a reduced copy of the real reconstruction: all poses, one
sparse point in four with their tracks thinned, and the boxes that the shipped networks give in its frames, so that the
scale can be recovered without the frames (which are not in this repository).
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap

from orthoscale.actions.find import VehicleSearch, find_in_model, measured_anew
from orthoscale.detect.detector import Detector
from orthoscale.detect.find import Effort
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.own import save_detections
from orthoscale.requests import EstimateRequest
from orthoscale.sources.colmap import ColmapSource
from orthoscale.synthetic import make_scene, write_ortho

HERE = Path(__file__).parent
TOWN_GSD = 0.085  # m/px
POINTS = 12_000  # sparse points kept
TRACK = 5  # observations kept of each point


def make_town() -> None:
    scene = make_scene(seed=11, fleet=load_fleet("DE"), extent_m=130, n_vehicles=90, style="suburb")
    truth = write_ortho(scene, HERE / "town" / "ortho.jpg", TOWN_GSD, seed=11)
    (HERE / "town" / "ortho.truth.json").unlink()
    keep = {"gsd_m": truth["gsd_m"], "fleet": "DE", "what": "synthetic suburb, python -m orthoscale.synthetic, seed 11"}
    (HERE / "town" / "truth.json").write_text(json.dumps(keep, indent=1) + "\n")


def make_sheffield(data: Path) -> None:
    folder, original = HERE / "sheffield", data / "reconstructions" / "sheffield"
    small = reduced(pycolmap.Reconstruction(str(original / "sparse")))
    source = ColmapSource.open(original)
    found = find_in_model(source, None, VehicleSearch(Detector()))
    found = measured_anew(source, found, EstimateRequest(), Effort())
    truth = json.loads((original / "truth.json").read_text())
    shutil.rmtree(folder, ignore_errors=True)  # only now, so that the example stays if data are missing
    (folder / "sparse").mkdir(parents=True)
    small.write_binary(str(folder / "sparse"))
    save_detections(found, folder / "detections.json")
    keep = {key: truth[key] for key in ("metres_per_model_unit", "how", "relative_uncertainty")}
    keep |= {"fleet": "US", "source": "pierotofy/drone_dataset_sheffield_cross, public domain"}
    (folder / "truth.json").write_text(json.dumps(keep, indent=1) + "\n")


def reduced(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The same cameras and poses with POINTS points of at most TRACK observations, and no other image points."""
    rng = np.random.default_rng(0)
    ids = np.array(sorted(i for i, p in model.points3D.items() if p.track.length() > 2))
    kept = set(rng.choice(ids, min(POINTS, len(ids)), replace=False).tolist())
    small = pycolmap.Reconstruction()
    for camera in model.cameras.values():
        small.add_camera_with_trivial_rig(camera)
    tracks: dict[int, list[tuple[int, int]]] = {i: [] for i in kept}
    for i in sorted(kept):
        elements = model.points3D[i].track.elements
        for k in rng.choice(len(elements), min(TRACK, len(elements)), replace=False):
            tracks[i].append((elements[k].image_id, elements[k].point2D_idx))
    wanted: dict[int, list[int]] = {}
    for elements in tracks.values():
        for image_id, index in elements:
            wanted.setdefault(image_id, []).append(index)
    place: dict[tuple[int, int], int] = {}
    for image in model.images.values():
        indices = sorted(wanted.get(image.image_id, []))
        place |= {(image.image_id, index): k for k, index in enumerate(indices)}
        points = pycolmap.Point2DList([pycolmap.Point2D(image.points2D[index].xy) for index in indices])
        copy = pycolmap.Image(name=image.name, points2D=points, camera_id=image.camera_id, image_id=image.image_id)
        small.add_image_with_trivial_frame(copy, image.cam_from_world())
    for i, elements in tracks.items():
        track = pycolmap.Track([pycolmap.TrackElement(image_id, place[image_id, k]) for image_id, k in elements])
        small.add_point3D(model.points3D[i].xyz, track, model.points3D[i].color)
    return small


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=HERE.parent.parent / "shared" / "data")
    options = parser.parse_args()
    make_town()
    make_sheffield(options.data)
    size = sum(path.stat().st_size for path in HERE.rglob("*") if path.is_file())
    print(f"{HERE}: {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
