"""Runs the detector on tiles: in threads of this process, or on a Dask cluster. The boxes are the same either way."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from ..core.detections import Tile
from ..core.source import Picture
from ..errors import InputError, OrthoscaleError, UsageError
from ..system.budget import allow, memory
from ..system.threads import Threads
from .detector import Detector, Passes
from .tiles import AnyDetector, Looks, look_twice

Done = TypeVar("Done")
Jobs = Mapping[int, tuple[Picture, Tile]]
Settings = tuple[Path | None, str | None, tuple[str, ...], Passes]
Visit = Callable[[Jobs], Iterator[tuple[int, Looks]]]
"""Looks at tiles; yields each with its number as soon as it is there, in any order."""

MOST_THREADS = 8  # by default; each holds a tile and the network's feature maps of it, some 70 MB
RETRIES = 3  # of a tile that fails on a Dask worker
CONNECTING = "10s"


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def worker_count(asked: int | None) -> int:
    """`asked`, or by default a thread per core, eight at most. Raises UsageError if `asked` is less than one."""
    if asked is not None and asked < 1:
        raise UsageError(f"--workers must be 1 or more, not {asked}")
    return asked or min(cores(), MOST_THREADS)


def on_threads(jobs: Jobs, detector: AnyDetector, count: int) -> Iterator[tuple[int, Looks]]:
    """Each thread reads, detects and decodes its own tile, so that one reads while another computes."""
    work = {number: partial(look_twice, picture, tile, detector) for number, (picture, tile) in jobs.items()}
    return done_on_threads(work, count)


def done_on_threads(work: Mapping[int, Callable[[], Done]], count: int) -> Iterator[tuple[int, Done]]:
    """The result of each piece of `work` with its number, as soon as one of `count` threads has finished it."""
    waiting = iter(work.items())
    with Threads(count) as pool:
        running: dict[Future[Done], int] = {}
        while True:
            # Few pieces are handed out at a time, since an error or Ctrl-C has to wait for all that are.
            for number, piece in islice(waiting, 2 * count - len(running)):
                running[pool.submit(piece)] = number
            if not running:
                return
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(done), done.result()


@contextmanager
def visitor(detector: Detector, count: int, scheduler: str | None) -> Iterator[Visit]:
    """A function that looks at tiles, on `count` threads or on the Dask cluster at the address `scheduler`
    (``tcp://host:8786``).

    On a cluster pictures and detector are opened by their paths, so every machine must have them there.
    Raises UsageError if Dask is not installed or nobody answers at the address.
    """
    if scheduler is None:
        yield lambda jobs: on_threads(jobs, detector, count)
        return
    with cluster(scheduler) as client:
        yield lambda jobs: _on_cluster(client, jobs, detector)


def cluster(address: str) -> AbstractContextManager[Any]:
    """A client of the Dask scheduler at `address`. Raises UsageError as `visitor` does."""
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--scheduler needs Dask", "Install it: pip install 'orthoscale[dask]'.") from error
    try:
        return Client(address, timeout=CONNECTING, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {address} ({error})", "Start one: dask scheduler; dask worker ADDRESS."
        ) from error


def _on_cluster(client: Any, jobs: Jobs, detector: Detector) -> Iterator[tuple[int, Looks]]:
    from distributed import KilledWorker, as_completed

    path, *how = detector.settings
    given = (None if path is None else Path(path).absolute(), *how), detector.sha256, memory()
    # Dask itself moves the tasks of a lost worker to another one; `retries` is for errors such as a network drive's.
    futures = {
        client.submit(_look_elsewhere, picture, tile, *given, pure=False, retries=RETRIES): number
        for number, (picture, tile) in jobs.items()
    }
    try:
        for future in as_completed(futures, loop=client.loop):
            yield futures[future], future.result()
    except KilledWorker as error:
        raise OrthoscaleError(
            f"the Dask cluster lost its workers ({error})", "Give them more memory; finished tiles are kept."
        ) from error
    finally:
        client.cancel([future for future in futures if not future.done()])


def _look_elsewhere(picture: Picture, tile: Tile, settings: Settings, sha256: str, budget: int) -> Looks:
    allow(budget)
    return look_twice(picture, tile, _detector(settings, sha256))


@lru_cache(maxsize=2)
def _detector(settings: Settings, sha256: str) -> Detector:
    """The detector, opened on this machine. Raises InputError if the file here has another `sha256`."""
    path, decoder, vehicle_classes, passes = settings
    detector = Detector(path, decoder, vehicle_classes, 1, passes)
    if detector.sha256 != sha256:
        raise InputError(
            f"{detector.path}: a Dask worker has another network there", "Give all machines the same, and run again."
        )
    return detector
