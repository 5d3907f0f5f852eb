"""Write the tables of standards in docs/anchors.md from what the finders look for.

    python docs/make_anchor_tables.py

Run it after a change of a standard; a test compares.
"""

from __future__ import annotations

from pathlib import Path

from orthoscale.anchors.kinds import ANCHOR_KINDS, finder

PAGE = Path(__file__).parent / "anchors.md"
BEGIN, END = "<!-- standards: made by make_anchor_tables.py -->\n", "<!-- end of standards -->\n"


def tables() -> str:
    """For each kind its standards with their sources, in Markdown."""
    parts = []
    for kind, about in ANCHOR_KINDS.items():
        made = finder(kind, {})
        usual = "" if about.proven else " Only looked for with `--anchors all` or by name."
        parts += [
            f"### {kind}\n",
            f"From {made.finest:g} to {made.coarsest:g} m/px.{usual}\n",
            "| standard | metres | 1 sigma | where | source |\n|---|---|---|---|---|",
            *(
                f"| {s.name} | {s.metres:.5g} | {100 * s.relative_sd:.2g} % | {', '.join(s.countries) or 'anywhere'} "
                f"| {s.source.replace('|', '/')} |"
                for s in sorted(made.standards, key=lambda s: (-s.prior, s.name))
            ),
            "",
        ]
    return "\n".join(parts)


def page() -> str:
    """docs/anchors.md with the tables of today."""
    head, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
