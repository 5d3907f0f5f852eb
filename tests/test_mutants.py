"""The table of mutants fits the program and the tests; `python -m tests.mutants` runs it."""

from pathlib import Path

import pytest
from mutants import MUTANTS


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant.file}: {mutant.becomes}")
def test_each_can_be_made_and_has_its_test(mutant):
    assert mutant.path.read_text(encoding="utf-8").count(mutant.was) == 1
    file, _, name = mutant.test.partition("::")
    assert f"def {name}" in (Path(__file__).parents[1] / file).read_text(encoding="utf-8")
