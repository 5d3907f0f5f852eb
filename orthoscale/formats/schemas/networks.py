"""The metadata of networks: cards, with their rulers, and MMDeploy's ``pipeline.json``."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType, structs

from ...core.boxes import KINDS
from ...core.projection.exact import BODIES
from ...core.ruler import Ruler
from .values import Finite, Metres, Name, Positive, PxOfDetector, PxSd, Share, Text, Threshold

Shrink = Annotated[float, Meta(ge=-1, lt=1)]  # at 1 all boxes have one size: nothing could be measured
Height = Annotated[float, Meta(ge=0, le=20)]  # [m] effective height, or undercut
InputPx = Annotated[float, Meta(gt=0, le=10_000)]  # length of a vehicle in a network's input


class RulerEntry(Struct, forbid_unknown_fields=True):
    """`core.ruler.Ruler`."""

    margin: tuple[PxOfDetector, PxOfDetector] = Ruler.margin
    margin_sd: tuple[PxSd, PxSd] = Ruler.margin_sd
    bias_sd: tuple[Share, Share] = Ruler.bias_sd
    common_sd: Share = Ruler.common_sd
    noise: tuple[PxSd, PxSd] = Ruler.noise
    shrink: tuple[Shrink, Shrink] = Ruler.shrink
    shrink_sd: tuple[Share, Share] = Ruler.shrink_sd
    usual: tuple[Metres, Metres] = Ruler.usual
    kinds: tuple[tuple[Share, Share, Share, Share], ...] = Ruler.kinds
    kinds_vehicles: Annotated[float, Meta(ge=0.1, le=1e6)] = Ruler.kinds_vehicles

    def __post_init__(self) -> None:
        rows = len(KINDS)
        if self.kinds and (len(self.kinds) != rows or any(abs(sum(row) - 1) > 0.02 for row in self.kinds)):
            raise ValueError(f"kinds: expected {rows} rows, the sum of each 1")

    @property
    def ruler(self) -> Ruler:
        """The ruler as a class of the core."""
        return Ruler(**structs.asdict(self))


def check_body(name: str) -> None:
    """Raise ValueError if `name` is none of `core.projection.exact.BODIES`."""
    if name not in BODIES:
        raise ValueError(f"body: expected one of {', '.join(BODIES)}")


class NormalisationEntry(Struct):
    """`detect.output_forms.Normalisation`."""

    mean: tuple[Finite, Finite, Finite]
    std: tuple[Positive, Positive, Positive]
    channels: Literal["RGB", "BGR"] = "RGB"


class CardEntry(Struct, forbid_unknown_fields=True):
    """`detect.detector.Card`."""

    name: Name
    usable_length: tuple[InputPx, InputPx]
    best_length: InputPx
    score: Threshold
    effective_height: tuple[Height, Height]
    ruler: RulerEntry
    undercut: tuple[Height, Height] = (0.0, 0.0)
    training: Text = ""
    licence: Text = ""
    sure: Share = 0.0
    stride: Annotated[int, Meta(ge=1, le=1024)] = 32
    body: Name = "car"
    normalisation: NormalisationEntry | UnsetType = UNSET
    extra: dict[str, Any] = {}  # what its makers note besides; nothing here reads it

    def __post_init__(self) -> None:
        check_body(self.body)
        if not self.usable_length[0] < self.usable_length[1]:
            raise ValueError("usable_length: expected the shorter of two lengths first")


class EmbeddingCardEntry(Struct, forbid_unknown_fields=True):
    """`locate.retrieval.EmbeddingCard`."""

    name: Name = ""
    size: Annotated[int, Meta(ge=16, le=4096)] | None = None
    normalisation: NormalisationEntry | UnsetType = UNSET
    licence: Text = ""
    extra: dict[str, Any] = {}  # what its makers note besides; nothing here reads it


class MeasurerCardEntry(Struct, forbid_unknown_fields=True):
    """`detect.measurer.MeasurerCard`."""

    name: Name
    ruler: RulerEntry
    sigma_times: tuple[Annotated[float, Meta(gt=0, le=100)], Annotated[float, Meta(gt=0, le=100)]]
    effective_height: tuple[Height, Height]
    undercut: tuple[Height, Height] = (0.0, 0.0)
    body: Name = "car"
    inward: Annotated[float, Meta(ge=0, le=100)] = 0.0
    sure: tuple[Annotated[float, Meta(ge=0, le=1)], Annotated[float, Meta(ge=0, le=100)]] = (0.0, 0.0)
    training: Text = ""
    licence: Text = ""

    def __post_init__(self) -> None:
        check_body(self.body)


class Task(Struct):
    """One task of MMDeploy's pipeline; the normalisation is among its transforms."""

    transforms: list[dict[str, Any]] = []


class Tasks(Struct):
    """The tasks of a pipeline, in order."""

    tasks: list[Task]


class Pipeline(Struct):
    """MMDeploy's ``pipeline.json``."""

    pipeline: Tasks
