"""What the pipeline needs of a source, whatever it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from .picture import Picture


class Pictures(Protocol):
    """Something with pictures.

    unit : what a scale of it is measured in, "m/px", "m/model-unit" ... notes : what its user should know.
    """

    @property
    def path(self) -> Path:
        """What was opened, as it was given."""
        ...

    @property
    def unit(self) -> str:
        """What the scale turns into metres: ``m/px`` or ``m/model-unit``."""
        ...

    @property
    def notes(self) -> list[str]:
        """What a user should know of it, a sentence each."""
        ...

    @property
    def pictures(self) -> Sequence[Picture]:
        """Those whose pixels are at hand."""
        ...

    @property
    def picture_names(self) -> list[str]:
        """Names of all its pictures, also of those whose pixels are not at hand."""
        ...


class Source(Pictures, Protocol):
    """Something with pictures and without metres: an orthophoto, or a reconstruction.

    metric_already : why the source counts as metric already, as a sentence; empty if it does not.
    """

    @property
    def metric_already(self) -> str:
        """Why it counts as being in metres; empty where it does not."""
        ...

    @property
    def files(self) -> Sequence[Path]:
        """The files that it was read from, but for its pictures; none of them is ever written to."""
        ...

    def content_hash(self) -> str:
        """SHA-256 of its files."""
        ...

    def write(self, path: Path, scale: float) -> None:
        """Write a copy of it, in metres, to the temporary `path`; what is worth knowing of that goes to `notes`."""
        ...
