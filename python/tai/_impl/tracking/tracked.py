"""Gradients of Python's values: arguments and results of kernels (numbers, matrices), and arrays.

Fields have adjoints of their own. A value has a `Gradient`: memory that the adjoints of
launches add to (arguments) or read (results). A tape records its address with a launch; this
module clears it before a sweep and collects it afterwards.
"""

from __future__ import annotations

import functools
import math
import operator
import weakref
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import state
from ..base.dtypes import DataType
from ..base.keywords import MissingMethod
from ..fields.arrays import Ndarray
from ..history import gradients, origins
from ..history.gradients import ArrayGradient, Gradient, note_variable
from ..interop import device_arrays
from ..values.matrix import Matrix, Vector, swizzle
from . import numpy_functions, tangents
from .tape_arrays import ArraySweep, TapeArrays

# Values


def variable(value: Any) -> Any:
    """A number, vector or matrix that has a gradient where kernels take it as an argument.

    ```python
    a = ti.ad.variable(0.3)
    with ti.ad.Tape(loss):
        step(a)
    print(a.grad)
    ```

    Args:
        value: a number, a `ti.Vector`, a `ti.Matrix`, or a list of numbers.

    Returns:
        A float, or a vector or matrix, that has a gradient. It is immutable: make the
        next one by `a = ti.ad.variable(a - 0.1 * a.grad)`.

    Raises:
        TaiRuntimeTypeError: the value is no such thing.
    """
    if isinstance(value, (bool, np.bool_)) or isinstance(value, str):
        raise TaiRuntimeTypeError(f"a variable is a float, a vector or a matrix, not {value!r}")
    if isinstance(value, (int, float, np.integer, np.floating)):
        gradient = Gradient(())
        note_variable(gradient)
        return Number._make(float(value), gradient)
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = None
    if array is None or array.ndim not in (1, 2) or array.size == 0:
        raise TaiRuntimeTypeError(
            f"a variable is a float, a vector or a matrix, not {value!r}",
            "keep larger arrays in a field or a ti.ndarray with needs_grad=True",
        )
    gradient = Gradient(array.shape)
    note_variable(gradient)
    return _wrap(array, gradient)


def gradient_of(value: Any) -> Gradient | None:
    """Returns the gradient of a value, or None if it has none."""
    return getattr(value, "_gradient", None) if isinstance(value, (Number, Matrix)) else None


def _is_tracked(value: Any) -> bool:
    """Whether Python's arithmetic on the value gives results with a gradient or a tangent.

    The gradient of a variable matters while a tape records; the result of a kernel under a tape may
    become part of a loss afterwards.
    """
    if tangents.cell_of(value) is not None:
        return True
    gradient = gradient_of(value)
    return gradient is not None and (state.tape is not None or not gradient.is_variable)


class Number(float):
    """A float with a gradient: a variable, or the result of a kernel under a tape.

    Sums, products, quotients and powers of such numbers have one, too, and NumPy's functions of
    single numbers (`np.sqrt(x)`). Everything else (`float(x)`, functions of `math`) gives plain
    numbers, which are constants to a tape: a `TaiGradientWarning` names the line where one of them
    comes back into a kernel or a field (see `origins`).

    Attributes:
        grad: the gradient after a reverse sweep.
    """

    backward = MissingMethod()

    _gradient: Gradient | None
    # The element that keeps the value's tangent in forward mode, or None.
    _cell: Any = None

    @classmethod
    def _make(cls, value: float, gradient: Gradient | None, cell: Any = None) -> Number:
        made = cls(value)
        made._gradient = gradient
        if cell is not None:
            made._cell = cell
        return made

    @property
    def grad(self) -> float:
        return float(_readable(self._gradient).total())

    def __reduce__(self) -> Any:
        return float, (float(self),)


def _plain(thing: Any) -> Any:
    """Returns the same object with plain numbers in the place of those with a gradient."""
    if isinstance(thing, Number):
        return float(thing)
    if type(thing) in (list, tuple):
        return type(thing)(map(_plain, thing))
    return thing


def _numbers_in(thing: Any) -> list[Number]:
    if isinstance(thing, (list, tuple)):
        return [number for item in thing for number in _numbers_in(item)]
    return [thing] if isinstance(thing, Number) else []


def _refuse_function(name: str, values: Any) -> None:
    """Refuses a function that would lose a gradient while a tape records, or in forward mode."""
    lost = any(map(_is_tracked, _numbers_in(values)))
    if lost and (state.tape is not None or state.forward):
        raise TaiAutodiffError(
            f"np.{name} knows no gradient of a number that a kernel returned",
            "compute it in a kernel, or say that it is a constant: float(…)",
        )


def _is_single(value: Any) -> bool:
    return value is None or isinstance(value, (bool, int, float, np.bool_, np.number))


def _numpy_function(ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
    """Evaluates a function of NumPy for single numbers, with its gradient."""
    name = ufunc.__name__
    values = [item.item() if isinstance(item, np.ndarray) and item.ndim == 0 else item
              for item in inputs]  # fmt: skip
    is_plain = (
        method == "__call__"
        and not options
        and all(isinstance(value, (int, float, np.number)) for value in values)
    )
    if is_plain and name in numpy_functions.OPERATORS:
        return getattr(operator, numpy_functions.OPERATORS[name])(
            *(value if isinstance(value, Number) else float(value) for value in values)
        )
    if name not in numpy_functions.CONSTANT and any(map(_is_tracked, values)):
        has_tangent = any(tangents.cell_of(value) is not None for value in values)
        if is_plain and not has_tangent:
            found = numpy_functions.derivative(name, [float(value) for value in values])
            if found is not None:
                return _combine(found[0], None, *zip(values, found[1], strict=True))
        _refuse_function(name, values)
    return getattr(ufunc, method)(*map(_plain, inputs), **options)


def _numpy_routine(function: Any, types: Any, args: Any, options: Any) -> Any:
    """A function of NumPy of single numbers, or of whole arrays, which are constants to a tape."""
    name, values = function.__name__, [*args, *options.values()]
    if any(map(_is_tracked, _numbers_in(values))) and all(map(_is_single, values)):
        composed = numpy_functions.COMPOSED.get(name)
        if composed is not None:
            return composed(*args, **options)
        if name in numpy_functions.UNARY and len(args) == 1 and not options:
            has_tangent = tangents.cell_of(args[0]) is not None
            found = numpy_functions.derivative(name, [float(args[0])])
            if found is not None and not has_tangent:
                return _combine(found[0], None, (args[0], found[1][0]))
    if name not in numpy_functions.FORM and name not in numpy_functions.CONSTANT:
        _refuse_function(name, values)
    return function(*_plain(args), **_plain_values(options))


def _plain_values(options: dict[str, Any]) -> dict[str, Any]:
    return {name: _plain(value) for name, value in options.items()}


Number.__array_ufunc__ = lambda self, *args, **options: _numpy_function(*args, **options)  # type: ignore[attr-defined]
Number.__array_function__ = lambda self, *args: _numpy_routine(*args)  # type: ignore[attr-defined]


def _readable(gradient: Gradient | None) -> Gradient:
    if gradient is None:
        raise TaiAutodiffError(
            "a number of forward mode has no gradient", "run the kernels in a tape"
        )
    if gradient.parts is not None:
        raise TaiAutodiffError(
            "a number that Python computed keeps no gradient",
            "ask those that it was computed from",
        )
    return gradient


def _combine(value: float, cell: Any, *terms: tuple[Any, float]) -> Any:
    """Makes a number that was computed from others, given the partial derivatives and the place of
    its tangent.
    """
    parts = []
    for operand, partial in terms:
        gradient = gradient_of(operand) if isinstance(operand, Number) else None
        if gradient is None:
            continue
        if gradient.parts is None:
            parts.append((gradient, None, partial))
        else:
            parts += [(g, c, p * partial) for g, c, p in gradient.parts]
    return Number._make(value, Gradient((), None, parts) if parts else None, cell)


def _power_partials(a: float, b: float) -> tuple[float, float]:
    first = 0.0 if b == 0 else b * a ** (b - 1)
    return first, a**b * math.log(a) if a > 0 else 0.0


# For each operation, its value and its partial derivatives.
_OPERATIONS: dict[str, tuple[Any, Any]] = {
    "add": (operator.add, lambda a, b: (1.0, 1.0)),
    "sub": (operator.sub, lambda a, b: (1.0, -1.0)),
    "mul": (operator.mul, lambda a, b: (b, a)),
    "truediv": (operator.truediv, lambda a, b: (1 / b, -a / (b * b))),
    "pow": (operator.pow, _power_partials),
    "mod": (operator.mod, lambda a, b: (1.0, -(a // b))),
}


def _define(name: str, function: Any, partials: Any) -> None:
    def compute(a: Any, b: Any) -> Any:
        if not isinstance(a, (int, float, np.number)) or not isinstance(b, (int, float, np.number)):
            return NotImplemented
        x, y = float(a), float(b)
        value = function(x, y)
        if not _is_tracked(a) and not _is_tracked(b):
            return value
        dx, dy = partials(x, y)
        cell = tangents.combine(name, a, b)
        return _combine(value, cell, (a, dx), (b, dy))

    setattr(Number, f"__{name}__", lambda self, other: compute(self, other))
    setattr(Number, f"__r{name}__", lambda self, other: compute(other, self))


for _name, (_function, _partials) in _OPERATIONS.items():
    _define(_name, _function, _partials)


def _unary(function: Any, partial: Any, name: str, second: float) -> Any:
    def compute(self: Number) -> Any:
        value = function(float(self))
        if not _is_tracked(self):
            return value
        cell = tangents.combine(name, self, second)
        return _combine(value, cell, (self, partial(float(self))))

    return compute


Number.__neg__ = _unary(operator.neg, lambda a: -1.0, "mul", -1.0)  # type: ignore[method-assign]
Number.__pos__ = _unary(operator.pos, lambda a: 1.0, "mul", 1.0)  # type: ignore[method-assign]
Number.__abs__ = _unary(abs, lambda a: float(np.sign(a)), "abs", 0.0)  # type: ignore[method-assign]


class _Tracked:
    """Base of vectors and matrices with a gradient."""

    __slots__ = ()

    @property
    def grad(self) -> Any:
        gradient = _readable(self._gradient)
        return Matrix._wrap(gradient.total().astype(self._array.dtype))

    def __getitem__(self, key: Any) -> Any:
        item = np.array(self._array[key])
        if item.ndim or not _is_tracked(self):
            self._refuse_in_tape()
            return Matrix._wrap(item)
        component = int(np.arange(self._array.size).reshape(self._array.shape)[key])
        gradient = self._gradient
        parts = None if gradient is None else Gradient((), None, [(gradient, component, 1.0)])
        whole = tangents.cell_of(self)
        cell = None if whole is None else tangents.Component(whole, component)
        return Number._make(float(item), parts, cell)

    def __setitem__(self, key: Any, value: Any) -> None:
        raise TaiAutodiffError(
            "a component of a value with a gradient cannot be set", "make a new variable of it"
        )

    def __getattr__(self, name: str) -> Any:
        found = swizzle(name, len(self._array)) if not name.startswith("_") else None
        if found is not None and len(found) == 1 and self._array.ndim == 1:
            return self[found[0]]
        if found is not None:
            self._refuse_in_tape()
        return Matrix.__getattr__(self, name)  # type: ignore[arg-type]

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self._array)))

    def _refuse_in_tape(self) -> None:
        """Raises an error for Python arithmetic on the value under a tape, since the result would
        have no gradient.
        """
        if state.tape is not None or tangents.cell_of(self) is not None:
            raise TaiAutodiffError(
                "matrices that have a gradient are not computed with in Python while a tape "
                "records or in forward mode",
                "do it in a kernel, or take the plain numbers by .to_numpy()",
            )

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        self._refuse_in_tape()
        return getattr(ufunc, method)(*map(_as_plain_array, inputs), **options)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        if function.__name__ not in numpy_functions.FORM:
            self._refuse_in_tape()
        return function(*map(_as_plain_array, args), **options)

    def _binary(self, function: Any, other: Any, swapped: bool = False) -> Any:
        self._refuse_in_tape()
        return Matrix._binary(self, function, other, swapped)  # type: ignore[arg-type]


def _as_plain_array(thing: Any) -> Any:
    if isinstance(thing, _Tracked):
        return thing.to_numpy()
    if type(thing) in (list, tuple):
        return type(thing)(map(_as_plain_array, thing))
    return thing


# Methods of matrices that give the numbers as they are; all others compute.
_PLAIN = {"to_numpy", "to_list", "get_shape", "field", "ndarray", "fill"}


def _guard(name: str, method: Any) -> None:
    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        self._refuse_in_tape()
        return method(self, *args, **kwargs)

    setattr(_Tracked, name, guarded)


for _name, _method in vars(Matrix).items():
    _computes = not _name.startswith("_") or _name in ("__matmul__", "__neg__", "__abs__")
    if _computes and _name not in _PLAIN and isinstance(_method, FunctionType):
        _guard(_name, _method)


class TrackedVector(_Tracked, Vector):
    """A vector with a gradient: a variable, or the result of a kernel under a tape."""

    __slots__ = ("_cell", "_gradient")


class TrackedMatrix(_Tracked, Matrix):
    """A matrix with a gradient: a variable, or the result of a kernel under a tape."""

    __slots__ = ("_cell", "_gradient")


def _wrap(array: np.ndarray, gradient: Gradient | None, cell: Any = None) -> Any:
    cls = TrackedVector if array.ndim == 1 else TrackedMatrix
    made: Any = object.__new__(cls)
    made._array, made._gradient, made._cell = array, gradient, cell
    return made


def wrap_result(answer: Any, gradient: Gradient | None, cell: Any = None) -> Any:
    """The result of a kernel under a tape or in forward mode, with its gradient and tangent."""
    if isinstance(answer, float):
        return Number._make(answer, gradient, cell)
    return _wrap(answer._array, gradient, cell)


# Arrays


def _is_tensor_with_gradient(value: Any) -> bool:
    if getattr(value, "requires_grad", False) is not True or not hasattr(value, "detach"):
        return False
    if not value.is_contiguous():
        raise TaiRuntimeTypeError(
            "a tensor with a gradient must be contiguous", "pass tensor.contiguous()"
        )
    return True


def has_gradient_array(value: Any) -> bool:
    """Whether kernels are differentiated with respect to the array.

    A `ti.ndarray` made with `needs_grad=True`, or a torch tensor with `requires_grad`.
    """
    if isinstance(value, np.ndarray):
        return False
    return _is_tensor_with_gradient(value) or gradient_array(value) is not None


def gradient_array(value: Any) -> Any:
    """The memory of the gradient of an array that has one; that of a tensor is made if it is
    missing."""
    if isinstance(value, np.ndarray):
        return None
    if _is_tensor_with_gradient(value):
        if value.grad is None:
            value.grad = value.detach().new_zeros(value.shape)
        elif not value.grad.is_contiguous():
            raise TaiRuntimeTypeError(
                "the gradient of a tensor must be contiguous", "t.grad = t.grad.contiguous()"
            )
        return device_arrays.as_device_array(value.grad) or value.grad.detach().numpy()
    grad = getattr(value, "grad", None)
    array = getattr(grad, "array", None)
    return array if isinstance(array, (np.ndarray, device_arrays.DeviceArray)) else None


# Tapes


class TapeValues:
    """The values and arrays of Python that the launches of a tape use."""

    def __init__(self, core: Any, runs_again: bool = False, clears: bool = True):
        self.core = core
        self._gradients: list[Gradient] = []  # of results and of values that Python computed
        self._passed: set[tuple[int, Any]] = set()
        self.arrays = TapeArrays(core, runs_again, weakref.WeakMethod(self.take))
        self._fed_back = False
        self._clears = clears
        # The thread that records or sweeps, until this work is done.
        self.worker: object = state.thread
        self._taken: list[Any] = []

    def take(self, thing: Any) -> None:
        """Notes that a launch uses the gradient of a variable or an array.

        A value that another thread has left in the gradient counts as zero.

        Raises:
            TaiRuntimeError: a tape of another thread uses it now.
        """
        other = None if thing.user is None else thing.user()
        if other is self:
            return
        me = state.thread
        if other is not None and other.worker not in (None, me) and (
            self._clears or other._clears
        ):  # fmt: skip
            raise TaiRuntimeError(
                "another thread records a tape that uses the gradient of the same "
                + ("array" if isinstance(thing, ArrayGradient) else "variable"),
                "give each thread its own, or begin with the one when the gradient of the other "
                "is there",
            )
        if thing.owner is not me:
            if self._clears:
                thing.clear()
            thing.owner = me
        thing.user = weakref.ref(self)
        self._taken.append(thing)

    def end_work(self) -> None:
        """Ends the work on the values: the sweep is over, or will not come."""
        self.worker = None

    def argument(self, gradient: Gradient, dt: DataType) -> np.ndarray:
        """The memory for the adjoint of an argument of the next launch."""
        buffer = gradient.buffer(dt)
        self.core.keep(buffer)
        if gradient.is_variable:
            self.take(gradient)
            return buffer
        self._fed_back = True
        if gradient.dt is not dt and (id(gradient), dt) not in self._passed:
            self._passed.add((id(gradient), dt))
            self._gradients.append(gradient)
            self.core.record(_nothing, gradient.pass_on)
        return buffer

    def result(self, shape: tuple[int, ...], dt: DataType) -> tuple[Gradient, np.ndarray]:
        """Makes a gradient for the result of the next launch."""
        gradient = Gradient(shape, dt)
        self._gradients.append(gradient)
        buffer = gradient.buffer(dt)
        self.core.keep(buffer)
        return gradient, buffer

    def begin_work(self, losses: tuple, forward: bool) -> None:
        """Prepares the values for a reverse sweep; see `ValueSweep`."""
        if self.worker is not state.thread:
            taken, self._taken = self._taken, []
            self.worker = state.thread
            try:
                for thing in taken:
                    thing.user = None if thing.user is None or thing.user() is self else thing.user
                    self.take(thing)
            except BaseException:
                self._taken = taken
                raise
        if forward:
            self.arrays.take_versions()
        else:
            self.arrays.check_versions()
        for gradient in self._gradients:
            gradient.clear()
        for value, amount in losses:
            _seed(value, amount)

    def check_replay(self) -> None:
        """Refuses a forward replay if a kernel was passed the result of another: arguments are
        recorded.
        """
        if self._fed_back:
            raise TaiRuntimeError(
                "the tape cannot run forward again: a kernel took what another had returned",
                "pass it on in a field",
            )


class ValueSweep(ArraySweep):
    """A context around a reverse sweep: sets the seeds of returned values, and restores arrays
    afterwards.

    Args:
        losses: pairs of values and seeds.
        forward: whether the launches run forward again before.
    """

    def __init__(self, values: TapeValues, losses: tuple[Any, ...] = (), forward: bool = False):
        super().__init__(values.arrays)
        self._values, self._losses, self._forward = values, losses, forward

    def _enter(self) -> None:
        self._values.begin_work(self._losses, self._forward)
        super()._enter()

    def _end(self) -> None:
        super()._end()
        self._values.end_work()


def _nothing() -> None:
    pass


def _seed(value: Any, amount: Any) -> None:
    if isinstance(value, Ndarray):
        assert value.grad is not None
        value.grad.array[...] += amount
        return
    gradient = gradient_of(value)
    assert gradient is not None
    gradient.add(amount)


def check_loss(loss: Any) -> None:
    """Refuses an array that cannot be the loss of a tape."""
    hint = "loss = ti.ndarray(ti.f32, shape=(), needs_grad=True)"
    if loss.grad is None:
        raise TaiRuntimeTypeError("an array without a gradient cannot be a loss", hint)
    if loss.array.size != 1:
        raise TaiRuntimeTypeError(
            f"the loss has shape {loss.array.shape}, but must be one number", hint
        )


def parse_losses(losses: tuple) -> tuple:
    """Returns pairs of values and seeds, from the arguments of `Tape.backward`.

    Raises:
        TaiRuntimeTypeError: a tape cannot begin with one of them, or its seed does not fit.
    """
    pairs = []
    for loss in losses:
        value, seed = loss if isinstance(loss, tuple) and len(loss) == 2 else (loss, None)
        if isinstance(value, Ndarray):
            if value.grad is None:
                raise TaiRuntimeTypeError(
                    "an array without a gradient cannot be a loss", "make it with needs_grad=True"
                )
            shape = value.array.shape
        elif (gradient := gradient_of(value)) is not None and not gradient.is_variable:
            shape = gradient.shape
        else:
            raise TaiRuntimeTypeError(
                f"a reverse sweep begins with what a kernel returned under the tape, not with "
                f"{value!r}",
                "tape.backward(L) where L = kernel(…) in its block",
            )
        if seed is None:
            if shape != ():
                raise TaiRuntimeTypeError(
                    f"a loss of shape {shape} needs a seed: the gradient of what one wants by it",
                    "tape.backward((value, seed))",
                )
            seed = 1.0
        array = np.asarray(seed, np.float64)
        if array.shape != shape:
            raise TaiRuntimeTypeError(
                f"the seed has shape {array.shape}, but the loss has shape {shape}"
            )
        pairs.append((value, array))
    return tuple(pairs)


def begin(core: Any, runs_again: bool = False, clears: bool = True) -> TapeValues:
    """Begins to follow the values of a tape, which may run kernels again in its sweep."""
    values = gradients.of_thread.active = TapeValues(core, runs_again, clears)
    return values


def recording() -> TapeValues | None:
    """Returns the values of the tape that records, in any thread; or None."""
    core, active = state.tape, gradients.of_thread.active
    if core is None:
        return None
    return active if active is not None and active.core is core else begin(core)


def end() -> None:
    """Forgets the values of the tape, when it records no more."""
    if not state.forward:
        origins.end()
    if gradients.of_thread.active is not None:
        gradients.of_thread.active.arrays.end()
    gradients.of_thread.active = None
