"""Descriptions of the parameters and the result of a kernel in one specialisation."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..base import dtypes, state
from ..fields.arrays import NONE_HINT, Ndarray
from ..fields.field import Field
from ..history import torch_graphs
from ..tracking import tangents, tracked
from ..tracking.arguments import as_array
from ..values.matrix import Matrix
from ..values.types import MatrixType, NdarrayType, ScalarType
from .signature import Parameter
from .struct_results import ResultType

_SLOT_KINDS = {"f32": ("f",), "f64": ("d",), "u1": ("b",)}


class ArgumentSpec:
    """Describes one parameter of a kernel in one specialisation.

    Attributes:
        kind: `scalar`, `matrix`, `array` or `template`.
        dt, shape: type of a number or matrix.
        ndim, element_shape: of an array.
        constant: the value of a template parameter.
        taken: the same as it was when the kernel was compiled, as a `_core.Constant`.
        alive: a weak reference to a template argument that the code does not keep alive.
        has_gradient: whether the kernel is differentiated by it. An array then comes with
            the array of its gradient.
        alias: the number of the parameter that is the same array, or None.
        is_element_fixed: whether the annotation says how many dimensions an element has.
        is_clamped: whether indices of the array are moved to the nearest element.
        is_checked: whether Python must look at each array that is given.
        is_constant: whether it is an array whose gradient the annotation leaves out.
        is_read, is_written: whether the kernel reads and writes the array; known once it is
            compiled.
        is_loaded: whether the kernel may use the value of an element, besides adding to it.
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
        self.alive: Any = None
        self.alias: int | None = None
        self.is_element_fixed = self.is_clamped = self.is_checked = self.is_constant = False
        self.is_read = self.is_written = self.is_loaded = self.uses_gradient = False

    @property
    def has_slot(self) -> bool:
        return self.kind != "template" and self.alias is None

    @property
    def mlir_types(self) -> list[str]:
        """Returns the types of the IR arguments that stand for this parameter."""
        if not self.has_slot:
            return []
        return [self.mlir_type] * (2 if self.kind == "array" and self.has_gradient else 1)

    def names(self, name: str) -> list[str]:
        """The names of the argument in the IR: of the argument itself and, for an array, of its
        gradient.
        """
        return [name, f"{name}.grad"][: len(self.mlir_types)]

    @property
    def mlir_type(self) -> str:
        if self.kind == "array":
            extents = ["?"] * self.ndim + [str(e) for e in self.element_shape]
            return f"memref<{'x'.join([*extents, self.dt.mlir])}>"
        if self.shape:
            return f"vector<{'x'.join(map(str, self.shape))}x{self.dt.mlir}>"
        return self.dt.mlir

    def description(self, cuts_graph: bool = False) -> tuple | None:
        """The argument for the launcher in C++, or None where Python must pack it.

        Args:
            cuts_graph: see `torch_graphs.cuts_graph`.
        """
        if self.kind == "template":
            return ("c", self.taken)
        if self.kind == "array":
            if self.uses_gradient or self.alias is not None or self.is_checked:
                return None
            shape = list(self.element_shape)
            return ("a", self.dt.numpy.char, self.ndim, shape, self.has_gradient,
                    self.is_element_fixed, self.is_written,
                    cuts_graph and self.has_gradient and self.is_read)  # fmt: skip
        if self.kind == "matrix":
            return None
        if self.dt.is_int:
            return ("i", self.dt.bits, self.dt.kind == "u")
        return _SLOT_KINDS[self.dt.name]


class ResultSpec:
    """Describes the type of the result of a kernel."""

    def __init__(self, type_: ResultType):
        self.type = type_
        self.dt, self.shape = type_.dtype, type_.shape

    @property
    def mlir_type(self) -> str:
        return ArgumentSpec("matrix", self.dt, self.shape).mlir_type

    def convert(self, emitter: Any, value: Any) -> Any:
        return self.type.convert(emitter, value)

    def description(self) -> tuple:
        """Kind and width of a number, how many, and the function that makes a matrix of them."""
        kind = "d" if self.dt.name == "f64" else self.dt.kind
        count = int(np.prod(self.shape, dtype=int))
        return (kind, self.dt.bits, count, self._wrap if self.shape else None)

    @property
    def has_gradient(self) -> bool:
        return self.dt.is_float

    def _wrap(self, numbers: tuple) -> Any:
        return Matrix._wrap(np.array(numbers, self.dt.numpy).reshape(self.shape))


def spec_of(kernel: str, parameter: Parameter, value: Any, tracks: bool = False) -> ArgumentSpec:
    """Returns the specification of a parameter of a kernel for a value.

    Args:
        tracks: whether the launch is recorded, or runs a gradient.

    Raises:
        TaiRuntimeTypeError: it does not fit the annotation.
        TaiAutodiffError: a value with a gradient for a template parameter; with `tracks`, a
            tensor that requires a gradient and was computed by torch.
    """
    type_ = parameter.type
    if isinstance(type_, ScalarType):
        return ArgumentSpec("scalar", type_.dtype)
    if isinstance(type_, MatrixType):
        return ArgumentSpec("matrix", type_.dtype, type_.shape)
    if isinstance(type_, NdarrayType):
        return _array_spec(kernel, parameter, value, tracks)
    has_gradient = tracked.gradient_of(value) is not None and state.tape is not None
    if has_gradient or tangents.cell_of(value) is not None:
        raise TaiAutodiffError(
            f"template argument '{parameter.name}' of kernel '{kernel}' is a constant, "
            "but got a value with a gradient",
            f"annotate it by a type: {parameter.name}: ti.f32",
        )
    return ArgumentSpec("template", constant=value)


def _converted(value: Any, dt: Any) -> str:
    """Returns the Python expression that gives an array another type."""
    if hasattr(value, "detach"):  # a torch tensor
        return f"t.to(torch.{dt.numpy})"
    return f"array.astype(np.{dt.numpy})"


def _array_spec(kernel: str, parameter: Parameter, value: Any, tracks: bool) -> ArgumentSpec:
    type_ = parameter.type
    what = f"argument '{parameter.name}' of kernel '{kernel}'"
    if str(getattr(value, "dtype", None)).removeprefix("torch.") == "bfloat16":
        wide = "t.float()" if hasattr(value, "detach") else "array.astype(np.float32)"
        raise TaiRuntimeTypeError(
            f"{what} takes no numbers of type bfloat16: NumPy has no such type, and ti.bf16 is a "
            "type of fields",
            f"pass f32: {wide}; or copy it into a field of ti.bf16, by "
            "x.from_torch(tensor) or x.from_numpy(array)",
        )
    array = as_array(value)
    if array is None:
        hint = (
            "annotate it as ti.template()"
            if isinstance(value, Field)
            else ("np.array(…) makes one of a list" if isinstance(value, (list, tuple)) else None)
        )
        hint = NONE_HINT if value is None else hint
        found = f"field '{value.name}'" if isinstance(value, Field) else type(value).__name__
        found = "None" if value is None else found
        raise TaiRuntimeTypeError(f"{what} expects an array, but got {found}", hint)
    dt = dtypes.to_dtype(array.dtype)
    if dt is None:
        raise TaiRuntimeTypeError(f"{what} expects numbers, but got {array.dtype}")
    if type_.dtype is not None and type_.dtype is not dt:
        raise TaiRuntimeTypeError(
            f"{what} expects an array of {type_.dtype}, but got {dt}",
            f"convert it: {_converted(value, type_.dtype)}",
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
    if tracks and dt.is_float:
        torch_graphs.check_leaf(value, what)
    holds_gradient = dt.is_float and tracked.has_gradient_array(value)
    has_gradient = holds_gradient and type_.needs_grad is not False
    if type_.needs_grad and isinstance(value, Ndarray) and not has_gradient:
        raise TaiRuntimeTypeError(
            f"{what} expects an array with a gradient",
            "make it with needs_grad=True",
        )
    spec = ArgumentSpec(
        "array", dt, ndim=ndim, element_shape=element_shape, has_gradient=has_gradient
    )
    spec.is_element_fixed = bool(type_.element_dim)
    spec.is_clamped = type_.boundary == "clamp"
    # An array may come without the gradient that the annotation asks for, which launches check.
    spec.is_checked = bool(type_.needs_grad) and not has_gradient
    # The C++ launcher distinguishes arrays by whether they have gradients, so it would take this
    # array for another kind.
    spec.is_checked = spec.is_checked or type_.needs_grad is False
    spec.is_constant = holds_gradient and not has_gradient
    return spec
