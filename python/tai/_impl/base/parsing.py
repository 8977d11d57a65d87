"""Syntax trees, in any thread."""

from __future__ import annotations

import ast

# The number of attempts: more than threads that disturb each other ever need.
_TRIES = 100


def parse(text: str) -> ast.Module:
    """Calls `ast.parse`, again if another thread has disturbed the parser.

    Before 3.13 CPython counts how deep the trees of all threads are in one place. A thread that
    makes a tree while the garbage collector interrupts another one that does spoils the count of
    both: "AST constructor recursion depth mismatch" (CPython's issue 106905).

    Raises:
        SyntaxError: as `ast.parse`.
    """
    for _ in range(_TRIES):
        try:
            return ast.parse(text)
        except SystemError as error:
            last = error
    raise last
