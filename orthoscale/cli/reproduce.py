"""The command that does again what a report tells."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

import click


def command_line(path: str, settings: Mapping[str, Any]) -> str:
    """`orthoscale estimate` of `path` with the `settings` of a report, those that are not its defaults."""
    from .scale import estimate

    words = ["orthoscale", "estimate", path]
    for option in estimate.params:
        value = settings.get(str(option.name))
        if not isinstance(option, click.Option) or value is None or value == option.default:
            continue
        if option.is_flag:
            alone = option.flag_value is not False  # what the bare flag stands for
            words += option.opts[:1] if value is alone else option.secondary_opts[:1]
        else:
            for one in value if isinstance(value, (list, tuple)) else [value]:
                words += [option.opts[0], str(one)]
    return shlex.join(words)
