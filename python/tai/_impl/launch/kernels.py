"""`@ti.kernel`: functions that are compiled and run over fields."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import Any, overload

from ...errors import (
    SHOW_TRACEBACK,
    TaiAutodiffError,
    TaiError,
    TaiRuntimeTypeError,
    TaiSyntaxError,
    TaiTypeError,
)
from ..base import compiling, native, state, texts
from ..base.elements import Elements
from ..base.modes import check_kernel, float_of
from ..base.program import get_program
from ..fields import notebook
from ..fields.arrays import Ndarray
from ..history import origins
from ..tracking import tracked
from . import autoreload
from .bound_kernel import BoundKernel
from .functions import func, pyfunc, real_func
from .launch import launch
from .signature import Signature, check_annotations, located, names_of
from .specialization import Specialization, Specializations, in_version
from .struct_results import ResultType

native.set_tracked_type(tracked.Number)
native.set_elements_type(Elements)
native.set_ndarray_type(Ndarray)


class Kernel(native.Launcher):
    """A function that is compiled, and that runs over fields and arrays.

    Calling it runs it; the first call with new kinds of arguments compiles it. `grad` runs
    the kernel that accumulates its gradient.
    """

    _tai_kernel = True

    def __init__(
        self, function: Callable[..., Any], is_method: bool, modes: dict[str, Any] | None = None
    ):
        texts.note(function)
        autoreload.follow()
        self._take(function, is_method, modes or {})
        self._program: Any = None
        self._signature: Signature | None = None
        # The `ti.batch` for whose worlds the kernel runs, or None.
        self.batch: Any = None
        self._specializations = Specializations(self, function, self._modes)
        # The serial number of the kernel in this process.
        self.number = state.kernels_made
        state.kernels_made += 1
        self.grad = GradientKernel(self)
        check_annotations(function, is_method)

    def _take(self, function: Callable[..., Any], is_method: bool, modes: dict[str, Any]) -> None:
        self._function, self._is_method = function, is_method
        # The modes that the kernel itself names.
        self._modes = modes
        self.__name__ = function.__name__
        self.__qualname__ = function.__qualname__
        self.__doc__ = function.__doc__
        self.__module__ = function.__module__
        self.__wrapped__ = function

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        return self if instance is None else BoundKernel(self, instance)

    def __reduce__(self) -> str:
        return self.__qualname__  # by name, as functions are

    def __repr__(self) -> str:
        return f"<ti.kernel '{self.__qualname__}'>"

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), "grad"]  # A class of C++ lists no attributes of its objects.

    def _repr_html_(self) -> str:
        """Shows the kernel in a notebook, with its source and its IR."""
        last = self._specializations.last if self._program is state.program else None
        return notebook.kernel_html(self, self._function, last, len(self._specializations))

    # Calling

    def _launch_slow(self, args: tuple, kwargs: dict) -> Any:
        try:
            return self._launch(self, args, kwargs, False)
        except TaiError as error:
            # The traceback of the compiler itself says nothing about the program.
            raise error if SHOW_TRACEBACK else error.with_traceback(None)  # noqa: B904

    def _launch(self, launcher: Any, args: tuple, kwargs: dict, grad: bool) -> Any:
        if state.emitter is not None:
            raise TaiSyntaxError(
                f"kernel '{self.__name__}' is called while another kernel is compiled",
                "make it a @ti.func",
            )
        signature = self._get_signature()
        try:
            values = signature.bind(args, kwargs)
        except TaiRuntimeTypeError as error:
            if grad:
                error.hint = f"{error.hint}; {self.__name__}.grad takes the same arguments"
            raise
        if state.tape is not None or state.forward:
            numbers = dict(zip(signature.names, values, strict=True))
            origins.check_call(self, [p.name for p in signature.given], numbers)
        tracks = grad or state.tape is not None
        found = self._specialize(values, tracks)
        signature = self._get_signature()  # another one after `ti.init`
        if grad and not found.has_gradients:
            raise TaiAutodiffError(
                f"kernel '{self.__name__}' has no gradient: nothing that it uses has one",
                "make the fields with needs_grad=True, or call ti.root.lazy_grad() after placing "
                "them",
            )
        if grad and self._has_result_alone(found):
            raise TaiAutodiffError(
                f"{self.__name__}.grad() starts from the gradients of fields and arrays, but "
                f"kernel '{self.__name__}' stores to none that has a gradient: it returns a number",
                f"with ti.ad.Tape() as tape: y = {self.__name__}(…) ; and then tape.backward(y)",
            )
        if compiling.is_shown():
            self._compile_now(found, grad)
        return launch(launcher, signature, found, values, grad, tracks)

    @staticmethod
    def _has_result_alone(found: Specialization) -> bool:
        """Whether the result is the only output that may have a gradient."""
        result = found.result_spec
        if result is None or not result.has_gradient:
            return False
        if any(spec.kind == "array" for spec in found.specs):
            return False
        stored = (*found.stored, *found.accumulated)
        return not any("grad" in field._companions for field in stored)

    def _compile_now(self, found: Specialization, grad: bool) -> None:
        """Compiles the code of the launch, and the code that a tape will need, under its name."""
        is_recorded = tracked.recording() is not None and found.has_gradients
        for adjoint in (False, True) if is_recorded and not grad else (grad,):
            if adjoint in found.announced:
                continue
            found.announced.add(adjoint)
            name = self.__name__ + (".grad" if adjoint else "")
            # Errors of the compiler are not reported here, but by the launch that needs the code.
            with contextlib.suppress(TaiError), compiling.compiling(name):
                found.core.compile(adjoint)

    def _get_signature(self) -> Signature:
        if self._signature is None:
            outer, state.of_thread.fp = state.fp, float_of(in_version(self._modes))
            try:
                self._signature = Signature(self._function, self._is_method)
            finally:
                state.of_thread.fp = outer
        return self._signature

    def parameter_name(self, number: int) -> str:
        """Returns the name of a parameter by its number."""
        return self._get_signature().names[number]

    @property
    def _result(self) -> ResultType | None:
        """The type of the kernel's result; None also before the first call."""
        return None if self._signature is None else self._signature.result

    def _specialize(self, values: list[Any], tracks: bool = False) -> Specialization:
        """Returns the compiled kernel for these arguments; see `Specializations.get`."""
        program = get_program()
        if self._program is not program:
            # The kernel is registered before anything is compiled, so that the program can make the
            # kernel forget its compiled code.
            program.kernels.add(self)
            self._signature = None  # default types may be others now
            self._program = program
        return self._specializations.get(program, self._get_signature(), values, tracks)

    def adopt(self, other: Kernel) -> None:
        """Makes this kernel equal to the kernel that a reloaded module defines under the same
        name.
        """
        self.release()
        self._take(other._function, other._is_method, other._modes)
        self._signature = None
        self._specializations = Specializations(self, self._function, self._modes)

    def forget_launches(self) -> None:
        """Makes the next launch look up anew which compiled code it needs."""
        self._specializations.forget_launches()

    def forget_types(self) -> None:
        """Makes the next launch look up anew which types `float` stands for."""
        self._signature = None

    def release(self) -> None:
        """Forgets the compiled code of the kernel, when the program is over."""
        self._program = None
        self._specializations.clear()

    # What was compiled

    def mlir(self, *args: Any, stage: str = "tai") -> str:
        """Returns the IR of the kernel as text.

        Args:
            args: arguments, to choose a specialisation; the last one used if left out.
            stage: `tai`, `autodiff`, `scf`, `llvm`, `llvmir` or `asm`; of kernels for a GPU also
                their device code, `nvvm` or `ptx`.
        """
        return self._find(args).core.ir(stage)

    def explain(self, *args: Any) -> str:
        """Describes the loops, the sums and the gradient of the kernel in words.

        For each parallel loop: its iterations, and on the CPU the time that the cost model
        expects; and for which values of a launch it has versions, or why it has none.
        For each update in a parallel loop: its form, the digits of the sum and the order of its
        terms (see docs/guides/precision.md), or why it stays atomic. For each field to which the
        iterations of a loop add at the elements of others, as gradients of stencils do: whether
        one iteration gathers all additions to its element, or the condition that failed and its
        line. The gradient has for each
        serial loop: the number of its iterations, the values saved of them, and the class
        of each value that it carries from one to the next: *linear*, of a *closed form*,
        *invertible* or a *trajectory* (see docs/guides/loops.md). For each branch: whether it was
        flattened, or why not. Then the fields that the gradient reads and adds to, and the data
        that the tape saves for it.

        Args:
            args: arguments, to choose a specialisation; the last one used if left out.

        Raises:
            TaiAutodiffError: the kernel cannot be differentiated.
        """
        return self._find(args).core.ir("explain")

    def _find(self, args: tuple) -> Specialization:
        """The specialisation for these arguments; the last one used if there are none."""
        last = self._specializations.last
        if not args and last is not None and self._program is state.program:
            return last
        signature = self._get_signature()
        if not args and signature.is_known:
            return self._specialize([None] * len(signature.parameters))
        return self._specialize(signature.bind(args, {}))

    def compile(self, *args: Any, grad: bool = False) -> None:
        """Compiles the kernel for these arguments without running it."""
        self._specialize(self._get_signature().bind(args, {})).core.compile(grad)


class GradientKernel(native.Launcher):
    """The object `kernel.grad`, whose call runs the kernel that accumulates the gradient."""

    def __init__(self, kernel: Kernel):
        self._kernel = kernel
        self.__name__ = kernel.__name__ + ".grad"

    def __repr__(self) -> str:
        return f"<gradient of {self._kernel!r}>"

    def _launch_slow(self, args: tuple, kwargs: dict) -> Any:
        try:
            return self._kernel._launch(self, args, kwargs, True)
        except TaiError as error:
            raise error if SHOW_TRACEBACK else error.with_traceback(None)  # noqa: B904


def _is_in_class(function: Callable[..., Any]) -> bool:
    parts = function.__qualname__.split(".")
    return len(parts) > 1 and parts[-2] != "<locals>"


@overload
def kernel(function: Callable[..., Any]) -> Kernel: ...


@overload
def kernel(
    *, precision: str = ..., sums: str = ..., math: str = ..., ftz: bool = ...
) -> Callable[[Callable[..., Any]], Kernel]: ...


def kernel(function: Callable[..., Any] | None = None, **modes: Any) -> Any:
    """Compiles a function to a kernel: its outermost loops run in parallel.

    `@ti.kernel(precision="f64", sums="compensated")` gives it modes of its own, which go before
    those of `ti.init`. Its gradient has them, too.

    Args:
        precision: the type of its arithmetic, whatever the types of the fields: `f64` or `f32`.
        sums: `compensated` or `deterministic`; see `ti.init`.
        math: `fast`, `strict` or `accurate`.
        ftz: denormal numbers are zero.

    Raises:
        TaiSyntaxError: a mode that there is not.
    """
    if function is None:
        return functools.partial(kernel, **modes)
    if isinstance(function, (staticmethod, classmethod)):
        raise TaiSyntaxError("put @staticmethod above @ti.kernel")
    if not hasattr(function, "__code__"):
        raise TaiTypeError(f"@ti.kernel takes a function, but got {function!r}")
    try:
        check_kernel(function.__name__, modes)
    except TaiSyntaxError as error:
        raise located(error, function) from None
    receiver = names_of(function)[:1]
    is_method = "self" in receiver or not set(receiver) <= set(function.__annotations__)
    return Kernel(function, _is_in_class(function) and is_method, modes)


def data_oriented(cls: type) -> type:
    """Marks a class whose methods are kernels and functions."""
    cls._tai_data_oriented = True  # type: ignore[attr-defined]
    return cls


__all__ = ["Kernel", "data_oriented", "func", "kernel", "pyfunc", "real_func"]
