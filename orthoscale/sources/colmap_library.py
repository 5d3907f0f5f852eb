"""pycolmap, which only this module imports: its logging takes SIGTERM at import, to print a stack and die."""

from __future__ import annotations

import pycolmap

from ..system import stopping

stopping.listen_again()

__all__ = ["pycolmap"]
