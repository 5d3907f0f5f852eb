"""Failures of a Dask cluster."""

import os
import signal
import threading
import time


def killing_one(cluster, client):
    """Start and return a thread that kills a worker of `cluster` as soon as any has work."""

    def kill():
        while not any(client.processing().values()):
            time.sleep(0.01)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    return thread
