"""The fields and arrays that an optimiser changes, and memory of the same layout beside them."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import dtypes, state
from ..fields.arrays import Ndarray
from ..fields.field import Field
from ..fields.make import make_field
from ..fields.snode import Axes, FieldsBuilder
from .kernels import get_kernels


def offset_of(field: Any) -> tuple[int, ...]:
    """Returns the first index of a field along each dimension."""
    return tuple(getattr(field, "offset", ()) or (0,) * len(field.shape))


class Parameter:
    """A field or a `ti.ndarray` with a gradient, as a parameter of an optimiser.

    Attributes:
        value: the field or array.
        name: in messages.
        dtype: of the gradient, and of everything that optimisers keep of it.
        size: how many numbers it holds.
        is_array: whether it is a `ti.ndarray`.
        is_sparse: whether some elements may be inactive.
    """

    def __init__(self, value: Any, user: str):
        if not isinstance(value, (Field, Ndarray)) or hasattr(value, "members"):
            raise TaiRuntimeTypeError(
                f"{user} changes fields and arrays of ti.ndarray, but got {value!r}",
                "give each member of a struct field by itself: [particles.x, particles.v]"
                if hasattr(value, "members")
                else "x = ti.field(ti.f32, shape=n, needs_grad=True)",
            )
        self.value: Any = value
        self.is_array = isinstance(value, Ndarray)
        value = self.value
        if not self.is_array:
            value.materialize(sys._getframe())
        self.name = "an array" if self.is_array else f"field '{value.name}'"
        if not value.dtype.is_float:
            raise TaiAutodiffError(
                f"{user}: {self.name} is of type {value.dtype}, which has no gradient",
                "parameters are of a float type such as ti.f32",
            )
        if not self.is_array:
            value.placed_grad()  # raises
        if value.grad is None:
            raise TaiAutodiffError(
                f"{user}: an array has no gradient",
                "make it with needs_grad=True: ti.ndarray(ti.f32, n, needs_grad=True)",
            )
        self.dtype = value.grad.dtype
        self.size = math.prod(value.shape) * math.prod(value.element_shape)
        levels = [] if self.is_array else [level for part in self._places() for level in part]
        self.is_sparse = any(level.kind != "dense" for level in levels)
        self._levels = levels
        self.inner = tuple(value.element_shape)
        self.offset = () if self.is_array else offset_of(value)

    def _places(self) -> list[list[Any]]:
        parts = getattr(self.value, "parts", None) or [self.value]
        return [part.level.path() for part in parts[:1]]

    def memory(self, what: str) -> Any:
        """Zeros of the same shape and layout, in the type of the gradient.

        Raises:
            TaiRuntimeError: a layout with lists.
        """
        value = self.value
        if self.is_array:
            return Ndarray(self.dtype, value.shape, value.element_shape)
        if not self.is_sparse:
            made: Any = make_field(
                value.element_shape, self.dtype, value.shape, None, f"optim_{what}",
                self.offset if any(self.offset) else None, False, False,
            )  # fmt: skip
            made.materialize()
            return made
        tree = FieldsBuilder()
        node: Any = tree.root
        for level in self._levels:
            if level.kind == "dynamic":
                raise TaiRuntimeError(
                    f"{self.name} lies in a dynamic level, whose lists an optimiser cannot follow",
                    "keep the parameters in a dense, pointer or bitmasked level",
                )
            node = getattr(node, level.kind)(Axes(level.axes), level.extents)
        made = make_field(
            value.element_shape, self.dtype, None, None, f"optim_{what}", None, False, False
        )
        node.place(made, offset=self.offset if any(self.offset) else None)
        tree.finalize()
        return made

    def require_dense(self, user: str) -> None:
        """Raises an error if the layout of the parameter is sparse.

        Raises:
            TaiRuntimeError: the parameter has inactive elements.
        """
        if self.is_sparse:
            raise TaiRuntimeError(
                f"{user}: {self.name} is sparse, and the products of vectors need all elements",
                "ti.optim.Adam and ti.optim.SGD take sparse fields",
            )

    def flat(self, which: str = "value") -> np.ndarray:
        """The memory of an array, of its gradient, or of its dual, as a contiguous vector."""
        array = self.value if which == "value" else self.value.grad
        return array.array.reshape(-1)

    def field(self, which: str = "value") -> Any:
        """Returns the field of the parameter, of its gradient, or of its dual."""
        return self.value if which == "value" else getattr(self.value, which)

    def first_not_finite(self) -> str:
        """Names the first element whose gradient is NaN or infinite, or is empty."""
        found = self.value.grad.to_numpy()
        where = np.argwhere(~np.isfinite(found.astype(np.float64)))
        if not len(where):
            return ""
        rank = len(self.value.shape)
        at = [int(i) for i in where[0]]
        shown = [i + o for i, o in zip(at[:rank], self.offset or (0,) * rank, strict=True)]
        what = "the gradient of " + self.name
        return f"{what} is {found[tuple(at)]} at {shown or [None]}"


def check_parameters(given: Any, user: str) -> list[Parameter]:
    """Checks and returns the parameters of an optimiser.

    Raises:
        TaiRuntimeTypeError: none, one twice, or something that is no field or array.
        TaiAutodiffError: a parameter has no gradient.
    """
    values = list(given) if isinstance(given, (list, tuple)) else [given]
    if not values:
        raise TaiRuntimeTypeError(f"{user} has no parameters", f"{user}([x, y])")
    if len({id(value) for value in values}) < len(values):
        raise TaiRuntimeTypeError(f"{user}: a parameter is given twice", "name each once")
    return [Parameter(value, user) for value in values]


def _places_of(field: Field) -> set[tuple[int, int]]:
    """The storage of a field: pairs of a field that is stored by itself, and a component of it."""
    found = [part.storage() for part in getattr(field, "components", None) or [field]]
    return {(id(stored), component) for stored, component in found}


def shares_memory(a: Any, b: Any) -> bool:
    """Returns whether two fields or arrays of `ti.ndarray` have elements in common."""
    if isinstance(a, Ndarray) or isinstance(b, Ndarray):
        return a is b
    return not _places_of(a).isdisjoint(_places_of(b))


def refuse_losses(parameters: Sequence[Parameter], losses: Sequence[Any], user: str) -> None:
    """Raises an error if a loss is one of the parameters.

    Args:
        parameters: of the optimiser.
        losses: fields and arrays of one number, which a tape sets to zero before it runs.
        user: the name of the calling function, for messages.

    Raises:
        TaiAutodiffError: a loss shares memory with a parameter.
    """
    for p in parameters:
        if any(shares_memory(p.value, loss) for loss in losses):
            raise TaiAutodiffError(
                f"{user}: {p.name} is a parameter and also the loss, which a tape sets to zero "
                "before it runs",
                "the parameters are the fields that the loss is computed from",
            )


def check_outside(user: str) -> None:
    """Raises an error if launches are being differentiated, where optimisers must not work.

    Raises:
        TaiAutodiffError: a tape records, or forward mode is on.
    """
    if state.tape is not None or state.forward:
        mode = "a tape records" if state.tape is not None else "forward mode is on"
        raise TaiAutodiffError(
            f"{user} is called while {mode}, and steps of optimisers are not differentiated",
            "leave the block first, then take the step",
        )


def check_number(user: str, name: str, value: Any, least: float, below: float = math.inf) -> float:
    """Checks and returns a number of an optimiser: least <= value < below.

    Raises:
        TaiRuntimeTypeError: it is no such number.
    """
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (least <= number < below):
        above = "" if below == math.inf else f" and below {below:g}"
        raise TaiRuntimeTypeError(
            f"{user}: {name} must be a number of at least {least:g}{above}, but got {value!r}"
        )
    return number


class Flat:
    """The numbers of several parameters as one vector in device memory.

    Attributes:
        size: the number of elements of the vector.
        dtype: f64 if any parameter is of f64, else f32.
    """

    def __init__(self, parameters: Sequence[Any]):
        self.parameters = list(parameters)
        self.size = sum(p.size for p in self.parameters)
        is_wide = any(p.dtype is dtypes.f64 for p in self.parameters)
        self.dtype = dtypes.f64 if is_wide else dtypes.f32
        self.starts = []
        start = 0
        for p in self.parameters:
            self.starts.append(start)
            start += p.size

    def vector(self, what: str, rows: int | None = None) -> Any:
        """Makes a field for such a vector, or for `rows` of them."""
        shape = (self.size,) if rows is None else (rows, self.size)
        made: Any = make_field((), self.dtype, shape, None, f"optim_{what}", None, False, False)
        made.materialize()
        return made

    def gather(self, vector: Any, which: str) -> None:
        """Copies the values, gradients or duals of the parameters to the vector."""
        k = get_kernels()
        for p, start in zip(self.parameters, self.starts, strict=True):
            if p.is_array:
                k.gather_array(vector, start, p.flat(which))
            else:
                k.gather(vector, start, p.field(which), p.offset, p.inner)

    def scatter(self, vector: Any, which: str) -> None:
        """Copies the vector to the values, gradients or duals of the parameters."""
        k = get_kernels()
        for p, start in zip(self.parameters, self.starts, strict=True):
            if p.is_array:
                k.scatter_array(vector, start, p.flat(which))
            else:
                k.scatter(vector, start, p.field(which), p.offset, p.inner)
