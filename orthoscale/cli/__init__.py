"""The command line: it parses, calls `actions` and prints."""

from .main import main

__all__ = ["main"]
