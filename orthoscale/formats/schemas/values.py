"""Numbers, names and lengths that several schemas share, with the ranges in which they are plausible."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

Finite = Annotated[float, Meta(ge=-1e15, le=1e15)]
Positive = Annotated[float, Meta(gt=0, le=1e15)]
Share = Annotated[float, Meta(ge=0, le=1)]
Threshold = Annotated[float, Meta(gt=0, lt=1)]  # of a confidence score, with finite log odds
Weight = Annotated[float, Meta(ge=0, le=1e6)]
Count = Annotated[int, Meta(ge=0, le=10**12)]
Text = Annotated[str, Meta(max_length=10_000)]
Name = Annotated[str, Meta(max_length=1_000)]
Metres = Annotated[float, Meta(ge=0.3, le=50)]  # size of a vehicle: from a bicycle's width to a road train's length
Sigma = Annotated[float, Meta(gt=0, le=25)]  # [m] one sigma of such a size
Px = Annotated[float, Meta(ge=-1e7, le=1e7)]  # a place in a picture
PxLength = Annotated[float, Meta(gt=0, le=1e7)]
PxOfDetector = Annotated[float, Meta(ge=-50, le=50)]  # of a margin
PxSd = Annotated[float, Meta(ge=0, le=100)]
Size = Annotated[int, Meta(gt=0, lt=2**20)]  # width or height of a picture
