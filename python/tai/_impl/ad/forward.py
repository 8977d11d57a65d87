"""Forward mode: kernels that propagate tangents beside values.

The tangent of a field is its dual, `x.dual`. In forward mode every launch, also one that a
tape replays and the gradient of a kernel, reads and writes duals beside the fields. A field
without a dual is constant.

"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base.program import get_program
from ..fields.root import materialize
from .mode import (
    ForwardMode,
    caller_names,
    check_dual,
    check_tangent,
    clear_duals,
    derivatives_of_gradients,
    find_lost,
    follow,
    one_thread,
    prepare,
    warn_of_lost,
)
from .snapshot import Snapshot
from .tape import Tape


def as_function(function: Any, or_tape: bool = False) -> Any:
    """Returns a function that launches kernels.

    Raises:
        TaiRuntimeTypeError: it is none.
    """
    if not callable(function) and not (or_tape and isinstance(function, Tape)):
        raise TaiRuntimeTypeError(
            f"the first argument is a function that launches kernels, but got {function!r}"
        )
    return function


def run_forward(
    function: Callable[[], Any] | Any,
    tangents: Sequence[tuple[Any, Any]],
    outputs: Sequence[Any] = (),
    clear: bool = True,
) -> list[np.ndarray]:
    """Runs kernels in forward mode.

    Args:
        function: a function without arguments that launches kernels, or a `Tape` that has
            recorded them; then they are run again on the current values of the fields.
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
    as_function(function, or_tape=True)
    pairs = prepare(tangents, "the field of a tangent")
    for field in outputs:
        check_dual(field, "output")
    with one_thread:
        if clear:
            clear_duals()
        for field, tangent in pairs:
            field.dual.from_numpy(tangent)
        with ForwardMode():
            follow([field for field, _ in pairs], not clear)
            if isinstance(function, Tape):
                function.replay(forward=True, backward=False)
            else:
                function()
            lost = find_lost(outputs)
        found = [field.dual.to_numpy() for field in outputs]
    warn_of_lost(lost)
    return found


def hessian_product(
    function: Callable[[], Any] | Any, loss: Any, pairs: Sequence[tuple[Any, Any]]
) -> list[np.ndarray]:
    """Returns the derivative of the gradient along the tangents of `pairs`: see `hvp`."""
    as_function(function, or_tape=True)

    def run() -> None:
        if isinstance(function, Tape):
            function.replay(forward=True, backward=True)
        else:
            with Tape(loss):
                function()

    return derivatives_of_gradients(run, loss, pairs)


def _as_list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _pair(inputs: Any, directions: Any) -> list[tuple[Any, Any]]:
    """Pairs each input field with its direction; both are one object or a list."""
    if not isinstance(inputs, (list, tuple)):
        return [(inputs, directions)]
    if not isinstance(directions, (list, tuple)) or len(directions) != len(inputs):
        raise TaiRuntimeTypeError(
            f"{len(inputs)} fields need a list of as many directions, but got {directions!r}"
        )
    return list(zip(inputs, directions, strict=True))


def jvp(
    function: Callable[[], Any] | Any, inputs: Any, directions: Any, outputs: Any,
    many: bool = False,
) -> Any:  # fmt: skip
    """A product of the Jacobian matrix and a vector, by one run in forward mode.

    ```python
    tangent = ti.ad.jvp(simulate, x, direction, loss)
    tangents = ti.ad.jvp(simulate, x, np.eye(n), y, many=True)
    ```

    Args:
        function: launches kernels; or a `Tape` that has recorded them.
        inputs: a field, or a list of fields.
        directions: for each of them an array of shape `shape + element_shape`.
        outputs: a field, or a list of fields.
        many: there are several directions: arrays have one more index, in front, and so have the
            results. There is a run for each direction, which begins with the fields as they are at
            the call, and they are put back at the end. Fields of a `ti.batch` take directions for
            all worlds in one run.

    Returns:
        The derivative of the outputs along the directions, an array of shape
        `shape + element_shape`, or a list of these for a list of outputs. The duals hold them
        too.

    Raises:
        TaiAutodiffError: a field has no dual, or something has no tangent rule.
        TaiRuntimeTypeError: a direction has the wrong shape.
    """
    pairs = _pair(inputs, directions)
    rows = _as_list(outputs)
    results = _run_many(function, pairs, rows) if many else run_forward(function, pairs, rows)
    return results if isinstance(outputs, (list, tuple)) else results[0]


def _run_many(
    function: Any, pairs: Sequence[tuple[Any, Any]], outputs: Sequence[Any]
) -> list[np.ndarray]:
    """Runs kernels in forward mode for each of several directions, from the same start."""
    as_function(function, or_tape=True)
    stacks = []
    for field, given in pairs:
        check_dual(field, "the field of a tangent")
        wanted = field.shape + field.element_shape
        stack = np.asarray(given)
        if stack.ndim != len(wanted) + 1 or stack.shape[1:] != wanted:
            raise TaiRuntimeTypeError(
                f"many directions of field '{field.name}' must have shape {('n', *wanted)}, but "
                f"got {stack.shape}".replace("'n'", "n")
            )
        stacks.append(stack)
    counts = sorted({len(stack) for stack in stacks})
    if len(counts) != 1 or counts[0] == 0:
        raise TaiRuntimeTypeError(
            f"each field needs the same number of directions, and at least one, but got {counts}"
        )
    materialize(get_program(), caller_names())
    found = []
    with Snapshot() as start:
        for number in range(counts[0]):
            start.restore(only_primal=True)
            chosen = [(f, stack[number]) for (f, _), stack in zip(pairs, stacks, strict=True)]
            found.append(run_forward(function, chosen, outputs))
    return [np.stack(arrays) for arrays in zip(*found, strict=True)]


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


class FwdMode(ForwardMode):
    """The context manager that runs the kernels of its block in forward mode.

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
        super().__init__()
        self.loss = _as_list(loss)
        if not self.loss:
            raise TaiRuntimeTypeError("ti.ad.FwdMode needs the field of the loss")
        for field in self.loss:
            check_dual(field, "the loss")
        self.param = check_dual(param, "the parameter")
        if seed is None:
            wanted = param.shape + param.element_shape
            if int(np.prod(wanted, dtype=int)) != 1:
                raise TaiRuntimeError(
                    f"the seed is not set, but field '{param.name}' is more than one number",
                    f"pass the direction of the derivative: seed=[…], of shape {wanted}",
                )
            seed = 1.0
        # A single number is the seed of the only element, whatever the shape of the field.
        if np.ndim(seed) == 0 and int(np.prod(param.shape + param.element_shape, dtype=int)) == 1:
            seed = [seed]
        self.seed = check_tangent(param, seed)
        self.clear_gradients = clear_gradients
        # Whether the tangents of the parameter were set, and are to be set to zero again.
        self._is_seeded = False

    def _enter(self) -> FwdMode:  # type: ignore[override]
        materialize(get_program(), caller_names())
        super()._enter()
        if self.clear_gradients:
            clear_duals()
        self._is_seeded = True
        self.param.dual.from_numpy(self.seed)
        follow([self.param], not self.clear_gradients)
        return self

    def _leave(self, kind: Any, error: Any, trace: Any) -> None:
        lost = [] if kind is not None else find_lost(self.loss)
        self._end()
        warn_of_lost(lost)

    def _end(self) -> None:
        super()._end()
        if self._is_seeded:
            self.param.dual.fill(0.0)
            self._is_seeded = False
