"""`rio orthoscale`: the same commands inside rasterio's own command line."""

from __future__ import annotations

from typing import Any

import click

from .cli.main import Commands
from .cli.options import say
from .errors import OrthoscaleError


class RioCommands(Commands):
    """Handles orthoscale's own errors: rio knows only click's, and would show a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command. An error ends it as in `orthoscale`, with a message and its exit code."""
        try:
            return super().invoke(ctx)
        except OrthoscaleError as error:
            say(*f"error: {error}".split("\n"), err=True)
            ctx.exit(error.exit_code)


@click.group(cls=RioCommands, short_help="Recover the scale of an orthophoto from its vehicles.")
def orthoscale() -> None:
    """Recover the ground sampling distance of an orthophoto from its vehicles.

    \b
    rio orthoscale check ortho.tif --fleet DE
    rio orthoscale fix ortho.tif --out scaled.tif --fleet DE
    """
