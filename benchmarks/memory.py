"""Peak memory of `orthoscale estimate` against the size of the raster.

    python benchmarks/memory.py RASTER.tif [RASTER.vrt ...] [-- --exhaustive --zoom 0.8 ...]

`--grid N RASTER.tif OUT.vrt` only makes a mosaic of N x N copies, for sizes that would not fit on the disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from xml.sax.saxutils import escape

import rasterio


def mosaic(raster: Path, count: int, out: Path) -> None:
    """Write a VRT of count x count copies, side by side, of a raster of three 8-bit bands."""
    with rasterio.open(raster) as d:
        width, height = d.width, d.height
    bands = []
    for band in (1, 2, 3):
        parts = [
            f'<SimpleSource><SourceFilename relativeToVRT="0">{escape(str(raster.resolve()))}</SourceFilename>'
            f'<SourceBand>{band}</SourceBand><SrcRect xOff="0" yOff="0" xSize="{width}" ySize="{height}"/>'
            f'<DstRect xOff="{x * width}" yOff="{y * height}" xSize="{width}" ySize="{height}"/></SimpleSource>'
            for y in range(count)
            for x in range(count)
        ]
        colour = ("Red", "Green", "Blue")[band - 1]
        bands.append(
            f'<VRTRasterBand dataType="Byte" band="{band}"><ColorInterp>{colour}</ColorInterp>'
            f"{''.join(parts)}</VRTRasterBand>"
        )
    size = f'rasterXSize="{count * width}" rasterYSize="{count * height}"'
    out.write_text(f"<VRTDataset {size}>{''.join(bands)}</VRTDataset>")


def peak(raster: Path, options: list[str]) -> tuple[float, float, float, str]:
    """Peak memory [MB], wall and processor seconds, and the first line of the answer."""
    job = [sys.executable, "-m", "orthoscale", "estimate", str(raster), "--no-cache", *options]
    start = time.perf_counter()
    process = subprocess.Popen(job, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    answer = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{raster}: failed")
    used = usage.ru_utime + usage.ru_stime
    return usage.ru_maxrss / 1e3, time.perf_counter() - start, used, answer.splitlines()[0]


def main() -> None:
    arguments = sys.argv[1:]
    if not arguments or "-h" in arguments or "--help" in arguments:
        sys.exit(__doc__)
    if arguments[0] == "--grid":
        mosaic(Path(arguments[2]), int(arguments[1]), Path(arguments[3]))
        return
    split = arguments.index("--") if "--" in arguments else len(arguments)
    print("| raster | Mpx | peak MB | wall s | processor s | answer |\n|---|---|---|---|---|---|")
    for raster in map(Path, arguments[:split]):
        with rasterio.open(raster) as d:
            mpx = d.width * d.height / 1e6
        memory, wall, processor, answer = peak(raster, arguments[split + 1 :])
        row = (raster.name, f"{mpx:.0f}", f"{memory:.0f}", f"{wall:.0f}", f"{processor:.1f}", " ".join(answer.split()))
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
