"""Photos with the tags of drones, and boxes of vehicles of known size in them."""

from __future__ import annotations

import numpy as np
from PIL import Image

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections
from orthoscale.core.ruler import Ruler
from orthoscale.synthetic import Camera, Perspective, Pose

from .bodies import body

SIZE = (1000, 750)
FOCAL, ALTITUDE = 900.0, 60.0
CARS = {
    "name": "nearly of one size",
    "source": "made for this test",
    "length": [4.5, 0.05],
    "width": [1.8, 0.02],
    "height": [1.5, 0.1],
    "mean_sd": [0.02, 0.01, 0.02],
}


def write_photo(path, xmp="", exif=(), gps=None, size=SIZE):
    """A grey JPEG with these tags: `xmp` attributes or elements of rdf:Description, `exif` {tag: value}, `gps`
    longitude, latitude and perhaps altitude, with whether it lies below the sea."""
    image = Image.new("RGB", size, (120, 120, 120))
    tags = Image.Exif()
    for tag, value in dict(exif).items():
        (tags if tag in (0x010F, 0x0110, 0x0112, 0x0132) else tags.get_ifd(0x8769))[tag] = value
    if gps:
        add_gps(tags, *gps)
    inner, _, elements = xmp.partition("|")
    packet = (
        '<?xpacket begin=""?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" xmlns:Camera="http://pix4d.com/camera/1.0/" '
        'xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/" xmlns:sky="https://www.skydio.com/1.0/" '
        f"{inner}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end='w'?>"
    )
    image.save(path, exif=tags, xmp=packet.encode() if xmp else b"")
    return path


def add_gps(tags, lon, lat, *altitude):
    """Add a position to `tags`, a PIL.Image.Exif."""
    sides = {1: "NS"[lat < 0], 3: "EW"[lon < 0]}
    tags.get_ifd(0x8825).update(
        {**sides, 2: dms(abs(lat)), 4: dms(abs(lon)), **dict(zip([6, 5], altitude, strict=False))}
    )


def dms(value):
    degrees, rest = divmod(value * 3600, 3600)
    return degrees, rest // 60, rest % 60


CALIBRATIONS = {
    "a.xml": "<calibration><projection>frame</projection><width>4000</width><height>3000</height><f>2300</f>"
    "<cx>12</cx><cy>-8</cy><k1>-0.02</k1><k2>0.003</k2><p1>0.0004</p1><p2>-0.0002</p2></calibration>",
    "a.txt": "# Camera list\n1 OPENCV 4000 3000 2300 2300 2012 1492 -0.02 0.003 -0.0002 0.0004\n",
    "a.json": '{"width": 4000, "height": 3000, "focal_px": 2300, "cx": 2012, "cy": 1492, "k1": -0.02, "k2": 0.003,'
    ' "p1": -0.0002, "p2": 0.0004}',
}


def view_from(pitch, roll=0.0):
    centre = np.array([0.0, 0.0, ALTITUDE])
    return Perspective(Camera(FOCAL, *SIZE), Pose.looking(centre, 0.4, np.radians(-pitch), np.radians(roll)))


def boxes_in(view, n=40, seed=0, shape=None):
    """Boxes of a body (by default a car up to 0.8 m), sized as CARS, of any heading, on the ground in the picture."""
    rng = np.random.default_rng(seed)
    plan, heights = shape or body()
    pixels = rng.uniform([60, 60], np.array(SIZE) - 60, (n, 2))
    rays = np.column_stack([(pixels - np.array(SIZE) / 2) / FOCAL, np.ones(n)]) @ view.pose.rotation
    steep = -rays[:, 2] / np.linalg.norm(rays, axis=1) > np.sin(np.radians(25)) + 0.05
    rows = []
    spread = rng.normal(0, [0.05, 0.02], (n, 2))
    sizes = np.array([4.5, 1.8]) + np.concatenate([spread[: (n + 1) // 2], -spread[: n // 2]])  # of mean 4.5 x 1.8 m
    for ray, size in zip(rays[steep], sizes, strict=False):
        place = view.pose.centre - ray * ALTITUDE / ray[2]
        angle = rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        ground = plan * size @ turn + place[:2]
        outline = view.project(np.column_stack([ground, heights]))
        along = view.project(place + np.r_[turn[0], 0.0]) - view.project(place)
        u = along / np.linalg.norm(along)
        axes = np.stack([u, [-u[1], u[0]]])
        extent = outline @ axes.T
        low, high = extent.min(0), extent.max(0)
        rows.append([*((low + high) / 2 @ axes), *(high - low), np.arctan2(u[1], u[0])])
    return Boxes(np.array(rows), np.ones(len(rows)))


def detections_of(boxes):
    """`boxes` as from a detector without margin and bias, with a known effective height."""
    ruler = Ruler((0, 0), (0.05, 0.05), (0.002, 0.002), 0.0, (0.3, 0.3))
    return Detections(boxes, 1.0, ruler, (0.8, 0.8), "made for this test")
