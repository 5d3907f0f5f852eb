"""Ensures one zlib in the process, whichever of pycolmap and orthoscale is imported first.

pycolmap's wheels for Linux contain a zlib of their own and also load the system's. If nothing has loaded the system's
before, its internal calls are bound to pycolmap's functions, and whatever compresses later (zlib, Pillow, OpenCV, GDAL)
aborts.
"""

from __future__ import annotations

import ctypes
import os
import sys


def settle() -> None:
    """Load the system's libz before pycolmap does; if it is too late for that, load a copy that is bound to itself.

    Modules imported between pycolmap and this call keep the broken one.
    """
    loaded = list(sys.modules)
    if "pycolmap" in loaded and "zlib" not in loaded[: loaded.index("pycolmap")] and hasattr(os, "memfd_create"):
        _load_a_copy()
    import zlib  # noqa: F401


def _load_a_copy() -> None:
    """The loader identifies a library by its file: a copy gets a scope of its own and, being global, is found first."""
    try:
        with open("/proc/self/maps") as maps:
            path = next(line.split()[-1] for line in maps if "/libz.so" in line)
        copy = os.memfd_create("libz")
        with open(path, "rb") as file, open(copy, "wb", closefd=False) as out:
            out.write(file.read())
        ctypes.CDLL(f"/proc/self/fd/{copy}", mode=ctypes.RTLD_GLOBAL)
        os.close(copy)
    except (OSError, StopIteration):  # no libz, and so no clash
        return
