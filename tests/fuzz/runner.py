"""One attempt: the command line in a forked child with limits, and what it did to its surroundings.

A worker process loads all modules once and starts no thread, so that its children begin at once and each with a clean
slate. Processes that are to be killed start anew, as a user's do.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import hashlib
import importlib
import json
import os
import pkgutil
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import orthoscale
from orthoscale.countries import country_at

# A child hangs that takes longer than this by the clock, less what it stood in line for the processor, as the kernel
# counts it: who computes and who waits for a pipe or a server are found alike, and a busy machine is nobody's fault.
TIME_LIMIT = 30.0  # [s]
WATCHED = 1.0  # [s] from which on it is counted, since what a thread stood is forgotten when it ends
WAITING = 10  # times that by the clock, whatever the kernel counts
GIB = 2**30
MEMORY_LIMIT = 1.0  # [GiB]
STOP_AT = 3.0  # [GiB] where a child is stopped, for the sake of the machine
TOLERANCE = 0.02  # of the scale of a damaged input that was accepted
STOPPED = "stopped; already written: "
DONE = frozenset((0, 2, 3, 4, 5, 6))
NOT_LOADED = ("orthoscale.synthetic", "orthoscale.rio", "orthoscale.__main__")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "GDAL_NUM_THREADS")
LIBRARIES = ("*** SIG", "*** Aborted", "libpng ", "Corrupt JPEG", "[ WARN:", "[ERROR:")  # how lines of theirs begin
PROBLEMS = ("crash", "hang", "memory", "left behind", "input changed", "wrong answer")


@dataclass(frozen=True)
class Attempt:
    """What to run in a folder whose `in/` holds the inputs, and what must come of it.

    argv : without the program's name; paths are relative to the folder. codes : exit codes that are in order.
    truth : the scale, where a success must be near it, within `tolerance`. memory : [GiB]. file_limit : [bytes] of any
    file written. kill : (signal, delay [s]) sent to a process of its own; when_writing : the
    delay counts from its first output. twins : how many run at once, of which one
    may succeed. beside : a success may add files to `in/`.
    patience : [s] after which it hangs, see TIME_LIMIT.
    """

    argv: tuple[str | bytes, ...]
    codes: frozenset[int] = DONE
    truth: float | None = None
    tolerance: float = TOLERANCE
    memory: float = MEMORY_LIMIT
    file_limit: int | None = None
    kill: tuple[int, float] | None = None
    twins: int = 1
    beside: bool = False
    when_writing: bool = False
    patience: float = TIME_LIMIT
    environment: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What came of an attempt.

    code : exit code, negative for a signal. seconds, cpu : by the clock, and of the processor. peak : of resident
    memory [GiB]. problems : of `PROBLEMS`.
    """

    name: str
    seed: int
    argv: tuple[str, ...]
    code: int
    seconds: float
    cpu: float
    peak: float
    problems: tuple[str, ...]
    said: str


def preload() -> None:
    """Load what commands need, once. Raises RuntimeError when that has started a thread: children would hang."""
    for module in pkgutil.walk_packages(orthoscale.__path__, "orthoscale."):
        if not module.name.startswith(NOT_LOADED):
            importlib.import_module(module.name)
    for name in ("pycolmap", "rasterio", "pyogrio", "cv2", "ezdxf", "PIL.Image", "scipy.spatial"):
        importlib.import_module(name)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # pycolmap's is loud
    country_at(0.0, 0.0)  # decodes the time zones, 0.07 s
    gc.collect()
    gc.freeze()  # a child whose collector of garbage walked through all of it would copy it, in 0.09 s
    if threading.active_count() > 1 or len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("a module has started threads: it cannot be loaded before a fork")


def one_thread() -> None:
    """Ask numerical libraries for one thread; before they are loaded."""
    os.environ.update(dict.fromkeys(THREADS, "1"))


def run(name: str, seed: int, folder: Path, attempt: Attempt) -> Outcome:
    """Run `attempt` in `folder`, and judge it."""
    (folder / "in").mkdir(exist_ok=True)
    before = contents(folder)
    begin = time.monotonic()
    runs = _killed(folder, attempt) if attempt.kill else _forked(folder, attempt)
    seconds = time.monotonic() - begin
    code = max((r.code for r in runs), key=lambda c: (c < 0, c))
    peak = max(r.peak for r in runs)
    said = "".join(r.err for r in runs)
    problems = set()
    if any(_crashed(r, attempt) for r in runs):
        problems.add("crash")
    if any(r.hung for r in runs):
        problems.add("hang")
    if peak > attempt.memory:
        problems.add("memory")
    after = contents(folder)
    problems |= marks(before, after, any(_delivered(r) for r in runs), attempt.beside)
    if _unnamed(runs, (path for path in after if path not in before and not path.startswith("cache"))):
        problems.add("left behind")
    if "left behind" in problems and attempt.kill and attempt.kill[0] == signal.SIGKILL:
        problems.discard("left behind")
        _forked(folder, attempt)  # the next one tidies up
        if any(_unfinished(p) for p in contents(folder)):
            problems.add("left behind")
    if any(_wrong(r.out, attempt) for r in runs if r.code == 0) or sum(r.code == 0 for r in runs) > 1:
        problems.add("wrong answer")
    words = tuple(os.fsdecode(a) for a in attempt.argv)
    ordered = tuple(p for p in PROBLEMS if p in problems)
    return Outcome(
        name,
        seed,
        words,
        code,
        round(seconds, 3),
        round(sum(r.cpu for r in runs), 3),
        round(peak, 3),
        ordered,
        said[-1500:],
    )


def contents(folder: Path) -> dict[str, str]:
    """What lies in `folder`, by relative path: a digest of each file, a link's target, a folder's mark."""
    found = {}
    for root, folders, files in os.walk(os.fsencode(folder)):
        for name in (*folders, *files):
            path = os.path.join(root, name)
            key = os.fsdecode(os.path.relpath(path, os.fsencode(folder)))
            if os.path.islink(path):
                found[key] = "link " + os.fsdecode(os.readlink(path))
            elif os.path.isfile(path) and os.path.getsize(path) < 2**26:
                with open(path, "rb") as file:
                    found[key] = hashlib.blake2b(file.read(), digest_size=16).hexdigest()
            else:
                status = os.stat(path, follow_symlinks=False)
                found[key] = (
                    "folder" if os.path.isdir(path) else f"{status.st_mode} {status.st_size} {status.st_mtime_ns}"
                )
    return found


def marks(before: dict[str, str], after: dict[str, str], success: bool, beside: bool) -> set[str]:
    """Whether inputs changed, and whether something lies about that nobody asked for.

    A success may add what lies outside of `in/`; a failure nothing at all.
    """
    problems = set()
    if any(after.get(path) != mark for path, mark in before.items() if not path.startswith("cache")):
        problems.add("input changed")
    new = [path for path in after if path not in before and not path.startswith("cache")]
    if any(_unfinished(path) for path in new):
        problems.add("left behind")
    if (any(path.startswith("in/") for path in new) and not (beside and success)) or (new and not success):
        problems.add("left behind")
    return problems


def _unfinished(path: str) -> bool:
    return any(part.endswith((".partial", ".former", ".tmp", "-journal")) for part in Path(path).parts)


@dataclass(frozen=True)
class _Run:
    code: int
    cpu: float
    peak: float
    hung: bool
    out: str
    err: str


def _delivered(run: _Run) -> bool:
    """Whether there is an output: also where a report or a picture beside it failed, which is said.

    Or where a signal came when it was in its place already. There is always such a moment before a program ends, and
    to take a verified output away again would lose what somebody may be reading. So it stays, and the run that was
    stopped says so: only what it names may be there.
    """
    return run.code == 0 or (run.code == 6 and "is written and verified, but" in run.err) or STOPPED in run.err


def _unnamed(runs: list[_Run], new: Iterable[str]) -> bool:
    """Whether a run that was stopped left something that it does not name as written."""
    said = [run.err.partition(STOPPED)[2] for run in runs if STOPPED in run.err]
    return any(Path(path).parts[0] not in words for words in said for path in new)


def _crashed(run: _Run, attempt: Attempt) -> bool:
    """A signal that nobody sent, an exit code that nobody promised, a traceback, or the words of a bug or a library."""
    if run.hung or run.peak >= STOP_AT:
        return False  # stopped from here: it counts as such
    if attempt.kill and "Fatal Python error: init_import_site" in run.err:
        return False  # Python itself was still starting, on a machine that has much else to do: nothing of ours ran
    bad = ["bug in orthoscale", "Fatal Python error"]
    # Python itself has a word to say to a signal while it starts, until the package is imported, before its program.
    frames = [line for line in run.err.splitlines() if "/orthoscale/" in line]
    if not attempt.kill or not all(line.strip().startswith("File") and _starts(line) for line in frames):
        bad.append("Traceback (most recent call last)")
    # Whether a program that tidied up ends with 128 + number or with the signal is a matter of taste; Python's way is
    # SIGINT for both.
    stopped = {129, 130, 143, -signal.SIGINT, -attempt.kill[0]} if attempt.kill else set()
    loud = any(line.startswith(LIBRARIES) for line in run.err.splitlines())
    return loud or any(word in run.err for word in bad) or run.code not in attempt.codes | stopped


def _starts(frame: str) -> bool:
    return any(name in frame for name in ("/orthoscale/__init__.py", "/orthoscale/system/libz.py"))


def _wrong(out: str, attempt: Attempt) -> bool:
    """A scale that is far from the truth, though it was given with success; by what ``--json`` printed."""
    if attempt.truth is None:
        return False
    try:
        scale = json.loads(out)["scale"]
        return not abs(float(scale) / attempt.truth - 1) <= attempt.tolerance
    except (ValueError, KeyError, TypeError):
        return True


def _forked(folder: Path, attempt: Attempt) -> list[_Run]:
    """The attempt in children of this process, as many at once as it has twins."""
    running = []
    for _ in range(attempt.twins):
        out, err = _Pipe(), _Pipe()
        pid = os.fork()
        if pid == 0:
            _child(folder, attempt, out.end, err.end)
        running.append((pid, out, err))
    return _wait(running, attempt.patience)


class _Pipe:
    """What a child prints, kept from filling the pipe. Not a file, since the size of files may be limited."""

    def __init__(self) -> None:
        self.start, self.end = os.pipe()
        os.set_blocking(self.start, False)
        self._parts: list[bytes] = []

    def drain(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self.start, 1 << 20):
                self._parts.append(part)

    def text(self) -> str:
        """All of it, at the end."""
        self.drain()
        os.close(self.start)
        return b"".join(self._parts).decode("utf-8", "replace")


def _child(folder: Path, attempt: Attempt, out: int, err: int) -> None:
    """In the child: never returns."""
    code = 99
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: it does not outlive the worker
        os.setsid()
        os.chdir(folder)
        os.dup2(out, 1)
        os.dup2(err, 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
        os.environ.update({"ORTHOSCALE_CACHE": str(folder / "cache"), "COLUMNS": "200", **attempt.environment})
        if attempt.file_limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (attempt.file_limit, attempt.file_limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        sys.argv = ["orthoscale", *(os.fsdecode(a) for a in attempt.argv)]
        from orthoscale.cli.main import main

        try:
            main()
            code = 0
        except SystemExit as ending:
            code = ending.code if isinstance(ending.code, int) else int(ending.code is not None)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
        code = 1
    finally:
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os._exit(code)


def _wait(running: list[tuple[int, _Pipe, _Pipe]], patience: float) -> list[_Run]:
    """Until all children ended, or were stopped because they took too long or too much."""
    for _, *pipes in running:
        for pipe in pipes:
            os.close(pipe.end)
    begin, pause, runs, most = time.monotonic(), 0.002, {}, dict.fromkeys((pid for pid, *_ in running), 0.0)
    stood: dict[int, dict[str, int]] = {pid: {} for pid, *_ in running}
    while len(runs) < len(running):
        for pid, out, err in running:
            if pid in runs:
                continue
            out.drain()
            err.drain()
            done, status, usage = os.wait4(pid, os.WNOHANG)
            most[pid] = max(most[pid], _resident(pid))
            clock = time.monotonic() - begin
            slow = not done and clock > min(WATCHED, patience)
            waited = _in_line(pid, stood[pid]) if slow else 0.0
            hung = slow and (clock - waited > patience or clock > WAITING * patience)
            if not done and (hung or most[pid] > STOP_AT):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(pid, signal.SIGKILL)
                done, status, usage = os.wait4(pid, 0)
            if done:
                peak = max(most[pid], usage.ru_maxrss * 1024 / GIB)
                code, cpu = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
                runs[pid] = _Run(code, cpu, peak, hung, out.text(), err.text())
        time.sleep(pause)
        pause = min(0.05, pause * 1.5)
    return list(runs.values())


def _resident(pid: int) -> float:
    """[GiB] of the child and its own children."""
    total = 0
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for number in (str(pid), *children):
            total += int(Path(f"/proc/{number}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        pass
    return total * resource.getpagesize() / GIB


def _in_line(pid: int, stood: dict[str, int]) -> float:
    """[s] that the child's threads and its own children could have run and did not, for want of a processor.

    stood : what each was last seen to have stood [ns], which is kept of those that have ended.
    """
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for number in (str(pid), *children):
            for task in Path(f"/proc/{number}/task").iterdir():
                stood[task.name] = int((task / "schedstat").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        pass
    return sum(stood.values()) / 1e9


def _killed(folder: Path, attempt: Attempt) -> list[_Run]:
    """The attempt in a process of its own, which gets a signal after a delay."""
    assert attempt.kill
    number, delay = attempt.kill
    out, err = _Pipe(), _Pipe()
    words = [sys.executable, "-m", "orthoscale", *attempt.argv]
    environment = {**os.environ, "ORTHOSCALE_CACHE": str(folder / "cache"), **attempt.environment}
    child = subprocess.Popen(words, cwd=folder, env=environment, stdout=out.end, stderr=err.end, start_new_session=True)
    names = set(os.listdir(os.fsencode(folder)))
    while attempt.when_writing and set(os.listdir(os.fsencode(folder))) <= names:
        if os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            break
        time.sleep(0.001)
    time.sleep(delay)
    os.kill(child.pid, number)
    child.returncode = 0  # is waited for below
    return _wait([(child.pid, out, err)], attempt.patience)


def clean(folder: Path) -> None:
    """Remove a work folder whatever lies in it."""
    shutil.rmtree(os.fsencode(folder), ignore_errors=True)
