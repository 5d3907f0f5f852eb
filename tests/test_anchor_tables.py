"""The tables of standards: every kind has them, with sources, and the page shows them as they are."""

import sys
from pathlib import Path

import pytest

from orthoscale.anchors import kinds
from orthoscale.anchors.kinds import ANCHOR_KINDS, finder

DOCS = Path(__file__).parent.parent / "docs"


def test_the_page_shows_the_standards_that_finders_have(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    import make_anchor_tables

    assert make_anchor_tables.page() == make_anchor_tables.PAGE.read_text(), "run docs/make_anchor_tables.py"


@pytest.mark.parametrize("kind", ANCHOR_KINDS)
def test_every_kind_is_what_the_table_says(kind):
    made = finder(kind, {})
    assert made.kind == kind and made.extent > 0 and made.finest < made.coarsest
    assert made.standards
    for standard in made.standards:
        assert standard.name and standard.source and standard.metres > 0 and 0 < standard.relative_sd < 0.2
        assert standard.prior > 0 and all(code.isupper() for code in standard.countries)


@pytest.mark.slow
def test_no_finder_is_imported_before_it_is_needed():
    import subprocess

    code = (
        "import sys, orthoscale.requests, orthoscale.anchors.kinds as k; "
        "names = {kind.finder.partition(':')[0] for kind in k.ANCHOR_KINDS.values()}; "
        "sys.exit(any(f'orthoscale.anchors.{name}' in sys.modules for name in names) or 'scipy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_kinds_are_chosen_by_their_names(monkeypatch):
    table = {"tennis court": kinds.Kind("a:A", True), "lane dashes": kinds.Kind("b:B")}
    monkeypatch.setattr(kinds, "ANCHOR_KINDS", table)
    assert kinds.chosen(["proven"]) == ["tennis court"] and kinds.chosen(["all"]) == ["tennis court", "lane dashes"]
    assert kinds.chosen(["lane-dashes"]) == ["lane dashes"] and kinds.chosen(["none"]) == []
