"""The input and output formats of network files, recognised from their metadata and the shapes of their outputs.

| decoder | outputs | made by |
|---|---|---|
| orthoscale | [n, 7, h/4, w/4] | `training/` |
| ultralytics | [1, 4 + classes + 1, n], angle last | YOLOv8-obb, YOLO11-obb |
| ultralytics-nms-free | [1, n, 7] | YOLO26-obb, or exported with ``nms=True`` |
| mmrotate | dets [1, n, 6], labels [1, n] | MMRotate through MMDeploy, Oriented R-CNN and most others |
| rtmdet | the same | RTMDet-R, whose input is BGR |
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..core.boxes import Boxes
from ..errors import InputError, UsageError, shown
from ..formats.detections.classes import DOTA, object_numbers, vehicle_numbers
from ..formats.reading import checked, read
from .decoders import decode_maps, decode_mmrotate, decode_ultralytics, decode_ultralytics_nms_free
from .foreign import IMAGE_ALONE

LARGEST_STRIDE = 1024  # [px] real networks have powers of two from 8 to 128
DECODERS = ("orthoscale", "ultralytics", "ultralytics-nms-free", "mmrotate", "rtmdet")


Shape = tuple[int | None, ...]  # None where the file leaves a size open


@dataclass(frozen=True)
class Normalisation:
    """From pixels 0..255 to a network's input: ``(pixel - mean) / std``, channel by channel in the order `channels`."""

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (255.0, 255.0, 255.0)
    channels: str = "RGB"


# MMDetection's preprocessing: for ImageNet-trained backbones, and for RTMDet (configs/rtmdet of MMRotate 1.x).
IMAGENET = Normalisation((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
RTMDET = Normalisation((103.53, 116.28, 123.675), (57.375, 57.12, 58.395), "BGR")


@dataclass(frozen=True)
class NetworkForm:
    """How to feed a network and how to read it.

    multiple : height and width of its input must be multiples of this [px]. size : (height, width) [px] if the file
    fixes them. decode : (outputs, class numbers, least score) to the boxes of these classes [px of its input].
    vehicles : numbers of the vehicle classes. objects : class numbers of objects of standard size, by kind. assumed :
    what the file does not say and was assumed, in words for the user.
    """

    decoder: str
    normalisation: Normalisation
    multiple: int
    size: tuple[int, int] | None
    decode: Callable[[Sequence[np.ndarray], Sequence[int], float], Boxes] = field(repr=False)  # the same in any process
    vehicles: tuple[int, ...] = ()
    assumed: str = ""
    objects: Mapping[str, Sequence[int]] = field(default_factory=dict)


def recognise(
    path: Path,
    metadata: Mapping[str, str],
    input_shape: Shape,
    outputs: Mapping[str, Shape],
    decoder: str | None = None,
    vehicle_classes: Sequence[str] = (),
) -> NetworkForm:
    """The form of the network in `path`. decoder : one of DECODERS; None to recognise it.

    metadata : of the ONNX file. input_shape : of its image. outputs : shape by name. vehicle_classes : names or
    numbers of the classes that count, instead of those whose names mean small vehicles.
    Raises InputError for a network that is none of those above, UsageError for a wrong or missing choice of the user.
    """
    task = metadata.get("task", "obb")
    if task != "obb":
        raise InputError(
            f"{path}: an Ultralytics network for {task!r}, whose boxes have no direction",
            "Give one trained for oriented boxes (task obb).",
        )
    found = decoder or _decoder(outputs, metadata)
    if found is None:
        raise InputError(
            f"{path}: outputs {_words(outputs)} are not those of any known detector of oriented boxes",
            f"Name its decoder by --decoder ({', '.join(DECODERS)}).",
        )
    if found not in DECODERS:
        raise UsageError(f"no decoder is called {found!r}", f"Known decoders: {', '.join(DECODERS)}.")
    if not _fits(found, outputs):
        raise InputError(
            f"{path}: outputs {_words(outputs)} are not those that the decoder {found!r} reads",
            "See docs/detectors.md for what each decoder expects, or remove --decoder.",
        )
    if len(input_shape) != 4 or input_shape[1] not in (3, None) or input_shape[0] not in (1, None):
        raise InputError(f"{path}: its input has shape {list(input_shape)}, not [1, 3, height, width]", IMAGE_ALONE)
    size = _fixed(input_shape)
    if found == "orthoscale":
        return NetworkForm(found, Normalisation(), 32, size, lambda arrays, _, score: decode_maps(arrays[0][0], score))
    if found.startswith("ultralytics"):
        return _ultralytics(path, found, metadata, outputs, size, vehicle_classes)
    return _mmrotate(path, found, outputs, size, vehicle_classes, named=decoder is not None)


def _decoder(outputs: Mapping[str, Shape], metadata: Mapping[str, str]) -> str | None:
    for name in ("mmrotate", "orthoscale"):
        if _fits(name, outputs):
            return name
    free, raw = (_fits(name, outputs) for name in ("ultralytics-nms-free", "ultralytics"))
    if free and raw:  # [1, 7, 7], or sizes that the file leaves open: the metadata must decide
        names = _names(metadata)
        if metadata.get("end2end") == "True" or "'nms': True" in metadata.get("args", ""):
            raw = False
        elif names is None:
            return None
        else:
            (shape,) = outputs.values()
            free = shape[1] not in (None, len(names) + 5)
    return "ultralytics-nms-free" if free else "ultralytics" if raw else None


def _fits(decoder: str, outputs: Mapping[str, Shape]) -> bool:
    """Whether outputs of these shapes can be those of `decoder`."""
    shapes = list(outputs.values())
    if decoder in ("mmrotate", "rtmdet"):
        return (
            set(outputs) == {"dets", "labels"}
            and len(outputs["dets"]) == 3
            and outputs["dets"][2] in (6, None)
            and len(outputs["labels"]) == 2
        )
    if len(shapes) != 1:
        return False
    (shape,) = shapes
    if decoder == "orthoscale":
        return len(shape) == 4 and shape[1] == 7
    if len(shape) != 3:
        return False
    if decoder == "ultralytics-nms-free":
        return shape[2] in (7, None)
    return shape[1] is None or (shape[1] >= 6 and not (shape[2] == 7 and shape[1] > 7))


def _ultralytics(
    path: Path,
    decoder: str,
    metadata: Mapping[str, str],
    outputs: Mapping[str, Shape],
    size: tuple[int, int] | None,
    wanted: Sequence[str],
) -> NetworkForm:
    names = _names(metadata)
    (shape,) = outputs.values()
    count = shape[1] - 5 if decoder == "ultralytics" and shape[1] else None
    if names is None and not wanted:
        of = "" if count is None else f", 0 to {count - 1}" if count > 1 else ", 0"
        hint = f"Give the class of small vehicles by number{of}: --vehicle-class NUMBER; of the 15 in DOTA it is 10."
        if "names" in metadata:
            raise InputError(f"{path}: the names of its classes cannot be read", hint)
        raise UsageError(f"{path}: it has no names of its classes", hint)
    if names is None:
        names = [str(k) for k in range(count or 1000)]
    elif decoder == "ultralytics" and shape[1] not in (None, len(names) + 5):
        raise InputError(
            f"{path}: {len(names)} class names, but outputs {_words(outputs)} hold {(shape[1] or 5) - 5} classes",
            "The file contradicts itself: export it again.",
        )
    vehicles = _vehicles(path, names, wanted)
    told = metadata.get("stride", "32")
    stride = int(told) if re.fullmatch(r"0*[0-9]{1,4}", told) else 0
    if not 1 <= stride <= LARGEST_STRIDE:
        raise InputError(
            f"{path}: its stride is {shown(told)!r}, not a whole number from 1 to {LARGEST_STRIDE}", "Export it again."
        )

    def decode(arrays: Sequence[np.ndarray], classes: Sequence[int], score: float) -> Boxes:
        read = decode_ultralytics if decoder == "ultralytics" else decode_ultralytics_nms_free
        return read(arrays[0][0].astype(np.float64), classes, score)

    objects = _others(names, vehicles)
    return NetworkForm(decoder, Normalisation(), stride, size, decode, tuple(vehicles), objects=objects)


def _mmrotate(
    path: Path,
    decoder: str,
    outputs: Mapping[str, Shape],
    size: tuple[int, int] | None,
    wanted: Sequence[str],
    named: bool,
) -> NetworkForm:
    numbers = [int(w) for w in wanted if w.isdigit()]
    assumed = [] if numbers else ["class numbers as in DOTA v1.0"]
    names = list(DOTA) + [str(k) for k in range(len(DOTA), max(numbers, default=0) + 1)]
    vehicles = _vehicles(path, names, wanted)
    normalisation = _pipeline_normalisation(path)
    if normalisation is None:
        normalisation = RTMDET if decoder == "rtmdet" else IMAGENET
        if not named:
            assumed.append("ImageNet's normalisation (for RTMDet-R say --decoder rtmdet)")
    dets, labels = list(outputs).index("dets"), list(outputs).index("labels")

    def decode(arrays: Sequence[np.ndarray], classes: Sequence[int], score: float) -> Boxes:
        return decode_mmrotate(arrays[dets][0].astype(np.float64), arrays[labels][0], classes, score)

    # If the user gives class numbers, the classes need not be DOTA's.
    objects = {} if numbers else _others(names, vehicles)
    return NetworkForm(decoder, normalisation, 32, size, decode, tuple(vehicles), "; ".join(assumed), objects)


def _vehicles(path: Path, names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    vehicles = vehicle_numbers(names, wanted)
    if not vehicles:
        listed = ", ".join(names[:20]) + (" ..." if len(names) > 20 else "")
        what = f"no class called {' or '.join(wanted)}" if wanted else "no class whose name means small vehicles"
        raise InputError(f"{path}: {what} among {listed}", "Name the right one by --vehicle-class.")
    return vehicles


def _others(names: Sequence[str], vehicles: Sequence[int]) -> dict[str, list[int]]:
    """Class numbers of objects of standard size, by kind, without classes that the user declared to be vehicles."""
    return {kind: n for kind, n in object_numbers(names).items() if not set(n) & set(vehicles)}


def _names(metadata: Mapping[str, str]) -> list[str] | None:
    """Class names as Ultralytics writes them, a Python dictionary of number to name; None if missing or unreadable."""
    try:
        table = ast.literal_eval(metadata["names"])
        return [str(table[k]) for k in range(len(table))]
    except (KeyError, ValueError, SyntaxError, TypeError, RecursionError, MemoryError):  # the last two: nested deeply
        return None


def _pipeline_normalisation(path: Path) -> Normalisation | None:
    """The normalisation in MMDeploy's ``pipeline.json`` (``--dump-info``) beside the network; None without one.

    Raises InputError for a file that cannot be understood.
    """
    from ..formats.schemas.networks import NormalisationEntry, Pipeline

    file = path.with_name("pipeline.json")
    if not file.exists():
        return None
    what, hint = "a pipeline of MMDeploy's that can be read", "Repair it, or move it away."
    tasks = read(file, Pipeline, what, hint).pipeline.tasks
    step = next((step for task in tasks for step in task.transforms if step.get("type") == "Normalize"), None)
    if step is None:
        return None
    how = checked(step, NormalisationEntry, str(file), what, hint)
    return Normalisation(how.mean, how.std, "RGB" if step.get("to_rgb", True) else "BGR")


def _fixed(shape: Shape) -> tuple[int, int] | None:
    height, width = shape[2:]
    return (height, width) if height and width else None


def _words(outputs: Mapping[str, Shape]) -> str:
    return ", ".join(f"{name} {['?' if n is None else n for n in shape]}" for name, shape in outputs.items())
