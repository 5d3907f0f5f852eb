"""Saves the boxes of a run to a file, even if it gives no scale: then they are most worth inspecting."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.detections import Detections
from ..core.source import Pictures
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..formats.detections import check_pictures, output_of, save
from ..system.outputs import Outputs

NO_SCALE = (TooLittleEvidence, EvidenceDisagrees)


class KeptBoxes:
    """The boxes that were found so far, and the file to save them in.

    outputs : to which the file is added. path : of the file, None to save none. partial : where it is written before it
    is moved to `path`. Raises UsageError, OutputError.
    """

    def __init__(self, outputs: Outputs, path: Path | None) -> None:
        self.path = path
        self.partial = output_of(outputs, path)
        self._outputs = outputs
        self._found: Detections | None = None
        self._source: Pictures | None = None

    def check(self, source: Pictures) -> None:
        """Raise UsageError if the file cannot hold boxes of `source`: before these are searched for."""
        if self.path is not None:
            check_pictures(self.path, source)

    def take(self, found: Detections, source: Pictures) -> None:
        """Remember the boxes `found` in `source`, instead of earlier ones."""
        self._found, self._source = found, source

    def save(self) -> None:
        """Write the remembered boxes, if they are to be saved. Raises UsageError, OSError."""
        if self.partial is not None and self._found is not None and self._source is not None:
            self._outputs.protect(*self._source.files)
            save(self._found, self.partial, self._source)

    def keep(self, found: Detections, source: Pictures) -> None:
        """Save the boxes `found` in `source` at once, whatever follows. Raises UsageError, OSError."""
        self.take(found, source)
        self._deliver()

    def _deliver(self) -> None:
        """Save the remembered boxes at once."""
        if self.partial is not None:
            self.save()
            self._outputs.deliver(self.partial)

    @contextmanager
    def also_without_scale(self) -> Iterator[None]:
        """If the block raises TooLittleEvidence or EvidenceDisagrees, the remembered boxes are saved at once, and the
        error says so."""
        with self.telling():
            try:
                yield
            except NO_SCALE:
                if self._found is not None and self._found.any_boxes:
                    self._deliver()
                raise

    @contextmanager
    def telling(self) -> Iterator[None]:
        """If the block raises TooLittleEvidence or EvidenceDisagrees, the error says where the boxes are saved."""
        try:
            yield
        except NO_SCALE as error:
            if self.path is not None and self._found is not None and self._found.any_boxes:
                error.reword(lambda message: f"{message}; the boxes are saved in {self.path}")
            raise
