"""`python -m orthoscale`, and the command `orthoscale`: signal handlers come before anything large is loaded."""

from __future__ import annotations

from .system import stopping

stopping.leave_at_once()


def main() -> None:
    """The command line."""
    from .system import quiet

    quiet.open_streams()
    from .cli import main as command_line

    try:
        command_line()
    finally:
        stopping.over()


if __name__ == "__main__":
    main()
