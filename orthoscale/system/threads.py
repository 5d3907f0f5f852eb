"""Threads for a part of the work, none of which is left when it is over."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from . import stopping


class Threads(ThreadPoolExecutor):
    """A pool for a `with` block. At its end what was not begun is cancelled, and signals wait until what was is done:
    Python takes a thread whose end it was kept from waiting for as ended, and a network that such a thread is still in
    aborts the process while Python ends."""

    def __exit__(self, *exc: object) -> None:
        """Raises Stopped if a signal came meanwhile."""
        with stopping.held():
            self.shutdown(wait=True, cancel_futures=True)
