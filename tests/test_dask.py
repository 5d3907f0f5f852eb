"""The sweep on a Dask cluster: the same result as on threads, also when a worker dies."""

from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.cluster import killing_one

from orthoscale.actions import processes
from orthoscale.detect import workers
from orthoscale.detect.detector import Detector
from orthoscale.detect.effort import Effort
from orthoscale.detect.find import find_vehicles
from orthoscale.errors import UsageError
from orthoscale.sources.raster import RasterSource
from orthoscale.system import budget

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def raster(tmp_path_factory):
    town = cv2.imread(str(Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"))
    path = tmp_path_factory.mktemp("raster") / "town.tif"
    cv2.imwrite(str(path), np.tile(town, (2, 2, 1)))
    return RasterSource.open(path)


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes on this machine."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        yield cluster


def swept(raster, **effort):
    return find_vehicles([raster], zoom=0.7, effort=Effort(cache=False, **effort))


@pytest.mark.slow
def test_a_cluster_finds_what_threads_find_and_a_lost_worker_loses_no_tile(raster, cluster):
    local = swept(raster, workers=2)
    (boxes,) = local.boxes.values()
    assert len(boxes) > 100
    assert np.array_equal(swept(raster, scheduler=cluster.scheduler_address).boxes["town.tif"].xylwa, boxes.xylwa)

    # Then again, and one of the two workers is killed as soon as it has something to do.
    with distributed.Client(cluster) as client:
        before = set(client.scheduler_info()["workers"])
        assassin = killing_one(cluster, client)
        again = swept(raster, scheduler=cluster.scheduler_address)
        assassin.join(60)
        assert set(client.scheduler_info()["workers"]) != before, "one worker is gone, or another one in its place"
    assert np.array_equal(again.boxes["town.tif"].xylwa, boxes.xylwa)
    assert len(again.swept.tiles) == again.swept.total


def test_nobody_at_the_address_is_said_so(raster, monkeypatch):
    monkeypatch.setattr("orthoscale.detect.workers.CONNECTING", "1s")
    with pytest.raises(UsageError, match="no Dask scheduler answers at tcp://127.0.0.1:9"):
        swept(raster, scheduler="tcp://127.0.0.1:9")
    with pytest.raises(UsageError, match="no Dask scheduler answers at nonsense"):
        swept(raster, scheduler="nonsense://x")


def test_a_raster_travels_as_its_path(raster):
    import pickle

    other = pickle.loads(pickle.dumps(raster))
    assert other is not raster and np.array_equal(other.read(0, 0, 99, 99, 50, 50), raster.read(0, 0, 99, 99, 50, 50))
    assert pickle.loads(pickle.dumps(raster)) is other, "opened once for all tiles"
    assert Detector(threads=1).card == Detector().card


class Elsewhere:
    """A client of another machine, with a memory budget of its own; what is submitted is done at once."""

    loop = None

    def submit(self, work, *given, **_):
        here, done = budget.memory(), Future()
        budget.allow(budget.LEAST_BYTES)
        try:
            done.set_result(work(*given))
        finally:
            budget.allow(here)
        return done

    def cancel(self, futures):
        assert not futures


def test_the_memory_budget_counts_on_a_cluster_too(monkeypatch):
    monkeypatch.setattr(budget, "_budget", 3 * 2**30)
    monkeypatch.setattr(distributed, "as_completed", lambda futures, loop: list(futures))
    monkeypatch.setattr(workers, "_detector", lambda *settings: None)
    monkeypatch.setattr(workers, "look_twice", lambda *given: budget.memory())
    detector = SimpleNamespace(settings=(None, None, (), False), sha256="")
    assert list(workers._on_cluster(Elsewhere(), {0: (None, None)}, detector)) == [(0, 3 * 2**30)]
    monkeypatch.setattr(processes, "cluster", lambda address: nullcontext(Elsewhere()))
    rows = processes.on_cluster([{"input": "a.tif"}], "tcp://there:1", lambda job: {"exit_code": budget.memory()})
    assert [row["exit_code"] for _, row in rows] == [3 * 2**30]
