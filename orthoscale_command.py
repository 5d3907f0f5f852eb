"""The command `orthoscale`, as pip installs it: Ctrl-C while the package itself is being imported is heard as well."""

from __future__ import annotations

import sys


def main() -> None:
    """The command line. `orthoscale.__main__` hears signals from its import on; until then Python raises them."""
    try:
        from orthoscale.__main__ import main as command_line
    except KeyboardInterrupt:
        print("stopped; nothing was written", file=sys.stderr)
        sys.exit(130)  # as shells count: 128 and the signal's number
    command_line()
