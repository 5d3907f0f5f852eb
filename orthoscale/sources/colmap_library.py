"""Imports pycolmap in one place, so that its logging does not take over SIGTERM (to print a stack trace and die)."""

from __future__ import annotations

from ..system import stopping

with stopping.unheard_by_libraries():
    import pycolmap

__all__ = ["pycolmap"]
