"""`@ti.kernel` and `@ti.func`."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import (
    SHOW_TRACEBACK,
    TaiAutodiffError,
    TaiError,
    TaiRuntimeTypeError,
    TaiSyntaxError,
    TaiTypeError,
)
from ..base import dtypes, native, state
from ..base.program import get_program
from ..fields.arrays import Ndarray
from ..fields.root import materialize, name_fields
from ..frontend import templates
from ..frontend.compiler import Compiler
from ..frontend.source import closure_of
from ..history import origins
from ..interop import device_arrays
from ..tracking import tangents, tracked
from ..tracking.arguments import adjoint_slots, as_array, check_arrays, find_alias
from ..tracking.tape_arrays import HeldArray, check_overlaps, is_same_array
from ..values.matrix import Matrix
from ..values.types import MatrixType, NdarrayType, ScalarType
from .bound_kernel import BoundKernel
from .signature import FunctionInfo, Parameter, check_annotations, names_of, parse_signature
from .slots import number_slot

native.set_tracked_type(tracked.Number)
native.set_ndarray_type(Ndarray)

_SLOT_KINDS = {"f32": ("f",), "f64": ("d",), "u1": ("b",)}


class ArgumentSpec:
    """What one parameter of a kernel is in one specialisation.

    Attributes:
        kind: `scalar`, `matrix`, `array` or `template`.
        dt, shape: type of a number or matrix.
        ndim, element_shape: of an array.
        constant: what a template parameter stands for.
        taken: the same as it was when the kernel was compiled, as a `_core.Constant`.
        has_gradient: whether the kernel is differentiated by it. An array then comes with
            the array of its gradient.
        alias: the number of the parameter that is the same array, or None.
        is_element_fixed: whether the annotation says how many dimensions an element has.
        is_checked: whether Python must look at each array that is given.
        is_read, is_written: whether the kernel reads and writes the array; known once it is
            compiled.
        uses_gradient: whether it names the gradient of the array; known then, too.
    """

    def __init__(
        self, kind: str, dt: Any = None, shape: tuple[int, ...] = (), ndim: int = 0,
        element_shape: tuple[int, ...] = (), constant: Any = None, has_gradient: bool = False,
    ):  # fmt: skip
        self.kind, self.dt, self.shape = kind, dt, shape
        self.ndim, self.element_shape, self.constant = ndim, element_shape, constant
        self.has_gradient = has_gradient
        self.taken: Any = None
        self.alias: int | None = None
        self.is_element_fixed = self.is_checked = False
        self.is_read = self.is_written = self.uses_gradient = False

    @property
    def has_slot(self) -> bool:
        return self.kind != "template" and self.alias is None

    @property
    def mlir_types(self) -> list[str]:
        """Of the arguments in IR that stand for this one."""
        if not self.has_slot:
            return []
        return [self.mlir_type] * (2 if self.kind == "array" and self.has_gradient else 1)

    def names(self, name: str) -> list[str]:
        """What these are called: the argument, and the gradient of an array."""
        return [name, f"{name}.grad"][: len(self.mlir_types)]

    @property
    def mlir_type(self) -> str:
        if self.kind == "array":
            extents = ["?"] * self.ndim + [str(e) for e in self.element_shape]
            return f"memref<{'x'.join([*extents, self.dt.mlir])}>"
        if self.shape:
            return f"vector<{'x'.join(map(str, self.shape))}x{self.dt.mlir}>"
        return self.dt.mlir

    def description(self) -> tuple | None:
        """The argument for the launcher in C++, or None where Python must pack it."""
        if self.kind == "template":
            return ("c", self.taken)
        if self.kind == "array":
            if self.uses_gradient or self.alias is not None or self.is_checked:
                return None
            shape = list(self.element_shape)
            return ("a", self.dt.numpy.char, self.ndim, shape, self.has_gradient,
                    self.is_element_fixed, self.is_written)  # fmt: skip
        if self.kind == "matrix":
            return None
        if self.dt.is_int:
            return ("i", self.dt.bits, self.dt.kind == "u")
        return _SLOT_KINDS[self.dt.name]


class ResultSpec:
    """The type of what a kernel returns."""

    def __init__(self, type_: ScalarType | MatrixType):
        self.type = type_
        self.dt, self.shape = type_.dtype, type_.shape

    @property
    def mlir_type(self) -> str:
        return ArgumentSpec("matrix", self.dt, self.shape).mlir_type

    def convert(self, emitter: Any, value: Any) -> Any:
        return self.type.convert(emitter, value)

    def description(self) -> tuple:
        """Kind and width of a number, how many, and what makes a matrix of them."""
        kind = "d" if self.dt.name == "f64" else self.dt.kind
        count = int(np.prod(self.shape, dtype=int))
        return (kind, self.dt.bits, count, self._wrap if self.shape else None)

    @property
    def has_gradient(self) -> bool:
        return self.dt.is_float

    def _wrap(self, numbers: tuple) -> Any:
        return Matrix._wrap(np.array(numbers, self.dt.numpy).reshape(self.shape))


class Specialization:
    """A kernel compiled for some kinds of arguments.

    Attributes:
        has_gradients: whether something that it uses has a gradient.
        reads: what the code depends on besides the arguments; see `templates.Reads`.
    """

    def __init__(
        self, core: Any, specs: list[ArgumentSpec], result: ResultSpec | None, reads: list[tuple]
    ):
        self.core, self.specs, self.reads = core, specs, reads
        # Takes it away from its kernel; set once the kernel has it.
        self.drop: Callable[[], None] = lambda: None
        self.has_gradients = True
        # Whether the launcher in C++ knows it, for `grad` false and true.
        self.registered: set[bool] = set()
        self.result = () if result is None else result.description()
        self.result_spec = result
        # In forward mode: the numbers of the parameters that it follows, and the pool in which
        # it keeps the result, or None.
        self.followed: list[int] = []
        self.result_pool: Any = None
        arrays = any(spec.kind == "array" for spec in specs)
        # Under a tape, someone must look at the arrays, and Python say where adjoints of results
        # are: numbers as in the launcher.
        self.tracking = 2 if result is not None and result.has_gradient else int(arrays)

    def fits(self, specs: list[ArgumentSpec]) -> bool:
        """Whether its code is that of these template arguments, as they are now."""
        return self.is_for(specs) and templates.still_hold(self.reads)

    def is_for(self, specs: list[ArgumentSpec]) -> bool:
        """Whether it was compiled for these template arguments, whatever it read of them."""
        pairs = zip(self.specs, specs, strict=True)
        return all(
            own.taken.matches(given.constant) for own, given in pairs if own.taken is not None
        )

    def uses_of(self, spec: ArgumentSpec) -> tuple[bool, bool]:
        """Whether the array is read and written, by any of the parameters that it is given for."""
        number = self.specs.index(spec)
        same = [other for other in self.specs if other is spec or other.alias == number]
        return any(s.is_read for s in same), any(s.is_written for s in same)


class Kernel(native.Launcher):
    """A function that is compiled and runs over fields.

    Calling it runs it; the first call with new kinds of arguments compiles it. `grad` runs
    the kernel that accumulates its gradient.
    """

    _tai_kernel = True

    def __init__(self, function: Callable[..., Any], is_method: bool):
        self._function, self._is_method = function, is_method
        self.__name__ = function.__name__
        self.__qualname__ = function.__qualname__
        self.__doc__ = function.__doc__
        self.__module__ = function.__module__
        self.__wrapped__ = function
        self._parameters: list[Parameter] | None = None
        self._result: ResultSpec | None = None
        self._program: Any = None
        self._specializations: dict[tuple, list[Specialization]] = {}
        self._last: Specialization | None = None
        # Of the kernels of this process, the how manieth.
        self.number = state.kernels_made
        state.kernels_made += 1
        self.grad = GradientKernel(self)
        check_annotations(function, is_method)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        return self if instance is None else BoundKernel(self, instance)

    def __repr__(self) -> str:
        return f"<ti.kernel '{self.__qualname__}'>"

    # Calling

    def _launch_slow(self, args: tuple, kwargs: dict) -> Any:
        try:
            return self._launch(self, args, kwargs, False)
        except TaiError as error:
            # How the compiler came there says nothing about the program.
            raise error if SHOW_TRACEBACK else error.with_traceback(None)  # noqa: B904

    def _launch(self, launcher: Any, args: tuple, kwargs: dict, grad: bool) -> Any:
        if state.emitter is not None:
            raise TaiSyntaxError(
                f"kernel '{self.__name__}' is called while another kernel is compiled",
                "make it a @ti.func",
            )
        values = self._bind(args, kwargs)
        if state.tape is not None or state.forward:
            origins.check_call(self, self._get_parameters(), values)
        tracks = grad or state.tape is not None
        found = self._specialize(values, tracks)
        if grad and not found.has_gradients:
            raise TaiAutodiffError(
                f"kernel '{self.__name__}' has no gradient: nothing that it uses has one",
                "make the fields with needs_grad=True, or call ti.root.lazy_grad() after placing "
                "them",
            )
        slots, kept = self._pack(found, values, tracks)
        if tracks:
            check_arrays(self.__name__, self._get_parameters(), found, values)
        if len(kept) > 1:
            check_overlaps(kept, tracks)
        descriptions = [spec.description() for spec in found.specs]
        wants_gradients = any(s.has_gradient and s.kind != "array" for s in found.specs)
        result = found.result_spec
        if (
            grad not in found.registered
            and None not in descriptions
            and not (found.followed or found.result_pool)
            and not wants_gradients
            and not (grad and result is not None and result.has_gradient)
        ):
            found.registered.add(grad)
            native.add_specialization(
                launcher, found.core, grad, descriptions, found.result, found.tracking, found.reads
            )
        others = [held.array for held in kept if isinstance(held.array, device_arrays.DeviceArray)]
        streams = device_arrays.order_before(others) if others else None
        tape = tracked.recording()
        slots += [tangents.cell_of(values[number]).first for number in found.followed]
        cell = None
        if found.result_pool is not None:
            count = int(np.prod(found.result_spec.shape, dtype=int))
            cell = tangents.Cell(found.result_pool, count)
            slots.append(cell.first)
        gradient = None
        try:
            for held in kept if tape is not None else ():
                is_read = found.core.reads_in_reverse(held.slot)
                ends = held.is_written and found.core.ends_gradients(held.slot)
                held = held._replace(is_read_in_reverse=is_read, ends_gradients=ends)
                launched = tape.arrays.use(held)
                slots[held.slot] = launched.ctypes.data
            if tracks:
                adjoints, gradient = adjoint_slots(found, values, tape)
                slots += adjoints
            answer = native.launch_slots(found.core, grad, slots, found.result)
            if streams:
                device_arrays.order_after(streams)
            for held in kept:
                if held.launched is not held.array and held.is_written and not grad:
                    held.array[...] = held.launched
            if tape is not None and kept:
                tape.arrays.after_launch()
        finally:
            if tape is not None and kept:
                tape.arrays.forget_launch()
        if grad or (gradient is None and cell is None):
            return answer
        origins.begin()
        return tracked.wrap_result(answer, gradient, cell)

    def _bind(self, args: tuple, kwargs: dict) -> list[Any]:
        """The value of each parameter."""
        parameters = self._get_parameters()
        if len(args) > len(parameters):
            raise TaiRuntimeTypeError(
                f"kernel '{self.__name__}' takes {len(parameters)} arguments, but got {len(args)}",
                f"its parameters: {', '.join(p.name for p in parameters) or 'none'}",
            )
        values = list(args)
        for parameter in parameters[len(args) :]:
            if parameter.name in kwargs:
                values.append(kwargs.pop(parameter.name))
            elif parameter.has_default:
                values.append(parameter.default)
            else:
                raise TaiRuntimeTypeError(
                    f"kernel '{self.__name__}' needs an argument '{parameter.name}'",
                    f"its parameters: {', '.join(p.name for p in parameters)}",
                )
        if kwargs:
            raise TaiRuntimeTypeError(
                f"kernel '{self.__name__}' has no parameter '{next(iter(kwargs))}'",
                f"its parameters: {', '.join(p.name for p in parameters) or 'none'}",
            )
        return values

    def _get_parameters(self) -> list[Parameter]:
        if self._parameters is None:
            self._parameters, result = parse_signature(self._function, self._is_method)
            self._result = None if result is None else ResultSpec(result)
        return self._parameters

    def _specialize(self, values: list[Any], tracks: bool = False) -> Specialization:
        """The compiled kernel for these arguments.

        Args:
            values: one for each parameter.
            tracks: whether numbers that have a gradient are to be differentiated by.
        """
        program = get_program()
        if self._program is not program:
            self._program = program
            program.kernels.add(self)
            self._parameters = None  # default types may be others now
        specs: list[ArgumentSpec] = []
        key: list[Any] = []
        followed: list[int] = []
        for parameter, value in zip(self._get_parameters(), values, strict=True):
            spec = self._spec(parameter, value)
            specs.append(spec)
            if spec.kind == "template":
                key.append(templates.hint(spec.constant))
            elif spec.kind == "array":
                spec.alias = find_alias(spec, value, values, specs)
                key.append((spec.dt.name, spec.ndim, spec.element_shape, spec.has_gradient,
                            spec.alias))  # fmt: skip
            elif spec.dt.is_float and tangents.cell_of(value) is not None:
                followed.append(len(specs) - 1)
                key.append(("followed", len(specs), tangents.cell_of(value).pool.number))
            elif tracks and spec.dt.is_float and tracked.gradient_of(value) is not None:
                spec.has_gradient = True
                key.append(len(specs))
        pool = None
        if state.forward and self._result is not None and self._result.dt.is_float:
            pool = tangents.pool_besides([tangents.cell_of(values[n]) for n in followed])
            key.append(("result", pool.number))
        variants = self._specializations.setdefault(tuple(key), [])
        found = next((one for one in reversed(variants) if one.fits(specs)), None)
        if found is None:
            inputs = [tangents.cell_of(values[n]).pool for n in followed]
            found = self._compile(program, specs, list(zip(followed, inputs, strict=True)), pool)
            variants.append(found)
            self._note_users(program, found, tuple(key))
            if found.reads:
                same = [one for one in variants if one.is_for(specs)]
                templates.warn_of_many(self.__name__, same)
        self._last = found
        return found

    def _note_users(self, program: Any, found: Specialization, key: tuple) -> None:
        """Lets the trees that it uses drop a specialization when they are freed."""
        kernel, one = weakref.ref(self), weakref.ref(found)

        def drop() -> None:
            owner, gone = kernel(), one()
            if owner is not None and gone is not None:
                owner._drop(gone, key)

        found.drop = drop
        for tree in found.core.trees:
            program.trees[tree].users.add(found)

    def _drop(self, gone: Specialization, key: tuple) -> None:
        variants = self._specializations.get(key, [])
        if gone not in variants:
            return
        variants.remove(gone)
        if not variants:
            del self._specializations[key]
        if self._last is gone:
            self._last = None
        native.drop_specialization(self, gone.core)
        native.drop_specialization(self.grad, gone.core)

    def release(self) -> None:
        """The program is over: forgets what was compiled for it."""
        self._program = self._last = None
        self._specializations.clear()
        native.clear_specializations(self)
        native.clear_specializations(self.grad)

    def _spec(self, parameter: Parameter, value: Any) -> ArgumentSpec:
        type_ = parameter.type
        if isinstance(type_, ScalarType):
            return ArgumentSpec("scalar", type_.dtype)
        if isinstance(type_, MatrixType):
            return ArgumentSpec("matrix", type_.dtype, type_.shape)
        if isinstance(type_, NdarrayType):
            return self._array_spec(parameter, value)
        has_gradient = tracked.gradient_of(value) is not None and state.tape is not None
        if has_gradient or tangents.cell_of(value) is not None:
            raise TaiAutodiffError(
                f"template argument '{parameter.name}' of kernel '{self.__name__}' is a constant, "
                "but got a value with a gradient",
                f"annotate it by a type: {parameter.name}: ti.f32",
            )
        return ArgumentSpec("template", constant=value)

    def _array_spec(self, parameter: Parameter, value: Any) -> ArgumentSpec:
        type_ = parameter.type
        what = f"argument '{parameter.name}' of kernel '{self.__name__}'"
        array = as_array(value)
        if array is None:
            raise TaiRuntimeTypeError(f"{what} expects an array, but got {type(value).__name__}")
        dt = dtypes.to_dtype(array.dtype)
        if dt is None:
            raise TaiRuntimeTypeError(f"{what} expects numbers, but got {array.dtype}")
        if type_.dtype is not None and type_.dtype is not dt:
            raise TaiRuntimeTypeError(
                f"{what} expects an array of {type_.dtype}, but got {dt}",
                f"convert it: array.astype(np.{type_.dtype.numpy})",
            )
        element_dim = type_.element_dim or len(getattr(value, "element_shape", ()))
        ndim = array.ndim - element_dim
        if ndim < 0 or (type_.ndim is not None and type_.ndim != ndim):
            wanted = type_.ndim if type_.ndim is not None else f"at least {element_dim}"
            raise TaiRuntimeTypeError(f"{what} expects {wanted} dimensions, but got {ndim}")
        element_shape = tuple(array.shape[ndim:])
        if type_.element_shape is not None and tuple(type_.element_shape) != element_shape:
            raise TaiRuntimeTypeError(
                f"{what} expects elements of shape {tuple(type_.element_shape)}, "
                f"but got {element_shape}"
            )
        has_gradient = dt.is_float and tracked.has_gradient_array(value)
        if type_.needs_grad and isinstance(value, Ndarray) and not has_gradient:
            raise TaiRuntimeTypeError(
                f"{what} expects an array with a gradient",
                "make it with needs_grad=True",
            )
        spec = ArgumentSpec(
            "array", dt, ndim=ndim, element_shape=element_shape, has_gradient=has_gradient
        )
        spec.is_element_fixed = bool(type_.element_dim)
        # Where the annotation wants a gradient, some arrays may still come without one.
        spec.is_checked = type_.needs_grad and not has_gradient
        return spec

    def _pack(
        self, found: Specialization, values: list[Any], tracks: bool
    ) -> tuple[list[int], list[HeldArray]]:
        """Slots of the arguments, and all arrays."""
        slots: list[int] = []
        kept: list[HeldArray] = []
        pairs = zip(self._get_parameters(), found.specs, values, strict=True)
        for parameter, spec, value in pairs:
            if spec.kind == "scalar":
                slots.append(number_slot(self.__name__, parameter.name, spec.dt, value))
            elif spec.kind == "matrix":
                array = np.asarray(value)
                if array.shape != spec.shape:
                    raise TaiRuntimeTypeError(
                        f"argument '{parameter.name}' of kernel '{self.__name__}' expects "
                        f"{parameter.type!r}, but got shape {array.shape}"
                    )
                slots += [
                    number_slot(self.__name__, parameter.name, spec.dt, x.item())
                    for x in array.ravel()
                ]
            elif spec.kind == "array" and spec.alias is None:
                array = as_array(value)
                is_read, is_written = found.uses_of(spec)
                if is_written and not array.flags.writeable:
                    raise TaiRuntimeTypeError(
                        f"argument '{parameter.name}' of kernel '{self.__name__}' is written, "
                        "but the array is read-only",
                        "pass a copy: array.copy()",
                    )
                if isinstance(array, device_arrays.DeviceArray):
                    array.check(f"argument '{parameter.name}' of kernel '{self.__name__}'")
                launched = array
                if not array.flags.c_contiguous:
                    same = (h.launched for h in kept if is_same_array(h.array, array))
                    launched = next(same, None)
                    if launched is None:
                        launched = np.array(array, order="C")
                kept.append(
                    HeldArray(parameter.name, self.__name__, value, array, launched, len(slots),
                              is_read, is_written, spec.has_gradient)
                )  # fmt: skip
                slots += [launched.ctypes.data, *array.shape]
                if spec.has_gradient:
                    # Torch makes gradients where they are wanted: a kernel that does not look at
                    # this one gets the array again.
                    looks = tracks or spec.uses_gradient
                    grad = tracked.gradient_array(value) if looks else launched
                    slots += [grad.ctypes.data, *grad.shape]
        return slots, kept

    # Compiling

    def _compile(
        self, program: Any, specs: list[ArgumentSpec], followed: list[tuple[int, Any]], pool: Any
    ) -> Specialization:
        for parameter, spec in zip(self._get_parameters(), specs, strict=True):
            if spec.dt is not None and spec.dt.name == "f16" and spec.kind != "array":
                raise TaiTypeError(f"argument '{parameter.name}' cannot be f16", "use ti.f32")
            if spec.kind == "template":
                spec.taken = templates.take(spec.constant, parameter.name, self.__name__)
                if hasattr(spec.constant, "__dict__"):
                    name_fields(vars(spec.constant))
        name_fields(closure_of(self._function))
        materialize(program, self._function.__globals__)
        symbol = program.unique_symbol(self.__name__)
        program.kernel_functions[symbol] = self._function
        names = [parameter.name for parameter in self._get_parameters()]
        parameters = list(zip(names, specs, strict=True))
        cells = ([(names[number], inputs.field) for number, inputs in followed],
                 None if pool is None else pool.field)  # fmt: skip
        compiler = Compiler(program, self._function, symbol, parameters, self._result, cells)
        try:
            core = compiler.compile()
        except BaseException:
            program.symbols.give_back(symbol)
            raise
        found = Specialization(core, specs, self._result, compiler.reads.all())
        weakref.finalize(found, program.symbols.give_back, symbol).atexit = False
        found.followed, found.result_pool = [number for number, _ in followed], pool
        found.has_gradients = compiler.has_gradients
        return found

    def mlir(self, *args: Any, stage: str = "tai") -> str:
        """The IR of the kernel.

        Args:
            args: arguments, to choose a specialisation; the last one used if left out.
            stage: `tai`, `autodiff`, `scf`, `llvm`, `llvmir` or `asm`; of kernels for a GPU also
                their device code, `nvvm` or `ptx`.
        """
        return self._find(args).core.ir(stage)

    def explain(self, *args: Any) -> str:
        """What the gradient of the kernel does, in words.

        For each serial loop: how many iterations it has, what is remembered of them, and for
        each value that it carries from one to the next whether it is *linear*, of a *closed
        form*, *invertible* or a *trajectory* (see docs/loops.md). For each branch: whether it
        was flattened, or why not. Then the fields that the gradient reads and adds to, and what
        the tape saves for it.

        Args:
            args: arguments, to choose a specialisation; the last one used if left out.

        Raises:
            TaiAutodiffError: the kernel cannot be differentiated.
        """
        return self._find(args).core.ir("explain")

    def _find(self, args: tuple) -> Specialization:
        """The specialisation for these arguments; the last one used if there are none."""
        if not args and self._last is not None and self._program is state.program:
            return self._last
        parameters = self._get_parameters()
        if not args and all(isinstance(p.type, (ScalarType, MatrixType)) for p in parameters):
            return self._specialize([None] * len(parameters))
        return self._specialize(self._bind(args, {}))

    def compile(self, *args: Any, grad: bool = False) -> None:
        """Compiles the kernel for these arguments without running it."""
        self._specialize(self._bind(args, {})).core.compile(grad)


class GradientKernel(native.Launcher):
    """Runs the kernel that accumulates the gradient: `kernel.grad(…)`."""

    def __init__(self, kernel: Kernel):
        self._kernel = kernel
        self.__name__ = kernel.__name__ + ".grad"

    def _launch_slow(self, args: tuple, kwargs: dict) -> Any:
        try:
            return self._kernel._launch(self, args, kwargs, True)
        except TaiError as error:
            raise error if SHOW_TRACEBACK else error.with_traceback(None)  # noqa: B904


def _is_in_class(function: Callable[..., Any]) -> bool:
    parts = function.__qualname__.split(".")
    return len(parts) > 1 and parts[-2] != "<locals>"


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compiles a function to a kernel: its outermost loops run in parallel."""
    if isinstance(function, (staticmethod, classmethod)):
        raise TaiSyntaxError("put @staticmethod above @ti.kernel")
    if not hasattr(function, "__code__"):
        raise TaiTypeError(f"@ti.kernel takes a function, but got {function!r}")
    return Kernel(function, _is_in_class(function) and "self" in names_of(function)[:1])


def func(function: Callable[..., Any], is_real_function: bool = False) -> Callable[..., Any]:
    """Makes a function that kernels can call; it is compiled in place of each call."""
    return _make_function(function, False)


def pyfunc(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `ti.func`, and Python can call it too."""
    return _make_function(function, True)


real_func = func


def _make_function(function: Callable[..., Any], in_python: bool) -> Callable[..., Any]:
    if not hasattr(function, "__code__"):
        raise TaiTypeError(f"@ti.func takes a function, but got {function!r}")

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if state.emitter is not None:
            return state.emitter.call(wrapper, args, kwargs)
        if in_python:
            return function(*args, **kwargs)
        raise TaiSyntaxError(
            f"function '{function.__name__}' can be called in kernels only",
            "decorate it with @ti.pyfunc to call it from Python too",
        )

    wrapper._tai_func = FunctionInfo(function)  # type: ignore[attr-defined]
    return wrapper


def data_oriented(cls: type) -> type:
    """Marks a class whose methods are kernels and functions."""
    cls._tai_data_oriented = True  # type: ignore[attr-defined]
    return cls


__all__ = ["Kernel", "data_oriented", "func", "kernel", "pyfunc", "real_func"]
