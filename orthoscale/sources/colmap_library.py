"""pycolmap, which only this module imports: its logging takes SIGTERM at import, to print a stack and die."""

from __future__ import annotations

from ..system import stopping

with stopping.unheard_by_libraries():
    import pycolmap

__all__ = ["pycolmap"]
