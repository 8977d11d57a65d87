"""Shadows for a part of a program, and values with their digits: `ti.tools.shadow_values`."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base import native, state
from ..base.locks import snapshot
from ..base.program import get_program
from ..base.shadows import context
from ..values.ops import grouped
from ..values.types import ndarray, template
from .kernels import kernel


@functools.cache
def _copier() -> Any:
    @kernel
    def copy(source: template(), to: ndarray()) -> None:  # type: ignore
        for at in grouped(source):
            to[at] = source[at]

    return copy


class Shadows(native.WithBlock):
    """A block, or each so many of its runs, whose kernels have shadows: see `shadows`."""

    def __init__(self, every: int):
        self._every, self._runs = every, 0
        self._is_on = False

    def _enter(self) -> Shadows:
        program = get_program()
        is_due = self._runs % self._every == 0
        self._runs += 1
        if is_due and not program.options.shadow and not state.shadows:
            program.context.set_option("shadow", "true")
            self._is_on = program.has_shadows = True
            state.of_thread.shadows = True
            _forget_launches(program)
        return self

    def _end(self) -> None:
        if not self._is_on:
            return
        self._is_on = False
        state.of_thread.shadows = False
        program = get_program()
        program.context.set_option("shadow", "false")
        _forget_launches(program)


def _forget_launches(program: Any) -> None:
    """Lets Python look again which code a launch needs."""
    for one in snapshot(program.kernels):
        one.forget_launches()


def shadows(every: int = 1) -> Shadows:
    """Kernels that are launched in the block compute each float once more, with more digits.

    ```python
    sample = ti.tools.shadows(every=100)
    for _ in range(1000):
        with sample:
            with ti.ad.Tape(loss):
                simulate()
    print(ti.tools.shadow_report())
    ```

    One of `every` runs of the block has shadows, the first among them; the others run the code of
    the program at its speed. Shadows begin at the values that fields have at the start of a block.
    In a program with `ti.init(shadow=True)` all kernels have shadows anyway. Other threads should
    launch nothing meanwhile.

    Args:
        every: the number of runs of which one has shadows.

    Raises:
        TaiRuntimeError: the program has fast maths, or does not run on the CPU.
    """
    if isinstance(every, bool) or not isinstance(every, int) or every < 1:
        raise TaiRuntimeTypeError(f"every is a number of runs, at least 1, but got {every!r}")
    return Shadows(every)


def shadow_values(field: Any) -> np.ndarray:
    """The values of a dense field with the digits of its shadows.

    The array is of f64 for a field of f32, and of `np.longdouble` for one of f64. An element that
    a kernel did not store last has the digits of its own type.

    Raises:
        TaiRuntimeError: kernels have no shadows now.
        TaiRuntimeTypeError: the field is not of f32 or f64.
    """
    found = context()
    if not (state.options.shadow or state.shadows):
        raise TaiRuntimeError(
            "shadows last as long as the block of ti.tools.shadows",
            "ask for the values within it",
        )
    plain = field.to_numpy()
    if plain.dtype not in (np.float32, np.float64):
        raise TaiRuntimeTypeError(
            f"fields of f32 and f64 have shadows in memory, but got one of {plain.dtype}"
        )
    wide = plain.astype(np.float64 if plain.dtype == np.float32 else np.longdouble)
    element = wide.shape[len(field.shape) :]
    for part in np.ndindex(element):
        own = field.get_scalar_field(*part) if element else field
        # A copy by a kernel also copies the shadow values of the floats.
        copied = np.zeros(field.shape, plain.dtype)
        _copier()(own, copied)
        errors = np.zeros(field.shape)
        found.shadow_errors(copied, errors)
        wide[(..., *part)] += errors
    return wide
