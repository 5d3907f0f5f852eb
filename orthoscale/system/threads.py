"""A thread pool that leaves no thread running at its end."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from . import stopping


class Threads(ThreadPoolExecutor):
    """A pool for a `with` block. At its end, pending tasks are cancelled, and signals wait until running ones are done:
    a signal that interrupted the wait would make Python take their threads for ended, and a network still running in
    one aborts the process while Python ends."""

    def __exit__(self, *exc: object) -> None:
        """Raises Stopped if a signal came meanwhile."""
        with stopping.held():
            self.shutdown(wait=True, cancel_futures=True)
