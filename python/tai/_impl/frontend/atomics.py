"""Atomic functions: they update the place that is their first argument."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from ..values import ops

# For each function that updates a place atomically, its operator.
ATOMICS = {
    ops.atomic_add: "+",
    ops.atomic_sub: "-",
    ops.atomic_mul: "*",
    ops.atomic_min: "min",
    ops.atomic_max: "max",
    ops.atomic_and: "&",
    ops.atomic_or: "|",
    ops.atomic_xor: "^",
}


def takes_reference(callee: Any) -> bool:
    """Whether a function may change the variables that it gets as arguments."""
    if isinstance(callee, Hashable) and callable(callee) and callee in ATOMICS:
        return True
    info = getattr(callee, "_tai_func", None)
    return info is not None and info.has_templates
