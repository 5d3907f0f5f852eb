"""The process that runs a user's ONNX network, started by `foreign.Worker`. It needs only NumPy and onnxruntime.

Messages in both directions are 8 bytes of length, one line of JSON and raw bytes. The first holds the network and the
limits, and is answered with the network's description. Then come images, each answered with the network's outputs. An
answer may be an "error" instead.
"""

import json
import os
import queue
import struct
import sys
import threading
from typing import IO, Any


def send(pipe: IO[bytes], head: dict, *bodies: Any) -> None:
    """Write one message; `bodies` are bytes or contiguous arrays."""
    line = json.dumps(head).encode() + b"\n"
    views = [memoryview(body).cast("B") for body in bodies if memoryview(body).nbytes]
    pipe.write(struct.pack("<Q", len(line) + sum(view.nbytes for view in views)) + line)
    for view in views:
        pipe.write(view)
    pipe.flush()


def receive(pipe: IO[bytes]) -> tuple[dict, bytes]:
    """Read one message. Raises EOFError at the end."""
    length = pipe.read(8)
    if len(length) < 8:
        raise EOFError
    (size,) = struct.unpack("<Q", length)
    line = pipe.readline(size)
    body = pipe.read(size - len(line))
    if len(body) < size - len(line):
        raise EOFError
    return json.loads(line), body


def main() -> None:
    """Serve requests from standard input until it ends; answers go to standard output, see the module's text."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What libraries print must not get into the answers.
    silence = os.open(os.devnull, os.O_RDWR)
    for fd in (0, 1, 2):
        os.dup2(silence, fd)
    waiting: queue.SimpleQueue = queue.SimpleQueue()

    def listen() -> None:
        try:
            while True:
                waiting.put(receive(requests))
        except (EOFError, OSError, ValueError):
            os._exit(0)  # nobody is left to answer to, and the network may never come to an end

    threading.Thread(target=listen, daemon=True).start()
    network = None
    while True:
        head, body = waiting.get()
        try:
            if network is None:
                _limit(head["memory"])
                network = session(body, head)
                send(answers, said(network))
            else:
                send(answers, *_run(network, head, body))
        except Exception as error:  # onnxruntime raises its own unrelated types
            lines = str(error).strip().splitlines()
            send(answers, {"error": (lines[0] if lines else repr(error))[:500], "kind": type(error).__name__})


class LibraryError(Exception):
    """The library of operators cannot be loaded."""


def _limit(memory: int) -> None:
    """Let no more than `memory` bytes be allocated, where the system counts them (Linux). Mapped files do not count;
    they would with RLIMIT_AS."""
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        resource.setrlimit(resource.RLIMIT_DATA, (memory if hard < 0 else min(memory, hard), hard))


def session(content: bytes, settings: dict) -> Any:
    """An onnxruntime session for the network `content`."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = settings["threads"]
    options.log_severity_level = 4  # no log: errors come as exceptions anyway
    # Spinning threads starve the reader and the decoder on machines with few cores.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.enable_cpu_mem_arena = settings["arena"]  # it asks for up to twice what is needed
    if settings["operators"]:
        try:
            options.register_custom_ops_library(settings["operators"])
        except Exception as error:
            raise LibraryError(str(error)) from error
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def said(network: Any) -> dict:
    """A network's description, with the fields of `foreign.Said`."""
    inputs, outputs = (
        [(v.name, v.type, v.shape) for v in some] for some in (network.get_inputs(), network.get_outputs())
    )
    return {"inputs": inputs, "outputs": outputs, "metadata": network.get_modelmeta().custom_metadata_map}


def _run(network: Any, head: dict, body: bytes) -> tuple:
    import numpy as np

    image = np.frombuffer(body, head["type"]).reshape(head["shape"])
    arrays = network.run(None, {head["input"]: image})
    for array in arrays:
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
            raise TypeError("an output holds no numbers")
    size = sum(array.nbytes for array in arrays)
    if size > head["most"]:
        raise ValueError(f"its outputs hold {size} bytes")
    arrays = [np.ascontiguousarray(array) for array in arrays]
    return {"arrays": [(array.dtype.str, array.shape) for array in arrays]}, *arrays


if __name__ == "__main__":
    main()
