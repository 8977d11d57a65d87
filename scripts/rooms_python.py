"""Checks the layering of `python/tai`: which packages may import which.

    python scripts/rooms_python.py          # the problems, if any
    python scripts/rooms_python.py --graph  # which package imports which

A package may import from those that `ALLOWED` lists for it, and its modules from one another, but
not in a cycle. Modules of tai are imported at the top of a module: an import inside of a function
hides a dependency. Optional libraries (torch, matplotlib, …) may be imported anywhere.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "tai"
# The module of compiled code; `_impl.base.native` loads it when it is needed.
EXTENSION = "_core"
MOST_FILES = 40

# From the bottom to the top; each row may import from the rows that it names. `errors` is for all.
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "_impl.base": set(),
    "_impl.values": {"_impl.base"},
    "_impl.history": {"_impl.base"},
    "_impl.interop": {"_impl.base"},
    "_impl.fields": {"_impl.base", "_impl.values", "_impl.history", "_impl.interop"},
    "_impl.tracking": {"_impl.base", "_impl.values", "_impl.history", "_impl.interop",
                       "_impl.fields"},
    "_impl.frontend": {"_impl.base", "_impl.values", "_impl.fields", "_impl.tracking"},
    "_impl.launch": {"_impl.base", "_impl.values", "_impl.history", "_impl.interop",
                     "_impl.fields", "_impl.tracking", "_impl.frontend"},
    "_impl.ad": {"_impl.base", "_impl.values", "_impl.history", "_impl.fields", "_impl.tracking",
                 "_impl.launch"},
    "_impl.solvers": {"_impl.base", "_impl.values", "_impl.history", "_impl.fields",
                      "_impl.tracking", "_impl.launch", "_impl.ad"},
    "_impl.optim": {"_impl.base", "_impl.values", "_impl.fields", "_impl.launch", "_impl.ad",
                    "_impl.solvers"},
    "_impl.frameworks": {"_impl.base", "_impl.values", "_impl.interop", "_impl.fields",
                         "_impl.tracking", "_impl.launch", "_impl.ad"},
    "_impl.drawing": {"_impl.base"},
    "public": {"_impl", "_impl.base", "_impl.values", "_impl.interop", "_impl.fields",
               "_impl.tracking", "_impl.launch", "_impl.ad", "_impl.solvers", "_impl.optim",
               "_impl.frameworks", "_impl.drawing"},
    "_impl": set(),
}  # fmt: skip


class Import(NamedTuple):
    """One import of a module of the package by another one."""

    source: str
    target: str
    line: int
    in_function: bool
    for_types: bool


def module_names(root: Path) -> dict[str, Path]:
    """The modules of the package by name, relative to it; the package itself is ''."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = list(path.relative_to(root).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        found[".".join(parts)] = path
    return found


def room(module: str) -> str:
    """The package that a module belongs to, as `ALLOWED` names it."""
    if module in ALLOWED:
        return module
    first, *rest = module.split(".")
    if first != "_impl":
        return "public"
    return f"_impl.{rest[0]}" if len(rest) > 1 else "_impl"


class _Imports(ast.NodeVisitor):
    def __init__(self, module: str, is_package: bool, modules: dict[str, Path]):
        self.module, self.modules = module, modules
        self.home = module.split(".") if module else []
        if not is_package:
            self.home = self.home[:-1]
        self.found: list[Import] = []
        self.depth = self.types = 0

    def _note(self, target: str, line: int) -> None:
        while target and target not in self.modules and target != EXTENSION:
            target = target.rpartition(".")[0]  # the import is of a name in a module
        if target != self.module:
            self.found.append(Import(self.module, target, line, self.depth > 0, self.types > 0))

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if node.level:
            base = self.home[: len(self.home) - node.level + 1]
        elif node.module and node.module.split(".")[0] == PACKAGE:
            base = []
        else:
            return
        inner = (node.module or "").split(".")
        path = [*base, *(inner if node.level else inner[1:])]
        for alias in node.names:
            self._note(".".join(p for p in [*path, alias.name] if p), node.lineno)

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            head, _, rest = alias.name.partition(".")
            if head == PACKAGE:
                self._note(rest, node.lineno)

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self.depth += 1
        self.generic_visit(node)
        self.depth -= 1

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_If(self, node: ast.If) -> None:
        for_types = "TYPE_CHECKING" in ast.unparse(node.test)
        self.types += for_types
        self.generic_visit(node)
        self.types -= for_types


def find_imports(root: Path) -> list[Import]:
    """All imports of modules of the package by one another."""
    modules = module_names(root)
    found = []
    for name, path in modules.items():
        visitor = _Imports(name, path.name == "__init__.py", modules)
        visitor.visit(ast.parse(path.read_text(), str(path)))
        found += visitor.found
    return found


def find_circles(arrows: dict[str, set[str]]) -> Iterator[list[str]]:
    """The sets of nodes that reach one another, each once."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        todo = [start]
        while todo:
            for target in arrows.get(todo.pop(), ()):
                if target not in seen:
                    seen.add(target)
                    todo.append(target)
        return seen

    reach = {name: reached(name) for name in arrows}
    done: set[str] = set()
    for name in sorted(arrows):
        if name in reach[name] and name not in done:
            circle = sorted(n for n in reach[name] if name in reach.get(n, ()))
            done.update(circle)
            yield circle


def problems(root: Path, allowed: dict[str, set[str]] = ALLOWED) -> list[str]:
    """Breaches of the rules, a line each."""
    found = []
    modules: dict[str, set[str]] = defaultdict(set)
    for one in find_imports(root):
        where = f"{one.source or PACKAGE}:{one.line}"
        if one.in_function:
            found.append(f"{where}: imports {one.target} inside of a function")
        if one.target == EXTENSION:
            found.append(f"{where}: imports tai._core; take it from _impl.base.native")
            continue
        source, target = room(one.source), room(one.target)
        if source not in allowed:
            found.append(
                f"{where}: package {source} is not in the table of scripts/rooms_python.py"
            )
        elif target not in (source, "errors") and target not in allowed[source]:
            found.append(f"{where}: {source} may not import from {target} ({one.target})")
        if not one.for_types:
            modules[one.source].add(one.target)
    found += [f"modules in a circle: {', '.join(circle)}" for circle in find_circles(modules)]
    found += [f"packages in a circle: {', '.join(circle)}" for circle in find_circles(allowed)]
    return list(dict.fromkeys(found))


def crowds(*folders: Path) -> list[str]:
    """The folders below that hold more files side by side than one can look over."""
    found = []
    for root in folders:
        counts = Counter(path.parent for path in root.rglob("*.py"))
        found += [
            f"{folder}: {count} files side by side, at most {MOST_FILES}"
            for folder, count in sorted(counts.items())
            if count > MOST_FILES
        ]
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--graph", action="store_true", help="print the arrows between packages")
    arguments = parser.parse_args()
    root = ROOT / "python" / PACKAGE
    if arguments.graph:
        arrows: dict[str, set[str]] = defaultdict(set)
        for one in find_imports(root):
            if room(one.source) != room(one.target) != "errors" and one.target != EXTENSION:
                arrows[room(one.source)].add(room(one.target))
        for name in ALLOWED:
            print(f"{name:<16} -> {', '.join(n for n in ALLOWED if n in arrows[name]) or '-'}")
        return 0
    found = problems(root) + crowds(root, ROOT / "test/python")
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
