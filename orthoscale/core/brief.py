"""The short form of a result when it is printed: a few labelled lines, as text and in a notebook."""

from __future__ import annotations

from html import escape


class Brief:
    """What has a `brief`, which `print` and notebooks show."""

    def brief(self) -> list[tuple[str, str]]:
        """Labels and texts, the answer first, fewer than ten."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return "\n".join(f"{label:10s} {text}" for label, text in self.brief())

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        rows = "".join(f"<tr><th>{escape(label)}</th><td>{escape(text)}</td></tr>" for label, text in self.brief())
        return f"<table>{rows}</table>"
