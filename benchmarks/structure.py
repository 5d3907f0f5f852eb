"""Figures of the source code itself, as in docs/architecture.md: `python benchmarks/structure.py [CHECKOUT]`.

Everything is counted from the syntax trees, so that another checkout can be compared with this one:

    git worktree add /tmp/old COMMIT && python benchmarks/structure.py /tmp/old
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def imported(name: str, tree: ast.Module, is_package: bool, names: set[str]) -> set[str]:
    """The modules of `names` that the module `name` imports, including imports in functions and for type checkers."""
    here = name.split(".") if is_package else name.split(".")[:-1]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            above = here[: len(here) - node.level + 1] if node.level else []
            base = ".".join(filter(None, [*above, node.module]))
            found |= {f"{base}.{a.name}" if f"{base}.{a.name}" in names else base for a in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
    return (found & names) - {name}


def circles(trees: dict[str, tuple[ast.Module, bool]]) -> list[int]:
    """Sizes of the groups of modules that import one another in circles, the largest first."""
    names = list(trees)
    edges = [(names.index(a), names.index(b)) for a in names for b in imported(a, *trees[a], set(names))]
    rows, columns = np.array(edges).T
    graph = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(names),) * 2)
    _, label = connected_components(graph, directed=True, connection="strong")
    return sorted((n for n in np.bincount(label).tolist() if n > 1), reverse=True)


def public(body: list[ast.stmt]) -> list[ast.AST]:
    """Public functions and classes, and the public members of these classes, without mere declarations of protocols."""
    found: list[ast.AST] = []
    for node in body:
        if isinstance(node, (*FUNCTIONS, ast.ClassDef)) and not node.name.startswith("_"):
            declared = isinstance(node.body[0], ast.Expr) and ast.unparse(node.body[0]) == "..."
            found += [] if declared else [node]
            found += public(node.body) if isinstance(node, ast.ClassDef) else []
    return found


def constants(tree: ast.Module) -> set[str]:
    """Names in upper case that a module assigns at its top level."""
    targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
    names = [name for t in targets for name in (t.elts if isinstance(t, ast.Tuple) else [t])]
    return {name.id for name in names if isinstance(name, ast.Name) and name.id.isupper()}


def main() -> None:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    trees, lines, longest = {}, 0, (0, "")
    for path in sorted((root / "orthoscale").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        trees[name] = ast.parse(text), parts[-1] == "__init__"
        lines += len(text.splitlines())
        for node in ast.walk(trees[name][0]):
            if isinstance(node, FUNCTIONS):
                longest = max(longest, (node.end_lineno - node.lineno + 1, f"{name}.{node.name}"))
    homes = Counter(constant for tree, _ in trees.values() for constant in constants(tree))
    names = [node for tree, _ in trees.values() for node in public(tree.body)]
    print(f"modules, lines       {len(trees)}, {lines}")
    print(f"import circles       {circles(trees)}")
    print(f"longest function     {longest[0]} lines, {longest[1]}")
    print(f"constants            {sum(n > 1 for n in homes.values())} of {len(homes)} in several modules")
    print(f"without a docstring  {sum(not ast.get_docstring(node) for node in names)} of {len(names)} public names")


if __name__ == "__main__":
    main()
