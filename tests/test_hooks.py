"""The drop-in steps, run as a pipeline runs them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "sheffield"


def test_post_sparse_writes_a_metric_model_once(tmp_path):
    program = tmp_path / "bin" / "orthoscale"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m orthoscale "$@"\n')
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"}
    workspace = tmp_path / "work"
    shutil.copytree(EXAMPLE / "sparse", workspace / "sparse" / "0")
    hook = [ROOT / "colmap_hooks" / "post_sparse.sh", workspace]
    options = ["--fleet", "US", "--detections", EXAMPLE / "detections.json"]

    first = subprocess.run([*hook, *options], env=environment, capture_output=True, text=True)
    assert first.returncode == 0, first.stderr
    sim3 = workspace / "sparse_metric" / "sim3.txt"
    before = sim3.stat().st_mtime_ns
    second = subprocess.run([*hook, *options], env=environment, capture_output=True, text=True)
    assert second.returncode == 0 and "nothing to do" in second.stdout
    assert sim3.stat().st_mtime_ns == before


def test_a_hook_hands_the_exit_code_on(tmp_path):
    hook = ROOT / "colmap_hooks" / "post_sparse.sh"
    assert subprocess.run([hook], capture_output=True).returncode == 2
