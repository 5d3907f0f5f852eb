"""Every option that a user can give, defined once: its default, choices, help, and the options that it excludes.

A request is validated when it is created: an unknown option, or one that would have no effect, is an error and never
ignored.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import Field, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from .anchors.kinds import ALL, ANCHOR_KINDS, NO_KIND, PROVEN, slug
from .errors import UsageError
from .option import checked, file_named, flag, nearest, option, options_in

if TYPE_CHECKING:
    from typing import Self

    from .core.source import Source

MODES = ("both", "oblique", "planar")
PROJECTIONS = ("exact", "planar", "decoupled", "program", "naive")
ESTIMATORS = ("robust", "iqr")
EXTRAS = ("tfw", "scale", "gpkg", "geojson", "tiles")
REPORTS = ("none", "json", "html")
KINDS_OF_DEPTH = ("z", "range")
LOCATE_METHODS = ("auto", "dense", "gradient", "retrieval")
BUILT_IN, NOTHING = "built-in", "none"  # words that some options accept instead of a file
BOXED = ("parking-bays", "tennis-court", "basketball-court", "container", "bus")  # kinds of anchors that boxes can show
ANCHORS = (ALL, NO_KIND, PROVEN, *dict.fromkeys([*map(slug, ANCHOR_KINDS), *BOXED]))


def _json_file(text: str) -> str | None:
    return text if text.lower().endswith(".json") else None


def _fleet_file(text: str) -> str | None:
    """Of ``fleet.json:mini`` as well, a place where most vehicles are of one class."""
    return _json_file(text) or _json_file(text.rpartition(":")[0])


def _no_word(text: str) -> str | None:
    return None if text in (BUILT_IN, NOTHING) else text


def command_line(path: str, settings: Mapping[str, Any], folder: str = "") -> str:
    """The command line that repeats an estimate of `path` with the `settings` of its report that differ from the
    defaults. folder : the one that relative paths start from, entered with `cd` first; '' for none."""
    words = ["orthoscale", "estimate", path]
    for each in options_in(EstimateRequest):
        value = settings.get(each.name)
        if value is None or value == each.default:
            continue
        if isinstance(value, bool):
            words.append(flag(each))
        else:
            for one in value if isinstance(value, (list, tuple)) else [value]:
                words += [flag(each), str(one)]
    there = f"{shlex.join(['cd', folder])}\n" if folder else ""
    return there + shlex.join(words)


@dataclass(frozen=True, kw_only=True)
class VehicleRequest:
    """The options on the fleet and on where the boxes come from; common to all requests that measure vehicles."""

    fleet: str | Path | None = option(
        None,
        str,
        "Main",
        "Country of the vehicles, by code or name (US, DE, Japan ...), with a class where most are of one (DE:mini); "
        "'world' where it is not known; or a fleet.json. Default: the calibration's own, else the country where the "
        "input lies, else world.",
        file_in=_fleet_file,
    )
    detections: str | Path | None = option(
        None,
        Path,
        "Input",
        "Take boxes from this file (.json, .txt, .csv, .geojson, .gpkg) or folder; no detector runs.",
    )
    detector: str | Path | None = option(
        None, Path, "Detector", "Another detector (.onnx) instead of the built-in one."
    )
    decoder: str | None = option(
        None, str, "Detector", "Output form of --detector, if its file does not say.", metavar="NAME"
    )
    vehicle_classes: Sequence[str] = option(
        (),
        str,
        "Detector",
        "Class to measure, by name or number, instead of the usual names of small vehicles; repeatable.",
        flag="--vehicle-class",
        metavar="NAME",
    )
    calibration: str | Path | None = option(
        None, Path, "Detector", "The detector's ruler, measured by `orthoscale calibrate`."
    )
    zoom: float | None = option(
        None,
        float,
        "Detector",
        "Resampling factor, detector pixels per picture pixel, instead of the scale search.",
        positive=True,
    )
    gsd_hint: float | None = option(
        None, float, "Detector", "Rough GSD in m/px, instead of the scale search.", metavar="M", positive=True
    )

    def __post_init__(self) -> None:
        """Raises UsageError for values of the wrong kind and for options that exclude each other."""
        for each in options_in(self):
            object.__setattr__(self, each.name, checked(each, getattr(self, each.name)))
        if self.zoom is not None and self.gsd_hint is not None:
            raise UsageError("--zoom and --gsd-hint set the same thing twice", "Give one of them.")
        if self.detections is not None:
            self._refuse(self.of_detector, "--detections takes the boxes from a file: no detector runs")

    @property
    def inputs(self) -> list[Path]:
        """The files and folders that the options name, whether or not they exist."""
        found = []
        for each in options_in(self):
            value = getattr(self, each.name)
            for one in value if isinstance(value, tuple) else (value,):
                if (file := file_named(each, one)) is not None:
                    found.append(Path(file))
        return found

    def with_absolute_paths(self) -> Self:
        """The same with absolute paths, for a process in another folder."""

        def absolute(of: Field, value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(absolute(of, one) for one in value)
            return value if file_named(of, value) is None else str(Path(value).absolute())

        return replace(self, **{each.name: absolute(each, getattr(self, each.name)) for each in options_in(self)})

    @property
    def of_detector(self) -> Iterable[str]:
        """Names of the options of detection, which have no effect where no detector runs."""
        return ("detector", "decoder", "zoom", "gsd_hint")

    def _refuse(self, names: Iterable[str], why: str) -> None:
        """Raise UsageError if one of the options `names` is not at its default. why : the reason, for the message."""
        for each in options_in(self):
            if each.name in names and getattr(self, each.name) != each.default:
                raise UsageError(f"{flag(each)} does nothing here: {why}", f"Remove {flag(each)}.")

    @classmethod
    def of(cls, keywords: Mapping[str, Any]) -> Self:
        """The request with the options `keywords`. Raises UsageError; for a misspelt name it suggests the right one."""
        known = [each.name for each in options_in(cls)]
        for name in keywords:
            if name not in known:
                raise UsageError(f"no option is called {name!r}", nearest(name, known))
        return cls(**keywords)

    def refuse_others(self, names: Collection[str], why: str) -> None:
        """Raise UsageError if an option other than `names` is not at its default. why : the reason, for the message."""
        self._refuse([each.name for each in options_in(self) if each.name not in names], why)

    def without(self, names: Iterable[str], **other: Any) -> Self:
        """The same with the options `names` at their defaults, and the `other` options at the given values."""
        changed: dict[str, Any] = {each.name: each.default for each in options_in(self) if each.name in names}
        return replace(self, **changed | other)

    def settings(self) -> dict[str, Any]:
        """The options that are not at their defaults, as JSON values; the request can be repeated with them."""
        every = ((each, getattr(self, each.name)) for each in options_in(self))
        said = {each.name: value for each, value in every if value != each.default}
        return {name: str(value) if isinstance(value, Path) else value for name, value in said.items()}


@dataclass(frozen=True, kw_only=True)
class PhotoRequest(VehicleRequest):
    """The options for single photos: the altitude by vehicles, and by a depth network to compare with."""

    depth: str | Path | None = option(
        None,
        Path,
        "Evidence",
        "Metric depth to compare with: of one photo (.npy, .tif, .png), a folder of such files named as the photos "
        "are, or a network (.onnx).",
    )
    depth_kind: str = option(
        "z", str, "Evidence", "Depth along the optical axis (z) or along each ray (range).", choices=KINDS_OF_DEPTH
    )
    depth_factor: str | None = option(
        None,
        str,
        "Evidence",
        "Metres per unit of depth, or the network's name: da3 (Depth Anything 3 metric), metric3d, unidepth. Default: "
        "metres.",
        metavar="M|NAME",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.depth is None:
            self._refuse(("depth_kind", "depth_factor"), "there is no --depth")


@dataclass(frozen=True, kw_only=True)
class EstimateRequest(VehicleRequest):
    """The options of `estimate`; see the help of each field. Raises UsageError for values that make no sense."""

    images: str | Path | None = option(None, Path, "Input", "Folder with the model's frames.")
    ground_cloud: str | Path | None = option(
        None,
        str,
        "Input",
        "Dense cloud (.ply) or dense workspace of COLMAP, from which a model's ground is found, or 'none' for its "
        "sparse points alone. Default: one that lies beside the model.",
        file_in=_no_word,
        metavar="PLY|FOLDER",
    )
    refine: bool = option(
        False,
        bool,
        "Detector",
        "Detect every vehicle four more times and take the median box; for inputs with few vehicles.",
    )
    measurer: str | Path | None = option(
        None,
        str,
        "Detector",
        "Network that measures the found vehicles again: 'built-in', 'none' or an .onnx file. Default: "
        "built-in where the built-in detector finds them and there is no --calibration, else none.",
        file_in=_no_word,
        metavar="NAME",
    )
    fast: bool = option(
        False,
        bool,
        "Detector",
        "Make both detection passes over an orthophoto with the small detector. By default a larger network makes the "
        "second: fewer mistakes, half as much time again.",
    )
    mode: str | None = option(
        None,
        str,
        "Advanced",
        "Measure a model in its frames (oblique), in frames warped onto the ground (planar), or both (the default, "
        "where possible).",
        choices=MODES,
    )
    target: float = option(
        0.005,
        float,
        "Advanced",
        "Stop the sweep of an orthophoto at this sampling uncertainty (relative, 1 sigma).",
        positive=True,
    )
    exhaustive: bool = option(False, bool, "Advanced", "Sweep all of an orthophoto, or all frames of a model.")
    seed: int = option(0, int, "Advanced", "Seed of the order in which tiles are visited.", not_negative=True)
    workers: int | None = option(
        None, int, "Advanced", "Number of threads; by default one per core, at most 8.", positive=True
    )
    scheduler: str | None = option(
        None, str, "Advanced", "Detect on a Dask cluster, such as tcp://host:8786.", metavar="URL"
    )
    cache: bool = option(True, bool, "Advanced", "Do not read or write the cache of detections.", flag="--no-cache")
    projection: str | None = option(
        None,
        str,
        "Advanced",
        "How boxes in frames are projected onto the ground; exact by default, the others for comparison.",
        choices=PROJECTIONS,
    )
    estimator: str = option(
        "robust",
        str,
        "Advanced",
        "How vehicles give the scale; iqr is the paper's, for comparison.",
        choices=ESTIMATORS,
    )
    known_distance: Sequence[str] = option(
        (),
        str,
        "Evidence",
        "Two points, the metres between them and, if known, the sigma: '120,80 560,80 23.77'. A point is X,Y in an "
        "orthophoto; X,Y,Z, id:NUMBER or FRAME@X,Y in a model. Repeatable.",
        metavar="'A B M [SD]'",
    )
    ground_control: str | Path | None = option(
        None,
        Path,
        "Evidence",
        "Text file with lines POINT EAST NORTH [UP] in metres; points as for --known-distance. A model needs UP where "
        "the ground is not level; an orthophoto's distances are horizontal. Or, for a model, OpenDroneMap's "
        "gcp_list.txt.",
        metavar="FILE",
    )
    gps: bool = option(
        True,
        bool,
        "Evidence",
        "Ignore the GPS positions in the tags of a model's frames.",
        flag="--no-gps",
    )
    against: str | Path | None = option(
        None,
        Path,
        "Evidence",
        "Georeferenced map of another date that shows the same ground: its scale counts besides the vehicles', and an "
        "orthophoto takes its place and direction from it.",
        metavar="MAP",
    )
    anchors: Sequence[str] = option(
        (PROVEN,),
        str,
        "Evidence",
        "Objects of standard size to look for, besides the vehicles: all, none, or kinds of them; by default those "
        "whose false finds are known to be rare. Repeatable.",
        choices=ANCHORS,
        metavar="KIND",
    )
    anchor: Sequence[str] = option(
        (),
        str,
        "Evidence",
        "Your own standard for a kind of anchor: bay=2.5, in metres, or a JSON file of them. Repeatable.",
        file_in=_json_file,
        metavar="KIND=M",
    )
    alone: bool = True
    """No option: whether the request is for one input only, so that boxes of a single picture are for that input."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode == "planar":
            self._refuse(("projection", "refine"), "--mode planar measures no boxes in frames")
        if self.calibration is not None and self.measures is not None:
            raise UsageError(
                "--calibration is for a detector's boxes, but --measurer replaces these", "Give one of them."
            )
        if self.detector is not None or self.measures is None:
            self._refuse(("fast",), "only where both built-in networks are used does a larger one make the second pass")
        if self.exhaustive:
            self._refuse(("target",), "--exhaustive visits every tile")
        if self.vehicles_only:
            self._refuse(("anchors", "anchor", "against", "gps"), "--estimator iqr is the paper's, for vehicles only")
            if self.known_distance or self.ground_control is not None:
                raise UsageError(
                    "the estimator 'iqr' is the paper's, for vehicles only",
                    "Remove known distances and ground control, or use --estimator robust.",
                )
        if not self.anchors:
            object.__setattr__(self, "anchors", (NO_KIND,))  # as on the command line
        if NO_KIND in self.anchors:
            self._refuse(("anchor",), "--anchors none looks for none")
            if len(self.anchors) > 1:
                raise UsageError("--anchors none and kinds of anchors contradict each other", "Give one of them.")

    @property
    def measures(self) -> str | None:
        """BUILT_IN, or the file of the network that measures vehicles again; None for no such network."""
        if self.measurer is None:
            own = self.detections is None and self.detector is None and self.calibration is None
            return BUILT_IN if own else None
        return None if self.measurer == NOTHING else str(self.measurer)

    @property
    def wanted_mode(self) -> str | None:
        """The mode in which a model is measured, None for every mode that has enough evidence. A projection applies to
        frames, so `projection` without `mode` means that frames alone are measured."""
        return "oblique" if self.mode is None and self.projection is not None else self.mode

    @property
    def counts_gps(self) -> bool:
        """Whether GPS positions of frames enter the scale."""
        return self.gps and not self.vehicles_only

    @property
    def vehicles_only(self) -> bool:
        """Whether only vehicles enter the scale, as with the paper's estimator."""
        return self.estimator == "iqr"

    @property
    def needs_pictures(self) -> bool:
        """Whether pixels are needed: to detect the boxes, or to measure them again."""
        return self.detections is None or self.measures is not None

    @property
    def confirms(self) -> bool:
        """Whether the finder confirms vehicles in an orthophoto: where the built-in detector proposes them, and they
        are measured again, because the finder measures badly."""
        return self.measures is not None and self.detector is None and self.detections is None and not self.fast

    @property
    def of_detector(self) -> Iterable[str]:
        """Names of the options of detection, which have no effect on boxes from a file."""
        return (*super().of_detector, *OF_LOOKING)

    def check_for(self, source: Source) -> None:
        """Raise UsageError for an option that has no effect on this kind of source."""
        (self._for_plan if source.plan is not None else self._for_posed)(source.path)

    def check_for_many(self) -> None:
        """Raise UsageError for an option that makes sense for a single input only."""
        self._refuse(("known_distance", "ground_control"), "it is about one input, without a summary")

    def _for_plan(self, path: Path) -> None:
        self._refuse(("mode", "images", "ground_cloud", "gps"), f"it is for COLMAP models, and {path} is an image")
        if self.projection not in (None, "planar"):
            raise UsageError(
                f"--projection {self.projection} needs a camera; an orthophoto has none", "Remove --projection."
            )

    def _for_posed(self, path: Path) -> None:
        self._refuse(("target",), f"frames are looked at until they repeat the ground, and {path} is a model")
        self._refuse(("fast",), f"it is for orthophotos, and {path} is a model")
        if self.wanted_mode == "oblique":
            self._refuse(("measurer",), f"by --projection the frames of {path} are measured, and nothing from above")


OF_LOOKING = ("refine", "fast", "target", "exhaustive", "seed", "workers", "scheduler", "cache")


@dataclass(frozen=True, kw_only=True)
class FixRequest(EstimateRequest):
    """The options of `fix`: those of `estimate`, and what to write."""

    overwrite: bool = option(False, bool, "Output", "Replace what orthoscale wrote at --out before.")
    override: bool = option(False, bool, "Output", "Rescale although INPUT claims to be in metres.")
    keep_origin: bool = option(False, bool, "Output", "Keep the CRS, upper left corner and rotation of an orthophoto.")
    cog: bool = option(False, bool, "Output", "Write a cloud-optimised GeoTIFF.")
    also: Sequence[str] = option(
        (),
        str,
        "Output",
        "Write more files beside OUT: world file, scale as text, vehicles (GeoPackage, GeoJSON), statistics per tile; "
        "repeatable.",
        choices=EXTRAS,
    )
    force: bool = option(
        False, bool, "Output", "Write although the scale is unusable: too uncertain, or contradicted by evidence."
    )
    dense: bool = option(False, bool, "Output", "Scale the model's dense workspace too: depth maps, cloud, meshes.")
    report: str = option(
        "html", str, "Output", "html: page, picture and JSON; json: without the page.", choices=REPORTS
    )

    def _for_plan(self, path: Path) -> None:
        super()._for_plan(path)
        self._refuse(("dense",), f"it is for COLMAP models, and {path} is an image")
        if self.against is not None:
            self._refuse(("keep_origin",), "--against gives the orthophoto its place")

    def _for_posed(self, path: Path) -> None:
        super()._for_posed(path)
        self._refuse(("keep_origin", "cog", "also"), f"it is for orthophotos, and {path} is a model")

    def estimating(self) -> EstimateRequest:
        """The part of the request that says how to measure."""
        return EstimateRequest(**{each.name: getattr(self, each.name) for each in fields(EstimateRequest)})


class VehicleOptions(TypedDict, total=False):
    """The fields of `VehicleRequest` as keywords, for type checkers and editors."""

    fleet: str | Path | None
    detections: str | Path | None
    detector: str | Path | None
    decoder: str | None
    vehicle_classes: Sequence[str]
    calibration: str | Path | None
    zoom: float | None
    gsd_hint: float | None


class PhotoOptions(VehicleOptions, total=False):
    """The fields of `PhotoRequest` as keywords."""

    depth: str | Path | None
    depth_kind: str
    depth_factor: str | None


class EstimateOptions(VehicleOptions, total=False):
    """The fields of `EstimateRequest` as keywords."""

    images: str | Path | None
    ground_cloud: str | Path | None
    refine: bool
    measurer: str | Path | None
    fast: bool
    mode: str | None
    target: float
    exhaustive: bool
    seed: int
    workers: int | None
    scheduler: str | None
    cache: bool
    projection: str | None
    estimator: str
    known_distance: Sequence[str]
    ground_control: str | Path | None
    gps: bool
    against: str | Path | None
    anchors: Sequence[str]
    anchor: Sequence[str]


class FixOptions(EstimateOptions, total=False):
    """The fields of `FixRequest` as keywords."""

    overwrite: bool
    override: bool
    keep_origin: bool
    cog: bool
    also: Sequence[str]
    force: bool
    dense: bool
    report: str
