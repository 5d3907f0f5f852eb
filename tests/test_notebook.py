"""The notebook runs from top to bottom, shows pictures, and is stored without what a run leaves."""

from __future__ import annotations

import os
from pathlib import Path

import nbformat
import pytest

nbclient = pytest.importorskip("nbclient")
ROOT = Path(__file__).parent.parent
TOUR = ROOT / "examples" / "tour.ipynb"


@pytest.mark.slow
def test_the_tour_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    notebook = nbformat.read(TOUR, 4)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(TOUR.parent)}}).execute()
    shown = [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in data for data in shown) >= 2
    assert sum("<table>" in data.get("text/html", "") for data in shown) >= 3, "results show themselves"
    text = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    assert text.count("inside the 90 % interval") == 1 and "Did you mean" in text


def test_it_is_stored_without_outputs():
    notebook = nbformat.read(TOUR, 4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
