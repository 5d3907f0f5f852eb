"""The rasterio plugin: found by its entry point, and with our exit codes."""

import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner
from rasterio.rio.main import main_group


def plugin():
    project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())
    module, name = project["project"]["entry-points"]["rasterio.rio_plugins"]["orthoscale"].split(":")
    return getattr(import_module(module), name)


def rio(*arguments):
    """As `rio` itself runs its plugins: under its main group."""
    command = plugin()
    main_group.add_command(command)
    try:
        return CliRunner().invoke(main_group, ["orthoscale", *map(str, arguments)])
    finally:
        main_group.commands.pop(command.name)


def test_it_has_our_commands():
    shown = rio("--help")
    assert shown.exit_code == 0 and {"fix", "check", "estimate"} <= set(shown.output.split())
    assert "--keep-origin" in rio("fix", "--help").output


def test_a_refusal_is_one_sentence_with_our_exit_code(tmp_path):
    done = rio("estimate", tmp_path / "none.tif")
    assert done.exit_code == 5 and "does not exist" in done.output and "Traceback" not in done.output


@pytest.mark.slow
def test_it_estimates(tmp_path):
    example = Path(__file__).parent.parent / "examples" / "sheffield"
    done = rio("estimate", example / "sparse", "--detections", example / "detections.json", "--fleet", "US",
               "--mode", "planar")  # fmt: skip
    assert done.exit_code == 0 and done.output.startswith("scale")
