"""What benchmarks, examples, hooks and training take from the package is there: nobody runs them all after a change."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPTS = [
    path for folder in ("benchmarks", "examples", "colmap_hooks", "training") for path in (ROOT / folder).rglob("*.py")
]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_name_that_a_script_takes_is_there(path):
    taken = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
    missing = []
    for node in taken:
        if node.level or not node.module or node.module.split(".")[0] not in ("orthoscale", "support"):
            continue
        home = importlib.import_module(node.module)
        missing += [
            f"{node.module}.{name.name}"
            for name in node.names
            if not hasattr(home, name.name) and importlib.util.find_spec(f"{node.module}.{name.name}") is None
        ]
    assert not missing


def test_the_scripts_are_found():
    assert len(SCRIPTS) > 40
