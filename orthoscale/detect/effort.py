"""How much of the pictures to process, and with what."""

from __future__ import annotations

from dataclasses import dataclass

from .workers import cores, worker_count


@dataclass(frozen=True)
class Effort:
    """How much of the pictures to process, and with which resources.

    target : stop when the sampling part of the scale's uncertainty (relative, one sigma) is at most this.
    exhaustive : process every tile of every picture.
    seed : for the order of tiles, and for the order of pictures in the scale search.
    workers : threads; None for one per core, eight at most. scheduler : address of a Dask scheduler to use instead.
    cache : store the detections in tiles, and use stored ones.
    """

    target: float = 0.005
    exhaustive: bool = False
    seed: int = 0
    workers: int | None = None
    scheduler: str | None = None
    cache: bool = True

    @property
    def threads(self) -> int:
        """Number of threads: `workers`, or their default."""
        return worker_count(self.workers)

    @property
    def threads_each(self) -> int:
        """Threads that a detector may use for one image, so that all workers together use one per core."""
        return max(1, cores() // self.threads)
