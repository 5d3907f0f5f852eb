"""``python -m orthoscale.synthetic labels OUT``: synthetic pictures with exact truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from orthoscale.synthetic.labels import write_labels


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m orthoscale.synthetic", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    labels = commands.add_parser("labels", help="pictures and boxes for training")
    labels.add_argument("out", type=Path)
    labels.add_argument("--count", type=int, default=240)
    labels.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(write_labels(args.out, args.count, args.seed))


if __name__ == "__main__":
    main()
