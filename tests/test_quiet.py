"""What libraries in C print does not reach the user; what Python prints does."""

import os
import subprocess
import sys

import pytest
from support.reports import car_park

SAID = """
import logging, os, sys
from orthoscale.system import quiet
print("before", file=sys.stderr)
with quiet.unheard():
    os.write(2, b"libpng warning: iCCP: known incorrect sRGB profile\\n")
    print("within", file=sys.stderr)
    sys.excepthook(KeyboardInterrupt, KeyboardInterrupt("within a callback of rasterio's"), None)
    log = logging.StreamHandler()
log.emit(logging.LogRecord("", logging.ERROR, "", 0, "a log begun within", (), None))
os.write(2, b"after\\n")
"""


@pytest.mark.slow
def test_only_python_is_heard():
    done = subprocess.run([sys.executable, "-c", SAID], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.split("\n")[:-1]) == (0, ["before", "within", "a log begun within", "after"])


@pytest.mark.slow
def test_without_a_standard_error_nothing_breaks():
    line = "import os; os.close(2); from orthoscale.system import quiet\nwith quiet.unheard(): print('fine')"
    done = subprocess.run([sys.executable, "-c", line], stdout=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "fine\n")


@pytest.mark.slow
def test_a_command_whose_streams_are_closed_does_its_work(tmp_path):
    """`fix ... >&- 2>&-` ended with 1 and wrote nothing; files took the descriptors of the streams."""
    car_park(tmp_path)
    files = tmp_path / "park.png", "--detections", tmp_path / "detections.json"
    command = [sys.executable, "-m", "orthoscale", "fix", *files, "--fleet", "DE", "--anchors", "none"]
    for number, closed in enumerate((">&- 2>&-", "<&- >&- 2>&-", "2>&-")):
        line = f'exec "$0" "$@" {closed}'
        out = tmp_path / f"out{number}.tif"
        done = subprocess.run(["sh", "-c", line, *map(str, command), "--out", out], timeout=120)
        assert done.returncode == 0 and out.is_file()


def test_the_network_tells_nobody_that_it_is_used(tmp_path):
    """onnxruntime keeps an identifier of the machine in the user's cache before it reports; there must be none."""
    program = "from orthoscale.detect.detector import Detector; Detector()"
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("date", ["", "abc"])
def test_a_date_for_builds_that_is_none_does_not_matter(date):
    """Numpy, as scipy imports it, ended the program with "invalid literal for int()"."""
    program = "import orthoscale; orthoscale.Scale"
    environment = {**os.environ, "SOURCE_DATE_EPOCH": date}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_letters_that_standard_output_cannot_hold_are_escaped(tmp_path):
    """`fix` ended with 1, as by a bug, after the copy was in place: in ISO-8859-1, and into files on Windows."""
    car_park(tmp_path)
    words = ["park.png", "--detections", "detections.json", "--fleet", "DE", "--anchors", "none", "--out", "市.tif"]
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    command = [sys.executable, "-m", "orthoscale", "fix", *words]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert rb"written    \u5e02.tif" in done.stdout
