"""`orthoscale fleets`: lists the fleets, and makes one from a register of vehicles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.market_segments import AXES
from ..errors import UsageError
from ..system.printing import echo
from .options import PATH, command, debug_option, json_option, option, overwrite_option, refuse_idle_overwrite, say

if TYPE_CHECKING:
    from ..core.fleet import Fleet

EXAMPLES = """\b
Examples:
  orthoscale fleets             all of them, with the shares of their segments
  orthoscale fleets JP India    two of them in full: classes, sizes, sources
  orthoscale fleets --json      for machines
  orthoscale fleets --registrations district.csv --out district.json
  orthoscale fix ortho.tif --fleet district.json --out scaled.tif

\b
Exit codes: 0 done; 2 usage; 3 a register of mostly unknown models;
5 input unreadable or damaged; 6 output could not be written.
"""
MOST_UNKNOWN = 10  # most models of unknown size that are listed


@command(epilog=EXAMPLES)
@click.argument("codes", nargs=-1)
@option(
    "--registrations",
    type=PATH,
    metavar="CSV",
    group="Input",
    help="Make a fleet from a register with columns model and count, and make if known.",
)
@option("--out", type=PATH, group="Main", help="Where to write it, as JSON for --fleet.")
@overwrite_option
@json_option("the fleets")
@debug_option
def fleets(
    codes: tuple[str, ...], registrations: Path | None, out: Path | None, overwrite: bool, as_json: bool
) -> None:
    """List the vehicle fleets, with sizes and sources.

    CODES are codes or names of countries: these fleets in full. Without them all are listed, in short.
    """
    from ..fleets import fleet_codes, load_fleet

    refuse_idle_overwrite(overwrite, out)
    if (registrations is None) != (out is None) or (codes and out):
        raise UsageError(
            "--registrations and --out go together, and without codes",
            "Such as: orthoscale fleets --registrations register.csv --out fleet.json.",
        )
    if registrations is not None and out is not None:
        _from_register(registrations, out, overwrite, as_json)
        return

    table = [load_fleet(code) for code in codes or sorted(fleet_codes())]
    if as_json:
        echo(json.dumps([_plain(f) for f in table], indent=1, ensure_ascii=False))
        return
    for f in table:
        echo(_in_full(f) if codes else _in_short(f))


def _from_register(path: Path, out: Path, overwrite: bool, as_json: bool) -> None:
    from ..registrations import fleet_of_register
    from ..system.outputs import Outputs

    with Outputs(overwrite, (path,)) as outputs:
        partial = outputs.file(out)
        register = fleet_of_register(path)
        text = json.dumps(register.entry, indent=1, ensure_ascii=False)
        partial.write_text(text, encoding="utf-8")
    if as_json:
        echo(text)
        return
    sizes = ", ".join(f"{axis} {register.entry[axis][0]:.2f} +- {register.entry[axis][1]:.2f} m" for axis in AXES)
    lines = [
        f"vehicles   {register.vehicles:,.0f}, {100 * register.known:.0f} % of models whose size is known",
        f"fleet      {sizes}; mean length known to {register.entry['mean_sd'][0]:.2f} m",
    ]
    lines += [f"not known  {name}: {100 * share:.1f} %" for name, share in register.unknown[:MOST_UNKNOWN]]
    if len(register.unknown) > MOST_UNKNOWN:
        rest = sum(share for _, share in register.unknown[MOST_UNKNOWN:])
        lines.append(f"not known  {len(register.unknown) - MOST_UNKNOWN} more: {100 * rest:.1f} %")
    say(*lines, f"written    {out}")


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
            for c in fleet.every_class
        ],
        "shares_source": fleet.shares_source,
    }


def _in_short(fleet: Fleet) -> str:
    sizes = " x ".join(f"{m:.2f}" for m in fleet.mean)
    known = 100 * fleet.mean_sd[0] / fleet.mean[0]
    mix = ", ".join(f"{c.name} {100 * c.weight:.0f} %" for c in fleet.every_class)
    mix = mix if len(fleet.classes) > 1 else "one class: " + (fleet.shares_source or "no shares given")
    return f"{fleet.code:10s} {sizes} m  (mean length known to {known:.1f} %)  {fleet.name}\n{'':10s} {mix}"


def _in_full(fleet: Fleet) -> str:
    """A table of the classes: means with the spread between vehicles, and the uncertainty of the mean length."""
    lines = [
        f"{fleet.code}: {fleet.name}" + (f", {fleet.year}" if fleet.year else ""),
        f"  {'class':22s} {'share':>6s}   {'length':>11s}  {'width':>11s}  {'height':>11s} m   length known to",
    ]
    for c in fleet.every_class:
        sizes = "  ".join(f"{m:.2f} +- {s:.2f}" for m, s in zip(c.mean, c.sd, strict=True))
        lines.append(f"  {c.name:22s} {100 * c.weight:5.1f} %  {sizes}     {100 * c.mean_sd[0] / c.mean[0]:.1f} %")
    sizes = "  ".join(f"{m:.2f} +- {s:.2f}" for m, s in zip(fleet.mean, fleet.sd, strict=True))
    whole = "all" if fleet.three_wheelers is None else "all cars"
    lines.append(f"  {whole:22s} {'':7s}  {sizes}     {100 * fleet.mean_sd[0] / fleet.mean[0]:.1f} %")
    lines += [f"  sizes: {fleet.source}", f"  shares: {fleet.shares_source or 'one class'}"]
    return "\n".join(lines)
