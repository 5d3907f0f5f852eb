"""The file that keeps the boxes of a run: also of one that gives no scale, whose boxes are worth a look above all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.detections import Detections
from ..core.source import Source
from ..errors import EvidenceDisagrees, TooLittleEvidence
from ..formats.detections import output_of, save
from ..system.outputs import Outputs

NO_SCALE = (TooLittleEvidence, EvidenceDisagrees)


class KeptBoxes:
    """The boxes that were found so far, and where they are kept.

    outputs : those that the file is one of. path : of the file, None to keep none. partial : where to write it.
    Raises UsageError, OutputError.
    """

    def __init__(self, outputs: Outputs, path: Path | None) -> None:
        self.path = path
        self.partial = output_of(outputs, path)
        self._outputs = outputs
        self._found: Detections | None = None
        self._source: Source | None = None

    def take(self, found: Detections, source: Source) -> None:
        """Remember what was `found` in `source`, in place of what was found before."""
        self._found, self._source = found, source

    def save(self) -> None:
        """Write what was taken, if it is to be kept. Raises UsageError, OSError."""
        if self.partial is not None and self._found is not None and self._source is not None:
            self._outputs.protect(*self._source.files)
            save(self._found, self.partial, self._source)

    @contextmanager
    def also_without_scale(self) -> Iterator[None]:
        """Where the block raises TooLittleEvidence or EvidenceDisagrees, boxes that were taken are put in their place
        at once, and the error says so."""
        with self.telling():
            try:
                yield
            except NO_SCALE:
                if self.partial is not None and self._found is not None and self._found.any_boxes:
                    self.save()
                    self._outputs.deliver(self.partial)
                raise

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Where the block raises TooLittleEvidence or EvidenceDisagrees, the error says where the boxes are saved."""
        try:
            yield
        except NO_SCALE as error:
            if self.path is not None and self._found is not None and self._found.any_boxes:
                error.reword(lambda message: f"{message}; the boxes are saved in {self.path}")
            raise
