"""Every public name says what it is, and what it refers to is there."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

import pytest

import orthoscale
from orthoscale import errors

PACKAGE = Path(orthoscale.__file__).parent
MODULES = sorted(path for path in PACKAGE.rglob("*.py"))
FOLDERS = {path.name for path in PACKAGE.iterdir() if path.is_dir()}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def public(body, prefix=""):
    """Name and node of public functions and classes, and of the public members of those classes, but for properties of
    protocols that the class's docstring explains."""
    for node in body:
        if isinstance(node, DEFINITIONS) and not node.name.startswith("_"):
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                told = re.findall(r"\w+", ast.get_docstring(node) or "")
                members = [m for m in node.body if not (is_declared(m) and m.name in told)]
                yield from public(members, f"{prefix}{node.name}.")


def is_declared(node):
    """Whether a protocol declares this property: it has no body."""
    if not (isinstance(node, ast.FunctionDef) and isinstance(node.body[0], ast.Expr)):
        return False
    value = node.body[0].value
    return isinstance(value, ast.Constant) and value.value is Ellipsis


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_every_public_name_has_a_docstring(path):
    tree = ast.parse(path.read_text())
    nodes = dict(public(tree.body))
    assert not [name for name, node in nodes.items() if not ast.get_docstring(node)]
    for name, node in nodes.items():
        said = set(re.findall(r"\w+", ast.get_docstring(node).lower()))
        told = set(re.findall(r"[a-z]+", node.name.lower()))
        assert said - told - {"the", "a", "of"}, f"{name}: the docstring only repeats the name"
    if tree.body:
        assert ast.get_docstring(tree), "the module does not say what it is for"


def resolves(name):
    """Whether `name` is a module of the package or reached from one by attributes."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(["orthoscale", *parts[:k]]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            fields = getattr(found, "__dataclass_fields__", {})
            if not hasattr(found, part) and part not in fields:
                return False
            found = getattr(found, part, None)
        return True
    return False


def test_modules_that_docstrings_name_are_there():
    stale = []
    for path in MODULES:
        for name in re.findall(r"(?<!`)`(?:orthoscale\.)?([a-z_]+(?:\.\w+)+)`(?!`)", path.read_text()):
            if name.split(".")[0] in FOLDERS and not resolves(name):
                stale.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not stale


ERRORS = {name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, Exception)}


def raised(function):
    """Names of the package's errors that `function` itself raises, not the functions in it."""
    waiting, found = list(function.body), set()
    while waiting:
        node = waiting.pop()
        if isinstance(node, DEFINITIONS):
            continue
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
            found.add(node.exc.func.id)
        waiting += ast.iter_child_nodes(node)
    return found & ERRORS


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_public_functions_say_which_errors_they_raise(path):
    """By name, or by another function that does. The docstrings of commands are their help, which users read."""
    if path.parent.name == "cli":
        return
    unsaid = {}
    for name, node in public(ast.parse(path.read_text()).body):
        told = ast.get_docstring(node)
        if isinstance(node, ast.FunctionDef) and not re.search(r"[Ss]ee `|[Rr]aises? what", told):
            unsaid[name] = sorted(raised(node) - set(re.findall(r"\w+", told)))
    assert not {name: which for name, which in unsaid.items() if which}
