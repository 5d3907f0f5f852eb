"""The common part of reconstructions that are a single file: written as one file, without a workspace around it."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError, UsageError
from ..formats.geometry.sim3 import Sim3
from .colmap import ColmapSource
from .colmap_write import require_same
from .fingerprint import require_unchanged

if TYPE_CHECKING:
    import pycolmap

DIGITS = 1e-6  # rounding error of a point cloud in single precision, as a share of the model's size


class OneFileSource(ColmapSource):
    """A reconstruction in one file of another program; `path` is the file, `folder` the folder that it lies in."""

    @cached_property
    def dense(self) -> Path:
        """Raises UsageError: there is no dense workspace of COLMAP."""
        raise UsageError(f"{self.path} has no dense workspace of COLMAP", "Scale other files with `orthoscale apply`.")

    def write(self, folder: Path, metres_per_unit: float) -> None:
        """Write the file in metres into the empty `folder`, with what belongs to it, and the files of `Sim3.save`.

        Raises UsageError for an impossible scale, InputError for a file that was changed since it was opened,
        OutputError if the written file does not read back as the scaled model.
        """
        sim3 = Sim3(float(metres_per_unit))
        out = folder / self.path.name
        require_unchanged(self._stamps)
        try:
            self._write_file(out, sim3.scale)
            sim3.save(folder)
        except OSError as error:
            raise OutputError(f"{folder}: writing failed ({error})", "Check permissions and free space.") from error
        require_same(self._model, self._read_back(out), sim3.scale, out, DIGITS)
        self._tell_moved(sim3.scale)

    @abstractmethod
    def _write_file(self, out: Path, scale: float) -> None:
        """Write the file with its lengths times `scale` to `out`, and what belongs to it beside that."""

    @abstractmethod
    def _read_back(self, out: Path) -> pycolmap.Reconstruction:
        """The model in the written file `out`."""
