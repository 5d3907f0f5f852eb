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


DEPTH_PICTURES = (".jp2", ".pgm", ".png", ".tif", ".tiff")
DEPTH_MODES = ("F", "I")
"""How Pillow's names of the modes of one band with more than 8 bits begin."""


def has_lengths(path: Path, frame: bool = False) -> bool:
    """Whether the file at `path` may contain lengths; true for unknown kinds. frame : whether it lies among the frames,
    whose pictures have none; others may be depth maps or elevations if they have one band with more than 8 bits."""
    ending = path.suffix.lower()
    if ending == ".bin":
        return path.parent.name not in LENGTHLESS_MAPS
    return ending not in LENGTHLESS or (not frame and ending in DEPTH_PICTURES and _may_be_depth(path))


def _may_be_depth(path: Path) -> bool:
    """Whether a picture's header says that it has one band with more than 8 bits; false for one that is unreadable."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return picture.mode.startswith(DEPTH_MODES)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return False
