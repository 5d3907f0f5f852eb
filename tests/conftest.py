"""What all tests share."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # There is a process for each core already: threads of their own would only wait for each other.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Modules of 20 s and more. They come first, the longest at the front, so that no process is left with one of them when
# the others are done.
LONGEST = (
    "test_seeds.py",
    "test_pipeline.py",
    "test_mapping_programs.py",
    "test_hooks.py",
    "test_ways.py",
    "test_pooling.py",
    "test_against.py",
    "test_outputs_guard.py",
    "test_locate.py",
    "test_control.py",
    "test_notebook.py",
    "test_cli.py",
)


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


def pytest_collection_finish():
    """Thousands of tests and their modules stay to the end: let them not be looked through for garbage."""
    gc.freeze()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real data, or a skip that says where it was looked for.

    ``ORTHOSCALE_DATA``, or else ``shared/data`` beside the repository. It is never part of the project.
    """
    folder = Path(os.environ.get("ORTHOSCALE_DATA") or Path(__file__).parents[2] / "shared" / "data")
    if not (folder / "orthophotos").is_dir():
        pytest.skip(f"no real data in {folder} (set ORTHOSCALE_DATA)")
    return folder


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """Tests keep their looks at tiles to themselves, also those that start the command as a process.

    Processes that share the tests share the looks: a scene that several modules use is looked at once.
    """
    before = os.environ.get("ORTHOSCALE_CACHE")
    own = tmp_path_factory.getbasetemp()
    os.environ["ORTHOSCALE_CACHE"] = str((own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache")
    yield
    if before is None:
        del os.environ["ORTHOSCALE_CACHE"]
    else:
        os.environ["ORTHOSCALE_CACHE"] = before


@pytest.fixture(scope="session")
def flight(tmp_path_factory):
    """The folder of a COLMAP model with its frames, and how its world is turned (3, 3). Tests only read it."""
    from support.models import make_model, put_frames, save

    folder = tmp_path_factory.mktemp("flight")
    model, turn = make_model()
    save(model, folder / "sparse" / "0", "bin")
    put_frames(model, folder / "images")
    return folder, turn


@pytest.fixture(scope="session")
def found(flight):
    """`Detections` of known vehicles in the frames and pictures of the ground of that flight."""
    from support.flights import found_by

    return found_by(*flight)


@pytest.fixture(scope="session")
def measured(flight, found):
    """The `Measurement` of them, in every way. Tests only read it."""
    from support.flights import FLEET

    from orthoscale.core.measuring.ways import measure_source
    from orthoscale.sources.colmap import ColmapSource

    return measure_source(ColmapSource.open(flight[0]), found, FLEET)
