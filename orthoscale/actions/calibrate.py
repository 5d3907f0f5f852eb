"""Calibrates a detector on an orthophoto of known scale, by detecting the same vehicles at three resampling factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..core.boxes import SAME_VEHICLE, Boxes, matched
from ..core.calibration import Calibration, MarginFit, fit_margin, local_fleet_entry
from ..core.detections import UNKNOWN_RULER
from ..core.fleet import Fleet
from ..core.normal import robust_sd
from ..core.pooling.robust import pool
from ..core.progress import Progress, of_step
from ..core.projection.planar import ground_size
from ..core.ruler import Ruler
from ..core.scale import PER_PIXEL, Scale
from ..core.source import Plan
from ..core.votes import Sightings, gather
from ..detect.detector import Detector
from ..detect.tiles import one_pass
from ..detect.zoom import check_zoom
from ..errors import InputError, TooLittleEvidence, UsageError
from ..fleets import load_fleet
from ..option import listed, positive
from ..system.paths import path_of

LOOKS = np.sqrt(2.0) ** np.array([-1, 0, 1])  # zooms relative to the detector's best; a vehicle must be found at all
FEWEST_VEHICLES = 20  # vehicles; a mean length is then known to 2 %
NO_PRIOR = (6.0, 4.0)  # one sigma about zero of the margin (length, width) of a detector without a card [detector px]
MEDIAN_OF = 10_000  # sampled vehicles, which give a fleet's median to 0.1 %
SMALLEST_PX = 1.0  # smallest size of a box after its margin is subtracted [detector px]
# Ratio of the vehicles' mean size to the fleet's from which the given scale must be wrong: the means of the 112 shipped
# fleets are 0.88 to 1.28 times the world's.
WRONG_SCALE = 1.4
DOUBTED = 2.0  # sigmas between those sizes from which it is said: chance makes as much in one calibration of 20
DISAGREEMENT = 0.02  # relative difference between --gsd and the georeferencing that is worth a note


def calibrate(
    path: str | Path,
    *,
    gsd: float | None = None,
    fleet: str | Path = "world",
    detector: str | Path | None = None,
    decoder: str | None = None,
    vehicle_classes: Sequence[str] = (),
    local_fleet: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Measure a detector's ruler on the orthophoto at `path`, whose scale is known.

    gsd : metres per pixel; by default from its georeferencing. fleet : of the country; the better it is known, the
    better the ruler. local_fleet : also fit a fleet to the vehicles in this picture. The other options are those of
    `orthoscale.estimate`. Raises InputError, UsageError, TooLittleEvidence.
    """
    path = path_of(path, "the path of an orthophoto")
    detector = None if detector is None else path_of(detector, "the path of a network (.onnx)")
    gsd = None if gsd is None else positive("--gsd", gsd)
    raster = _orthophoto(path)
    gsd, notes = _known_gsd(raster, gsd)
    prior = load_fleet(fleet)
    network = Detector(detector, decoder, listed("--vehicle-class", vehicle_classes))
    zooms = LOOKS * network.card.best_length * gsd / float(prior.mean[0])
    check_zoom(float(zooms.max()), network.card)
    looks = _looks(raster, zooms, network, progress)
    ruler, fits, sizes, doubts = measure_ruler(looks, zooms, gsd, prior, network.card.ruler)
    entry = None
    if local_fleet:
        relative_sd = np.array([fit.size_sd / fit.size for fit in fits])
        noise = np.asarray(ruler.noise) * gsd / zooms[len(zooms) // 2]
        name = f"{len(sizes)} vehicles of {path.name}"
        source = f"orthoscale calibrate, {len(sizes)} vehicles, {prior.code}"
        entry = local_fleet_entry(sizes, noise, relative_sd, prior, name, source)
    made_from = {
        "orthophoto": path.name,
        "sha256": raster.content_hash(),
        "gsd_m": gsd,
        "fleet": prior.code,
        "vehicles": len(sizes),
        "zooms": [round(float(z), 4) for z in zooms],
        "size_m": [round(fit.size, 3) for fit in fits],
        "size_sd_m": [round(fit.size_sd, 3) for fit in fits],
        "notes": notes + doubts,
    }
    return Calibration(network.card.name, network.sha256, ruler, entry, made_from)


def _orthophoto(path: Path) -> Plan:
    """The orthophoto at `path`. Raises InputError; UsageError for a reconstruction, or pixels that are not square."""
    from ..sources.opening import open_source

    plan = open_source(path, need_images=False).plan
    if plan is None:
        raise UsageError(
            f"{path} is a reconstruction", "Calibrate on an orthophoto; models calibrate themselves on their own views."
        )
    if plan.claimed.aspect != 1:
        raise UsageError(
            f"{path}: pixels are {plan.claimed.aspect:.3g} times as wide as high on the ground",
            "Warp it first: gdalwarp -t_srs EPSG:CODE, the code of its UTM zone.",
        )
    return plan


def _looks(plan: Plan, zooms: np.ndarray, network: Detector, progress: Progress | None) -> list[Boxes]:
    """The same vehicles at each resampling factor of `zooms`, in the same order. Raises TooLittleEvidence."""
    steps = [of_step(progress, f"Detection pass {k} of {len(zooms)}") for k in range(1, len(zooms) + 1)]
    looks = same_vehicles([one_pass([plan], z, network, s)[plan.name] for z, s in zip(zooms, steps, strict=True)])
    if len(looks[0]) < FEWEST_VEHICLES:
        raise TooLittleEvidence(
            f"{plan.path}: {len(looks[0])} vehicles detected at all three resampling factors, "
            f"{FEWEST_VEHICLES} are needed for a calibration",
            "Give an orthophoto with more vehicles, and check its scale (--gsd).",
        )
    return looks


def _known_gsd(source: Plan, gsd: float | None) -> tuple[float, list[str]]:
    claimed = source.claimed.gsd_m if source.claimed.usable else None
    if gsd is None and claimed is None:
        raise UsageError(
            f"{source.path}: its scale is not known ({source.claimed.why})", "Give it: --gsd METRES_PER_PIXEL."
        )
    if gsd is None:
        assert claimed is not None
        return claimed, [f"scale {source.claimed.why}"]
    if claimed is not None and abs(gsd / claimed - 1) > DISAGREEMENT:
        return gsd, [f"--gsd {gsd:g} was used; the georeferencing says {claimed:.4g} m/px"]
    return gsd, []


def same_vehicles(looks: Sequence[Boxes]) -> list[Boxes]:
    """The boxes of the vehicles that were found in all looks; equal rows are the same vehicle."""
    rows = [np.arange(len(looks[0]))]
    for before, here in pairwise(looks):
        i, j, _ = matched(before[rows[-1]], here, SAME_VEHICLE)
        rows = [*(r[i] for r in rows), j]
    return [look[r] for look, r in zip(looks, rows, strict=True)]


def measure_ruler(
    looks: Sequence[Boxes], zooms: np.ndarray, gsd: float, fleet: Fleet, ruler: Ruler
) -> tuple[Ruler, tuple[MarginFit, MarginFit], np.ndarray, list[str]]:
    """The ruler fitted to boxes of the same vehicles at several resampling factors, with the detector's own `ruler` as
    the prior.

    looks : boxes of the same vehicles [px of the picture] at `zooms` (K,) [detector px per picture px]. Returns the
    ruler, the fits of length and width, the vehicles' sizes (N, 2) [m] by that ruler, and doubts about the given scale.
    Raises InputError if the sizes cannot be of that scale.
    """
    middle = len(looks) // 2
    pooled = _pooled(looks[middle], zooms[middle], fleet, ruler)
    looks = [look[pooled.used] for look in looks]
    # The vehicles' mean sizes [m] by the boxes of each zoom, less the detector's own margin.
    seen = np.array(
        [_mean_size(_sizes(look, gsd, 1 / zoom, ruler), fleet) for look, zoom in zip(looks, zooms, strict=True)]
    )
    ratio = seen[middle] / fleet.mean[:2]
    if np.abs(np.log(ratio)).max() > np.log(WRONG_SCALE):
        raise InputError(
            f"at {gsd:g} m/px these vehicles would be {seen[middle, 0]:.2f} x {seen[middle, 1]:.2f} m on average",
            "Check --gsd; a preview that was made smaller than its original has larger pixels.",
        )
    pixel = gsd / zooms
    bias_sd = np.asarray(ruler.bias_sd) * seen
    # These vehicles' mean differs from the fleet's, and all their boxes may be too large by a common factor.
    stray = np.diag(fleet.log_mean_covariance) + pooled.parts["sampling"] ** 2 + ruler.common_sd**2
    fleet_sd = np.sqrt(stray) * fleet.mean[:2]
    margin_sd = np.array(NO_PRIOR if ruler == UNKNOWN_RULER else ruler.margin_sd)
    # By how many sigmas length and width differ from the fleet's, as the given scale makes both.
    sigmas = np.log(ratio) / np.hypot(stray**0.5, margin_sd * pixel[middle] / seen[middle])
    doubts = _doubts(gsd, ratio, float(sigmas.mean()), fleet)
    fits = [
        fit_margin(
            seen[:, axis] + ruler.margin[axis] * pixel,
            pixel,
            bias_sd[:, axis],
            (float(fleet.mean[axis]), float(fleet_sd[axis])),
            (ruler.margin[axis], margin_sd[axis]),
        )
        for axis in (0, 1)
    ]
    # The fit treats `bias_sd` as independent between zooms, and `common_sd` as part of the vehicles' sizes. In fact all
    # boxes of one scene share both.
    shared = np.hypot(ruler.bias_sd, ruler.common_sd)
    length, width = (
        replace(fit, size_sd=float(np.hypot(fit.size_sd, fit.size * sd))) for fit, sd in zip(fits, shared, strict=True)
    )
    new = replace(
        ruler,
        margin=(length.margin, width.margin),
        margin_sd=(length.margin_sd, width.margin_sd),
        noise=box_noise(looks, zooms),
    )
    return new, (length, width), _sizes(looks[middle], gsd, 1 / zooms[middle], new), doubts


def _doubts(gsd: float, ratio: np.ndarray, sigmas: float, fleet: Fleet) -> list[str]:
    """What to say where the vehicles are `ratio` (2,) times as long and wide as those of `fleet`, off by `sigmas`."""
    if abs(sigmas) < DOUBTED:
        return []
    length, width = (f"{100 * (each - 1):+.0f} %" for each in ratio)
    return [
        f"at {gsd:.4g} m/px these vehicles differ from those of fleet {fleet.code} by {length} in length and {width} "
        f"in width ({abs(sigmas):.1f} sigma): check the scale (--gsd), by which the ruler is wrong too, and the fleet"
    ]


def _sizes(boxes: Boxes, gsd: float, pixel: float, ruler: Ruler) -> np.ndarray:
    """(N, 2) lengths and widths [m] of vehicles, less the margin; a detector pixel is `pixel` pixels of the picture."""
    return np.maximum(ground_size(boxes) - pixel * np.asarray(ruler.margin), SMALLEST_PX * pixel) * gsd


def _mean_size(size: np.ndarray, fleet: Fleet) -> np.ndarray:
    """(2,) mean length and width of `fleet`, rescaled to have the median of `size` (N, 2), which a few larger vehicles
    do not move. The scale is known here, so that another mix of classes must not explain the sizes."""
    usual = np.median(fleet.sample(np.random.default_rng(0), MEDIAN_OF)[:, :2], axis=0)
    return fleet.mean[:2] * np.median(size, axis=0) / usual


def _pooled(boxes: Boxes, zoom: float, fleet: Fleet, ruler: Ruler) -> Scale:
    seen = Sightings(ground_size(boxes), np.full(len(boxes), 1 / zoom), boxes.centre, boxes.score)
    return pool(gather(seen, repeated=False), fleet, ruler, PER_PIXEL)


def box_noise(looks: Sequence[Boxes], zooms: np.ndarray) -> tuple[float, float]:
    """The noise of one box in length and width [detector px], from the differences between neighbouring looks at the
    same vehicles."""
    noise = []
    for (a, za), (b, zb) in pairwise(zip(looks, zooms, strict=True)):
        ratio = np.log(b.sides / a.sides)
        # Two boxes differ by both their noises, each a share of its own size in pixels.
        size = np.median(a.sides, axis=0)
        noise.append(robust_sd(ratio) * size / np.hypot(1 / za, 1 / zb))
    length, width = np.mean(noise, axis=0)
    return float(length), float(width)
