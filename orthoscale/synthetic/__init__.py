"""Synthetic scenes with exact ground truth, for tests, examples and training: what a survey would see, in metres.

    scene = make_scene(seed=1, n_vehicles=60)
    image, boxes = render_ortho(scene, gsd_m=0.08)
    truth = write_colmap(scene, Path("survey"), metres_per_unit=3.7, n_frames=16)

No other package of orthoscale imports this one.
"""

from .labels import write_labels
from .model import flight, write_colmap, write_ortho
from .render import Look, render, render_frame, render_ortho, vehicle_boxes
from .scene import STYLES, NormalFleet, Scene, make_scene
from .vehicle import Vehicle
from .view import Camera, Ortho, Perspective, Pose

__all__ = [
    "STYLES",
    "Camera",
    "Look",
    "NormalFleet",
    "Ortho",
    "Perspective",
    "Pose",
    "Scene",
    "Vehicle",
    "flight",
    "make_scene",
    "render",
    "render_frame",
    "render_ortho",
    "vehicle_boxes",
    "write_colmap",
    "write_labels",
    "write_ortho",
]
