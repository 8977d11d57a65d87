"""`ti.Matrix` and `ti.Vector`: small matrices, in Python and in kernels."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from ...errors import TaiRuntimeTypeError, TaiTypeError
from ..base import dtypes, state
from ..base.elements import format_numbers
from ..base.keywords import check_keywords, missing_attribute

SWIZZLE_SETS = ("xyzw", "rgba", "stpq")


def swizzle(name: str, n: int) -> list[int] | None:
    """The components that `v.xy` or `v.rgb` names, or None if it is no swizzle of n components."""
    if not 1 <= len(name) <= 4:
        return None
    for letters in SWIZZLE_SETS:
        if all(c in letters for c in name):
            found = [letters.index(c) for c in name]
            return found if max(found) < n else None
    return None


class Matrix:
    """A small matrix in Python, outside of kernels.

    In Python it holds a NumPy array. In a kernel, `ti.Matrix([...])` makes a value of the
    kernel instead, with the same operators and methods.
    """

    __slots__ = ("_array",)
    __array_priority__ = 1000.0
    is_matrix = True
    # The name of the attribute by which template arguments of this class are compared.
    _tai_content = "_array"

    def __new__(cls, arr: Any = None, dt: Any = None, *args: Any, **kwargs: Any) -> Any:
        if state.emitter is not None and cls in (Matrix, Vector):
            return state.emitter.make_matrix(arr, kwargs.get("dtype", dt), cls is Vector)
        return object.__new__(cls)

    def __init__(self, arr: Any, dt: Any = None, dtype: Any = None):
        array = _to_array(arr)
        wanted = dt if dt is not None else dtype
        if wanted is not None:
            resolved = dtypes.to_dtype(wanted)
            if resolved is None:
                raise TaiRuntimeTypeError(f"{wanted!r} is not a type of numbers")
            array = _converted(array, resolved)
        elif array.dtype == np.float64 or array.dtype == np.int64:
            kind = "default_fp" if array.dtype.kind == "f" else "default_ip"
            array = _converted(array, getattr(state.options, kind))
        if array.ndim not in (1, 2):
            raise TaiRuntimeTypeError(
                f"a matrix has one or two dimensions, but got {array.ndim}: {arr!r}"
            )
        self._array = array

    @classmethod
    def _wrap(cls, array: np.ndarray) -> Any:
        """Wraps an array that has no other user in a matrix or vector; an array without dimensions
        becomes a number.
        """
        if np.ndim(array) == 0:
            return array.item() if isinstance(array, (np.generic, np.ndarray)) else array
        made = object.__new__(Vector if array.ndim == 1 else Matrix)
        made._array = array
        return made

    # Shape

    @property
    def n(self) -> int:
        return self._array.shape[0]

    @property
    def m(self) -> int:
        return self._array.shape[1] if self._array.ndim == 2 else 1

    @property
    def ndim(self) -> int:
        return self._array.ndim

    @property
    def element_shape(self) -> tuple[int, ...]:
        return self._array.shape

    def get_shape(self) -> tuple[int, ...]:
        return self._array.shape

    @property
    def dtype(self) -> dtypes.DataType:
        found = dtypes.to_dtype(self._array.dtype)
        assert found is not None
        return found

    def __len__(self) -> int:
        return self._array.shape[0]

    def __iter__(self) -> Any:
        return (Matrix._wrap(row) for row in self._array.copy())

    # Conversion

    def to_numpy(self, keep_dims: bool = False) -> np.ndarray:
        array = self._array.copy()
        return array[:, None] if keep_dims and array.ndim == 1 else array

    def to_list(self) -> list:
        return self._array.tolist()

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self._array.astype(dtype) if dtype is not None else self._array.copy()

    def __str__(self) -> str:
        return str(self._array)

    def __format__(self, spec: str) -> str:
        """Each component in a format of numbers: `f"{v:.2f}"` gives `[1.00, 2.50]`."""
        return str(self) if not spec else format_numbers(self._array, spec)

    def __repr__(self) -> str:
        return f"<ti.{'Vector' if self.ndim == 1 else 'Matrix'} {self._array.tolist()}>"

    def __eq__(self, other: Any) -> Any:
        return self._compare(np.equal, other)

    def __ne__(self, other: Any) -> Any:
        return self._compare(np.not_equal, other)

    __hash__ = None  # type: ignore[assignment]

    # Elements

    def __getitem__(self, key: Any) -> Any:
        return Matrix._wrap(np.array(self._array[key]))

    def __setitem__(self, key: Any, value: Any) -> None:
        self._array[key] = _plain(value)

    def _missing(self, name: str) -> AttributeError:
        text = f"a matrix of {self.n}×{self.m} has no attribute '{name}'"
        return missing_attribute(text, name, dir(type(self)))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # also of one that is being copied, which has no array yet
            raise AttributeError(name)
        found = swizzle(name, len(self._array))
        if found is None:
            raise self._missing(name)
        return self[found[0]] if len(found) == 1 else Matrix._wrap(self._array[found])

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "_array" or name.startswith("_"):
            object.__setattr__(self, name, value)
            return
        found = swizzle(name, len(self._array))
        if found is None:
            raise self._missing(name)
        values = _plain(value)
        for position, component in enumerate(found):
            self[component] = values[position] if np.ndim(values) else values

    # Arithmetic

    def _binary(self, function: Any, other: Any, swapped: bool = False) -> Any:
        if state.emitter is not None and hasattr(other, "emit_operand"):
            return NotImplemented
        b = _plain(other)
        if np.ndim(b) and np.shape(b) != self._array.shape:
            raise TaiRuntimeTypeError(
                f"shapes {self._array.shape} and {np.shape(b)} do not go together"
            )
        return apply(function, other, self) if swapped else apply(function, self, other)

    def _compare(self, function: Any, other: Any) -> Any:
        b = _plain(other)
        if np.ndim(b) and np.shape(b) != self._array.shape:
            return NotImplemented
        return Matrix._wrap(function(self._array, b))

    def __matmul__(self, other: Any) -> Any:
        b = _plain(other)
        if np.ndim(b) == 0 or self._array.ndim != 2 or self._array.shape[1] != b.shape[0]:
            raise TaiRuntimeTypeError(f"shapes {self._array.shape} and {np.shape(b)} do not chain")
        return apply(np.matmul, self, other)

    def __neg__(self) -> Any:
        return Matrix._wrap(-self._array)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return Matrix._wrap(abs(self._array))

    # Algebra

    def dot(self, other: Any) -> Any:
        """Σ aᵢ bᵢ."""
        return (self * other).sum()

    def cross(self, other: Any) -> Any:
        """The cross product of two 3-vectors, or the number a₀b₁ − a₁b₀ of two 2-vectors."""
        a, b = self._array, _plain(other)
        if a.shape == b.shape == (2,):
            return (a[0] * b[1] - a[1] * b[0]).item()
        if not a.shape == b.shape == (3,):
            raise TaiRuntimeTypeError("cross takes two vectors of 2 or of 3 components")
        return apply(np.cross, self, other)

    def outer_product(self, other: Any) -> Any:
        """The matrix aᵢ bⱼ."""
        return apply(np.outer, self, other)

    def transpose(self) -> Any:
        """The transpose; that of a vector is a matrix of one row."""
        array = self._array[None, :] if self.ndim == 1 else self._array.T
        return Matrix._wrap(np.ascontiguousarray(array))

    def determinant(self) -> float:
        """Returns the determinant of a square matrix."""
        return float(np.linalg.det(self._square()))

    def inverse(self) -> Any:
        """Returns the inverse of a square matrix."""
        return Matrix._wrap(np.linalg.inv(self._square()).astype(self._array.dtype))

    def _square(self) -> np.ndarray:
        if self.ndim != 2 or self.n != self.m:
            raise TaiRuntimeTypeError(f"needs a square matrix, but got {self.n}×{self.m}")
        return self._array

    def trace(self) -> Any:
        """Returns the sum of the diagonal of the matrix."""
        return np.trace(self._square()).item()

    def sum(self) -> Any:
        """Returns the sum of all components."""
        return self._array.sum(dtype=self._array.dtype).item()

    def max(self) -> Any:
        """The greatest component."""
        return self._array.max().item()

    def min(self) -> Any:
        """The least component."""
        return self._array.min().item()

    def any(self) -> bool:
        """Whether any component of the matrix is not zero."""
        return bool(self._array.any())

    def all(self) -> bool:
        """Whether no component of the matrix is zero."""
        return bool(self._array.all())

    def norm_sqr(self) -> Any:
        """Σ aᵢ²."""
        return (self._array * self._array).sum().item()

    def norm(self, eps: float = 0) -> float:
        """√(Σ aᵢ² + eps)."""
        if eps == 0:  # right where the squares over- or underflow
            return math.hypot(*self._array.ravel().tolist())
        return math.sqrt(self.norm_sqr() + eps)

    def norm_inv(self, eps: float = 0) -> float:
        """1 / norm(eps)."""
        return 1 / self.norm(eps)

    def normalized(self, eps: float = 0) -> Any:
        """Returns a / (‖a‖ + eps), and zero for a zero vector."""
        length = self.norm() + eps
        a: Any = self  # with operators, which are installed below
        return a / length if length else a * 0.0

    def cast(self, dtype: Any) -> Any:
        """Returns the matrix with components of another type."""
        return Matrix._wrap(_converted(self._array, dtypes.to_dtype(dtype)))

    def fill(self, value: Any) -> None:
        self._array[...] = value

    # Making matrices

    @staticmethod
    def zero(dt: Any, n: int, m: int | None = None) -> Any:
        """Returns a vector of n, or a matrix of n×m zeros."""
        return _full(0, dt, n, m)

    @staticmethod
    def one(dt: Any, n: int, m: int | None = None) -> Any:
        """Returns a vector of n, or a matrix of n×m ones."""
        return _full(1, dt, n, m)

    @staticmethod
    def identity(dt: Any, n: int) -> Any:
        """Returns the identity matrix of size n."""
        return _from_rows([[int(r == c) for c in range(n)] for r in range(n)], dt)

    @staticmethod
    def unit(n: int, i: int, dt: Any = None) -> Any:
        """Returns the i-th unit vector of n components."""
        if not 0 <= i < n:
            raise TaiTypeError(f"a vector of {n} components has no unit vector {i}")
        return _from_rows([int(r == i) for r in range(n)], dt if dt is not None else int)

    @staticmethod
    def diag(dim: int, val: Any) -> Any:
        """Returns `val` times the identity matrix of size `dim`."""
        return Matrix([[val if r == c else 0 * val for c in range(dim)] for r in range(dim)])

    @staticmethod
    def rows(rows: Any) -> Any:
        """Returns the matrix with these row vectors."""
        return Matrix([[row[c] for c in range(_length(row))] for row in rows])

    @staticmethod
    def cols(cols: Any) -> Any:
        """Returns the matrix with these column vectors."""
        cols = list(cols)
        return Matrix([[col[r] for col in cols] for r in range(_length(cols[0]))])

    # The methods that make fields and arrays of such elements are set by `fields.make` and
    # `fields.arrays`.
    field: ClassVar[Callable[..., Any]]
    ndarray: ClassVar[Callable[..., Any]]


class Vector(Matrix):
    """A matrix of one column; see `Matrix`."""

    __slots__ = ()


class ElementOfField(Vector):
    """An element of a matrix field, read from Python; writing a component writes the field."""

    __slots__ = ("_field", "_index")

    def __new__(cls, *args: Any) -> Any:
        return object.__new__(cls)

    def __init__(self, field: Any, index: tuple):
        self._field, self._index = field, index
        self._array = field.read(index)

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(key, value)
        for number, component in enumerate(self._array.ravel()):
            self._field.write(self._index, number, component.item())

    def fill(self, value: Any) -> None:
        self[...] = value

    def __reduce__(self) -> Any:
        return Matrix._wrap, (self._array.copy(),)  # as it is now


def _operator(name: str, function: Any) -> None:
    def forward(self: Matrix, other: Any) -> Any:
        return self._binary(function, other)

    def backward(self: Matrix, other: Any) -> Any:
        return self._binary(function, other, swapped=True)

    setattr(Matrix, f"__{name}__", forward)
    setattr(Matrix, f"__r{name}__", backward)


for _name, _function in {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "truediv": np.true_divide,
    "floordiv": np.floor_divide, "mod": np.mod, "pow": np.power, "and": np.bitwise_and,
    "or": np.bitwise_or, "xor": np.bitwise_xor, "lshift": np.left_shift,
    "rshift": np.right_shift,
}.items():  # fmt: skip
    _operator(_name, _function)

for _name, _function in {
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal
}.items():  # fmt: skip
    setattr(
        Matrix,
        f"__{_name}__",
        lambda self, other, function=_function: self._compare(function, other),
    )


def _dispatch(name: str) -> None:
    """Makes a method callable by the class name, as in `ti.Vector.normalized(v)`, also with a value
    of a kernel.
    """
    method = getattr(Matrix, name)

    @functools.wraps(method)
    def either(self: Any, *args: Any, **kwargs: Any) -> Any:
        if hasattr(self, "emit_operand"):
            return getattr(self, name)(*args, **kwargs)
        return method(self, *args, **kwargs)

    setattr(Matrix, name, either)


for _name in (
    "dot", "cross", "outer_product", "transpose", "determinant", "inverse", "trace", "sum", "max",
    "min", "any", "all", "norm_sqr", "norm", "norm_inv", "normalized", "cast",
):  # fmt: skip
    _dispatch(_name)


def _to_array(arr: Any) -> np.ndarray:
    if isinstance(arr, Matrix):
        return arr._array.copy()
    if isinstance(arr, (list, tuple)):
        arr = [_plain(item) if isinstance(item, Matrix) else item for item in arr]
    try:
        array = np.array(arr)
    except ValueError as error:
        raise TaiRuntimeTypeError(f"the rows of a matrix have one length: {arr!r}") from error
    if array.dtype == object or array.dtype.kind not in "biuf":
        raise TaiRuntimeTypeError(f"a matrix is made of numbers, but got {arr!r}")
    return array


def _converted(array: np.ndarray, dt: Any) -> np.ndarray:
    """Converts the numbers of a matrix to the type that the program names, as `ti.cast` does."""
    if array.dtype.kind in "iuf" and dt.is_int and not np.can_cast(array.dtype, dt.numpy):
        numbers = [dtypes.convert(x, dt) for x in array.ravel().tolist()]
        return np.array(numbers, dt.numpy).reshape(array.shape)
    return array.astype(dt.numpy)


def _plain(value: Any) -> Any:
    if isinstance(value, Matrix):
        return value._array
    if isinstance(value, (list, tuple)):
        return np.array([_plain(v) for v in value])
    return value


# Functions of NumPy whose result for whole numbers is a float.
_TO_FLOATS = {np.true_divide, np.arctan2, np.hypot, np.copysign}


def apply(function: Any, a: Any, b: Any) -> Any:
    """`function` of NumPy on two operands, matrices or numbers, in the type of a kernel.

    A number or list of Python takes the type of a float that it meets. Beside whole numbers, and
    for their quotients, it is default_fp.
    """
    arrays = [_typed(a), _typed(b)]
    kinds = [np.result_type(x).kind for x in arrays]
    typed = [x.dtype for x in arrays if isinstance(x, (np.ndarray, np.generic))]
    floats = [dtype for dtype in typed if dtype.kind == "f"]
    if floats:
        wanted = functools.reduce(np.promote_types, floats)
    elif "f" in kinds or function in _TO_FLOATS:
        wanted = state.options.default_fp.numpy
    else:
        wanted = None if typed else state.options.default_ip.numpy
    if wanted is not None:
        arrays = [np.asarray(x, wanted) for x in arrays]
    with np.errstate(all="ignore"):
        return Matrix._wrap(function(*arrays))


def _typed(value: Any) -> Any:
    """Converts a list to an array; a Python number is returned as it is, because it has no type of
    its own.
    """
    if isinstance(value, (list, tuple)):
        return Matrix(value)._array
    return _plain(value)


def _length(row: Any) -> int:
    return len(row)


def to_extent(n: Any) -> int:
    if not hasattr(n, "__index__") or n.__index__() < 1:
        raise TaiRuntimeTypeError(f"a matrix has at least one row and column, but got {n!r}")
    return n.__index__()


def _full(value: int, dt: Any, n: int, m: int | None) -> Any:
    n, m = operator.index(n), None if m is None else operator.index(m)
    rows = [value] * n if m is None else [[value] * m for _ in range(n)]
    return _from_rows(rows, dt)


def _from_rows(rows: list, dt: Any) -> Any:
    return (Matrix if isinstance(rows[0], list) else Vector)(rows, dt)


check_keywords(globals(), ["Matrix", "Vector"], attributes=False)
