"""How the modules may know one another: nobody in a circle, the core nobody, and the extras known by nobody."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import orthoscale

ROOT = Path(orthoscale.__file__).parent
# What stands beside the program: commands of their own, and what draws scenes for tests and training.
EXTRAS = {"layout", "evaluate", "synthetic", "photos.crop"}
# What each folder, or module beside the folders, may import: those above it in this table, and of them only these.
MAY_IMPORT = {
    "errors": "",
    "version": "",
    "countries": "",
    "core": "errors",
    "system": "errors version",
    "formats": "core errors system",
    "fleets": "core countries errors formats system",
    "registrations": "core errors formats",
    "detect": "core errors formats system",
    "anchors": "core detect formats system",
    "option": "errors",
    "requests": "anchors core errors option",
    "sources": "core countries errors fleets formats option system",
    "photos": "core detect errors formats option requests sources system",
    "locate": "core detect errors formats option photos sources",
    "report": "core errors formats requests sources system version",
    "actions": "anchors core detect errors fleets formats locate option photos report requests sources system",
    "": "actions core errors fleets formats photos report system version",  # the package: its public names
    "layout": "core errors formats sources version",
    "evaluate": "actions core errors formats locate photos sources system version",
    "synthetic": "core errors evaluate fleets formats sources system",
    "cli": "actions core errors evaluate fleets formats layout locate option photos registrations report requests "
    "sources system version",
    "rio": "cli errors",
    "__main__": "cli system",
}


def modules() -> dict[str, Path]:
    """Every module of the package by its name below it; a package by its own."""
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = path
    return found


MODULES = modules()


@cache
def tree_of(name: str) -> ast.Module:
    return ast.parse(MODULES[name].read_text(encoding="utf-8"))


@cache
def imports(name: str, within: ast.AST | None = None) -> set[str]:
    """The modules of the package that the module `name` imports, in functions and for type checkers too; or those that
    the part `within` of it does."""
    package = name.split(".") if MODULES[name].name == "__init__.py" else name.split(".")[:-1]
    package = [part for part in package if part]
    found = set()
    for node in ast.walk(within or tree_of(name)):
        if isinstance(node, ast.ImportFrom) and node.level:
            above = package[: len(package) - node.level + 1]
            base = ".".join([*above, *([node.module] if node.module else [])])
            inside = {a.name: f"{base}.{a.name}".strip(".") for a in node.names}
            found |= {place if place in MODULES else base for place in inside.values()}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "orthoscale":
            found.add((node.module or "").removeprefix("orthoscale").strip("."))
        elif isinstance(node, ast.Import):
            own = [a.name for a in node.names if a.name.split(".")[0] == "orthoscale"]
            found |= {each.removeprefix("orthoscale").strip(".") for each in own}
    return found & set(MODULES) - {name}


def folder(name: str) -> str:
    return name.split(".")[0]


def extra(name: str) -> str | None:
    return next((each for each in EXTRAS if name == each or name.startswith(each + ".")), None)


def test_no_module_imports_itself_by_way_of_others():
    """Counting imports in functions, and those for type checkers only."""
    assert len(MODULES) > 150
    try:
        TopologicalSorter({name: imports(name) for name in MODULES}).prepare()
    except CycleError as error:
        raise AssertionError(f"an import circle: {' -> '.join(error.args[1])}") from None


def test_folders_import_what_the_table_says():
    """And the table says no more than they do; those that a folder may import stand above it, so there is no circle."""
    above: set[str] = set()
    for name, others in MAY_IMPORT.items():
        assert set(others.split()) <= above, f"{name} stands above {set(others.split()) - above}"
        above.add(name)
    known: dict[str, set[str]] = {folder(name): set() for name in MODULES}
    for name in MODULES:
        known[folder(name)] |= {folder(m) for m in imports(name)} - {folder(name)}
    assert known == {name: set(others.split()) for name, others in MAY_IMPORT.items()}


# How calls end that open files, in Python, NumPy and OpenCV.
OPENS = {"open", "read_text", "read_bytes", "write_text", "write_bytes", "fromfile", "tofile", "load", "loadtxt"}
OPENS |= {"save", "savez", "genfromtxt", "savetxt", "imread", "imwrite"}


def test_the_core_opens_no_file():
    for name in MODULES:
        if folder(name) == "core":
            tree = tree_of(name)
            called = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
            reads = {call for call in called if call.split(".")[-1] in OPENS}
            assert not reads, f"{name} calls {reads}"


def test_rasters_are_read_by_sources_gdal_alone():
    """It is offline, within the memory limit, and refuses pipes; the others may only write what is theirs."""
    assert {call for call, _ in gdal_calls("sources.gdal")} >= {"Env", "DatasetReader"}
    for name in set(MODULES) - {"sources.gdal"}:
        for call, mode in gdal_calls(name):
            assert call == "open" and mode in ("w", "r+"), f"{name} calls rasterio's {call}"
        assert "NotGeoreferencedWarning" not in MODULES[name].read_text(encoding="utf-8"), name


def gdal_calls(name: str) -> list[tuple[str, object]]:
    """Calls by the module `name` that open rasters or change GDAL's settings: what is called, and its second argument
    where that is a plain value."""
    tree = tree_of(name)
    own = {
        alias.asname or alias.name: alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "rasterio"
        for alias in node.names
    }
    calls = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            what = own.get(called, called.removeprefix("rasterio.") if called.startswith("rasterio.") else "")
            if what in ("open", "Env", "io.DatasetReader", "DatasetReader"):
                second = node.args[1] if len(node.args) > 1 else None
                calls.append((what, second.value if isinstance(second, ast.Constant) else None))
    return calls


def test_extras_are_imported_by_nobody_but_their_commands():
    """And by these in functions only, so that the program starts without them."""
    for name in MODULES:
        theirs = {m for m in imports(name) if extra(m) not in (None, extra(name))}
        if not theirs or folder(name) == "synthetic":  # which makes inputs for the others, and does not ship
            continue
        assert folder(name) == "cli", f"{name} imports {theirs}"
        for node in tree_of(name).body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and "TYPE_CHECKING" not in ast.unparse(
                node
            ):
                at_once = {m for m in imports(name, node) if extra(m)}
                assert not at_once, f"{name} imports {at_once} when it is imported"


SAYS_WHAT_IS_ALLOWED = (
    " must be ",
    " must lie between ",
    " takes ",
    " is not one of ",
    " is neither ",
    " positive number",
)


def test_every_error_gives_a_hint_or_says_itself_what_is_allowed():
    """But for too little evidence and contradictions: `actions` name the input and say what to try."""
    told = 0
    for name in MODULES:
        for node in ast.walk(tree_of(name)):
            error = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else None
            if error in ("UsageError", "InputError", "OutputError"):
                told += 1
                said = ast.unparse(node.args[0]) if node.args else ""
                hinted = len(node.args) + len(node.keywords) > 1
                allowed = error == "UsageError" and any(each in said for each in SAYS_WHAT_IS_ALLOWED)
                assert hinted or allowed, f"{name}, line {node.lineno}: {said} gives no hint"
    assert told > 300
