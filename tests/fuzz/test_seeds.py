"""Every input that once failed, and that a campaign can fail at all."""

from __future__ import annotations

import multiprocessing
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

if not sys.platform.startswith("linux"):
    pytest.skip("forks, and reads /proc", allow_module_level=True)
pytest.importorskip("onnx")

from . import campaign, commands, damage, runner  # noqa: E402
from .seeds import SEEDS  # noqa: E402

KILLS = [name for name in SEEDS if name.startswith("kill: ")]
# Of 27 kills, three signals at nine moments, the suite has nine: each moment once, each signal three times. The
# campaign has all.
CAMPAIGN = {name for k, name in enumerate(KILLS) if k // 9 != k % 3}


@pytest.fixture(scope="session")
def corpus(tmp_path_factory):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(campaign.make_corpus, (tmp_path_factory.mktemp("fuzz") / "corpus", ("cache",)))


@pytest.fixture(scope="session")
def worker():
    """A process that has loaded the modules, started no thread, and can be forked."""
    threads = {name: "1" for name in runner.THREADS}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in threads.items():
            patch.setenv(name, value)
        pool = multiprocessing.get_context("spawn").Pool(1, runner.preload)
        with pool:
            yield pool


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SEEDS if name not in CAMPAIGN])
def test_what_once_failed(name, corpus, worker, tmp_path):
    outcome = worker.apply(campaign.run_seed, (corpus, tmp_path / "work", name))
    assert not outcome.problems, f"exit {outcome.code}, {outcome.peak} GiB\n{outcome.said}"


# Attempts of the campaign that once failed, each with a fault that no seed above shows.
ONCE = (
    ("rasters damaged", 153),  # a PNG's text chunk, told as an error while tags were read
    ("rasters damaged", 174),  # a TIFF's tag without a type, likewise
)


@pytest.mark.slow
@pytest.mark.parametrize("name, seed", ONCE)
def test_attempts_that_once_failed(name, seed, corpus, worker, tmp_path):
    outcome = worker.apply(campaign.attempt, ((corpus, tmp_path, name, seed, False),))
    assert not outcome.problems, outcome.said


def judged(attempt, folder: Path):
    (folder / "in").mkdir(parents=True)
    (folder / "in/a.txt").write_text("a")
    return runner.run("own", 0, folder, attempt)


@pytest.mark.slow
def test_the_campaign_sees_what_goes_wrong(worker, tmp_path):
    """Each column of the table can be other than 0."""
    fine = worker.apply(judged, (runner.Attempt(("fleets",)), tmp_path / "fine"))
    assert (fine.code, fine.problems) == (0, ())
    usage = worker.apply(judged, (runner.Attempt(("fleets",), codes=frozenset((5,))), tmp_path / "code"))
    assert usage.problems == ("crash",), "a code that nobody promised"
    far = worker.apply(judged, (runner.Attempt(("fleets",), truth=1.0), tmp_path / "far"))
    assert far.problems == ("wrong answer",)
    both = worker.apply(judged, (runner.Attempt(("fleets",), twins=2), tmp_path / "twins"))
    assert both.problems == ("wrong answer",)
    much = worker.apply(judged, (runner.Attempt(("fleets",), memory=0.001), tmp_path / "much"))
    assert much.problems == ("memory",)
    slow = worker.apply(judged, (runner.Attempt(("fleets",), patience=0.001), tmp_path / "slow"))
    assert slow.problems == ("hang",)


COMPUTE = """
import os, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
while time.process_time() < 0.5:
    pass
"""


@pytest.mark.slow
def test_who_stands_in_line_does_not_hang():
    """Two that compute on one core have half of it each: the kernel counts the rest as waiting."""
    first, second = (subprocess.Popen([sys.executable, "-c", COMPUTE]) for _ in range(2))
    stood, waited = {}, 0.0
    while first.poll() is None:
        waited = runner._in_line(first.pid, stood)
        time.sleep(0.01)
    second.wait()
    assert waited > 0.1
    assert runner._in_line(first.pid, stood) == pytest.approx(waited, abs=0.05)  # kept of what has ended


def test_a_stopped_run_is_held_to_what_it_says():
    stopped = runner._Run(143, 0, 0, False, "", "stopped; already written: out.tif, out.tif.json\n")
    assert runner._delivered(stopped)
    assert not runner._unnamed([stopped], ["out.tif", "out.tif.json"])
    assert runner._unnamed([stopped], ["out.tif", "more"])
    nothing = runner._Run(143, 0, 0, False, "", "stopped; nothing was written\n")
    assert not runner._delivered(nothing) and not runner._unnamed([nothing], ["out"])


def test_marks():
    before = {"in": "folder", "in/a": "1"}
    assert runner.marks(before, dict(before), success=False, beside=False) == set()
    assert runner.marks(before, {**before, "out": "2"}, success=True, beside=False) == set()
    assert runner.marks(before, {**before, "out": "2"}, success=False, beside=False) == {"left behind"}
    assert runner.marks(before, {**before, ".x.partial": "2"}, success=True, beside=False) == {"left behind"}
    assert runner.marks(before, {**before, "in/a.aux": "2"}, success=True, beside=False) == {"left behind"}
    assert runner.marks(before, {**before, "in/b": "2"}, success=True, beside=True) == set()
    assert runner.marks(before, {"in": "folder", "in/a": "2"}, success=True, beside=False) == {"input changed"}
    assert runner.marks(before, {"in": "folder"}, success=True, beside=False) == {"input changed"}


@pytest.mark.parametrize("how", [damage.binary, damage.text, damage.json_text])
def test_damage_follows_from_the_seed(how):
    data = b'{"a": [1, 2.5, {"b": "text"}], "c": 3}'
    made = [how(data, random.Random(seed)) for seed in range(200)]
    assert made == [how(data, random.Random(seed)) for seed in range(200)]
    assert sum(m != data for m in made) > 180


def test_ten_thousand():
    assert sum(count for _, count in commands.CLASSES.values()) >= 10_000
