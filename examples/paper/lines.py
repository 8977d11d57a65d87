"""Counts the lines of simulators as the tables of the paper do.

Counted as essential are fields, named constants (`DT = 1e-3`), and code that a tape records: the
kernels and functions called within `with ...Tape(...)`, their callees, and hand-written gradients
of any of them (without a tape: all kernels). Not counted are blank lines, comments, docstrings,
options, set-up, the optimiser and drawing. `code` counts all lines except blank lines, comments
and docstrings.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterable
from pathlib import Path
from typing import Any

# The numbers of essential lines that the paper gives in tables 1 and 2.
PAPER = {"diffmpm": 110, "smoke": 75}
SILENT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(source: str) -> set[int]:
    """Lines with code; strings that are statements, docstrings that is, are none."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if isinstance(node.value.value, str):
                lines -= _span(node)
    return lines


def _span(node: ast.stmt | ast.expr) -> set[int]:
    return set(range(node.lineno, (node.end_lineno or node.lineno) + 1))


def names_of(node: ast.AST) -> set[str]:
    """Returns the names of functions, methods and values in a syntax tree."""
    found: set[str] = set()
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            found.add(part.id)
        elif isinstance(part, ast.Attribute):
            found.add(part.attr)
    return found


def text_of(nodes: Iterable[ast.AST]) -> str:
    """Returns the source text of some syntax nodes."""
    return " ".join(map(ast.unparse, nodes))


def is_tape(node: ast.AST) -> bool:
    words = ("Tape(", "studio.tape(")
    return isinstance(node, ast.With) and any(w in text_of(node.items) for w in words)


def recorded(tree: ast.Module) -> set[str]:
    """The names of functions that tapes record, also if a kernel is chosen before or passed as an
    argument.
    """
    found: set[str] = set()
    for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        names = {name for node in ast.walk(function) if is_tape(node) for name in names_of(node)}
        if not names:
            continue
        for node in ast.walk(function):
            if isinstance(node, ast.Assign) and names & names_of(ast.Tuple(node.targets)):
                names |= names_of(node.value)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(function.name):
                names |= {name for argument in node.args for name in names_of(argument)}
        found |= names
    return found | {name for n in tree.body if is_tape(n) for name in names_of(n)}


def is_gradient_of(function: ast.FunctionDef, name: str) -> bool:
    return f"grad_for({name})" in text_of(function.decorator_list)


def makes_field(node: ast.AST) -> bool:
    """A field, its place in a tree, or a number by its name."""
    if isinstance(node, ast.Expr):
        return ast.unparse(node).startswith("ti.root")
    if not isinstance(node, ast.Assign):
        return False
    made = ast.unparse(node.value)
    is_field = any(word in made for word in (".field(", ".root", "StructField("))
    names = text_of(node.targets).strip("()").split(", ")
    parts = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
    is_table = any(isinstance(p, ast.Tuple | ast.List | ast.ListComp | ast.Dict) for p in parts)
    return is_field or (all(name.isupper() for name in names) and not is_table)


def essential(source: str) -> set[int]:
    """Returns the lines of a program that belong to the simulator."""
    tree = ast.parse(source)
    functions = {n.name: n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
    waiting = list(recorded(tree))
    if not waiting:
        waiting = [n for n, f in functions.items() if "ti." in text_of(f.decorator_list)]
    taken: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in functions and name not in taken:
            taken.add(name)
            waiting += names_of(functions[name])
            waiting += [n for n, f in functions.items() if is_gradient_of(f, name)]
    nodes: list[Any] = [functions[name] for name in taken]
    bodies: list[Any] = [tree, *(n for n in ast.walk(tree) if isinstance(n, ast.ClassDef))]
    bodies += [f for n, f in functions.items() if n == "__init__"]
    nodes += [node for body in bodies for node in body.body if makes_field(node)]
    lines: set[int] = set()
    for node in nodes:
        for part in (node, *getattr(node, "decorator_list", [])):
            lines |= _span(part)
    return lines & code_lines(source)


def counts(examples: Path) -> list[tuple[str, int, int]]:
    """Name, essential lines and lines of code of each simulator in a folder."""
    found: list[tuple[str, int, int]] = []
    for path in sorted(examples.glob("*.py")):
        source = path.read_text()
        count = len(essential(source))
        if count:
            found.append((path.stem, count, len(code_lines(source))))
    return found
