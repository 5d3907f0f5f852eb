"""Jobs done elsewhere, by a function that is given: in processes on this machine, or on a Dask cluster.

Each job comes back as a row, also if its process dies or is stopped.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from importlib import import_module
from queue import SimpleQueue
from threading import Thread
from typing import Any

from ..detect.foreign_worker import receive, send
from ..detect.workers import cluster
from ..report.summary import COLUMNS, Row
from ..system import stopping
from ..system.budget import allow, memory
from ..system.paths import absolute
from ..system.threads import Threads

BUG = 1
"""Exit code of an input that met a bug of orthoscale, or whose process died."""

LOOK_AFTER = 0.5  # [s] between two looks whether the parent process is there

Job = dict[str, Any]
"""Plain values. Known here are only input, which names it, and out, where its copy goes (None without one)."""

Do = Callable[[Job], Row]
"""Does one job and returns its row; raises only what stops the process. A function of a module, so that another process
can import it."""


def in_processes(todo: Sequence[Job], jobs: int, do: Do) -> Iterator[tuple[int, Row]]:
    """Do the jobs `todo` by `do`, `jobs` at once, each in a process of its own; yields the number and row of each as
    soon as it is done."""
    free: SimpleQueue[_Child] = SimpleQueue()
    children = [_Child(do) for _ in range(min(jobs, len(todo)))]
    for child in children:
        free.put(child)

    def give(job: Job) -> Row:
        child = free.get()
        try:
            return child.do(job)
        finally:
            free.put(child)

    with Threads(len(children)) as pool:
        try:
            futures = {pool.submit(give, job): k for k, job in enumerate(todo)}
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        finally:
            with stopping.held():  # a second signal must not leave any of them running
                for child in children:
                    child.end()
                # A copy that was in place before its process ended is there: the user is told so.
                outputs = [future.result()["output"] for future in futures]
                stopping.written.extend(output for output in outputs if output is not None)
                for child in children:
                    child.close()


class _Child:
    """A process that does jobs, one at a time; one that dies takes only its own job with it."""

    def __init__(self, do: Do) -> None:
        self._do = do
        self._process: subprocess.Popen | None = None
        self._over = False

    def do(self, job: Job) -> Row:
        if self._process is None or self._process.poll() is not None:
            if self._over:
                return _died(job, "was stopped")
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, self._do.__module__, self._do.__name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only the parent, which passes it on
            )
        assert self._process.stdin is not None and self._process.stdout is not None  # pipes were asked for
        level = logging.getLogger("orthoscale").level
        try:
            send(self._process.stdin, {"job": job, "memory": memory(), "log": level})
            return receive(self._process.stdout)[0]
        except (EOFError, OSError, ValueError):
            return _died(job, f"ended with {self._process.wait()}")

    def end(self) -> None:
        """Stop the process; it removes what it was writing."""
        self._over = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            self._process.wait()

    def close(self) -> None:
        """Close the pipes of a process that has ended, after its last answer was read."""
        for pipe in (self._process.stdin, self._process.stdout) if self._process is not None else ():
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]


def _died(job: Job, how: str) -> Row:
    error = {"error": f"its process {how}", "hint": "Run it alone; if memory ran out, allow less by --memory."}
    return {**dict.fromkeys(COLUMNS), "input": job["input"], "exit_code": BUG, **error}


def on_cluster(todo: Sequence[Job], address: str, do: Do) -> Iterator[tuple[int, Row]]:
    """Do the jobs `todo` by `do` on the Dask cluster at `address`; yields the number and row of each as soon as it is
    done.

    Raises UsageError if no scheduler answers.
    """
    from distributed import as_completed as as_done

    with cluster(address) as client:
        elsewhere = [{**job, "input": str(absolute(job["input"]))} for job in todo]
        futures = {client.submit(_within, memory(), do, job, pure=False): k for k, job in enumerate(elsewhere)}
        try:
            for future in as_done(futures, loop=client.loop):
                k = futures[future]
                # The job of a lost worker goes to another; the cluster gives a job up only if it kills every worker.
                lost = future.exception()
                row = (
                    future.result() if lost is None else _died(todo[k], f"was lost with the cluster's workers ({lost})")
                )
                yield k, {**row, "input": todo[k]["input"]}
        finally:
            client.cancel([future for future in futures if not future.done()])


def _within(budget: int, do: Do, job: Job) -> Row:
    """`do` in a process of its own, with a memory `budget` [byte]."""
    allow(budget)
    return do(job)


def serve(do: Do) -> None:
    """Do the jobs that come on standard input by `do`, until it ends; rows go to standard output."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not mix with the answers
    talk = logging.StreamHandler()
    talk.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    talk.addFilter(lambda record: not record.exc_info)  # of a bug: a row says so, and --debug alone shows where it is
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.NullHandler())
    logging.getLogger("orthoscale").addHandler(talk)
    with suppress(EOFError, OSError, KeyboardInterrupt), stopping.listening():
        Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
        while True:
            head, _ = receive(requests)
            logging.getLogger("orthoscale").setLevel(head["log"])
            try:
                row = _within(head["memory"], do, job := head["job"])
                stopping.check()  # a library may have swallowed it, and the next job would never come
            except KeyboardInterrupt:
                there = job["out"] if job["out"] in stopping.written else None
                send(answers, {**_died(job, "was stopped"), "output": there})
                raise
            send(answers, row)


def _end_with(parent: int) -> None:
    """Stop this process when the process `parent` has ended: one that was killed could not say so, and the job would go
    on, its output locked, for as long as it takes."""
    while os.getppid() == parent:
        time.sleep(LOOK_AFTER)
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    module, name = sys.argv[1:]
    serve(getattr(import_module(module), name))
