"""Forward mode: kernels that carry tangents along with what they compute.

The tangent of a field is its dual, `x.dual`. In forward mode every launch, also one that a
tape replays and the gradient of a kernel, reads and writes duals beside the fields. A field
without a dual is constant.

Stable for other modules of the package: `forward_mode`, `clear_duals`, `run_forward` and
`hessian_product`.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import native, state
from ..base.program import get_program
from ..history import origins
from .seeds import TaiGradientWarning, parts_of


def check_dual(field: Any, what: str) -> Any:
    """The field, if it has a dual in memory.

    Raises:
        TaiRuntimeTypeError: it is not a field.
        TaiAutodiffError: it is not of a float type, or has no dual.
    """
    from ..fields.fields import Field

    if not isinstance(field, Field):
        raise TaiRuntimeTypeError(
            f"{what} must be a field, but got {'nothing' if field is None else repr(field)}"
        )
    if not field.dtype.is_float:
        raise TaiAutodiffError(f"{what} '{field.name}' is of type {field.dtype}, not a float")
    dual = field.dual
    if dual is None or dual.snode is None:
        raise TaiAutodiffError(
            f"{what} '{field.name}' has no dual",
            "make it with needs_dual=True, or call ti.root.lazy_dual() after placing it",
        )
    return field


def check_tangent(field: Any, tangent: Any) -> np.ndarray:
    """A tangent as an array of shape `field.shape + field.element_shape`.

    Raises:
        TaiRuntimeTypeError: it is not made of numbers, or has another shape.
    """
    wanted = field.shape + field.element_shape
    try:
        array = np.asarray(tangent, field.dtype.numpy)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"the tangent of field '{field.name}' must be made of numbers, but got {tangent!r}"
        ) from None
    # A list of all components in order is what Taichi takes.
    if array.shape != wanted and array.shape != (int(np.prod(wanted, dtype=int)),):
        raise TaiRuntimeTypeError(
            f"the tangent of field '{field.name}' must have shape {wanted}, but got {array.shape}"
        )
    return array.reshape(wanted)


def clear_duals() -> None:
    """Sets the duals of all fields to zero, but those that another thread has computed."""
    get_program().context.clear_tangents()


# Threads are in forward mode one after the other: the duals of a field that two of them use are
# those of one run.
_one_thread = threading.RLock()


def _cores_of(fields: Sequence[Any]) -> list[Any]:
    """The places of fields, in C++."""
    return [part.core for field in fields for part, _ in parts_of(field)]


def _follow(inputs: Sequence[Any], all_others: bool) -> None:
    """Follows the tangents of fields, to say where they get lost."""
    program = get_program()
    if all_others:
        duals = (f for f in program.fields.values() if f.role == "dual")
        inputs = [*inputs, *(d.primal for d in duals if d.snode is not None)]
    program.context.follow_tangents(_cores_of(inputs))


def _find_lost(outputs: Sequence[Any]) -> list[str]:
    """Where tangents got lost on the way to the outputs; to be called in forward mode."""
    return get_program().context.lost_tangents(_cores_of(outputs)).splitlines()


def _warn_of_lost(lines: list[str], stacklevel: int) -> None:
    for line in lines:
        warnings.warn(line, TaiGradientWarning, stacklevel=stacklevel + 1)


@contextlib.contextmanager
def forward_mode() -> Iterator[None]:
    """Launches kernels with their tangents while its block runs.

    Another thread that wants that waits for the end of the block.

    Raises:
        TaiRuntimeError: forward mode is on already.
    """
    if state.forward:
        raise TaiRuntimeError("forward mode is on already", "leave its `with` block first")
    with _one_thread:
        yield from _forward_mode()


def _forward_mode() -> Iterator[None]:
    program = get_program()
    program.context.set_option("forward_mode", "true")
    state.forward = True
    native.set_forward_mode(True)
    try:
        yield
    finally:
        state.forward = False
        native.set_forward_mode(False)
        if state.tape is None:
            origins.end()
        program.context.set_option("forward_mode", "false")


def _prepare(pairs: Sequence[tuple[Any, Any]], what: str) -> list[tuple[Any, np.ndarray]]:
    """The fields of the pairs, in memory, with their tangents as arrays."""
    checked = [(check_dual(field, what), tangent) for field, tangent in pairs]
    get_program().materialize(_caller_names())
    return [(field, check_tangent(field, tangent)) for field, tangent in checked]


def _caller_names() -> dict[str, Any]:
    """The variables of the program that called into the package."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("tai."):
        frame = frame.f_back
    return frame.f_globals


def run_forward(
    function: Callable[[], Any] | Any,
    tangents: Sequence[tuple[Any, Any]],
    outputs: Sequence[Any] = (),
    clear: bool = True,
) -> list[np.ndarray]:
    """Runs kernels in forward mode.

    Args:
        function: a function without arguments that launches kernels, or a `Tape` that has
            recorded them; then they are run again on what the fields hold now.
        tangents: fields that have duals, each with its tangent, an array of shape
            `shape + element_shape`.
        outputs: the fields whose tangents are wanted.
        clear: set all other duals to zero first.

    Returns:
        The tangents of `outputs`, each of shape `shape + element_shape`.

    Raises:
        TaiAutodiffError: a field has no dual, or something has no tangent rule.
        TaiRuntimeTypeError: a tangent has the wrong shape.
    """
    from .tape import Tape

    pairs = _prepare(tangents, "the field of a tangent")
    for field in outputs:
        check_dual(field, "output")
    with _one_thread:
        if clear:
            clear_duals()
        for field, tangent in pairs:
            field.dual.from_numpy(tangent)
        with forward_mode():
            _follow([field for field, _ in pairs], not clear)
            if isinstance(function, Tape):
                function.replay(forward=True, backward=False)
            else:
                function()
            lost = _find_lost(outputs)
        found = [field.dual.to_numpy() for field in outputs]
    _warn_of_lost(lost, 3)
    return found


def hessian_product(
    function: Callable[[], Any] | Any, loss: Any, pairs: Sequence[tuple[Any, Any]]
) -> list[np.ndarray]:
    """The gradient's derivative along the tangents of `pairs`: see `hvp`."""
    from .tape import Tape

    checked = _prepare(pairs, "the input")
    check_dual(loss, "the loss")
    # What has a gradient takes part in it; its dual would be missed without a word.
    for field in get_program().fields.values():
        if field.role == "grad" and getattr(field.dual, "snode", None) is None:
            raise TaiAutodiffError(
                f"field '{field.primal.name}' has a gradient but no dual, and the derivative of "
                "a gradient passes through both",
                "make it with needs_dual=True too, or call ti.root.lazy_dual()",
            )
    with _one_thread:
        clear_duals()
        for field, tangent in checked:
            if field.grad is None or field.grad.snode is None:
                field.grad._placed_node()  # raises
            field.dual.from_numpy(tangent)
        with forward_mode():
            if isinstance(function, Tape):
                function.replay(forward=True, backward=True)
            else:
                with Tape(loss):
                    function()
        return [field.grad.dual.to_numpy() for field, _ in checked]


def _as_list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _pair(inputs: Any, directions: Any) -> list[tuple[Any, Any]]:
    """One direction for one field, or a list for a list."""
    if not isinstance(inputs, (list, tuple)):
        return [(inputs, directions)]
    if not isinstance(directions, (list, tuple)) or len(directions) != len(inputs):
        raise TaiRuntimeTypeError(
            f"{len(inputs)} fields need a list of as many directions, but got {directions!r}"
        )
    return list(zip(inputs, directions, strict=True))


def jvp(function: Callable[[], Any] | Any, inputs: Any, directions: Any, outputs: Any) -> Any:
    """A product of the Jacobian matrix and a vector, by one run in forward mode.

    ```python
    tangent = ti.ad.jvp(simulate, x, direction, loss)
    ```

    Args:
        function: launches kernels; or a `Tape` that has recorded them.
        inputs: a field, or a list of fields.
        directions: for each of them an array of shape `shape + element_shape`.
        outputs: a field, or a list of fields.

    Returns:
        The derivative of the outputs along the directions, an array of shape
        `shape + element_shape`, or a list of these for a list of outputs. The duals hold them
        too.

    Raises:
        TaiAutodiffError: a field has no dual, or something has no tangent rule.
        TaiRuntimeTypeError: a direction has the wrong shape.
    """
    results = run_forward(function, _pair(inputs, directions), _as_list(outputs))
    return results if isinstance(outputs, (list, tuple)) else results[0]


def hvp(function: Callable[[], Any] | Any, loss: Any, inputs: Any, directions: Any) -> Any:
    """A product of the Hessian matrix of a loss and a vector, forward over reverse.

    ```python
    x = ti.field(ti.f64, shape=n, needs_grad=True, needs_dual=True)
    curvature = ti.ad.hvp(compute_loss, loss, x, direction)
    ```

    Args:
        function: launches the kernels that compute the loss; or a `Tape` that has recorded
            them.
        loss: a field without dimensions that has a gradient and a dual.
        inputs: a field, or a list of fields, with gradients and duals.
        directions: for each of them an array of shape `shape + element_shape`.

    Returns:
        The derivative of the gradient along the directions, an array of shape
        `shape + element_shape`, or a list of these for a list of inputs. The gradient itself
        is in `x.grad`.

    Raises:
        TaiAutodiffError: a field lacks a gradient or a dual, or something has no rule.
        TaiRuntimeTypeError: a direction has the wrong shape.
    """
    results = hessian_product(function, loss, _pair(inputs, directions))
    return results if isinstance(inputs, (list, tuple)) else results[0]


class FwdMode:
    """Runs the kernels of its block in forward mode.

    ```python
    with ti.ad.FwdMode(loss=loss, param=x, seed=[1.0, 0.0, 0.0]):
        compute()
    print(loss.dual[None])
    ```

    Args:
        loss: a field, or a list of fields, whose duals are wanted.
        param: the field by which to differentiate.
        seed: its tangent: an array of shape `shape + element_shape`, or a list of all
            components in order. A single number needs none: it is 1.
        clear_gradients: set all duals to zero first.

    The duals of `loss` and of everything between hold the tangents afterwards; that of `param`
    is zero again.

    Raises:
        TaiAutodiffError: a field has no dual, or something in a kernel has no tangent rule.
        TaiRuntimeError: the seed is missing, or forward mode is on already.
        TaiRuntimeTypeError: `loss` or `param` is not a field, or the seed has the wrong shape.
    """

    def __init__(self, loss: Any, param: Any, seed: Any = None, clear_gradients: bool = True):
        self.loss = _as_list(loss)
        if not self.loss:
            raise TaiRuntimeTypeError("ti.ad.FwdMode needs the field of the loss")
        for field in self.loss:
            check_dual(field, "the loss")
        self.param = check_dual(param, "the parameter")
        if seed is None:
            wanted = param.shape + param.element_shape
            if wanted:
                raise TaiRuntimeError(
                    f"the seed is not set, but field '{param.name}' is more than one number",
                    f"pass the direction of the derivative: seed=[…], of shape {wanted}",
                )
            seed = 1.0
        self.seed = check_tangent(param, seed)
        self.clear_gradients = clear_gradients
        self._mode: Any = None

    def __enter__(self) -> FwdMode:
        get_program().materialize(_caller_names())
        mode = forward_mode()
        mode.__enter__()
        self._mode = mode
        if self.clear_gradients:
            clear_duals()
        self.param.dual.from_numpy(self.seed)
        _follow([self.param], not self.clear_gradients)
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        mode, self._mode = self._mode, None
        lost = [] if kind is not None else _find_lost(self.loss)
        mode.__exit__(None, None, None)
        self.param.dual.fill(0.0)
        _warn_of_lost(lost, 2)
