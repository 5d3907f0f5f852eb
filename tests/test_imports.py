"""Whoever is imported first: pictures are written, in a process of their own for each order."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parent.parent / "examples" / "sheffield"
FIX = """
import sys
import numpy as np
orthoscale.fix({example!r} + "/sparse", sys.argv[1], fleet="US", mode="planar",
               detections={example!r} + "/detections.json")
from orthoscale.formats.pictures import write_png
from pathlib import Path
write_png(Path(sys.argv[1]) / "noise.png", np.random.default_rng(0).integers(0, 255, (300, 200, 3), np.uint8))
import rasterio
with rasterio.open(sys.argv[1] + "/a.tif", "w", driver="GTiff", width=64, height=64, count=1, dtype="uint8",
                   compress="deflate") as file:
    file.write(np.arange(4096, dtype=np.uint8).reshape(1, 64, 64))
"""


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("other", ["pycolmap", "torch", "open3d"])
def test_both_orders(other, first, tmp_path):
    if importlib.util.find_spec(other) is None:
        pytest.skip(f"{other} is not installed")
    imports = [f"import {other}", "import orthoscale"]
    code = "\n".join([*(imports if first else imports[::-1]), FIX.format(example=str(EXAMPLE))])
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLE.parents[1])}
    command = [sys.executable, "-c", code, str(tmp_path / "out")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "out/vehicles.png").read_bytes()[-8:-4] == b"IEND"
    assert (tmp_path / "out/noise.png").stat().st_size > 150_000 and (tmp_path / "out/a.tif").is_file()


def test_help_is_there_at_once():
    """It needs no numpy, whose import alone takes longer than all of the rest."""
    code = "import sys; from orthoscale.cli.main import cli; cli(['fix', '--help'], standalone_mode=False); "
    code += "assert 'numpy' not in sys.modules"
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLE.parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "--against" in done.stdout, done.stderr[-2000:]
