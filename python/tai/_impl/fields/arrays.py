"""`ti.ndarray`: arrays that Python owns and kernels take as arguments."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...errors import TaiIndexError, TaiMemoryError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import dtypes, fitting, pieces, state
from ..base.elements import Elements, is_number
from ..base.keywords import check_keywords, checked
from ..history import gradients, origins
from ..values.matrix import Matrix, Vector
from ..values.types import MatrixType
from . import copies
from .field import Field
from .shapes import to_shape

GRADIENT_HINT = "make it with needs_grad=True"
# For the gradient of an array that has none, which is None.
NONE_HINT = "the grad of a ti.ndarray is None unless it is made with needs_grad=True"


class Ndarray(Elements):
    """An array that kernels take, around NumPy memory, indexed like a field.

    Attributes:
        array: the memory, of shape `shape + element_shape`.
        shape: the extents, without those of the element.
        element_shape: `()`, `(n,)` or `(n, m)`.
        grad: the gradient, an array of the same kind; None without `needs_grad`.
    """

    def __init__(
        self, dtype: Any, shape: Any, element_shape: tuple[int, ...] = (), needs_grad: bool = False
    ):
        if isinstance(dtype, MatrixType):
            element_shape, dtype = dtype.shape, dtype.dtype
        resolved = dtypes.to_dtype(dtype)
        if resolved is None:
            raise TaiRuntimeTypeError(f"{dtype!r} is not a type of numbers")
        if resolved is dtypes.bf16:
            raise TaiRuntimeTypeError(
                "an array holds no bf16: NumPy has no such type", "use ti.f16, or a ti.field"
            )
        self.dtype, self.element_shape = resolved, tuple(element_shape)
        self.shape = to_shape(shape)
        if any(extent < 0 for extent in self.shape):
            raise TaiRuntimeTypeError(f"an array of shape {self.shape} does not exist")
        try:
            self.array = np.zeros(self.shape + self.element_shape, resolved.numpy)
        except (ValueError, OverflowError, MemoryError):
            raise TaiMemoryError(
                f"there is no memory for an array of {resolved} and shape "
                f"{self.shape + self.element_shape}",
                "make its shape smaller",
            ) from None
        self._grad: Ndarray | None = None
        # The use by a tape, if this array is a gradient itself.
        self.taken: Any = None
        if needs_grad:
            if not resolved.is_float:
                raise TaiRuntimeTypeError(
                    f"an array of {resolved} has no gradient",
                    "needs_grad=True goes with a float type such as ti.f32",
                )
            self._grad = Ndarray(resolved, self.shape, self.element_shape)
            self._grad.taken = gradients.note_gradient_array(self._grad)

    def __reduce__(self) -> Any:
        grad = None if self._grad is None else self._grad.array.copy()
        return _array_of, (self.dtype, self.shape, self.element_shape, self.array.copy(), grad)

    def _described(self) -> str:
        return "a ti.ndarray"

    def _example(self) -> str:
        return f"x[{', '.join('ijklmnop'[: len(self.shape)]) or None}]"

    @property
    def grad(self) -> Ndarray | None:
        return self._grad

    @grad.setter
    def grad(self, value: Any) -> None:
        if self._grad is None:
            raise TaiRuntimeTypeError("this array has no gradient", GRADIENT_HINT)
        raise TaiRuntimeTypeError(
            "the gradient of an array cannot be replaced", "fill it: a.grad.from_numpy(array)"
        )

    def _check_write(self, value: Any) -> None:
        """Checks a value that Python code is about to write to the array.

        Raises:
            TaiRuntimeError: a tape that records minds.
        """
        if state.tape is None:
            return
        what = gradients.recorded_as(self.array, self._grad is not None)
        if what is not None:
            raise TaiRuntimeError(
                f"{what} is changed from Python while the tape that has recorded it is open",
                "change it in a kernel, or before the tape begins",
            )
        origins.check_write(self, value)

    @contextlib.contextmanager
    def _refusing(self, key: Any, value: Any) -> Iterator[None]:
        """Turns NumPy's errors about an index or a value into errors of the package."""
        what = f"an array of {self.dtype} and shape {self.array.shape}"
        try:
            yield
        except IndexError as error:
            raise TaiIndexError(
                f"{what} has no element {key!r}: {error}",
                "indices are whole numbers from 0 on, one for each dimension",
            ) from None
        except OverflowError:
            fitting.check_float(value, self.dtype, what)
            raise
        except (TypeError, ValueError) as error:
            raise TaiRuntimeTypeError(
                f"{what} cannot take {value!r}: {error}",
                "an element takes a number, or as many numbers as it has components",
            ) from None

    def __getitem__(self, key: Any) -> Any:
        with self._refusing(key, None):
            item = self.array[() if key is None else key]
        value = Matrix._wrap(item) if np.ndim(item) else item.item()
        if state.tape is None:
            return value
        origins.note_read(self)
        return origins.note_number(self, value)

    def __setitem__(self, key: Any, value: Any) -> None:
        self._check_write(value)
        with self._refusing(key, value):
            self.array[() if key is None else key] = self._stored(value)

    def to_numpy(self) -> np.ndarray:
        if state.tape is not None:
            origins.note_read(self)
        return pieces.copied(self.array)

    def from_numpy(self, array: Any) -> None:
        if array is None:
            raise TaiRuntimeTypeError(f"from_numpy expects an array, but got {array}", NONE_HINT)
        with self._refusing(..., array):
            array = fitting.unmasked(array)
        if array.shape != self.array.shape:
            raise TaiRuntimeTypeError(
                f"expects an array of shape {self.array.shape}, but got {array.shape}"
            )
        self._check_write(array)
        with self._refusing(..., array):
            pieces.copy(self.array, self._stored(array))

    def fill(self, value: Any) -> None:
        self._check_write(value)
        with self._refusing(..., value):
            pieces.copy(self.array, self._stored(value))

    def _stored(self, value: Any) -> Any:
        """Converts numbers from Python to the type of the array."""
        if value is None:
            raise TaiRuntimeTypeError(f"it holds numbers of type {self.dtype}", NONE_HINT)
        if np.ndim(value) == 0 and is_number(value):
            value = value.item() if hasattr(value, "item") else value
            return fitting.stored(value, self.dtype, "the array")
        return fitting.stored_array(fitting.unmasked(value), self.dtype, "the array")

    def copy_from(self, other: Any) -> None:
        """Copies an array or a field of the same shape; tapes and forward mode follow it."""
        if other is self:
            return
        if not isinstance(other, (Ndarray, Field)) or hasattr(other, "members"):
            raise TaiRuntimeTypeError(
                f"copy_from expects a ti.ndarray or a field, but got {type(other).__name__}",
                NONE_HINT if other is None else "copy a NumPy array by from_numpy(array)",
            )
        if tuple(other.shape) + tuple(other.element_shape) != self.array.shape:
            raise TaiRuntimeTypeError(
                f"expects an array of shape {self.array.shape}, but got "
                f"{tuple(other.shape) + tuple(other.element_shape)}"
            )
        if copies.is_followed(self, other):
            copies.copy_array(self, other)
        else:
            self.from_numpy(other.to_numpy())

    def __dlpack__(self, **options: Any) -> Any:
        """The memory for another library, by DLPack; it is on the host."""
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.array.__dlpack_device__()

    def __str__(self) -> str:
        return str(self.array)

    def __repr__(self) -> str:
        elements = f", elements of shape {self.element_shape}" if self.element_shape else ""
        return f"<ti.ndarray of {self.dtype}, shape {self.shape}{elements}>"

    def _repr_html_(self) -> str:
        """Shows the array in a notebook: its statistics, and a picture."""
        return importlib.import_module("tai._impl.fields.notebook").array_html(self)


def _array_of(
    dtype: Any, shape: tuple[int, ...], element_shape: tuple[int, ...], values: Any, grad: Any
) -> Ndarray:
    """Makes the array for data that is loaded or copied."""
    made = Ndarray(dtype, shape, element_shape, grad is not None)
    made.array[...] = values
    if made._grad is not None:
        made._grad.array[...] = grad
    return made


def ndarray(dtype: Any, shape: Any, needs_grad: bool = False) -> Ndarray:
    """Makes an array of zeros that kernels take as `ti.types.ndarray()`.

    Args:
        dtype: a number type, or a vector or matrix type.
        shape: the extents.
        needs_grad: give it a gradient, `grad`, which tapes add to.

    Raises:
        TaiRuntimeTypeError: a type that is none of these, or a gradient of whole numbers.
    """
    return Ndarray(dtype, shape, needs_grad=needs_grad)


def _matrix_array(n: int, m: int, dtype: Any, shape: Any, needs_grad: bool = False) -> Any:
    """Makes an array of n×m matrices; see `ti.ndarray`."""
    return Ndarray(dtype, shape, (n, m), needs_grad)


def _vector_array(n: int, dtype: Any, shape: Any, needs_grad: bool = False) -> Any:
    """Makes an array of vectors of n components; see `ti.ndarray`."""
    return Ndarray(dtype, shape, (n,), needs_grad)


# The class Matrix does not know arrays, so its methods `ndarray` are set here.
for _function, _class in ((_matrix_array, Matrix), (_vector_array, Vector)):
    _function.__name__ = "ndarray"
    _function.__qualname__ = f"{_class.__name__}.ndarray"
    _class.ndarray = staticmethod(checked(_function))


check_keywords(globals(), ["ndarray", "Ndarray"], attributes=False)
