"""What the documentation site has beside the pages of docs/: those of other folders, and the report's JSON Schema."""

from __future__ import annotations

import json
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from orthoscale.report.schema import report_schema

ROOT = Path(__file__).parent.parent
ELSEWHERE = {"hooks.md": "colmap_hooks/README.md", "benchmarks.md": "benchmarks/README.md"}
"""Pages of the site, and the files of the repository that they are."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from elsewhere and the schema."""
    for name, path in ELSEWHERE.items():
        files.append(File.generated(config, name, content=(ROOT / path).read_text(encoding="utf-8")))
    schema = json.dumps(report_schema(), indent=1) + "\n"
    files.append(File.generated(config, "reference/report.schema.json", content=schema))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links between pages that lie elsewhere in the repository lead to where they are on the site."""
    for name, path in ELSEWHERE.items():
        markdown = markdown.replace(f"](../{path}", f"]({name}")
    if page.file.src_uri in ELSEWHERE:
        markdown = markdown.replace("](../docs/", "](")
    return markdown
