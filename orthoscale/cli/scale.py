"""`orthoscale estimate` and `orthoscale fix`: the scale of an orthophoto or a model, printed or written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from .options import EXIT_CODES, evidence_options, progress_bars


@click.command(
    epilog="\b\nExamples:\n  orthoscale estimate ortho.tif --fleet DE\n"
    "  orthoscale estimate sparse/0 --images frames/ --fleet US --json\n\n" + EXIT_CODES
)
@evidence_options
def estimate(path: Path, as_json: bool, debug: bool, save_detections: Path | None, **options: Any) -> None:
    """Print the scale of INPUT, an orthophoto or the folder of a COLMAP model, and write nothing."""
    from .. import pipeline

    with progress_bars() as progress:
        result = pipeline.estimate(path, progress=progress, **options)
    _finish(result, as_json, save_detections)


@click.command(
    epilog="\b\nExamples:\n  orthoscale fix ortho.tif --out scaled.tif --fleet PH\n"
    "  orthoscale fix utm.tif --out scaled.tif --override --keep-origin --also gpkg --also tfw\n"
    "  orthoscale fix model/ --out scaled/ --fleet US\n"
    "  orthoscale fix model/ --out scaled/ --detections boxes.json\n\n" + EXIT_CODES
)
@evidence_options
@click.option("--out", required=True, type=click.Path(path_type=Path), help="GeoTIFF or folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace what is at --out.")
@click.option("--override", is_flag=True, help="Rescale although INPUT says that it is in metres.")
@click.option("--keep-origin", is_flag=True, help="Keep an orthophoto's CRS, first corner and direction.")
@click.option("--cog", is_flag=True, help="Write a cloud-optimised GeoTIFF.")
@click.option(
    "--also",
    multiple=True,
    type=click.Choice(["tfw", "scale", "gpkg", "geojson", "tiles"]),
    help="More files beside OUT: world file, plain scale, vehicles (GeoPackage, GeoJSON), statistics per tile.",
)
@click.option("--force", is_flag=True, help="Write although the evidence is poor or disagrees.")
def fix(path: Path, out: Path, as_json: bool, debug: bool, save_detections: Path | None, **options: Any) -> None:
    """Write a copy of INPUT in metres: an orthophoto with its GSD, or a COLMAP model rescaled.

    An orthophoto's pixels are copied as they are; OUT.json and OUT.png come with it. A model is scaled about its own
    origin; sim3.txt, report.json and vehicles.png come with it. INPUT is never touched.
    """
    from .. import pipeline

    with progress_bars() as progress:
        result = pipeline.fix(path, out, progress=progress, **options)
    _finish(result, as_json, save_detections, out)


def _finish(result: Any, as_json: bool, save_detections: Path | None, out: Path | None = None) -> None:
    if save_detections is not None:
        from ..atomic import new_file

        with new_file(save_detections, overwrite=True) as partial:
            result.detections.save(partial)
    if as_json:
        from ..report.document import document

        click.echo(json.dumps(document(result)))
    else:
        from ..report.terminal import summary

        click.echo(summary(result, out))
