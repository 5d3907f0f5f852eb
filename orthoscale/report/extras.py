"""Files that `fix --also` writes beside a scaled orthophoto, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rasterio.transform import Affine

from ..core.source import Placement, Plan
from ..errors import InputError
from ..formats.csv_table import write_csv
from ..sources.gdal import open_dataset, reading
from ..system.signatures import ours, room
from .geo import check_on_earth, write_geojson, write_geopackage
from .result import Result

TILE_COLUMNS = ("x_px", "y_px", "width_px", "height_px", "vehicles", "used", "m_per_px", "relative_spread")


@dataclass(frozen=True)
class Extra:
    """place : the file's path, from that of the main output. write : writes the file.
    check : raises UsageError, before any work, for a source from which it cannot be made; the second argument says
    whether the copy keeps the source's place.
    mine : whether orthoscale wrote a file at that path, by its content and the main output; for formats that have no
    room for a signature.
    """

    place: Callable[[Path], Path]
    write: Callable[[Result, Placement, Path], None]
    mine: Callable[[Path, Path], bool] | None = None
    check: Callable[[Plan, bool], None] = lambda source, keep_origin: None

    def known(self, out: Path) -> Callable[[Path], bool] | None:
        """`mine`, given the main output `out`."""
        return None if self.mine is None else partial(self.mine, out)


def write_world_file(result: Result, place: Placement, path: Path) -> None:
    """Write six lines: the transform's linear part, then the centre of the first pixel (ESRI's convention)."""
    path.write_text("".join(f"{value:.17g}\n" for value in _world(place.transform)))


def _world(t: Affine) -> tuple[float, ...]:
    return t.a, t.d, t.b, t.e, t.c + (t.a + t.b) / 2, t.f + (t.d + t.e) / 2


def _says_the_same(out: Path, path: Path) -> bool:
    """Whether orthoscale wrote the GeoTIFF `out`, and the world file `path` gives the picture the same place."""
    if not ours(out):
        return False
    try:
        with reading(out, "is not a GeoTIFF", "Write it again."), open_dataset(out) as raster:
            said = [float(line) for line in path.read_text(encoding="ascii").split()]
            return len(said) == 6 and np.allclose(said, _world(raster.transform), rtol=1e-9, atol=1e-9)
    except (InputError, ValueError):
        return False


def write_scale_file(result: Result, place: Placement, path: Path) -> None:
    """Write the scale as the first word, and a description of it after a ``#``."""
    low, high = result.scale.interval90
    path.write_text(
        f"{result.scale.value:.17g}  # {result.scale.unit}, 90 % from {low:.6g} to {high:.6g}, "
        f"{result.scale.vehicles_used} vehicles, fleet {result.scale.fleet}; {room(path)}\n",
        encoding="utf-8",
        errors="backslashreplace",  # the fleet's name may be that of its file
    )


def write_tiles(result: Result, place: Placement, path: Path) -> None:
    """Write a line per processed tile: its place, the number of its vehicles, and the scale from them."""
    swept = result.detections.swept
    votes, scale = result.votes, result.scale
    rows = []
    if swept is not None:
        tiles = [tile for _, tile in swept.tiles]
        centre = np.array([[t.x + t.width / 2, t.y + t.height / 2] for t in tiles])
        span = np.array([[t.width, t.height] for t in tiles])
        deviation = result.vehicles["scale_deviation"]
        # Tiles overlap: a vehicle counts in the one whose centre is nearest.
        owner = np.array([np.argmin((np.abs(p - centre) / span).max(1)) for p in votes.place], int)
        for k, tile in enumerate(tiles):
            here, used = owner == k, (owner == k) & scale.used
            n = int(used.sum())
            local = f"{scale.value * np.exp(deviation[used].mean()):.6g}" if n else None
            spread = f"{deviation[used].std(ddof=1):.4g}" if n > 1 else None
            values = [tile.x, tile.y, tile.width, tile.height, int(here.sum()), n, local, spread]
            rows.append(dict(zip(TILE_COLUMNS, values, strict=True)))
    write_csv(path, TILE_COLUMNS, rows)


WRITERS = {
    "tfw": Extra(lambda out: out.with_suffix(".tfw"), write_world_file, _says_the_same),
    "scale": Extra(lambda out: out.with_name(f"{out.name}.scale.txt"), write_scale_file),
    "gpkg": Extra(lambda out: out.with_name(f"{out.name}.gpkg"), write_geopackage),
    "geojson": Extra(lambda out: out.with_name(f"{out.name}.geojson"), write_geojson, check=check_on_earth),
    "tiles": Extra(lambda out: out.with_name(f"{out.name}.tiles.csv"), write_tiles),
}


def chosen(kinds: Sequence[str]) -> list[Extra]:
    """The WRITERS that `kinds` names, each once, in the order of `kinds`."""
    return [WRITERS[kind] for kind in dict.fromkeys(kinds)]
