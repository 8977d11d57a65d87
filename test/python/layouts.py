"""Runs programs whose fields stand in dense levels below sparse ones instead.

A layout is `pointer`, `hash` (blocks of dense cells) or `bitmasked` (no blocks). All cells are
active from the start, so that a loop over a field visits the same elements as on dense levels; with
`-lazy` behind the name none is, and kernels activate the cells they write.

    python layouts.py pointer program.py arguments …     # a script, as __main__
"""

from __future__ import annotations

import contextlib
import os
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

LAYOUTS = ("dense", "pointer", "bitmasked", "hash")
LAZY = tuple(f"{name}-lazy" for name in LAYOUTS[1:])
VARIABLE = "TAI_TEST_LAYOUT"


def block_of(extent: int) -> int:
    """The extent of the dense blocks: a divisor, so that the shape stays."""
    return next(size for size in (4, 3, 2, 1) if extent % size == 0)


def _root_of_companion(field: Any) -> Any:
    """Where the field stands of which this one is the gradient or the tangent, or None."""
    of = getattr(field, "primal", None)
    for name in ("field", "_whole"):
        whole = getattr(field, name, None)
        if of is None and whole is not None and whole.primal is not None:
            of = whole.primal if name == "field" else whole.primal.components[field._index]
    if of is None or field.role == "primal":
        return None
    parts = getattr(of, "parts", [of])
    return parts[0].level


def _is_converted(level: Any) -> bool:
    return any(getattr(above, "converted", False) for above in level.path())


@contextlib.contextmanager
def below(layout: str) -> Iterator[None]:
    """Within, dense levels at the root stand below levels of the layout."""
    if layout == "dense":
        yield
        return
    from tai._impl.fields import scalar, snode

    kind, _, lazy = layout.partition("-")
    dense, put_into = snode.SNode.dense, scalar.ScalarField.put_into
    allocate = snode.Root.allocate

    def sparse_dense(self: Any, axes: Any, dimensions: Any) -> Any:
        if self.kind != "root":
            return dense(self, axes, dimensions)
        made = dense(self, axes, dimensions)  # with its checks
        self.children.remove(made)
        if kind == "bitmasked":
            found = self.bitmasked(axes, dimensions)
        else:
            blocks = [block_of(extent) for extent in made.extents]
            outer = [n // b for n, b in zip(made.extents, blocks, strict=True)]
            found = dense(getattr(self, kind)(axes, outer), axes, blocks)
        found.converted = True
        return found

    def put_beside(self: Any, node: Any, offset: Any = None) -> None:
        home = _root_of_companion(self)
        if home is not None and _is_converted(node):
            # A gradient stands in the cells of its field.
            node = home
        put_into(self, node, offset)

    def allocate_and_activate(self: Any, program: Any) -> None:
        allocate(self, program)
        if lazy or self.tree is None:
            return
        for field in self.places():
            if _is_converted(field.level):
                # An array activates the cells of its elements that are not zero.
                whole = field.level.shape + field.element_shape
                field.core.copy_from(np.ones(whole, field.dtype.numpy))
                field.core.fill(0)

    snode.SNode.dense = sparse_dense
    scalar.ScalarField.put_into = put_beside
    snode.Root.allocate = allocate_and_activate
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = layout
    try:
        yield
    finally:
        snode.SNode.dense, scalar.ScalarField.put_into = dense, put_into
        snode.Root.allocate = allocate
        os.environ.pop(VARIABLE)
        if before is not None:
            os.environ[VARIABLE] = before


def command() -> list[str]:
    """The command that runs a script on the layout of the current test."""
    layout = os.environ.get(VARIABLE, "dense")
    return [sys.executable] + ([] if layout == "dense" else [__file__, layout])


if __name__ == "__main__":
    wanted, script, *arguments = sys.argv[1:]
    sys.argv = [script, *arguments]
    sys.path[0] = str(Path(script).resolve().parent)
    with below(wanted):
        runpy.run_path(script, run_name="__main__")
