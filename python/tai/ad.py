"""Gradients across kernels: the tape, and gradients that the program writes itself."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

from . import _state
from ._ad_check import CheckResult as CheckResult
from ._ad_check import GradCheck
from ._ad_check import GradientCheckError as GradientCheckError
from ._ad_check import check as check
from ._ad_health import HealthReport, take_health
from ._ad_validation import LIMIT, raise_violations
from ._ad_validation import Violation as Violation
from .errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from .program import get_program


class Tape:
    """Records the kernels that run in its block, and then runs their gradients in reverse.

    ```python
    with ti.ad.Tape(loss):
        simulate()
    print(x.grad[0])
    ```

    Args:
        loss: a field without dimensions that has a gradient.
        clear_gradients: set all gradients to zero first.
        validation: check the global data access rules at run time, element by element: no
            element is written again but by accumulation, and none once it was read. What
            breaks them raises `TaiAssertionError` when the block is left, also where the tape
            could have saved the value; the `violations` of the error list them. In debug
            mode, iterations of one loop that meet in an element are reported without it.
        grad_check: a list of f64 fields whose gradients are compared with forward mode and
            differences when the block is left; a wrong one raises `GradientCheckError`, with
            a report that names the first kernel to blame. See `ti.ad.check`.
        health: look at the adjoints after each record of the reverse sweep; see `health()`.
    """

    def __init__(
        self, loss: Any = None, clear_gradients: bool = True, validation: bool = False,
        grad_check: Any = None, health: bool = False, *, validate: bool = False,
    ):  # fmt: skip
        from .fields import ScalarField

        if not isinstance(loss, ScalarField):
            what = "nothing" if loss is None else repr(loss)
            raise TaiRuntimeTypeError(
                f"ti.ad.Tape takes the field of the loss, but got {what}",
                "loss = ti.field(ti.f32, shape=(), needs_grad=True)",
            )
        if loss.shape != ():
            raise TaiRuntimeTypeError(
                f"the loss '{loss.name}' has shape {loss.shape}, but must be one number",
                "loss = ti.field(ti.f32, shape=(), needs_grad=True)",
            )
        if not loss.dtype.is_float:
            raise TaiAutodiffError(f"the loss '{loss.name}' is of type {loss.dtype}, not a float")
        self.loss, self.clear_gradients = loss, clear_gradients
        self._core: Any = None
        self._is_recording = False
        self._check = GradCheck(grad_check) if grad_check else None
        self._watches = health
        self._validates = validation or validate

    def __enter__(self) -> Tape:
        from . import _core

        if _state.tape is not None:
            raise TaiRuntimeError("tapes do not nest", "close the outer ti.ad.Tape first")
        program = get_program()
        self.loss.materialize(sys._getframe(1))
        grad = self.loss.grad
        if grad.snode is None:
            grad._placed_node()  # raises
        if self._check:
            self._check.begin(self.loss)
        self._core = program.context.tape(self.loss.core, self.clear_gradients)
        self._core.watch_health(self._watches)
        self._checks = self._validates or program.options.debug
        if self._checks:
            self._core.check_accesses(LIMIT, not self._validates)
        _state.tape = self._core
        _core.set_tape(self._core)
        self._is_recording = True
        return self

    def _stop(self) -> None:
        from . import _core

        _state.tape = None
        _core.set_tape(None)
        self._is_recording = False
        self._core.end()

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        self._stop()
        if kind is None:
            if self._checks:
                raise_violations(self._core)
            self._core.backward()
            if self._check:
                self._check.end(self._core, self.loss)

    def grad(self) -> None:
        """Runs the gradients of what was recorded, again."""
        self._need_record()
        self._core.backward()

    def replay(self, forward: bool = True, backward: bool = True) -> None:
        """Runs the recorded kernels, and their gradients, on what the fields hold now.

        One native call, without Python between the kernels. Gradients are cleared before
        the reverse sweep.
        """
        self._need_record()
        self._core.replay(forward, backward)

    def explain(self) -> str:
        """One line for each record: replayed or skipped, and why."""
        self._need_record()
        return self._core.explain()

    def health(self) -> HealthReport:
        """What the reverse sweep did to the adjoints: NaN, overflow, growth, flatness.

        From the last sweep if the tape was made with `health=True`; otherwise the sweep runs
        once more, and the gradients are put back.
        """
        self._need_record()
        return take_health(self._core, self.loss, self._watches)

    def _need_record(self) -> None:
        if self._core is None or self._is_recording:
            raise TaiRuntimeError("the tape holds nothing yet", "leave its `with` block first")

    @property
    def num_records(self) -> int:
        return self._core.records

    @property
    def num_skipped(self) -> int:
        return self._core.skipped


def clear_all_gradients() -> None:
    """Sets the gradients of all fields to zero."""
    get_program().materialize(sys._getframe(1).f_globals)
    get_program().context.clear_gradients()


def no_grad(function: Callable[..., Any]) -> Callable[..., Any]:
    """Lets a function run without being recorded: no gradient passes through it."""

    @functools.wraps(function)
    def decorated(*args: Any, **kwargs: Any) -> Any:
        tape = _state.tape
        if tape is None:
            return function(*args, **kwargs)
        result = _unrecorded(tape, function, args, kwargs)
        tape.record(functools.partial(function, *args, **kwargs), lambda: None)
        return result

    return decorated


def grad_replaced(function: Callable[..., Any]) -> Callable[..., Any]:
    """Gives a function a gradient of its own, which `grad_for` defines.

    The function may run many kernels; the tape runs the other function in their place.
    """

    @functools.wraps(function)
    def decorated(*args: Any, **kwargs: Any) -> Any:
        tape = _state.tape
        if tape is None:
            return function(*args, **kwargs)
        if decorated.grad is None:
            raise TaiAutodiffError(
                f"function '{function.__name__}' is marked by grad_replaced but has no gradient",
                f"define one: @ti.ad.grad_for({function.__name__})",
            )
        result = _unrecorded(tape, function, args, kwargs)
        gradient = decorated.grad
        forward = functools.partial(function, *args, **kwargs)
        tape.record(forward, lambda: gradient(*args, **kwargs))
        return result

    decorated.grad = None  # type: ignore[attr-defined]
    return decorated


def _unrecorded(tape: Any, function: Callable[..., Any], args: tuple, kwargs: dict) -> Any:
    from . import _core

    tape.suspend()
    _state.tape = None
    _core.set_tape(None)
    try:
        return function(*args, **kwargs)
    finally:
        _state.tape = tape
        _core.set_tape(tape)
        tape.resume()


def grad_for(primal: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Defines the gradient of a function that is marked by `grad_replaced`."""
    if not hasattr(primal, "grad") or getattr(primal, "_tai_kernel", False):
        raise TaiAutodiffError(
            f"'{getattr(primal, '__name__', primal)}' takes no gradient of its own",
            "mark it by @ti.ad.grad_replaced",
        )

    def decorator(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def decorated(*args: Any, **kwargs: Any) -> Any:
            return function(*args, **kwargs)

        primal.grad = decorated
        return decorated

    return decorator


class FwdMode:
    """Forward mode: not built in yet."""

    def __init__(self, *args: Any, **kwargs: Any):
        raise TaiAutodiffError("forward mode is not built in yet", "use ti.ad.Tape")


# The names of the paper.
complex_kernel = grad_replaced
complex_kernel_grad = grad_for
