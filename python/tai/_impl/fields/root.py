"""`ti.root`: the tree under construction, and its allocation."""

from __future__ import annotations

import os
import re
import sys
from typing import Any

from ..base import state
from ..base.elements import Elements
from ..base.program import Program, get_program
from .snode import Root


def open_root(program: Program) -> Root:
    """Returns the root of the tree that is being laid out."""
    if program.root is None:
        with program.layout:
            if program.root is None:
                program.root = Root()
    return program.root


def materialize(program: Program, namespace: dict[str, Any] | None = None) -> None:
    """Allocates the tree of all fields placed under `ti.root` since the last call.

    Args:
        program: the program.
        namespace: variables of the caller, to name fields after, so that the IR and
            diagnostics say `@x` for the field that the program calls `x`.
    """
    with program.layout:
        root = open_root(program)
        if root.children:
            if namespace is not None:
                name_fields(namespace)
            # Steps that Ctrl-C interrupts here or in the allocation are repeated at the next use of
            # a field.
            fresh = Root()
            program.laid_out = [*program.laid_out, root]
            program.root = fresh
    for root in program.laid_out:
        root.allocate(program)
        if root.allocated and root.tree is None and root.refused is None:
            continue  # A signal handler calls this in the middle of it.
        with program.layout:
            program.laid_out = [other for other in program.laid_out if other is not root]


def begin_in_child() -> None:
    """A forked child does not wait for trees that another thread of its parent allocated."""
    for root in state.program.laid_out if state.program is not None else ():
        if not root.lock._is_owned():
            root.lock._at_fork_reinit()


os.register_at_fork(after_in_child=begin_in_child)


_OF_NOTEBOOKS = re.compile(r"_+(i|oh|dh)?\d*|_i+|Out|In")


def name_fields(namespace: dict[str, Any]) -> None:
    """Names the fields that variables of `namespace` hold, where they have no name yet."""
    for name, value in list(namespace.items()):
        # Notebooks call the value of a cell _, __ or _12, and its text _i12.
        if _OF_NOTEBOOKS.fullmatch(name):
            continue
        if isinstance(value, Elements):
            value.suggest_name(name)
        elif isinstance(value, (list, tuple)):
            for index, item in enumerate(value):
                if isinstance(item, Elements):
                    item.suggest_name(f"{name}_{index}")


class _Root:
    """The type of `ti.root`, which stands for the root of the tree that is being laid out."""

    is_root = True

    def __getattr__(self, name: str) -> Any:
        return getattr(open_root(get_program()), name)

    def deactivate_all(self) -> None:
        """Makes all cells of all sparse levels inactive, in all trees."""
        program = get_program()
        materialize(program, sys._getframe(1).f_globals)
        for tree in list(program.trees.values()):
            tree.deactivate_all()

    def __eq__(self, other: Any) -> bool:
        return other is self or getattr(other, "kind", None) == "root"

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return "ti.root"


root = _Root()


def deactivate_all_snodes() -> None:
    """`ti.root.deactivate_all()`."""
    root.deactivate_all()
