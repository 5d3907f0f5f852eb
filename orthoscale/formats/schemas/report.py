"""Reports."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from ...core.scale import PER_PIXEL
from .values import Count, Finite, Metres, Name, Positive, Px, PxLength, Share, Sigma, Text, Weight


class ReportScale(Struct):
    """A scale of a report (`report.document`), with its interval."""

    scale: Positive
    interval90: tuple[Positive, Positive]


class ReportMode(ReportScale):
    """The scale by one way of measuring a reconstruction."""

    vehicles_used: Count


class ReportOfPictures(ReportScale):
    """The same with its unit and the sizes [px] of the pictures it was measured in, where the report has them."""

    unit: Name = PER_PIXEL
    pictures: dict[str, tuple[Count, Count]] = {}


class ReportRemark(Struct):
    """`core.remarks.Remark`."""

    severity: Literal["refusal", "caution", "support", "info"]
    text: Text


class ReportJudgement(Struct):
    """`core.remarks.Judgement`."""

    severity: Literal["refusal", "caution", "support", "info"]
    what: Text
    detail: Text


class ReportInput(Struct):
    """The input: its path, its kind, the hash of its content, and the folder from which relative paths, here and in
    `settings`, start."""

    path: Annotated[str, Meta(min_length=1, max_length=10_000)]
    sha256: Name
    folder: Annotated[str, Meta(max_length=10_000)]
    kind: Literal["orthophoto", "reconstruction"]


class ReportBox(Struct):
    """One box that showed a vehicle: centre, length, width [px], angle [rad]."""

    picture: Text
    xylwa_px: tuple[Px, Px, PxLength, PxLength, Finite]
    score: Share


class ReportVehicle(Struct):
    """A vehicle's size and place [m], and whether it was used or why not."""

    length: Finite
    width: Finite
    place_m: tuple[Finite, Finite]
    used: bool
    reason: Text
    boxes: list[ReportBox]


class ReportSize(Struct):
    """A fleet's mean size, the spread between vehicles, and the uncertainty of the mean, one sigma each [m]."""

    mean: Metres
    sd: Sigma
    mean_sd: Sigma


class ReportClass(Struct):
    """One class of the fleet: weight, mean and one sigma of length and width [m]."""

    name: Text
    weight: Weight
    mean: tuple[Metres, Metres]
    sd: tuple[Sigma, Sigma]


class ReportFleet(Struct):
    """The sizes [m] that a scale rests on."""

    length: ReportSize
    width: ReportSize
    classes: list[ReportClass]


class ReportEvidence(Struct):
    """A scale from other evidence than the vehicles, with its relative one sigma."""

    kind: Text
    scale: Positive
    relative_sd: Finite
    says: Text


class ReportAnchor(Struct):
    """An object of standard size that was found: its fitted lines in a picture [px], and the scale that it gives."""

    kind: Text
    standard: Text
    metres: Positive
    scale: Positive
    relative_sd: Finite
    counted: bool
    count: Count
    views: Count
    picture: Text
    lines_px: list[tuple[tuple[Px, Px], tuple[Px, Px]]]
    residual_cm: Finite


class Report(Struct):
    """A report; parts of only one kind of source, such as ``drift``, are not checked. The last four are only in reports
    of inputs that have them."""

    format: Literal["orthoscale report 2"]
    scale: Positive
    unit: Name
    uncertainty: Annotated[dict[str, Annotated[float, Meta(ge=0, le=1e3)]], Meta(min_length=1)]
    vehicles_used: Count
    fleet: Name
    verdict: Name
    remarks: list[ReportRemark]
    interval90: tuple[Positive, Positive]
    fit: Text
    judgements: list[ReportJudgement]
    vehicles_rejected: dict[str, Count]
    boxes_rejected: dict[str, Count]
    fleet_sizes: ReportFleet
    checks: dict[str, Finite]
    input: ReportInput
    settings: dict[str, Any]
    pictures: dict[str, tuple[Count, Count]]
    frame_bytes: dict[str, Count]
    frame_crc32: dict[str, Count]
    other_files: dict[str, tuple[Count, Count]]
    pixel_aspect: Positive
    seconds: Finite
    vehicles: list[ReportVehicle]
    evidence: list[ReportEvidence]
    anchors: list[ReportAnchor]
    fleets: dict[str, Finite]
    claim: dict[str, Any] | None
    drift: dict[str, Any] | None
    without_anchors: ReportScale | UnsetType = UNSET
    modes: dict[str, ReportMode] | UnsetType = UNSET
    calibration: dict[str, Any] | UnsetType = UNSET
    agreement: dict[str, Any] | UnsetType = UNSET
