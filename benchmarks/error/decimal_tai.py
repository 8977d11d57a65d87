"""The part of the Taichi API that the scenes use, in arithmetic of 50 digits.

Kernels run as plain Python functions; fields are dictionaries of mpmath numbers. Slow, but
independent of the compiler: the reference for tai's results in f64.
"""

from __future__ import annotations

import itertools
import sys
import types
from typing import Any

import mpmath
import numpy as np

mp = mpmath.mp
mp.dps = 50

i, ij, ijk, jk, j, k = "i", "ij", "ijk", "jk", "j", "k"
i32, i64, u1, f32, f64 = int, int, bool, float, float
cpu = "cpu"


def exact(value: Any) -> Any:
    """A number as one of 50 digits; whole numbers stay."""
    if isinstance(value, (float, np.floating)):
        return mpmath.mpf(float(value))
    if isinstance(value, (bool, np.bool_, np.integer)):
        return int(value)
    return value


class Tensor(np.ndarray):
    """A vector or matrix of exact numbers."""

    def __new__(cls, values: Any) -> Tensor:
        return np.array(values, object).view(cls)

    def dot(self, other: Any) -> Any:
        return sum(a * b for a, b in zip(self.ravel(), np.ravel(other)))

    def norm_sqr(self) -> Any:
        return self.dot(self)

    def norm(self) -> Any:
        return mpmath.sqrt(self.norm_sqr())

    def normalized(self) -> Tensor:
        return self / self.norm()

    def cross(self, other: Any) -> Any:
        if len(self) == 2:
            return self[0] * other[1] - self[1] * other[0]
        a, b = self, other
        pairs = ((1, 2), (2, 0), (0, 1))
        return Tensor([a[m] * b[n] - a[n] * b[m] for m, n in pairs])

    def outer_product(self, other: Any) -> Tensor:
        return Tensor([[a * b for b in other] for a in self])

    def determinant(self) -> Any:
        if len(self) == 2:
            return self[0, 0] * self[1, 1] - self[0, 1] * self[1, 0]
        return self[0].cross(self[1]).dot(self[2])

    def inverse(self) -> Tensor:
        if len(self) == 2:
            rows = [[self[1, 1], -self[0, 1]], [-self[1, 0], self[0, 0]]]
            return Tensor(rows) / self.determinant()
        rows = [self[(n + 1) % 3].cross(self[(n + 2) % 3]) for n in range(3)]
        return Tensor(rows).transpose() / self.determinant()


def polar_decompose(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """By Newton's iteration, from a matrix near a rotation."""
    rotation = matrix
    for _ in range(12):
        rotation = (rotation + rotation.inverse().transpose()) / 2
    return rotation, rotation.transpose() @ matrix


class Matrix:
    def __new__(cls, rows: Any) -> Tensor:
        return Tensor([[exact(x) for x in np.ravel(row)] for row in rows])

    @staticmethod
    def field(n: int, m: int, dtype: Any = float, shape: Any = None, **_: Any) -> Field:
        return Field((n, m), dtype, shape)

    @staticmethod
    def diag(dim: int, val: Any) -> Tensor:
        return Tensor([[exact(val) if a == b else 0 for b in range(dim)] for a in range(dim)])

    @staticmethod
    def identity(_: Any, n: int) -> Tensor:
        return Matrix.diag(n, 1.0)

    @staticmethod
    def zero(_: Any, n: int, m: int) -> Tensor:
        return Tensor([[mpmath.mpf(0)] * m for _ in range(n)])


class Vector:
    def __new__(cls, numbers: Any) -> Tensor:
        return Tensor([exact(x) for x in numbers])

    @staticmethod
    def field(n: int, dtype: Any = float, shape: Any = None, **_: Any) -> Field:
        return Field((n,), dtype, shape)

    @staticmethod
    def zero(_: Any, n: int) -> Tensor:
        return Tensor([mpmath.mpf(0)] * n)


def _flat(key: Any) -> tuple[int, ...]:
    if key is None:
        return ()
    parts = key if isinstance(key, tuple) else (key,)
    return tuple(int(x) for part in parts for x in np.ravel(part))


class Field:
    """Values by index; an element that was never written is zero."""

    grad = None

    def __init__(self, element: tuple[int, ...], dtype: Any, shape: Any):
        self.element, self.is_whole = element, dtype in (int, bool)
        self.shape = () if shape is None else shape if isinstance(shape, tuple) else (shape,)
        self.n, self.m = (*element, 1, 1)[:2]
        self.values: dict[tuple[int, ...], Any] = {}

    def _zero(self) -> Any:
        number = 0 if self.is_whole else mpmath.mpf(0)
        return Tensor(np.full(self.element, number)) if self.element else number

    def __getitem__(self, key: Any) -> Any:
        found = self.values.get(_flat(key))
        if found is None:
            return self._zero()
        return found.copy() if self.element else found

    def __setitem__(self, key: Any, value: Any) -> None:
        if self.element:
            self.values[_flat(key)] = Tensor([exact(x) for x in np.ravel(value)]).reshape(
                self.element
            )
        else:
            self.values[_flat(key)] = exact(value)

    def __iter__(self) -> Any:
        found = self.indices()
        return (index[0] for index in found) if len(self.shape) == 1 else iter(found)

    def indices(self) -> list[tuple[int, ...]]:
        return list(np.ndindex(self.shape)) if self.shape else sorted(self.values) or [()]

    def get_scalar_field(self, *_: int) -> Field:
        return self

    def fill(self, value: Any) -> None:
        self.values.clear()
        for index in self.indices() if value else ():
            self[index] = np.full(self.element, value) if self.element else value

    def from_numpy(self, array: np.ndarray) -> None:
        shape = array.shape[: array.ndim - len(self.element)]
        for index in np.ndindex(shape):
            self[index] = array[index]

    def to_numpy(self) -> np.ndarray:
        found = [np.array(self[index]).astype(float) for index in self.indices()]
        return np.array(found).reshape(self.shape + self.element)

    def copy_from(self, other: Field) -> None:
        for index in other.indices():
            self[index] = other[index]


def field(dtype: Any = float, shape: Any = None, **_: Any) -> Field:
    return Field((), dtype, shape)


class _Root:
    def dense(self, *_: Any) -> _Root:
        return self

    def place(self, *_: Any) -> None:
        return None

    def lazy_grad(self) -> None:
        return None


root = _Root()


def _same(thing: Any) -> Any:
    return thing


kernel = func = data_oriented = static = _same


def template() -> Any:
    return Any


def _unary(name: str) -> Any:
    scalar = getattr(mpmath, name)

    def function(x: Any) -> Any:
        return Tensor([scalar(v) for v in x]) if isinstance(x, np.ndarray) else scalar(exact(x))

    return function


sin, cos, tanh, exp, log, sqrt, floor = map(
    _unary, ("sin", "cos", "tanh", "exp", "log", "sqrt", "floor")
)


def cast(value: Any, dtype: Any) -> Any:
    if isinstance(value, np.ndarray):
        return Tensor([cast(x, dtype) for x in value])
    return int(value) if dtype is int else exact(dtype(value) if dtype is bool else value * 1.0)


def ndrange(*extents: Any) -> Any:
    ranges = [range(*(e if isinstance(e, tuple) else (e,))) for e in extents]
    return itertools.product(*ranges)


def grouped(what: Any) -> Any:
    return (Tensor(index) for index in what.indices())


def _fold(choose: Any) -> Any:
    return lambda *values: choose(exact(v) for v in values)


max, min = _fold(max), _fold(min)


def init(**_: Any) -> None:
    return None


class _Anything(types.SimpleNamespace):
    """A stand-in for names that scenes use and that do not matter here."""

    def __getattr__(self, name: str) -> Any:
        return _Anything()

    def __call__(self, *_: Any, **__: Any) -> Any:
        return lambda function: function


def _clamp(value: Any, low: int, high: int) -> Any:
    return Tensor([sorted((low, x, high))[1] for x in value])


math = types.SimpleNamespace(clamp=_clamp)
ad = types.SimpleNamespace(
    grad_replaced=_same, grad_for=lambda _: _same, Tape=_Anything(), no_grad=_same
)
types = types.SimpleNamespace(ndarray=lambda **_: Any)  # type: ignore[assignment]
tools = _Anything()
# The examples use these in annotations.
GUI = ScalarField = Any
sys.modules.setdefault("tai", sys.modules[__name__])
