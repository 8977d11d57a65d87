"""Shrinks a failing random program: drops statements, blocks and calls while it still fails.

python test/fuzz/reduce.py SEED [CONFIGURATION]
"""

from __future__ import annotations

import ast
import multiprocessing
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import configurations
import random_kernels as programs

CONFIGURATION = configurations.Configuration()


def _judge(text: str, seed: int, answers) -> None:
    import outcome

    kinked = programs.is_kinked(seed)
    with tempfile.TemporaryDirectory() as folder:
        found = outcome.judge(text, seed, kinked, Path(folder), CONFIGURATION)
    answers.put((found.kind, found.reason, found.detail))


def judge(text: str, seed: int) -> tuple[str, str, str]:
    """The outcome, from a process of its own."""
    context = multiprocessing.get_context("fork")
    answers = context.SimpleQueue()
    process = context.Process(target=_judge, args=(text, seed, answers))
    process.start()
    process.join(60)
    if process.is_alive():
        process.kill()
        return ("FAIL", "timeout", "")
    return answers.get() if not answers.empty() else ("FAIL", "the process died", "")


class Editor(ast.NodeTransformer):
    """Makes the n-th possible cut."""

    def __init__(self, number: int):
        self.number = number
        self.count = -1
        self.done = False

    def _here(self) -> bool:
        self.count += 1
        if self.count == self.number:
            self.done = True
            return True
        return False

    def cut_body(self, body: list) -> list:
        result = []
        for node in body:
            if self._here():
                continue
            if isinstance(node, (ast.If, ast.For, ast.While)) and self._here():
                result += node.body  # the block without its head
                continue
            if isinstance(node, ast.If) and node.orelse and self._here():
                node.orelse = []
            result.append(self.visit(node))
        return result or [ast.Pass()]

    def visit_block(self, node):
        node.body = self.cut_body(node.body)
        if getattr(node, "orelse", None):
            node.orelse = [n for n in self.cut_body(node.orelse) if not isinstance(n, ast.Pass)]
        return node

    visit_If = visit_For = visit_While = visit_block

    def visit_FunctionDef(self, node):
        return self.visit_block(node)

    def visit_Assign(self, node):
        node.value = self.cut(node.value)
        return node

    visit_AugAssign = visit_Assign

    def visit_Expr(self, node):
        if isinstance(node.value, ast.Call):
            node.value.args = [self.cut(a) for a in node.value.args]
        return node

    def cut(self, node):
        """Puts an operand in the place of an operation."""
        parts = []
        if isinstance(node, ast.BinOp):
            parts = [node.left, node.right]
        elif isinstance(node, ast.Call):
            parts = [*node.args]
            if isinstance(node.func, ast.Attribute) and not isinstance(node.func.value, ast.Name):
                parts.append(node.func.value)
        elif isinstance(node, ast.IfExp):
            parts = [node.body, node.orelse]
        elif isinstance(node, ast.UnaryOp):
            parts = [node.operand]
        for part in parts:
            if self._here():
                return part
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                new = self.cut(child)
                for name, value in ast.iter_fields(node):
                    if value is child:
                        setattr(node, name, new)
                    elif isinstance(value, list) and child in value:
                        value[value.index(child)] = new
        return node


def reduce(text: str, seed: int) -> str:
    """The smallest program found that fails for the same reason."""
    wanted = judge(text, seed)
    if wanted[0] != "FAIL":
        return text
    head, rest = programs.HEADER, text[len(programs.HEADER) :]
    progress = True
    while progress:
        progress, number = False, 0
        while True:
            editor = Editor(number)
            tree = editor.visit(ast.parse(rest))
            if not editor.done:
                break
            new = "\n\n\n" + ast.unparse(ast.fix_missing_locations(tree)) + "\n"
            found = judge(head + new, seed)
            if found[:2] == wanted[:2]:
                rest, progress = new, True
            else:
                number += 1
    return head + rest


if __name__ == "__main__":
    number = int(sys.argv[1])
    if len(sys.argv) > 2:
        CONFIGURATION = configurations.parse(sys.argv[2])
    small = reduce(programs.program(number), number)
    print(small[len(programs.HEADER) :])
    print("\n".join(judge(small, number)))
