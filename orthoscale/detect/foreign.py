"""Runs other people's networks in a process of their own, with limits on memory and time."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..system.budget import in_words, memory
from . import foreign_worker
from .foreign_worker import receive, send

LONGEST_SECONDS = 25.0
"""[s] in which a network must be loaded, or look at one image. A sweep takes some hundred looks."""

MOST_OUTPUT = 2**26
"""[byte] An answer may have: ten times that of a YOLO for twenty classes and 2048 px."""

NO_NETWORK = "Export the network as ONNX again; other forms, such as .pt and .engine, are not read."
IMAGE_ALONE = "Export it with one RGB image [1, 3, height, width] of single or half precision as its only input."


class Said(NamedTuple):
    """A network's description, from its file: (name, type, shape) of inputs and outputs, and its metadata."""

    inputs: list[tuple[str, str, list]]
    outputs: list[tuple[str, str, list]]
    metadata: dict[str, str]


class Worker:
    """A network in a process of its own, which ends with this object or with our process.

    It processes one image at a time, so callers from several threads wait for each other; `threads` work on an image.
    On Linux its memory is limited to the budget.
    """

    def __init__(self, path: Path, content: bytes, threads: int, operators: str | None, seconds: float | None = None):
        """Load the network `content` of the file at `path`, which has `seconds` for each image.

        Raises InputError; ForeignError for an error that onnxruntime reports.
        """
        self._path = path
        self._seconds = LONGEST_SECONDS if seconds is None else seconds
        self._turn = threading.Lock()
        self._late = False
        # -P: nothing is imported from the user's current folder. The variables: no more threads than are asked for.
        self._process = subprocess.Popen(
            [sys.executable, "-P", foreign_worker.__file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C is for us; the process ends when its pipe does
        )
        self._end = weakref.finalize(self, _stop, self._process)
        head = {"memory": memory(), "threads": threads, "operators": operators, "arena": False}
        said, _ = self._ask("be loaded", head, content)
        self.said = Said(said["inputs"], said["outputs"], said["metadata"])

    def run(self, image: np.ndarray) -> list[np.ndarray]:
        """The outputs for `image`. Raises InputError if the network's process dies or takes too long, ForeignError for
        an error that onnxruntime reports."""
        image = np.ascontiguousarray(image)
        head = {
            "input": self.said.inputs[0][0],
            "type": image.dtype.str,
            "shape": image.shape,
            "most": MOST_OUTPUT,
        }
        answer, body = self._ask(f"process {image.shape[-1]} x {image.shape[-2]} px", head, image)
        arrays, at = [], 0
        for kind, shape in answer["arrays"]:
            count = int(np.prod(shape, dtype=np.int64))
            arrays.append(np.frombuffer(body, kind, count, at).reshape(shape))
            at += arrays[-1].nbytes
        return arrays

    def _ask(self, what: str, head: dict[str, Any], body: Any) -> tuple[dict, bytes]:
        with self._turn:
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None and stdout is not None  # pipes were asked for
            clock = threading.Timer(self._seconds, self._too_late)
            clock.start()
            try:
                send(stdin, head, body)
                answer, rest = receive(stdout)
            except (EOFError, OSError, ValueError) as error:
                self._end()
                raise self._died(what) from error
            except BaseException:
                self._end()  # its answer would be taken for the next one's
                raise
            finally:
                clock.cancel()
                clock.join()  # its thread holds this object, and with it the process, until it has ended
        if "error" in answer:
            if (
                answer["kind"] == "MemoryError"
                or "bad_alloc" in answer["error"]
                or "allocate memory" in answer["error"]
            ):
                raise self._too_large(what)
            raise ForeignError(answer["error"], answer["kind"] == foreign_worker.LibraryError.__name__)
        return answer, rest

    def _too_late(self) -> None:
        self._late = True
        self._process.kill()

    def _died(self, what: str) -> InputError:
        if self._late:
            return InputError(
                f"{self._path}: the network takes more than {self._seconds:.0f} s to {what}",
                "Take a smaller one, or a faster machine.",
            )
        return self._too_large(what, f" (its process ended with {self._process.returncode})")

    def _too_large(self, what: str, how: str = "") -> InputError:
        return InputError(
            f"{self._path}: the network cannot {what} within {in_words(memory())} of memory{how}",
            f"If it is to be trusted, allow more: --memory {-(-2 * memory() // 2**30)}G",
        )


class ForeignError(Exception):
    """What onnxruntime says is wrong with a network, in one line. library : whether the library of custom operators is
    to blame."""

    def __init__(self, reason: str, library: bool = False):
        super().__init__(reason)
        self.library = library


def _stop(process: subprocess.Popen) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):  # unsent data is lost
                pipe.close()
