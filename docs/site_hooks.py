"""What the documentation site has beside the pages of docs/: those of other folders."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
ELSEWHERE = {
    "hooks.md": "colmap_hooks/README.md",
    "benchmarks.md": "benchmarks/README.md",
    **{
        f"results/{page.name}": f"benchmarks/results/{page.name}"
        for page in sorted((ROOT / "benchmarks/results").glob("*.md"))
    },
}
"""Pages of the site, and the files of the repository that they are."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from elsewhere."""
    for name, path in ELSEWHERE.items():
        files.append(File.generated(config, name, content=(ROOT / path).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links between pages that lie elsewhere in the repository lead to where they are on the site."""
    up = "../" * page.file.src_uri.count("/")
    for name, path in ELSEWHERE.items():
        markdown = markdown.replace(f"](../{up}{path}", f"]({up}{name}")
    if page.file.src_uri in ELSEWHERE:
        markdown = markdown.replace(f"](../{up}docs/", f"]({up}")
    return markdown
