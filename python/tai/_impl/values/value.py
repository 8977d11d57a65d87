"""Values of a kernel: numbers and small matrices that exist when the kernel runs.

They overload Python's operators, so that plain Python functions can compute with them while
a kernel is compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...errors import TaiTypeError, did_you_mean
from ..base import state
from ..base.dtypes import DataType
from .matrix import swizzle

if TYPE_CHECKING:
    from .emitter import Emitter


class NoAttribute(TaiTypeError, AttributeError):
    """An attribute that a value has not: an error in kernels, an answer for `hasattr`."""

    # As tracebacks name it: the public class.
    __module__, __qualname__ = TaiTypeError.__module__, TaiTypeError.__qualname__
    # Python 3.12 and later set the name when an attribute is not found, and their tracebacks then
    # add a suggestion of their own behind the hint.
    name = property(lambda self: None, lambda self, name: None)


class Value:
    """A number that a kernel computes, at compile time represented by its handle in IR.

    Attributes:
        dt: its type.
        shape: `()`, or the shape of the matrix.
        const: the number where it is known, else None.
        index: how to have the same number as an MLIR `index` without a cast: a handle,
            an expression `(operator, a, b)` of values, `"cast"`, or None. Subscripts made
            of loop variables stay affine through it.
    """

    __slots__ = ("_handle", "const", "dt", "emitter", "index")
    shape: tuple[int, ...] = ()
    emit_operand = True
    is_matrix = False
    __array_priority__ = 2000.0

    def __init__(
        self, emitter: Emitter, handle: Any, dt: DataType, index: Any = None, const: Any = None
    ):
        self.emitter, self._handle, self.dt = emitter, handle, dt
        self.index, self.const = index, const

    @property
    def handle(self) -> Any:
        """The SSA value."""
        return self._handle

    @property
    def kind_name(self) -> str:
        """The name of the value's type, for messages."""
        return str(self.dt)

    def __bool__(self) -> bool:
        raise TaiTypeError(
            "the truth of a value is known only when the kernel runs",
            "in a kernel, use it in `if`, `while` or `and`; a Python function cannot branch on it",
        )

    def __iter__(self) -> Any:
        raise TaiTypeError(f"a number of type {self.kind_name} cannot be taken apart")

    def __index__(self) -> int:
        raise TaiTypeError(
            "a value that is known only when the kernel runs stands where Python needs a number",
            "ti.static needs values that are known when the kernel is compiled",
        )

    def __int__(self) -> int:
        raise TaiTypeError(
            "Python's int and float cannot convert a value that is known only when the kernel runs",
            "in a plain Python function, use ti.cast(x, int)",
        )

    __float__ = __int__

    def __getitem__(self, key: Any) -> Any:
        raise TaiTypeError(f"a number of type {self.kind_name} has no elements")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise NoAttribute(f"a number of type {self.kind_name} has no attribute '{name}'")

    def cast(self, dtype: Any) -> Value:
        return self.emitter.cast(self, self.emitter.to_dtype(dtype))

    def __str__(self) -> str:
        raise TaiTypeError(
            "a value that is known only when the kernel runs has no text yet",
            'print it: print(x), print(f"… {x}")',
        )

    def __format__(self, spec: str) -> str:
        return str(self)

    def __repr__(self) -> str:
        return f"<{self.kind_name} of a kernel>"

    __hash__ = object.__hash__

    def __abs__(self) -> Value:
        return self.emitter.unary("abs", self)

    def __neg__(self) -> Value:
        return self.emitter.unary("neg", self)

    def __pos__(self) -> Value:
        return self

    def __invert__(self) -> Value:
        return self.emitter.unary("invert", self)


def _install_operators() -> None:
    def make(op: str) -> tuple[Any, Any]:
        def forward(self: Value, other: Any) -> Any:
            return self.emitter.binary(op, self, other)

        def backward(self: Value, other: Any) -> Any:
            return self.emitter.binary(op, other, self)

        return forward, backward

    names = {
        "add": "+", "sub": "-", "mul": "*", "truediv": "/", "floordiv": "//", "mod": "%",
        "pow": "**", "and": "&", "or": "|", "xor": "^", "lshift": "<<", "rshift": ">>",
        "matmul": "@",
    }  # fmt: skip
    for name, op in names.items():
        forward, backward = make(op)
        setattr(Value, f"__{name}__", forward)
        setattr(Value, f"__r{name}__", backward)
    for name, op in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
        setattr(
            Value, f"__{name}__", lambda self, other, op=op: self.emitter.compare(op, self, other)
        )


_install_operators()


class MatrixValue(Value):
    """A small vector or matrix that a kernel computes.

    `elements` holds the components where they are known one by one, which keeps integer
    vectors, such as grid indices, scalar. The SSA vector is then made where it is needed.
    """

    __slots__ = ("elements", "is_diagonal", "shape")
    is_matrix = True

    def __init__(
        self,
        emitter: Emitter,
        handle: Any,
        dt: DataType,
        shape: tuple[int, ...],
        elements: list[Value] | None = None,
    ):
        super().__init__(emitter, handle, dt)
        self.shape, self.elements = shape, elements
        # Whether the matrix is zero off the diagonal by construction.
        self.is_diagonal = False

    @property
    def handle(self) -> Any:
        if self._handle is None:
            assert self.elements is not None
            return self.emitter.pack(self.elements, self.dt, self.shape)
        return self._handle

    @property
    def kind_name(self) -> str:
        if len(self.shape) == 1:
            return f"vector of {self.shape[0]} {self.dt}"
        return f"{self.shape[0]}×{self.shape[1]} matrix of {self.dt}"

    # Shape

    @property
    def n(self) -> int:
        return self.shape[0]

    @property
    def m(self) -> int:
        return self.shape[1] if len(self.shape) == 2 else 1

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def dtype(self) -> DataType:
        return self.dt

    def get_shape(self) -> tuple[int, ...]:
        return self.shape

    def __len__(self) -> int:
        return self.shape[0]

    # Elements

    def scalars(self) -> list[Value]:
        """Returns all components, row by row."""
        if self.elements is not None:
            return self.elements
        count = 1
        for extent in self.shape:
            count *= extent
        return [self.emitter.extract(self, c) for c in range(count)]

    def __iter__(self) -> Any:
        return iter([self[row] for row in range(self.shape[0])])

    def __getitem__(self, key: Any) -> Any:
        return self.emitter.subscript_matrix(self, key)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        found = swizzle(name, self.shape[0]) if len(self.shape) == 1 else None
        if found is None:
            raise NoAttribute(
                f"a {self.kind_name} has no attribute '{name}'",
                did_you_mean(name, [m for m in dir(type(self)) if not m.startswith("_")]),
            )
        if len(found) == 1:
            return self.emitter.extract(self, found[0])
        return self.emitter.vector([self.emitter.extract(self, c) for c in found], self.dt)

    def fill(self, value: Any) -> None:
        # A value cannot be filled; variables and elements, which can, use `Place.fill`.
        raise TaiTypeError(
            f"a {self.kind_name} without a place cannot be filled",
            "give it a name: b = …; b.fill(…)",
        )

    # Algebra

    def _like(self, other: Any, what: str) -> MatrixValue:
        other = self.emitter.as_value(other)
        if other.shape != self.shape:
            raise TaiTypeError(f"{what} of a {self.kind_name} and a {other.kind_name}")
        return other

    def _square(self, what: str) -> MatrixValue:
        if len(self.shape) != 2 or self.shape[0] != self.shape[1]:
            raise TaiTypeError(f"{what} needs a square matrix, but got a {self.kind_name}")
        return self

    def dot(self, other: Any) -> Value:
        """Σ aᵢ bᵢ."""
        other = self._like(other, "dot product")
        a, b = self.emitter.unify(self, other)
        if a.elements is not None or b.elements is not None:
            return (a * b).sum()
        return self.emitter.scalar_op(self.emitter.builder.dot, [a, b], a.dt)

    def norm_sqr(self) -> Value:
        """Σ aᵢ²."""
        return self.dot(self)

    def norm(self, eps: Any = 0) -> Value:
        """√(Σ aᵢ² + eps)."""
        a = self.emitter.to_float(self)
        if not _is_zero(eps):
            return self.emitter.unary("sqrt", a.dot(a) + eps)
        # Without `fast`, the norm is right where the squares over- or underflow.
        emitter = self.emitter
        handle = emitter.builder.norm(a.handle, emitter.type_of(a.dt), emitter.fast_norms)
        return Value(emitter, handle, a.dt)

    def norm_inv(self, eps: Any = 0) -> Value:
        return self.emitter.binary("/", 1.0, self.norm(eps))

    def normalized(self, eps: Any = 0) -> MatrixValue:
        """Emits a / (‖a‖ + eps), and zero for a zero vector."""
        emitter = self.emitter
        a = emitter.to_float(self)
        length = a.norm() + eps
        if not _is_zero(eps):
            return a / length
        is_zero = emitter.compare("==", length, 0.0)
        safe = emitter.select(is_zero, 1.0, length)
        return emitter.select(is_zero, emitter.splat(0.0, a.dt, a.shape), a / safe)

    def cross(self, other: Any) -> Value:
        """The cross product of 3-vectors; of 2-vectors the number a₀b₁ − a₁b₀."""
        other = self._like(other, "cross product")
        a, b = self.emitter.unify(self, other)
        if a.shape == (2,):
            return a[0] * b[1] - a[1] * b[0]
        if a.shape != (3,):
            raise TaiTypeError(f"cross product of a {self.kind_name}: it takes 2 or 3 components")
        return self.emitter.matrix_op(self.emitter.builder.cross, [a, b], a.dt, (3,))

    def outer_product(self, other: Any) -> MatrixValue:
        """The matrix aᵢ bⱼ."""
        other = self.emitter.as_value(other)
        if len(self.shape) != 1 or len(other.shape) != 1:
            raise TaiTypeError("the outer product takes two vectors")
        a, b = self.emitter.same_type(self, other)
        return self.emitter.matrix_op(self.emitter.builder.outer, [a, b], a.dt, (a.n, b.n))

    def transpose(self) -> MatrixValue:
        emitter = self.emitter
        if len(self.shape) == 1:
            return emitter.matrix(self.scalars(), self.dt, (1, self.shape[0]))
        if self.elements is not None:
            rows, cols = self.shape
            flipped = [self.elements[r * cols + c] for c in range(cols) for r in range(rows)]
            return emitter.matrix(flipped, self.dt, (cols, rows))
        return emitter.matrix_op(emitter.builder.transpose, [self], self.dt, self.shape[::-1])

    def determinant(self) -> Value:
        a = self.emitter.to_float(self._square("the determinant"))
        self.emitter.check_small(a, "the determinant")
        return self.emitter.scalar_op(self.emitter.builder.determinant, [a], a.dt)

    def inverse(self) -> MatrixValue:
        a = self.emitter.to_float(self._square("the inverse"))
        self.emitter.check_small(a, "the inverse")
        return self.emitter.matrix_op(self.emitter.builder.inverse, [a], a.dt, a.shape)

    def trace(self) -> Value:
        a = self.emitter.to_computed(self._square("the trace"))
        if a.elements is not None:
            return self.emitter.reduce("+", [a.elements[r * (a.n + 1)] for r in range(a.n)])
        return self.emitter.scalar_op(self.emitter.builder.trace, [a], a.dt)

    def sum(self) -> Value:
        if self.is_diagonal:  # its zeros are no variables, also to the gradient
            return self.trace()
        if self.elements is not None:
            return self.emitter.reduce("+", self.elements)
        if self.dt.is_bool:
            return self.emitter.reduce("+", self.scalars())
        a = self.emitter.to_computed(self)
        return self.emitter.scalar_op(self.emitter.builder.sum, [a], a.dt)

    def max(self) -> Value:
        return self.emitter.reduce("max", self.scalars())

    def min(self) -> Value:
        return self.emitter.reduce("min", self.scalars())

    def any(self) -> Value:
        emitter = self.emitter
        return emitter.reduce("|", [emitter.to_bool(v) for v in self.scalars()])

    def all(self) -> Value:
        emitter = self.emitter
        return emitter.reduce("&", [emitter.to_bool(v) for v in self.scalars()])


def stop_gradient(value: Value) -> Value:
    """Returns the value as one that gradients take for a constant."""
    if not value.dt.is_float:
        return value
    emitter = value.emitter
    handle = emitter.builder.stop_gradient(value.handle, emitter.type_of(value.dt, value.shape))
    return emitter.value(handle, value.dt, value.shape)


def _is_zero(eps: Any) -> bool:
    return isinstance(eps, (int, float)) and eps == 0


def is_value(thing: Any) -> bool:
    """Whether `thing` is a value that is known only when the kernel runs."""
    return isinstance(thing, Value)


def is_dynamic(*things: Any) -> bool:
    """Whether a kernel is being compiled and one of `things` is a value of that kernel."""
    return state.emitter is not None and any(isinstance(t, Value) for t in things)
