"""Syntax trees, in any thread."""

from __future__ import annotations

import ast

# More often than threads meet each other again.
_TRIES = 100


def parse(text: str) -> ast.Module:
    """`ast.parse`, tried again where another thread came in between.

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
