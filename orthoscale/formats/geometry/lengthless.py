"""Decides which files of a workspace contain no lengths, so that they can be copied unchanged."""

from __future__ import annotations

from pathlib import Path

LENGTHLESS = frozenset(
    [
        ".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tga", ".tif", ".tiff", ".webp",
        ".bat", ".cfg", ".conf", ".ini", ".log", ".md", ".mtl", ".sh", ".toml", ".vis", ".yaml", ".yml",
    ]
)  # fmt: skip
"""Endings of pictures and settings. A text (.txt) may hold anything, projection matrices and points too."""

LENGTHLESS_MAPS = {"normal_maps", "consistency_graphs"}
"""COLMAP's folders of ``.bin`` files without lengths."""


def has_lengths(path: Path) -> bool:
    """Whether the file at `path` may contain lengths, by its name; true for unknown kinds."""
    if path.suffix.lower() == ".bin":
        return path.parent.name not in LENGTHLESS_MAPS
    return path.suffix.lower() not in LENGTHLESS
