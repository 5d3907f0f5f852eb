"""`orthoscale fleets`: the vehicle sizes of each country."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from .options import command, debug_option, json_option

if TYPE_CHECKING:
    from ..core.fleet import Fleet

EXAMPLES = """\b
Examples:
  orthoscale fleets             all of them, with the shares of their segments
  orthoscale fleets JP India    two of them in full: classes, sizes, sources
  orthoscale fleets --json      for machines
"""


@command(epilog=EXAMPLES)
@click.argument("codes", nargs=-1)
@json_option("the fleets")
@debug_option
def fleets(codes: tuple[str, ...], as_json: bool, debug: bool) -> None:
    """List the vehicle fleets, with sizes and sources.

    CODES are codes or names of countries: these fleets in full. Without them all are listed, in short.
    """
    from ..fleets import fleet_codes, load_fleet

    table = [load_fleet(code) for code in codes or fleet_codes()]
    if as_json:
        click.echo(json.dumps([_plain(f) for f in table], indent=1, ensure_ascii=False))
        return
    for f in table:
        click.echo(_in_full(f) if codes else _in_short(f))


def _plain(fleet: Fleet) -> dict[str, Any]:
    return {
        "code": fleet.code,
        "name": fleet.name,
        "mean": fleet.mean.tolist(),
        "sd": fleet.sd.tolist(),
        "mean_sd": fleet.mean_sd.tolist(),
        "year": fleet.year,
        "source": fleet.source,
        "classes": [
            {
                "class": c.name,
                "share": round(c.weight, 4),
                "mean": c.mean.round(3).tolist(),
                "sd": c.sd.round(3).tolist(),
                "mean_sd": c.mean_sd.round(3).tolist(),
                "corr_LW": round(c.corr_lw, 2),
            }
            for c in fleet.classes
        ],
        "shares_source": fleet.shares_source,
    }


def _in_short(fleet: Fleet) -> str:
    sizes = " x ".join(f"{m:.2f}" for m in fleet.mean)
    known = 100 * fleet.mean_sd[0] / fleet.mean[0]
    mix = ", ".join(f"{c.name} {100 * c.weight:.0f} %" for c in fleet.classes)
    mix = mix if len(fleet.classes) > 1 else "one class: " + (fleet.shares_source or "no shares given")
    return f"{fleet.code:10s} {sizes} m  (mean length known to {known:.1f} %)  {fleet.name}\n{'':10s} {mix}"


def _in_full(fleet: Fleet) -> str:
    """A table of the classes: means with the spread between vehicles, and how well the mean length is known."""
    lines = [
        f"{fleet.code}: {fleet.name}, {fleet.year}",
        f"  {'class':22s} {'share':>6s}   {'length':>11s}  {'width':>11s}  {'height':>11s} m   length known to",
    ]
    for c in fleet.classes:
        sizes = "  ".join(f"{m:.2f} +- {s:.2f}" for m, s in zip(c.mean, c.sd, strict=True))
        lines.append(f"  {c.name:22s} {100 * c.weight:5.1f} %  {sizes}     {100 * c.mean_sd[0] / c.mean[0]:.1f} %")
    sizes = "  ".join(f"{m:.2f} +- {s:.2f}" for m, s in zip(fleet.mean, fleet.sd, strict=True))
    lines.append(f"  {'all':22s} {'':7s}  {sizes}     {100 * fleet.mean_sd[0] / fleet.mean[0]:.1f} %")
    lines += [f"  sizes: {fleet.source}", f"  shares: {fleet.shares_source or 'one class'}"]
    return "\n".join(lines)
