"""`orthoscale fleets`: what the rulers are made of."""

from __future__ import annotations

import json

import click


@click.command()
@click.option("--json", "as_json", is_flag=True)
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def fleets(as_json: bool, debug: bool) -> None:
    """List the built-in fleets: sizes, how well they are known, and their sources."""
    from ..fleet import Fleet, codes

    table = [Fleet.load(code) for code in codes()]
    if as_json:
        rows = [
            {
                "code": f.code,
                "name": f.name,
                "mean": f.mean.tolist(),
                "sd": f.sd.tolist(),
                "mean_sd": f.mean_sd.tolist(),
                "year": f.year,
                "source": f.source,
            }
            for f in table
        ]
        click.echo(json.dumps(rows, indent=1, ensure_ascii=False))
        return
    for f in table:
        sizes = " x ".join(f"{m:.2f}" for m in f.mean)
        click.echo(f"{f.code:10s} {sizes} m  (mean length known to {100 * f.mean_sd[0] / f.mean[0]:.1f} %)  {f.name}")
