"""`python -m orthoscale`, and the command `orthoscale`. Signal handlers are set before anything large is imported."""

from __future__ import annotations

from .system import stopping

stopping.leave_at_once()


def main() -> None:
    """Run the command line."""
    from .system import quiet

    quiet.open_streams()
    from .cli import main as command_line

    try:
        command_line()
    finally:
        stopping.over()


if __name__ == "__main__":
    main()
