"""What people read: the help of every command, and the links of every page."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from collections import Counter
from pathlib import Path

import click
import jsonschema
import pytest
from click.testing import CliRunner
from support.reports import car_park

import orthoscale
from orthoscale.cli.main import COMMANDS, cli
from orthoscale.option import GROUPS
from orthoscale.report.schema import report_schema

ROOT = Path(__file__).parent.parent
PAGES = [
    path
    for pattern in (
        "*.md",
        "docs/*.md",
        "docs/*/*.md",
        "*/README.md",
        "training/*/README.md",
        "*/results/*.md",
        "orthoscale/detect/weights/README.md",
    )
    for path in sorted(ROOT.glob(pattern))
]
PICTURE_OR_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def help_of(*words: str) -> str:
    done = CliRunner().invoke(cli, [*words, "--help"], terminal_width=80)
    assert done.exit_code == 0, done.output
    return done.output


def test_the_summary_of_every_command_fits_a_line_of_80_columns():
    lines = help_of().splitlines()
    for name in COMMANDS:
        (line,) = [line for line in lines if line.split()[:1] == [name]]
        assert len(line) <= 80 and line.endswith(".") and not line.endswith("..."), line


@pytest.mark.parametrize("words", [(), *((name,) for name in COMMANDS)])
def test_help_fits_80_columns(words):
    assert not [line for line in help_of(*words).splitlines() if len(line) > 80]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_stands_under_one_heading(name):
    headings = Counter()
    heading = None
    for line in help_of(name).splitlines():
        if line.endswith(":") and line[:-1] in GROUPS:
            heading = line[:-1]
        elif not line:
            heading = None
        elif heading and (found := re.match(r"  (?:-\w, )?(--[\w-]+)", line)):
            headings[found[1]] += 1
    command = cli.get_command(click.Context(cli), name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    assert all(each.group in GROUPS for each in options)
    assert headings == {**{each.opts[0]: 1 for each in options}, "--help": 1}


@pytest.mark.parametrize("name", COMMANDS)
def test_what_most_runs_need_comes_first(name):
    """Required options, then --fleet and --out, where a command has them."""
    command = cli.get_command(click.Context(cli), name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    required = [each.opts[0] for each in options if each.required]
    needed = set(required) | {"--fleet", "--out"} & {each.opts[0] for each in options}
    _, *sections = re.split(rf"^(?:{'|'.join(GROUPS)}):$", help_of(name), flags=re.MULTILINE)
    listed = re.findall(r"^  (?:-\w, )?(--[\w-]+)", "".join(sections), re.MULTILINE)
    assert set(listed[: len(needed)]) == needed
    assert listed[: len(required)] == required


def anchors(page: Path) -> set[str]:
    """Of the headings of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings_that_are_there(page):
    for target in PICTURE_OR_LINK.findall(page.read_text()):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{page.name} links to {target}"
        assert not anchor or anchor in anchors(file), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_a_page_names_are_there(page):
    """Those of the repository, named from its root: `orthoscale/detect/decoders.py`."""
    folders = "orthoscale|tests|docs|examples|benchmarks|colmap_hooks|training|qgis"
    for name in re.findall(rf"`((?:{folders})/[\w./-]+)`", page.read_text()):
        assert (ROOT / name).exists(), f"{page.name} names {name}"


def test_the_site_has_fewer_than_6000_words_of_prose():
    """Beside the reference, which is looked up and not read; tables and code do not count."""
    read, _ = (ROOT / "mkdocs.yml").read_text().split("  - Reference:")
    pages = [ROOT / "docs" / name for name in re.findall(r": (\S+\.md)$", read, re.MULTILINE)]
    pages = [page for page in pages if page.exists()]  # the others are of other folders
    assert len(pages) > 10
    prose = []
    for page in pages:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        prose += re.sub(r"^\|.*$", "", text, flags=re.MULTILINE).split()
    assert len(prose) < 6000


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda page: page.name
)
def test_python_on_a_page_can_be_read_and_names_what_is_there(page):
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
        ast.parse(block)
        for name in re.findall(r"\borthoscale\.(\w+)\(", block):
            assert name in orthoscale.__all__, f"{page.name} calls orthoscale.{name}"


def test_the_published_schema_is_that_of_the_code_and_holds_for_a_report(tmp_path):
    """Made anew by `orthoscale report --schema > docs/reference/report.schema.json`."""
    published = json.loads((ROOT / "docs/reference/report.schema.json").read_text())
    assert published == report_schema()
    car_park(tmp_path)
    report = orthoscale.estimate(tmp_path / "park.png", fleet="DE", detections=tmp_path / "detections.json").to_dict()
    jsonschema.validate(report, published)
    for broken in ({**report, "interval90": [0.1]}, {**report, "scale": -1}, {**report, "vehicles": [{}]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(broken, published)


def test_names_in_the_glossary_are_in_the_code():
    rows = re.findall(r"^\|.*\|([^|]*)\|$", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE)
    code = "\n".join(path.read_text() for path in sorted((ROOT / "orthoscale").rglob("*.py")))
    names = [name for cell in rows for name in re.findall(r"`([^`]+)`", cell)]
    assert len(names) > 20
    for name in names:
        last = name.removeprefix("orthoscale ").removeprefix("--").rsplit(".")[-1].split("/")[-1]
        assert re.search(rf"\b{re.escape(last)}\b", code), f"the glossary's {name} is in no module"


def test_the_page_of_a_package_index_needs_no_other_file():
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    text = (ROOT / told["readme"]).read_text()
    assert [target for target in PICTURE_OR_LINK.findall(text) if not target.startswith("https://")] == []


def test_the_long_options_that_pages_name_exist():
    """Those of a command line are that command's, on a line of its own or within a sentence."""
    of = {
        name: {each for option in cli.get_command(click.Context(cli), name).params
               for each in (*option.opts, *option.secondary_opts)}
        for name in COMMANDS
    }  # fmt: skip
    pages = [page for page in PAGES if ROOT / "docs" in page.parents or page.parent in (ROOT, ROOT / "colmap_hooks")]
    commands = re.compile(r"^ *orthoscale (.*?)(?:  +#.*)?$|`orthoscale ([^`]*)`", re.MULTILINE)
    named = 0
    for page in pages:
        for line in map("".join, commands.findall(page.read_text().replace("\\\n", ""))):
            known = next((of[word] for word in line.split() if word in of), set()) | {"--version", "--help"}
            options = set(re.findall(r"--[a-z][\w-]+", line))
            assert options <= known, f"{page.name}: orthoscale {line}: {options - known}"
            named += len(options)
    assert named > 80


PROGRAM = re.compile(r"python -m ((?:training|orthoscale)\.[\w.]+)([^`\n|]*)|\b(benchmarks/\w+\.py)([^`\n|]*)")


def test_programs_beside_the_command_that_pages_name_are_there_and_have_the_options_that_are_shown():
    """Those of benchmarks, of training and of `orthoscale.synthetic`; behind ` -- ` stand orthoscale's own."""
    shown = 0
    for page in PAGES:
        for module, ours, script, its in PROGRAM.findall(page.read_text().replace("\\\n", "")):
            file = ROOT / (script or module.replace(".", "/") + ".py")
            file = file if file.exists() else file.with_suffix("") / "__main__.py"
            assert file.exists(), f"{page.name} names {script or module}"
            options = set(re.findall(r"--[a-z][\w-]+", (ours or its).partition(" -- ")[0]))
            missing = {each for each in options if each not in file.read_text()}
            assert not missing, f"{page.name}: {file.name} has no {missing}"
            shown += len(options)
    assert shown > 80


def test_the_container_is_built_of_all_that_the_wheel_is_made_of():
    """A part that stays outside of the image is missed only when somebody starts it."""
    built = tomllib.loads((ROOT / "pyproject.toml").read_text())
    made_of = {
        "pyproject.toml",
        built["project"]["readme"],
        *built["project"]["license-files"],
        *built["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"],
    }
    stage = (ROOT / "Containerfile").read_text().partition("RUN ")[0]
    copied = {word for line in stage.splitlines() if line.startswith("COPY ") for word in line.split()[1:-1]}
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert made_of == copied == let_in


def test_the_tour_gives_the_figures_of_the_readme():
    """Of the example that both show: measured anew, it is written anew in both."""
    (row,) = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("| `examples/town`")]
    _, _, truth, value, _, interval, vehicles, *_ = (cell.strip() for cell in row.split("|"))
    tour = (ROOT / "docs/index.md").read_text()
    assert f"scale      {value} m/px" in tour and f"90 %       {interval} m/px" in tour
    assert f"vehicles   {vehicles} used" in tour and f"The truth is {100 * float(truth.split()[0]):g} cm" in tour


def last_row(heading: str) -> list[str]:
    """Cells of the last row of the first table below `heading` in the record of real places: what holds now."""
    record = (ROOT / "benchmarks/results/places.md").read_text().partition(heading)[2]
    table = re.search(r"(?:^\|.*\n)+", record, re.MULTILINE)[0]
    return [cell.strip() for cell in table.splitlines()[-1].strip("|").split("|")]


def test_the_figures_of_real_places_are_the_same_on_every_page():
    """Measured anew, they are written anew on all of them, not only in the record."""
    _, own, world, _ = last_row("What each step changed")
    median, squares, worst, held, scenes = re.findall(r"[\d.]+", own)
    world_median, world_squares, world_worst, world_held, answered = re.findall(r"[\d.]+", world)
    _, chips, chips_held, world_chips, world_chips_told = last_row("### American places made of chips")
    world_chips_held, chips_answered = re.findall(r"\d+", world_chips_told)
    _, chips_median, chips_squares, chips_worst = re.findall(r"[\d.]+", chips)
    quarters, *_, quarters_held = last_row("### Quarters")
    (quarters_answered,) = re.findall(r"\((\d+) answered\)", quarters)
    told = {name: " ".join((ROOT / name).read_text().split())
            for name in ("README.md", "docs/pypi.md", "docs/method.md", "benchmarks/README.md")}  # fmt: skip
    for row in (
        f"| the country's | {scenes} | {median} % | {squares} % | {worst} % | at {held} |",
        f"| `world` | {answered} | {world_median} % | {world_squares} % | {world_worst} % | at {world_held} |",
        f"| the country's | 52 | {chips_median} % | {chips_squares} % | {chips_worst} % | at {chips_held} |",
        f"| `world` | {chips_answered} | | {world_chips} | | at {world_chips_held} |",
    ):
        assert row in told["README.md"]
    assert f"On {scenes} pictures and models" in told["docs/pypi.md"]
    assert f"{median} % in the median, and the 90 % interval holds the truth at {held}." in told["docs/pypi.md"]
    assert f"{held} of {scenes} scenes" in told["docs/method.md"]
    assert (
        f"{chips_held} of 52 American places, and in {quarters_held} of {quarters_answered} quarters"
        in told["docs/method.md"]
    )
    ours = f"{scenes} places in eight countries: {median} % off in the median, {held} hold"
    assert f"{ours}; 52 American ones: {chips_median} %, {chips_held} hold" in told["benchmarks/README.md"]


APPLIED = re.compile(r"orthoscale apply (\S+)/sim3\.json .*?--out (\S+)")


def test_what_pages_apply_is_not_written_where_the_transform_lies():
    """Such a command is refused: its output would hold an input."""
    shown = [*(page.read_text() for page in PAGES), help_of("apply")]
    told = [found.groups() for text in shown for found in APPLIED.finditer(text)]
    assert len(told) > 5
    assert [(model, out) for model, out in told if out.strip("`./") == model] == []
