"""Differentiable functions of JAX that launch kernels; `tai.jax` is the interface.

XLA calls one handler of the extension module for all of them. An attribute of the call says which
function it is for, and with which inputs differentiated: the number of a task.
"""

from __future__ import annotations

import functools
import secrets
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import TaiAutodiffError, TaiCompilationError, TaiRuntimeError, TaiRuntimeTypeError
from ..ad.tape import Tape
from ..base import native, state
from ..fields.arrays import Ndarray
from ..interop.streams import let_stream_wait, wait_for_stream
from ..launch.kernels import Kernel
from ..launch.stacked import StackedKernel
from ..tracking import tracked
from .parameters import as_shape, asks_for_tape, check_outputs, copy_shared, in_order, kinds_of
from .stacked import Stacks
from .writers import ForwardRuns, kind_of
from .xla_buffers import DeviceBuffer, copy_of, number_of, store_number, zeros_like

_TARGET = "tai_call"
# A random number in the name of each operator, because executables that JAX keeps on disk can only
# be used by the process that made them.
_SESSION = secrets.randbits(62)
_tasks: list[_Task] = []
# The types of numbers that kernels take from XLA.
_TYPES = {"bool", "float16", "float32", "float64"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


class _Array:
    """An array on a GPU and its gradient as kernels take them; the memory of both belongs to XLA.

    Attributes:
        shape: the extents.
        dtype: the type of the elements, as of an array of NumPy.
        ndim: the number of dimensions.
    """

    def __init__(self, array: Any, grad: Any):
        self.array, self.grad = array, None if grad is None else _Array(grad, None)
        self.shape, self.dtype, self.ndim = array.shape, array.dtype, array.ndim


def _with_gradient(array: Any, grad: Any) -> Any:
    """Returns the array in the form in which kernels are differentiated by it."""
    if not isinstance(array, np.ndarray):
        return _Array(array, grad)
    # The launcher recognises objects of the class Ndarray.
    whole: Any = Ndarray.__new__(Ndarray)
    part: Any = Ndarray.__new__(Ndarray)
    for made, memory in ((whole, array), (part, grad)):
        made.array, made.shape, made.element_shape = memory, memory.shape, ()
        made.dtype, made._grad, made.taken = None, None, None
    whole._grad = part
    return whole


def _as_variable(value: Any) -> Any:
    """Returns an array of floats with a gradient of zeros, and any other value itself."""
    if hasattr(value, "dtype") and np.issubdtype(value.dtype, np.floating):
        return _with_gradient(value, zeros_like(value, value))
    return value


def _apart(values: Sequence[Any]) -> list[Any]:
    """Returns the values, with copies of arrays that XLA keeps in the memory of an earlier one."""
    return copy_shared(
        values, lambda v: v.ctypes.data if getattr(v, "nbytes", 0) else None, copy_of
    )


def _clear(result: Any) -> None:
    if isinstance(result, np.ndarray):
        result[...] = 0
    else:
        result.clear()


class _Task:
    """A call by XLA: the forward run of an operator, or its gradient by some inputs, for operands
    with a number of batch dimensions.
    """

    def __init__(self, operator: Operator, wanted: tuple[int, ...] | None, ranks: tuple[int, ...]):
        self._operator, self._wanted, self._ranks = operator, wanted, ranks
        # Types of operands for which it was checked that the kernels do not write to inputs.
        self._checked: set[tuple] = set()

    def run(self, operands: list[Any], results: list[Any]) -> None:
        """Runs the kernel on the operands, once for each element of a batch."""
        types = tuple([o.dtype for o in operands])
        if types not in self._checked:
            for operand in operands[: len(self._operator.inputs)]:
                operand.flags.writeable = False  # To write to it is an error.
            try:
                self._run(operands, results)
            except TaiRuntimeTypeError as error:
                if "is read-only" not in error.message:
                    raise
                raise TaiRuntimeTypeError(
                    f"'{self._operator.__name__}' writes to an input: {error.message}",
                    "name it in outputs, or let a kernel copy it to an output first",
                ) from None
            self._checked.add(types)
            return
        self._run(operands, results)

    def _run(self, operands: list[Any], results: list[Any]) -> None:
        # The dimensions of a batch come before the dimensions of the parameters.
        depth = operands[0].ndim - self._ranks[0] if operands else 0
        if depth == 0:
            self._run_with(self._operator, operands, results)
            return
        if depth == 1 and self._run_batch(operands, results):
            return
        for number in range(results[0].shape[0]):
            # An operand that is the same for all elements of the batch has the extent 1.
            one = [o[(number if o.shape[0] > 1 else 0, ...)] for o in operands]
            self._run(one, [r[(number, ...)] for r in results])

    def _run_batch(self, operands: list[Any], results: list[Any]) -> bool:
        """Runs the call for all elements of a batch at once, unless that is not possible."""
        operator, size = self._operator, results[0].shape[0]
        given, names = list(operands), []
        for number, operand in enumerate(operands):
            is_input = number < len(operator.inputs)
            has_batch = operand.shape[0] == size
            if not has_batch and self._wanted is not None:
                if number in self._wanted or not is_input:  # a gradient for each element
                    if not isinstance(operand, np.ndarray):
                        return False
                    operand = np.broadcast_to(operand, (size, *operand.shape[1:]))
                    given[number], has_batch = np.ascontiguousarray(operand), True
            if has_batch and is_input:
                if operator._kinds[number] != "array":
                    return False
                names.append(operator.inputs[number])
            if not has_batch:
                given[number] = operand[(0, ...)]
        found = operator._stacks.find(names) if size > 1 else None
        if found is None:
            return False
        try:
            self._run_with(found, given, results)
        except TaiCompilationError as error:
            operator._stacks.refuse(names, error)
            return False
        return True

    def _run_with(self, operator: Operator, operands: list[Any], results: list[Any]) -> None:
        if self._wanted is None:
            operator._compute(operands, results)
        else:
            operator._differentiate(operands, results, self._wanted)


def _called(attributes: dict, operands: list, results: list, stream: int) -> None:
    """Runs an operator; XLA calls this function through the handler of each platform."""
    if attributes.get("session") != _SESSION:
        raise TaiRuntimeError("the program was compiled by another process", "compile it again")
    task = _tasks[attributes["task"]]
    if state.tape is not None or state.forward:
        raise TaiRuntimeError(
            f"'{task._operator.__name__}' is called by JAX while a tape records",
            "call the kernel itself in the tape, or leave the tape first",
        )
    if isinstance(results[0], np.ndarray):
        task.run(operands, results)
        return
    operands = [DeviceBuffer(o[0], o[1], o[2], stream) for o in operands]
    results = [DeviceBuffer(r[0], r[1], r[2], stream) for r in results]
    for result in results[: attributes["cleared"]]:
        result.clear()
    wait_for_stream(stream)
    task.run(operands, results)
    let_stream_wait(stream)


def _batch_last(function: Callable[..., Any], count: int) -> Callable[..., Any]:
    """A function that `vmap` calls with a batch of each of its last arguments.

    A result can have the memory of an argument only if both have the dimension of the batch.
    """
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def in_batch(size: int, is_batched: list[bool], *args: Any) -> Any:
        given, axes = list(args), [0 if one else None for one in is_batched]
        for n in range(len(given) - count, len(given)):
            if axes[n] is None:
                given[n], axes[n] = jnp.broadcast_to(given[n], (size, *given[n].shape)), 0
        answer = _batch_last(jax.vmap(function, in_axes=axes), count)(*given)
        return answer, [True] * len(answer)

    return batched


@functools.cache
def _register() -> None:
    host, device = native.xla_handlers(_called)
    jax.ffi.register_ffi_target(_TARGET, host, platform="cpu")
    jax.ffi.register_ffi_target(_TARGET, device, platform="CUDA")


class Operator:
    """A kernel, or a function that launches kernels, as a function of JAX.

    Attributes:
        inputs: the names of the parameters that a call gives, in order.
        outputs: the names of those that are its results.
    """

    def __init__(self, function: Any, outputs: dict[str, Any]):
        kinds = kinds_of(function, "tai.jax.wrap")
        self._function: Any = function
        self.__name__ = self.__qualname__ = function.__name__
        self.__doc__ = function.__doc__
        self._order = list(kinds)
        check_outputs(self.__name__, outputs, kinds, "jax.ShapeDtypeStruct(…)")
        self._shapes = outputs
        self.inputs = [n for n in kinds if n not in outputs]
        self.outputs = [n for n in kinds if n in outputs]
        self._kinds = [kinds[n] for n in self.inputs]
        # Whether a gradient needs output values that later stores overwrite; None before
        # compilation.
        self._needs_tape: bool | None = None if isinstance(function, Kernel) else True
        self._forward_runs = ForwardRuns(self.__name__, _as_variable, _apart)
        self._numbers: dict[tuple, int] = {}
        self._stacks = Stacks(function, self.outputs, functools.partial(_OfBatch, self))
        _register()
        self._differentiable = jax.custom_vjp(self._call)
        self._differentiable.defvjp(self._forward, self._backward, symbolic_zeros=True)
        self._gradient = jax.custom_jvp(self._call_gradient, nondiff_argnums=(0,))
        self._gradient.defjvp(self._refuse)

    def __repr__(self) -> str:
        return f"<tai.jax function '{self.__name__}'>"

    @property
    def one_by_one(self) -> dict[frozenset[str], str]:
        """Why `vmap` launches once for each element: the reason, by the names of the arrays that
        have a batch. Elsewhere one launch runs for the whole batch."""
        return dict(self._stacks.reasons)

    # What JAX traces

    def __call__(self, *inputs: Any, **named: Any) -> Any:
        """Computes the outputs of the operator from arrays and numbers.

        Args:
            inputs: an array or number for each parameter that is no output, in order.
            named: inputs given by name.

        Returns:
            The output, or a tuple of them in the order of the parameters.

        Raises:
            TaiRuntimeTypeError: the number of arguments is wrong.
        """
        if named or len(inputs) != len(self.inputs):
            inputs = in_order(f"'{self.__name__}'", self.inputs, inputs, named)
        return self._differentiable(*map(self._as_operand, inputs, self._kinds, self.inputs))

    def _as_operand(self, value: Any, kind: str, name: str) -> Any:
        try:
            array = jnp.asarray(value)
        except (TypeError, ValueError):
            wanted = "an array" if kind == "array" else f"a number of type {kind}"
            raise TaiRuntimeTypeError(
                f"input '{name}' of '{self.__name__}' is {wanted}, but got {type(value).__name__}",
                "pass an array of JAX or NumPy, or a number",
            ) from None
        if kind == "array":
            if str(array.dtype) not in _TYPES:
                raise TaiRuntimeTypeError(
                    f"input '{name}' of '{self.__name__}' holds numbers of type {array.dtype}, "
                    "which kernels have not",
                    f"convert it: {name}.astype(jnp.float32)"
                    if array.dtype.kind != "c"
                    else f"pass its parts, {name}.real and {name}.imag",
                )
            return array
        dtype: Any = {"float": jnp.result_type(float), "int": jnp.result_type(int), "bool": bool}[
            kind
        ]
        if array.ndim or (kind != "float" and jnp.issubdtype(array.dtype, jnp.floating)):
            raise TaiRuntimeTypeError(
                f"input '{name}' of '{self.__name__}' is a number of type {kind}, but got "
                f"{array.dtype}{list(array.shape)}"
            )
        return array.astype(dtype)

    def _task(self, wanted: tuple[int, ...] | None, operands: Sequence[Any]) -> np.int64:
        ranks = tuple(o.ndim for o in operands)
        number = self._numbers.get((wanted, ranks))
        if number is None:
            number = self._numbers[wanted, ranks] = len(_tasks)
            _tasks.append(_Task(self, wanted, ranks))
        return np.int64(number)

    def _emit(
        self, results: list[Any], operands: Sequence[Any], wanted: Any, cleared: int
    ) -> list[Any]:
        """Emits the custom call by which XLA runs the operator.

        Args:
            results: their types. The last operands lend their memory to those after `cleared`.
            cleared: the number of the results that hold zeros as the call begins.
        """
        lent, before = len(results) - cleared, len(operands) - len(results)
        call = jax.ffi.ffi_call(
            _TARGET, results, vmap_method="expand_dims",
            input_output_aliases={before + n: n for n in range(len(results) - lent, len(results))},
        )  # fmt: skip
        task, session = self._task(wanted, operands), np.int64(_SESSION)

        def emit(*given: Any) -> list[Any]:
            return list(call(*given, task=task, session=session, cleared=np.int64(cleared)))

        if lent:
            emit = _batch_last(emit, lent)
        return emit(*operands)

    def _result_types(self, inputs: Sequence[Any]) -> list[Any]:
        given, found = dict(zip(self.inputs, inputs, strict=True)), []
        for name in self.outputs:
            shape = self._shapes[name]
            if isinstance(shape, str):
                found.append(jax.ShapeDtypeStruct(given[shape].shape, given[shape].dtype))
                continue
            answer = shape(*inputs)
            is_number = isinstance(answer, np.integer)
            if hasattr(answer, "shape") and hasattr(answer, "dtype") and not is_number:
                if str(answer.dtype) not in _TYPES:
                    raise TaiRuntimeTypeError(
                        f"outputs of '{self.__name__}' give {answer.dtype} as the type of "
                        f"'{name}', which kernels have not",
                        "use a type such as jnp.float32, and convert the result",
                    )
                found.append(jax.ShapeDtypeStruct(answer.shape, answer.dtype))
                continue
            arrays = (i for i, k in zip(inputs, self._kinds, strict=True) if k == "array")
            like = next(arrays, None)
            dtype = jnp.result_type(float) if like is None else like.dtype
            found.append(jax.ShapeDtypeStruct(as_shape(self.__name__, name, answer), dtype))
        return found

    def _call(self, *inputs: Any) -> Any:
        types = self._result_types(inputs)
        found = self._emit(types, inputs, None, len(types))
        return found[0] if len(found) == 1 else tuple(found)

    def _forward(self, *primals: Any) -> Any:
        inputs = tuple(p.value for p in primals)
        # The set of inputs whose gradient is wanted is encoded in the keys of a dictionary, which
        # are part of the traced structure.
        wanted = {
            str(n): ()
            for n, p in enumerate(primals)
            if p.perturbed and jnp.issubdtype(p.value.dtype, jnp.floating)
        }
        # The differentiable function is called once more, so that a gradient of a gradient reaches
        # the error for it.
        return self._differentiable(*inputs), (inputs, wanted)

    def _backward(self, residuals: Any, bars: Any) -> tuple:
        inputs, names = residuals
        wanted = tuple(sorted(map(int, names)))
        bars = bars if len(self.outputs) > 1 else (bars,)
        kept = []
        for bar, result in zip(bars, self._result_types(inputs), strict=True):
            if jnp.issubdtype(result.dtype, jnp.floating):
                is_zero = isinstance(bar, jax.custom_derivatives.SymbolicZero)
                kept.append(jnp.zeros(result.shape, result.dtype) if is_zero else bar)
        gradients: list[Any] = [None] * len(inputs)
        if wanted and kept:
            found = self._gradient(wanted, *inputs, *kept)
            for number, gradient in zip(wanted, found, strict=True):
                gradients[number] = gradient
        return tuple(gradients)

    def _call_gradient(self, wanted: tuple[int, ...], *operands: Any) -> list[Any]:
        # The last results share the memory of the seeds, which the reverse sweep overwrites.
        shown = [operands[n] for n in wanted] + list(operands[len(self.inputs) :])
        types = [jax.ShapeDtypeStruct(one.shape, one.dtype) for one in shown]
        return self._emit(types, operands, wanted, len(wanted))[: len(wanted)]

    def _refuse(self, wanted: Any, primals: Any, tangents: Any) -> Any:
        raise TaiAutodiffError(
            f"the gradient of '{self.__name__}' has no gradient: kernels with arrays are "
            "differentiated once",
            "ti.ad.hvp differentiates kernels of fields twice",
        )

    # Launches

    def _launch(self, inputs: Sequence[Any], outputs: Sequence[Any], call: Any = None) -> Any:
        named = dict(zip(self.inputs, inputs, strict=True))
        named.update(zip(self.outputs, outputs, strict=True))
        answer = (call or self._function)(*[named[n] for n in self._order])
        if answer is not None:
            raise TaiRuntimeTypeError(
                f"'{self.__name__}' returns a value, which as a function of JAX it cannot",
                "store it to an array of shape (1,), and name that in outputs",
            )

    def _values(self, operands: Sequence[Any]) -> list[Any]:
        return [
            o if kind == "array" else number_of(o)
            for o, kind in zip(operands, self._kinds, strict=True)
        ]

    def _compute(self, operands: list[Any], results: list[Any]) -> None:
        values, kind = self._values(operands), kind_of(operands)
        self._forward_runs.run(kind, self._launch, values, results, _clear)

    def _differentiate(
        self, operands: list[Any], results: list[Any], wanted: tuple[int, ...]
    ) -> None:
        count = len(self.inputs)
        inputs = _apart(self._values(operands[:count]))
        seeds = iter(results[len(wanted) :])
        numbers = []
        for number, result in zip(wanted, results, strict=False):
            if self._kinds[number] == "array":
                inputs[number] = _with_gradient(inputs[number], result)
            else:
                inputs[number] = tracked.variable(inputs[number])
                numbers.append((inputs[number], result))
        needs_tape = bool(numbers) or self._reads_outputs(operands[:count], inputs)
        outputs = []
        for type_ in self._result_types(operands[:count]):
            if not np.issubdtype(type_.dtype, np.floating):
                outputs.append(zeros_like(type_, operands[0]))
                continue
            seed = next(seeds)
            # A gradient that does not read the outputs accepts any memory as outputs.
            value = zeros_like(type_, operands[0]) if needs_tape else seed
            outputs.append(_with_gradient(value, seed))
        if needs_tape:
            with Tape() as tape:
                self._launch(inputs, outputs)
            self._forward_runs.check(kind_of(operands[:count]), tape)
            tape.grad()
        else:
            try:
                self._launch(inputs, outputs, self._function.grad)
            except TaiRuntimeError as error:
                if not asks_for_tape(error):
                    raise
                self._needs_tape = True
                self._differentiate(operands, results, wanted)
                return
        for value, result in numbers:
            store_number(result, value.grad)

    def _reads_outputs(self, operands: list[Any], inputs: list[Any]) -> bool:
        """Whether the kernel reads elements of outputs, of which a tape keeps earlier values."""
        if self._needs_tape is None:
            types = self._result_types(operands)
            outputs = [zeros_like(type_, operands[0]) for type_ in types]
            named = dict(zip(self.inputs, inputs, strict=True))
            named.update(zip(self.outputs, outputs, strict=True))
            found = self._function._specialize([named[n] for n in self._order])
            pairs = zip(self._order, found.specs, strict=True)
            self._needs_tape = any(s.is_loaded for n, s in pairs if n in self.outputs)
        return self._needs_tape


class _OfBatch(Operator):
    """An operator whose kernel runs for all elements of a batch at once."""

    def __init__(self, one: Operator, kernel: StackedKernel, names: Iterable[str]):
        """Makes the operator of a batch.

        Args:
            one: the operator for one element.
            kernel: the kernel that runs for all elements of the batch.
            names: the names of the inputs whose first dimension is that of the batch.
        """
        super().__init__(kernel, one._shapes)
        self._has_batch = [name in names for name in one.inputs]

    def _result_types(self, inputs: Sequence[Any]) -> list[Any]:
        pairs = list(zip(inputs, self._has_batch, strict=True))
        size = next(i.shape[0] for i, has_batch in pairs if has_batch)
        ones = [jax.ShapeDtypeStruct(i.shape[1:], i.dtype) if b else i for i, b in pairs]
        return [
            jax.ShapeDtypeStruct((size, *type_.shape), type_.dtype)
            for type_ in super()._result_types(ones)
        ]
