"""Make orthophotos of any size, from rendered scenes or real frames, for the benchmarks of the sweep.

    python benchmarks/large_raster.py OUT.tif --mpx 460 --scenes FOLDER [--compress deflate] [--overviews]
    python benchmarks/large_raster.py OUT.tif --mpx 460 --frames ../shared/data/reconstructions/sheffield/images

Thirty scenes of 2048 x 2048 px at 0.1 m/px are rendered once and kept in FOLDER (five minutes of one core). The raster
is a grid of them, each turned and mirrored at random. Most blocks are parks and villages with few vehicles, as in most
surveys; a third of the blocks have streets or car parks. Frames, all of one size, are used in the same way, with equal
shares. The seed determines everything.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.windows import Window

from orthoscale.fleets import load_fleet
from orthoscale.synthetic import make_scene, render_ortho

SIDE, GSD = 2048, 0.1
# style, vehicles, scenes of it, share of the blocks
KINDS = [
    ("park", 0, 6, 0.35),
    ("park", 6, 4, 0.15),
    ("village", 20, 6, 0.2),
    ("suburb", 90, 5, 0.1),
    ("city", 140, 5, 0.1),
    ("carpark", 200, 4, 0.1),
]


def scenes(folder: Path) -> list[list[Path]]:
    """Files of rendered scenes, by kind; missing ones are rendered."""
    folder.mkdir(parents=True, exist_ok=True)
    files: list[list[Path]] = []
    for k, (style, vehicles, count, _) in enumerate(KINDS):
        files.append([folder / f"{style}_{vehicles}_{n}.png" for n in range(count)])
        for n, path in enumerate(files[-1]):
            if path.exists():
                continue
            scene = make_scene(100 * k + n, load_fleet("DE"), SIDE * GSD, vehicles, style)
            image, _ = render_ortho(scene, GSD, seed=100 * k + n)
            part = path.with_suffix(".part.png")
            cv2.imwrite(str(part), cv2.cvtColor(image[:SIDE, :SIDE], cv2.COLOR_RGB2BGR))
            part.rename(path)
    return files


def make(
    out: Path, mpx: float, files: list[list[Path]], shares: list[float], compress: str, overviews: bool, seed: int = 0
) -> None:
    """Write a grid of blocks, each a picture of one kind of `files`; kinds are drawn by `shares`."""
    rng = np.random.default_rng(seed)
    pictures = {p: cv2.cvtColor(cv2.imread(str(p)), cv2.COLOR_BGR2RGB) for kind in files for p in kind}
    height, width = next(iter(pictures.values())).shape[:2]
    rows, columns = (max(1, round(np.sqrt(mpx * 1e6) / side)) for side in (height, width))
    profile = {"driver": "GTiff", "width": columns * width, "height": rows * height, "count": 3, "dtype": "uint8"}
    profile |= {"tiled": True, "blockxsize": 512, "blockysize": 512, "compress": compress, "bigtiff": "IF_SAFER"}
    profile |= {"photometric": "YCBCR", "jpeg_quality": 90} if compress == "jpeg" else {"predictor": 2, "zlevel": 1}
    profile |= {"num_threads": 2, "interleave": "pixel"}
    with rasterio.Env(GDAL_CACHEMAX=256 * 2**20):
        with rasterio.open(out, "w", **profile) as raster:
            for row in range(rows):
                for column in range(columns):
                    kind = files[rng.choice(len(files), p=shares)]
                    quarters = rng.integers(4) if width == height else 2 * rng.integers(2)
                    block = np.rot90(pictures[kind[rng.integers(len(kind))]], quarters)
                    if rng.random() < 0.5:
                        block = block[:, ::-1]
                    window = Window(column * width, row * height, width, height)
                    raster.write(np.moveaxis(block, -1, 0), window=window)
        if overviews:
            with rasterio.open(out, "r+") as raster:
                raster.build_overviews([2, 4, 8, 16, 32], Resampling.average)
    print(f"{out}: {columns * width} x {rows * height} px, {out.stat().st_size / 1e6:.0f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--mpx", type=float, default=460)
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("--scenes", type=Path, help="folder that keeps the rendered scenes")
    given.add_argument("--frames", type=Path, help="folder of real frames")
    parser.add_argument("--compress", choices=("deflate", "jpeg"), default="deflate")
    parser.add_argument("--overviews", action="store_true")
    a = parser.parse_args()
    if a.scenes:
        make(a.out, a.mpx, scenes(a.scenes), [share for *_, share in KINDS], a.compress, a.overviews)
    else:
        frames = sorted(p for p in a.frames.iterdir() if p.suffix.lower() in (".jpg", ".jpeg", ".png"))
        make(a.out, a.mpx, [frames], [1.0], a.compress, a.overviews)


if __name__ == "__main__":
    main()
