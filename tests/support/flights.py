"""Parked vehicles of known size under the flight of `models.make_model`, and the boxes of a perfect detector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections
from orthoscale.core.ruler import Ruler
from orthoscale.fleets import load_fleet
from orthoscale.sources.opening import open_source

from .bodies import body

UNIT = 5.0  # [m]: the cameras of `make_model` fly at 60 m
HEIGHT, MARGIN = 0.8, 0.5  # of the boxes [m], [px]
FLEET = load_fleet("DE")


def vehicles(turn, count=45, seed=1):
    """(count, P, 3) outlines of parked vehicles and (count, 2, 3) rear and front, in the world [units]."""
    rng = np.random.default_rng(seed)
    place = np.array([(x, y) for x in np.arange(-9, 9.1, 2.2) for y in np.arange(-8, 8.1, 2.2)])
    place = place[rng.permutation(len(place))[:count]] + rng.uniform(-0.4, 0.4, (count, 2))
    size = FLEET.sample(rng, count)[:, :2]
    size *= FLEET.mean[:2] / size.mean(0) / UNIT  # without sampling error, so that only the method's error remains
    angle = rng.uniform(0, np.pi, count)
    axes = np.stack([np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)], 1)
    plan, heights = body(top=HEIGHT)
    flat = place[:, None] + (plan * size[:, None]) @ axes
    points = np.concatenate([flat, np.broadcast_to(heights[:, None] / UNIT, (count, len(plan), 1))], 2)
    ends = place[:, None] + np.array([-0.05, 0.05])[:, None] * axes[:, :1]
    return points @ turn.T, np.pad(ends, ((0, 0), (0, 0), (0, 1))) @ turn.T


def enclosing(points, heading, margin):
    """(5,) the box along `heading` (2,) around `points` (P, 2), larger by `margin`."""
    u = heading / np.linalg.norm(heading)
    axes = np.array([u, [-u[1], u[0]]])
    low, high = (points @ axes.T).min(0), (points @ axes.T).max(0)
    return [*((low + high) / 2 @ axes), *(high - low + margin), np.arctan2(u[1], u[0])]


def found_by(folder, turn, noise=0.3, seed=0):
    """Detections of a perfect detector whose boxes reach HEIGHT and exceed the vehicle by MARGIN."""
    rng = np.random.default_rng(seed)
    source = open_source(folder)
    bodies, ends = vehicles(turn)
    frames, plans = {}, {}
    for name in source.picture_names:
        boxes = []
        for whole, end in zip(bodies, ends, strict=True):
            points, heading = source.project(name, whole), source.project(name, end)
            if np.isfinite(points).all() and (points > 3).all() and (points < np.array([637, 477])).all():
                boxes.append(enclosing(points, heading[1] - heading[0], MARGIN + rng.normal(0, noise, 2)))
        frames[name] = Boxes(np.array(boxes), np.full(len(boxes), 0.9))
    for picture in source.ground_pictures:
        centre, up = source.centre(picture.image), turn[:, 2]
        boxes = []
        for whole, end in zip(bodies, ends, strict=True):
            drop = (centre @ up) / ((centre - whole) @ up)
            shadow = centre + (whole - centre) * drop[:, None]  # where the warp puts points above the ground
            points, heading = (
                (source.ground.plane(p) - picture.origin) @ picture.axes.T / picture.unit_per_pixel
                for p in (shadow, end)
            )
            if (points > 0).all() and (points < (picture.width, picture.height)).all():
                boxes.append(enclosing(points, heading[1] - heading[0], MARGIN + rng.normal(0, noise, 2)))
        plans[picture.name] = Boxes(np.array(boxes).reshape(-1, 5), np.full(len(boxes), 0.9))
    ruler = Ruler(margin=(MARGIN, MARGIN), margin_sd=(0.5, 0.5), noise=(noise, noise))
    plain = Detections(frames, 1.0, ruler, (HEIGHT, HEIGHT), "perfect")
    return replace(plain, planar=replace(plain, boxes=plans))
