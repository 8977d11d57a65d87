"""Mutants of the Python package: one small change each, and the tests that run the changed line."""

from __future__ import annotations

import ast
import os
import re
import signal
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.FloorDiv: ast.Mult,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A change of the text of a file, from `begin` to `end`, in bytes."""

    file: str
    line: int
    kind: str
    begin: int
    end: int
    before: str
    after: str

    @property
    def name(self) -> str:
        return f"{self.file}:{self.line}: {self.kind}: {self.before} -> {self.after}"

    def apply(self, text: bytes) -> bytes:
        return text[: self.begin] + self.after.encode() + text[self.end :]


class Finder(ast.NodeVisitor):
    """Collects the mutants of a file.

    Bodies of kernels are left out, since the compiler and not Python runs them; so are
    annotations, decorators, the texts of errors, and `strict` of `zip`, which asserts that the
    lists have one length.
    """

    def __init__(self, file: str, text: str):
        self.file, self.text = file, text.encode()
        self.starts = [0]
        for line in self.text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.found: list[Mutant] = []
        self.depth = 0

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        begin = self.starts[node.lineno - 1] + node.col_offset
        return begin, self.starts[node.end_lineno - 1] + node.end_col_offset

    def add(self, node: ast.expr | ast.stmt, kind: str, after: str) -> None:
        begin, end = self.span(node)
        before = self.text[begin:end].decode()
        if self.depth:
            self.found.append(Mutant(self.file, node.lineno, kind, begin, end, before, after))

    def swap(self, node: ast.expr, kind: str, other: ast.expr) -> None:
        self.add(node, kind, f"({ast.unparse(other)})")

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if any(re.search(r"\b(kernel|func)$", ast.unparse(one)) for one in node.decorator_list):
            return
        for default in [*node.args.defaults, *filter(None, node.args.kw_defaults)]:
            self.visit(default)
        self.depth += 1
        for statement in node.body:
            self.visit(statement)
        self.depth -= 1

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        return

    def visit_Compare(self, node: ast.Compare) -> None:
        for at, op in enumerate(node.ops):
            ops = list(node.ops)
            ops[at] = COMPARISONS[type(op)]()
            self.swap(node, "comparison", ast.Compare(node.left, ops, node.comparators))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        self.swap(node, "and or", ast.BoolOp(op, node.values))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        texts = isinstance(node.left, (ast.Constant, ast.JoinedStr)) and not isinstance(
            getattr(node.left, "value", ""), (int, float))  # fmt: skip
        if type(node.op) in ARITHMETIC and not texts:
            op = ARITHMETIC[type(node.op)]()
            self.swap(node, "arithmetic", ast.BinOp(node.left, op, node.right))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            self.swap(node, "negation", node.operand)
        self.generic_visit(node)

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        plain = not isinstance(node.test, ast.Compare) or len(node.test.ops) > 1
        if plain and not isinstance(node.test, ast.UnaryOp) and not is_typing(node.test):
            self.swap(node.test, "condition", ast.UnaryOp(ast.Not(), node.test))
        if not is_typing(node.test):
            self.generic_visit(node)

    visit_While = visit_IfExp = visit_If

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self.add(node, "constant", str(not node.value))
        elif isinstance(node.value, int):
            self.add(node, "constant", str(node.value + 1))

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg != "strict":
            self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        return

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self.add(node, "statement", "pass")
        self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        if all(isinstance(target, (ast.Attribute, ast.Subscript)) for target in node.targets):
            self.add(node, "statement", "pass")
        self.visit(node.value)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self.add(node, "statement", "pass")
        self.visit(node.value)


def is_typing(test: ast.expr) -> bool:
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"


def mutants(package: Path) -> list[Mutant]:
    """All mutants of a package, in the order of its files."""
    found = []
    for path in sorted(package.rglob("*.py")):
        text = path.read_text()
        finder = Finder(str(path.relative_to(package)), text)
        finder.visit(ast.parse(text))
        found += finder.found
    return found


class Tests:
    """The tests that run a line, from the contexts of a run of coverage.py."""

    def __init__(self, data: Path, root: Path, seconds: dict[str, float]):
        import coverage

        found = coverage.CoverageData(str(data))
        found.read()
        self.root, self.seconds = root, seconds
        self.files = {path.stem: str(path.relative_to(root))
                      for path in (root / "test/python").rglob("test_*.py")}  # fmt: skip
        self.lines: dict[str, dict[int, list[str]]] = {}
        counts: dict[str, int] = defaultdict(int)
        for name in found.measured_files():
            relative = name.rpartition("python/tai/")[2]
            self.lines[relative] = found.contexts_by_lineno(name)
            for contexts in self.lines[relative].values():
                for context in contexts:
                    counts[context] += 1
        self.counts = counts

    def is_run(self, mutant: Mutant) -> bool:
        return bool(self.lines.get(mutant.file, {}).get(mutant.line))

    def choose(self, mutant: Mutant, budget: float) -> list[str]:
        """The tests of a line, those of few lines first, for about so many seconds."""
        contexts = [c for c in self.lines.get(mutant.file, {}).get(mutant.line, []) if c]
        chosen, taken = [], 0.0
        for context in sorted(contexts, key=lambda c: (self.time_of(c), self.counts[c])):
            if identity := self.identity(context):
                taken += self.time_of(context)
                if taken > budget and chosen:
                    break
                chosen.append(identity)
        return chosen

    def time_of(self, context: str) -> float:
        return self.seconds.get(context, 0.02)

    def identity(self, context: str) -> str | None:
        module, _, function = context.partition(".")
        return (
            f"{self.files[module]}::{function.replace('.', '::')}" if module in self.files else None
        )


def read_seconds(log: str) -> dict[str, float]:
    """Seconds of each test, all its cases together, from `pytest --durations=0`."""
    seconds: dict[str, float] = defaultdict(float)
    pattern = r"^([\d.]+)s (?:call|setup)\s+\S*?(\w+)\.py::([\w:]+)"
    for count, module, function in re.findall(pattern, log, re.MULTILINE):
        seconds[f"{module}.{function.replace('::', '.')}"] += float(count)
    return seconds


def run_tests(tests: list[str], root: Path, environment: dict[str, str], limit: float) -> str:
    """killed, timeout or survived: pytest in a child of this process.

    The child has from its parent the modules that all tests import, but for the package.
    """
    import hypothesis  # noqa: F401
    import numpy  # noqa: F401
    import pytest

    child = os.fork()
    if not child:
        os.setsid()
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        os.chdir(root)
        os.environ.update(environment)
        sys.path.insert(0, environment["PYTHONPATH"])
        for name in [name for name in sys.modules if name.partition(".")[0] == "tai"]:
            del sys.modules[name]
        options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider"]
        os._exit(int(pytest.main([*options, *tests])))
    deadline = time.monotonic() + limit
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "timeout"
        time.sleep(0.05)
    status = os.waitstatus_to_exitcode(ended[1])
    # A module that cannot be imported ends with 4.
    if status == 5:
        raise SystemExit(f"no test was found: {' '.join(tests)}")
    return "survived" if status == 0 else "killed"


def judge(
    mutant: Mutant, tests: Tests, package: Path, build: Path, budget: float
) -> dict[str, object]:
    """Runs the tests of a mutant in a copy of the package, whose file is put back afterwards."""
    row: dict[str, object] = {"name": mutant.name, "tests": 0}
    if not tests.is_run(mutant):
        return row | {"outcome": "not run by any test"}
    chosen = tests.choose(mutant, budget)
    begun = time.monotonic()
    path = package / mutant.file
    text = path.read_bytes()
    environment = {"PYTHONPATH": str(package.parent), "TAI_BUILD_DIR": str(build),
                   "PYTHONDONTWRITEBYTECODE": "1", "TAI_VERIFY_EACH": "0"}  # fmt: skip
    try:
        path.write_bytes(mutant.apply(text))
        # Lines that run when a module is imported have no test of their own.
        if not chosen:
            chosen = ["test/python/ad/test_gradients.py", "test/python/frontend/test_matrices.py"]
        outcome = run_tests(chosen, tests.root, environment, 60 + 5 * budget)
    finally:
        path.write_bytes(text)
    seconds = round(time.monotonic() - begun, 1)
    return row | {"outcome": outcome, "tests": len(chosen), "seconds": seconds}
