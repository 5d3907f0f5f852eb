"""The short form in which a result is printed: a few labelled lines, as text and in a notebook."""

from __future__ import annotations

from html import escape


class Brief:
    """Base of results that `print` and notebooks show by their `brief`."""

    def brief(self) -> list[tuple[str, str]]:
        """Fewer than ten pairs of label and text, the answer first."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return "\n".join(f"{label:10s} {text}" for label, text in self.brief())

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        rows = "".join(f"<tr><th>{escape(label)}</th><td>{escape(text)}</td></tr>" for label, text in self.brief())
        return f"<table>{rows}</table>"
