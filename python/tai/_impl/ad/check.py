"""`ti.ad.check`: verifies a gradient and, if it is wrong, names the kernel at fault."""

from __future__ import annotations

import functools
from typing import Any

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base import state
from .compare import CheckResult, Program, as_fields, check_program, check_start, run_records
from .seeds import as_float_field, number_of
from .snapshot import Snapshot
from .tape import Tape


def check(
    target: Any,
    *args: Any,
    loss: Any = None,
    wrt: Any = None,
    directions: int = 4,
    seed: int = 0,
    tolerance: float | None = None,
    forward_tolerance: float | None = None,
    bisect: bool = True,
) -> CheckResult:
    """Checks the gradients of a program against forward mode and against finite differences.

    ```python
    result = ti.ad.check(simulate, loss=loss, wrt=[x])
    print(result)
    assert result
    ```

    Args:
        target: a kernel; a function that runs kernels; or a finished `ti.ad.Tape`, with
            the fields restored to the values that they had when it was entered.
        args: arguments of the kernel or function.
        loss: the field of the loss. Without it all fields that the target changes are
            weighted by random numbers.
        wrt: the fields to check; all that the target reads if left out. They need gradients.
        directions: how many random directions for each field.
        seed: the seed of the random directions.
        tolerance: greatest relative error of the differences; 1e-7 for f64, 5e-3 for f32.
        forward_tolerance: greatest relative error against forward mode; 1e-12 and 1e-4.
        bisect: if a gradient is wrong, search the first kernel at fault.

    Returns:
        A result that is true if everything agrees, and prints as a report. Where nothing was
        checked it is false, and says why: no field with a gradient is read, all are of types
        that differences are too coarse for, or nothing depends on them.

    Raises:
        TaiAutodiffError: nothing was launched, or a field has no gradient.
        TaiRuntimeError: called inside a tape; the start of the tape is gone; or the program
            gives another result when it is run again.
    """
    if state.tape is not None:
        raise TaiRuntimeError("a gradient cannot be checked inside a tape", "leave the tape first")
    if isinstance(target, Tape):
        target._need_record()
        run, what = functools.partial(run_records, target._core), "the tape"
        loss = target.loss if loss is None else loss
        recorded = number_of(loss) if loss is not None else None
    elif callable(target):
        run = functools.partial(target, *args)
        what = f"'{getattr(target, '__name__', 'the function')}'"
        recorded = None
    else:
        raise TaiRuntimeTypeError(
            f"ti.ad.check takes a kernel, a function or a tape, but got {target!r}",
            "ti.ad.check(run, loss=loss, wrt=[x])",
        )
    wrt = as_fields(wrt, "wrt")
    if loss is not None:
        as_fields([as_float_field(loss, "the loss")], "loss")
        what += f", loss '{loss.name}'"
    for f in [*(wrt or ()), *([loss] if loss is not None else [])]:
        f.materialize()
    with Snapshot() as before:
        program = Program(run, loss, before)
        program.record()
        check_start(program, recorded)
        core = target._core if isinstance(target, Tape) else program.core
        return check_program(
            program, core, what, wrt, directions, seed, tolerance, forward_tolerance, bisect
        )
