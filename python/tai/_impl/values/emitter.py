"""Emits arithmetic: types, constants, casts, elementwise operations, small matrices."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiCompilationError, TaiIndexError, TaiTypeError
from ..base import dtypes, state
from ..base.dtypes import DataType, computed_in, dtype_of, i32, promote, u1
from . import positions
from .builder import IS_NAN, ORDERED, SIGNED, UNORDERED, UNSIGNED, Builder
from .compile_time import PYTHON, compute
from .division import check_division
from .domains import check_domain, check_power
from .integers import check_shift, check_signs, integer_power, operand_beside, shift
from .misuse import describe_misuse, misuse_hint, name_of
from .value import MatrixValue, Value

# For each operator: the operation on floats, on signed integers, and on unsigned integers
_ARITHMETIC = {
    "+": ("arith.addf", "arith.addi", "arith.addi"),
    "-": ("arith.subf", "arith.subi", "arith.subi"),
    "*": ("arith.mulf", "arith.muli", "arith.muli"),
    "/": ("arith.divf", None, None),
    "max": ("arith.maxnumf", "arith.maxsi", "arith.maxui"),
    "min": ("arith.minnumf", "arith.minsi", "arith.minui"),
    "&": (None, "arith.andi", "arith.andi"),
    "|": (None, "arith.ori", "arith.ori"),
    "^": (None, "arith.xori", "arith.xori"),
    "<<": (None, "arith.shli", "arith.shli"),
    ">>": (None, "arith.shrsi", "arith.shrui"),
}

# Float predicates of maximum and minimum, for a constant as the first operand the second one.
_TIES = {"max": (ORDERED[">"], UNORDERED[">"]), "min": (ORDERED["<"], UNORDERED["<"])}

_MATH = {
    name: f"math.{name}"
    for name in (
        "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "exp2",
        "log", "log2", "log10", "sqrt", "rsqrt", "cbrt", "floor", "ceil", "round", "trunc", "erf",
        "erfc", "log1p", "expm1", "asinh", "acosh", "atanh",
    )
}  # fmt: skip


class Emitter:
    """Emits operations at the insertion point of a builder.

    Args:
        builder: appends the operations.
    """

    def __init__(self, builder: Builder):
        self.builder = builder
        # A function of the compiler for calls that Python code makes while it is traced.
        self.call: Any = None
        # The function that makes a value of a struct type from its members.
        self.make_struct: Any = None
        # The function that warns of a float that is stored in an integer.
        self.warn_of_fraction: Any = None
        # Whether norms may be computed by squares that over- and underflow.
        self.fast_norms = False
        self.entry: Any = None
        self._types: dict[tuple, Any] = {}
        self._constants: dict[tuple, Any] = {}
        self.index_type = builder.type("index")
        self.num_random = 0
        # The fields that the kernel reads or writes, collected for its declarations.
        self.fields: set[Any] = set()
        # The storage places that the kernel stores to, and those that it changes by atomics.
        self.stored: set[Any] = set()
        self.accumulated: set[Any] = set()
        # The fields whose loaded values are constants to gradients, by identity.
        self.stopped: set[int] = set()
        # The select arguments that are being emitted: the condition of each select, and the value
        # at which the argument is selected.
        self.arms: list[tuple[Any, bool]] = []
        # The worlds of the batch that the kernel runs for; see `frontend.worlds`.
        self.worlds: Any = None

    # Types

    def type_of(self, dt: DataType, shape: tuple[int, ...] = ()) -> Any:
        key = (dt.mlir, shape)
        found = self._types.get(key)
        if found is None:
            text = f"vector<{'x'.join(map(str, shape))}x{dt.mlir}>" if shape else dt.mlir
            found = self._types[key] = self.builder.type(text)
        return found

    def to_dtype(self, what: Any) -> DataType:
        resolved = dtypes.to_dtype(what)
        if resolved is None:
            raise TaiTypeError(f"{what!r} is not a type of numbers", "use ti.f32, ti.i32, …")
        return resolved

    # Making values

    def value(self, handle: Any, dt: DataType, shape: tuple[int, ...] = ()) -> Any:
        if shape:
            return MatrixValue(self, handle, dt, shape)
        return Value(self, handle, dt)

    def constant(self, number: Any, dt: DataType) -> Value:
        """A scalar constant; they stand at the start of the kernel, one for each number.

        Raises:
            TaiTypeError: a whole number that does not fit the type.
        """
        if dt.is_float:
            number = dtypes.rounded(number, dt)
        elif dt.is_bool:
            number = bool(number)
        else:
            number = dtypes.fit(number, dt)
        handle = self._constant(self.type_of(dt), (dt.mlir, ()), number)
        return Value(self, handle, dt, const=number)

    def splat(self, number: Any, dt: DataType, shape: tuple[int, ...]) -> MatrixValue:
        number = float(number) if dt.is_float else int(number)
        return MatrixValue(
            self, self._constant(self.type_of(dt, shape), (dt.mlir, shape), number), dt, shape
        )

    def _constant(self, type_: Any, key: tuple, number: Any) -> Any:
        key = (*key, repr(number))
        found = self._constants.get(key)
        if found is None:
            found = self._constants[key] = self.builder.constant(self.entry, type_, number)
        return found

    def index(self, number: int) -> Any:
        """Returns an index constant, as a handle."""
        return self._constant(self.index_type, ("index", ()), int(number))

    def as_value(self, thing: Any, dt: DataType | None = None) -> Any:
        """A value for a number, a matrix, or a list of numbers; `dt` types a plain number.

        Raises:
            TaiTypeError: it cannot be computed with.
        """
        if isinstance(thing, Value):
            return thing
        if isinstance(thing, (bool, int, float, np.generic)):
            return self.constant(thing, dtype_of(thing) if dt is None else dt)
        if getattr(thing, "is_matrix", False):
            array = thing.to_numpy()
            found = dtypes.to_dtype(array.dtype)
            assert found is not None
            numbers = [self.constant(x.item(), found) for x in array.ravel()]
            return self.matrix(numbers, found, array.shape)
        if isinstance(thing, (list, tuple)):
            return self.make_matrix(thing, dt, False)
        raise TaiTypeError(describe_misuse(thing), misuse_hint(thing))

    def make_matrix(self, rows: Any, dt: Any, want_vector: bool) -> MatrixValue:
        """The matrix of a list of numbers, of lists of numbers, or of vectors."""
        if isinstance(rows, MatrixValue) or getattr(rows, "is_matrix", False):
            value = self.as_value(rows)
            return value if dt is None else self.cast(value, self.to_dtype(dt))
        if isinstance(rows, np.ndarray):
            rows = rows.tolist()
        if not isinstance(rows, (list, tuple)) or not rows:
            got = name_of(rows) if rows else "an empty list"
            raise TaiTypeError(f"a matrix is made of a list of numbers, but got {got}")
        parts: list[Any] = []
        widths: set[int | None] = set()
        for row in rows:
            if isinstance(row, (list, tuple, np.ndarray)):
                items = list(row)
                widths.add(len(items))
                parts += items
            elif isinstance(row, MatrixValue) or getattr(row, "is_matrix", False):
                vector = self.as_value(row)
                if len(vector.shape) != 1:
                    raise TaiTypeError("the rows of a matrix are vectors or lists of numbers")
                widths.add(vector.shape[0])
                parts += vector.scalars()
            else:
                widths.add(None)
                parts.append(row)
        if len(widths) != 1:
            raise TaiTypeError(
                "the rows of a matrix have different lengths",
                "each row must hold the same number of components",
            )
        width = widths.pop()
        if want_vector and width is not None:
            if width != 1:
                raise TaiTypeError("a vector is made of numbers, but got rows", "use ti.Matrix")
            width = None
        shape = (len(rows),) if width is None else (len(rows), width)
        if dt is not None:
            named = self.to_dtype(dt)
            parts = [dtypes.convert(p, named) if isinstance(p, (bool, int, float)) else p
                     for p in parts]  # fmt: skip
        values = [
            self.constant(part, named)
            if dt is not None and isinstance(part, (bool, int, float))
            else self.as_value(part)
            for part in parts
        ]
        for value in values:
            if value.shape:
                raise TaiTypeError(f"a component must be a number, but got a {value.kind_name}")
        if dt is None:
            wanted = values[0].dt
            for value in values[1:]:
                wanted = promote(wanted, value.dt)
        else:
            wanted = self.to_dtype(dt)
        return self.matrix([self.recast(v, p, wanted) for v, p in zip(values, parts, strict=True)],
                           wanted, shape)  # fmt: skip

    def recast(self, value: Value, source: Any, dt: DataType) -> Value:
        """`value` as `dt`; a plain number that it came from is taken at full precision."""
        if isinstance(source, (int, float)) and value.dt is not dt:
            return self.constant(source, dt)
        return self.cast(value, dt)

    def matrix(self, scalars: list[Value], dt: DataType, shape: tuple[int, ...]) -> MatrixValue:
        """Makes a matrix of components of type `dt`. Integer components stay separate values."""
        if dt.is_float:
            first = scalars[0].const
            if first is not None and all(repr(s.const) == repr(first) for s in scalars):
                return self.splat(first, dt, shape)
            handle = self.pack(scalars, dt, shape)
            return MatrixValue(self, handle, dt, shape, list(scalars))
        return MatrixValue(self, None, dt, shape, list(scalars))

    def vector(self, scalars: list[Value], dt: DataType) -> MatrixValue:
        return self.matrix(scalars, dt, (len(scalars),))

    def pack(self, scalars: list[Value], dt: DataType, shape: tuple[int, ...]) -> Any:
        return self.builder.from_elements([s.handle for s in scalars], self.type_of(dt, shape))

    # Operations

    def scalar_op(self, op: Callable[..., Any], operands: list[Value], dt: DataType) -> Value:
        """Emits an operation of the builder, such as `builder.dot`, whose result is a number."""
        return Value(self, op(*(v.handle for v in operands), self.type_of(dt)), dt)

    def matrix_op(
        self, op: Callable[..., Any], operands: list[Value], dt: DataType, shape: tuple[int, ...]
    ) -> MatrixValue:
        """Emits an operation on floats for a vector or matrix."""
        handle = op(*(v.handle for v in operands), self.type_of(dt, shape))
        return MatrixValue(self, handle, dt, shape)

    def elementwise(self, name: str, operands: list[Value], dt: DataType) -> Any:
        """Emits an operation of the dialects `arith` or `math` on values of one shape."""
        shape = operands[0].shape
        handle = self.builder.apply(name, [v.handle for v in operands], self.type_of(dt, shape))
        return self.value(handle, dt, shape)

    def loaded(self, field: Any, value: Any) -> Any:
        """Called for each element that a kernel loads; returns the value that the kernel uses."""
        del field
        return value

    def added(self, field: Any, value: Any) -> Any:
        """Called for each value that a kernel adds to an element; returns the value that is
        added.
        """
        del field
        return value

    def compare_by(self, predicate: int, a: Value, b: Value) -> Any:
        """Emits the comparison by a predicate of the builder between values of one type."""
        compare = self.builder.compare_floats if a.dt.is_float else self.builder.compare_integers
        handle = compare(predicate, a.handle, b.handle, self.type_of(u1, a.shape))
        return self.value(handle, u1, a.shape)

    def extract(self, matrix: MatrixValue, component: int) -> Value:
        """Emits the extraction of one component, counted row by row."""
        if matrix.elements is not None:
            return matrix.elements[component]
        position = (component,) if len(matrix.shape) == 1 else divmod(component, matrix.shape[1])
        handle = self.builder.extract(matrix.handle, position, self.type_of(matrix.dt))
        return Value(self, handle, matrix.dt)

    def with_component(self, matrix: MatrixValue, component: Any, value: Value) -> MatrixValue:
        """A matrix value with one component replaced; the component's index is a number or a
        value.
        """
        if isinstance(component, Value):
            return positions.replace(self, matrix, component, value)
        shape = matrix.shape
        if matrix.elements is None and matrix.dt.is_float:
            position = (component,) if len(shape) == 1 else divmod(component, shape[1])
            handle = self.builder.insert(
                value.handle, matrix.handle, position, self.type_of(matrix.dt, shape)
            )
            return MatrixValue(self, handle, matrix.dt, shape)
        scalars = list(matrix.scalars())
        scalars[component] = value
        return self.matrix(scalars, matrix.dt, matrix.shape)

    def subscript_matrix(self, matrix: MatrixValue, key: Any) -> Any:
        """Evaluates `matrix[key]`: a component, a row, or a part by slices."""
        component = self.component_of(matrix, key)
        if isinstance(component, list):
            parts = [self._component(matrix, c) for c in component[0]]
            return self.matrix(parts, matrix.dt, component[1])
        return self._component(matrix, component)

    def _component(self, matrix: MatrixValue, component: Any) -> Value:
        if isinstance(component, int):
            return self.extract(matrix, component)
        component = positions.in_range(self, component, matrix)
        return positions.read(self, matrix, positions.flat(self, component, matrix.shape))

    def component_of(self, matrix: Any, key: Any) -> Any:
        """Finds the component of a matrix that `key` names.

        Returns:
            Its number, a value that is its index, the pair of its row and column of which one is a
            value, or `[[component, …], shape]` of several.
        """
        shape = matrix.shape
        keys = list(key) if isinstance(key, (tuple, list)) else [key]
        if len(keys) == 1 and isinstance(keys[0], MatrixValue):
            keys = keys[0].scalars()
        if len(keys) == 1 and len(shape) == 2 and not isinstance(keys[0], slice):
            keys.append(slice(None))  # a row
        if len(keys) != len(shape):
            raise TaiIndexError(
                f"a {matrix.kind_name} takes {len(shape)} "
                f"{'index' if len(shape) == 1 else 'indices'}, but got {len(keys)}"
            )
        numbers: list[Any] = []
        for k, extent in zip(keys, shape, strict=True):
            if isinstance(k, slice):
                if any(isinstance(p, Value) for p in (k.start, k.stop, k.step)):
                    raise TaiTypeError("slices of a matrix must be known at compile time")
                numbers.append(list(range(*k.indices(extent))))
                continue
            if isinstance(k, Value):
                if k.const is not None and k.dt.is_int:
                    k = k.const
                elif not k.dt.is_int or k.shape:
                    raise TaiTypeError(
                        f"an index must be a whole number, but got {k.kind_name}",
                        "convert it: int(…)",
                    )
            elif not isinstance(k, (int, np.integer)) or isinstance(k, bool):
                raise TaiTypeError(
                    f"an index must be a whole number, but got {name_of(k)}", misuse_hint(k)
                )
            if not isinstance(k, Value) and not 0 <= k < extent:
                raise TaiIndexError(
                    f"index {k} is out of range: a {matrix.kind_name} has {extent} "
                    f"{'components' if len(shape) == 1 else 'rows or columns'} here"
                )
            numbers.append(k)
        if any(isinstance(k, list) for k in numbers):
            is_known = not any(isinstance(k, Value) for k in numbers)
            lists = [k if isinstance(k, list) else [k] for k in numbers]
            kept = tuple(len(k) for k in numbers if isinstance(k, list))
            if not all(kept):
                raise TaiIndexError("the slice is empty")
            if len(shape) == 1:
                return [lists[0], kept]
            pairs = [(i, j) for i in lists[0] for j in lists[1]]
            return [[i * shape[1] + j for i, j in pairs] if is_known else pairs, kept]
        if len(numbers) == 1:
            return numbers[0]
        row, col = numbers
        if isinstance(row, Value) or isinstance(col, Value):
            return row, col
        return int(row) * shape[1] + int(col)

    # Types of operands

    def broadcast(self, value: Value, shape: tuple[int, ...]) -> Any:
        if value.shape == shape:
            return value
        if value.shape:
            size = "×".join(map(str, shape))
            other = f"vector of {size}" if len(shape) == 1 else f"{size} matrix"
            raise TaiTypeError(f"a {value.kind_name} and a {other} do not go together")
        if not value.dt.is_float:
            count = math.prod(shape)
            return MatrixValue(self, None, value.dt, shape, [value] * count)
        if value.const is not None:
            return self.splat(value.const, value.dt, shape)
        handle = self.builder.broadcast(value.handle, self.type_of(value.dt, shape))
        return MatrixValue(self, handle, value.dt, shape)

    def operands(self, a: Any, b: Any) -> tuple[Value, Value, DataType]:
        """Converts two operands to values, and finds their common type, which plain Python numbers
        take.
        """
        weak_a, weak_b = not isinstance(a, Value), not isinstance(b, Value)
        number = (bool, int, float, np.generic)
        if weak_a and isinstance(a, number) and not weak_b:
            dt = computed_in(promote(dtype_of(a), b.dt))
            return operand_beside(self, a, dt), b, dt
        if weak_b and isinstance(b, number) and not weak_a:
            dt = computed_in(promote(a.dt, dtype_of(b)))
            return a, operand_beside(self, b, dt), dt
        a, b = self.as_value(a), self.as_value(b)
        return a, b, computed_in(promote(a.dt, b.dt))

    def same_type(self, a: Any, b: Any) -> tuple[Any, Any]:
        a, b, dt = self.operands(a, b)
        return self.cast(a, dt), self.cast(b, dt)

    def unify(self, a: Any, b: Any, dt: DataType | None = None) -> tuple[Any, Any]:
        """Casts and broadcasts two operands to one type and one shape."""
        a, b, common = self.operands(a, b)
        dt = dt or common
        a, b = self.cast(a, dt), self.cast(b, dt)
        shape = a.shape or b.shape
        if a.shape and b.shape and a.shape != b.shape:
            raise TaiTypeError(f"a {a.kind_name} and a {b.kind_name} do not go together")
        return self.broadcast(a, shape), self.broadcast(b, shape)

    def cast(self, value: Value, dt: DataType) -> Any:
        source = value.dt
        if source is dt:
            return value
        if value.const is not None and not value.shape:
            number = value.const
            if dt.is_bool:
                return self.constant(number != 0, dt)
            if dt.is_float:
                return self.constant(number, dt)
            if source.is_float or dt.min <= number <= dt.max:
                return self.constant(dtypes.fit(number, dt), dt)
        if value.shape and not value.dt.is_float and value.elements is not None:
            cast = [self.cast(v, dt) for v in value.elements]
            return self.matrix(cast, dt, value.shape)
        if dt.is_bool:
            return self.compare("!=", value, self.constant(0, source))
        if source.mlir == dt.mlir:
            made = self.value(value.handle, dt, value.shape)
            return made
        name = _cast_op(source, dt)
        if name is None:  # floats to narrow unsigned integers, through i64
            wide = self.elementwise("arith.fptosi", [value], dtypes.i64)
            return self.elementwise("arith.trunci", [wide], dt)
        made = self.elementwise(name, [value], dt)
        if name in ("arith.extsi", "arith.trunci") and not value.shape and dt.kind == "i":
            made.index = value.index if dt.bits > source.bits else None
        return made

    def to_float(self, value: Any) -> Any:
        value = self.as_value(value)
        dt = value.dt if value.dt.is_float else dtypes.default_fp()
        return self.cast(value, computed_in(dt))

    def to_computed(self, value: Any) -> Any:
        """Converts a value to the type in which arithmetic on it is done."""
        return self.cast(value, computed_in(value.dt))

    def to_bool(self, value: Any) -> Value:
        """Returns the truth value of a number."""
        value = self.as_value(value)
        if value.shape:
            raise TaiTypeError(
                f"the truth of a {value.kind_name} is not one answer", "use .any() or .all()"
            )
        return self.cast(value, u1)

    def to_index(self, value: Any) -> Any:
        """Returns a whole number as an `index` handle."""
        if not isinstance(value, Value):
            if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
                return self.index(int(value))
            value = self.as_value(value)
        if value.shape or not (value.dt.is_int or value.dt.is_bool):
            raise TaiTypeError(
                f"an index must be a whole number, but got {value.kind_name}",
                "convert it: int(…) or ti.cast(…, ti.i32)",
            )
        if value.const is not None:
            return self.index(value.const)
        how = value.index
        if how is not None and not isinstance(how, (tuple, str)):
            return how
        if isinstance(how, tuple):
            name = {"+": "arith.addi", "-": "arith.subi", "*": "arith.muli"}[how[0]]
            operands = [self.to_index(how[1]), self.to_index(how[2])]
            return self.builder.apply(name, operands, self.index_type)
        name = "arith.index_cast" if value.dt.kind == "i" else "arith.index_castui"
        return self.builder.apply(name, [value.handle], self.index_type)

    def from_index(self, handle: Any, dt: DataType = i32) -> Value:
        """Converts a loop index to an integer that remembers the index."""
        made = self.builder.apply("arith.index_cast", [handle], self.type_of(dt))
        return Value(self, made, dt, index=handle)

    # Arithmetic

    def unary(self, name: str, x: Any) -> Any:
        x = self.as_value(x)
        if name in _MATH:
            x = self.to_float(x)
            if self.fast_norms and name in ("exp2", "log2"):
                return self._by_base_e(name, x)
            check_domain(self, name, x)
            return self.elementwise(_MATH[name], [x], x.dt)
        if name in ("neg", "abs"):
            x = self.cast(x, state.options.default_ip if x.dt.is_bool else computed_in(x.dt))
        if x.shape and x.elements is not None and not x.dt.is_float:
            return self.matrix([self.unary(name, v) for v in x.elements], x.dt, x.shape)
        if name == "neg":
            if x.const is not None and x.dt.is_signed:
                return self.constant(-x.const, x.dt)
            if x.dt.is_float:
                return self.elementwise("arith.negf", [x], x.dt)
            return self.binary("-", self.constant(0, x.dt), x)
        if name == "abs":
            if x.dt.is_float:
                return self.elementwise("math.absf", [x], x.dt)
            return self.elementwise("math.absi", [x], x.dt) if x.dt.kind == "i" else x
        if name == "invert":
            if x.dt.is_float:
                raise TaiTypeError(f"'~' takes whole numbers, but got {x.kind_name}")
            ones = self.constant(x.dt.max if x.dt.kind == "u" else -1, x.dt)
            return self.binary("^", x, Value(self, ones.handle, x.dt))
        if name == "not":
            if x.dt.is_float:
                raise TaiTypeError(
                    f"'not' takes truth values or whole numbers, but got {x.kind_name}",
                    "compare it: x == 0",
                )
            return self.binary("^", self.to_bool(x), self.constant(True, u1))
        raise TaiCompilationError(f"there is no operation '{name}'")

    def _by_base_e(self, name: str, x: Any) -> Any:
        """Computes exp2 and log2 by exp and log, with an error of some units in the last place,
        because only exp and log have vector forms.
        """
        if name == "exp2":
            return self.unary("exp", self.binary("*", x, math.log(2.0)))
        return self.binary("*", self.unary("log", x), 1.0 / math.log(2.0))

    def binary(self, op: str, a: Any, b: Any) -> Any:
        """Emits `a op b` in the type that Taichi gives the result."""
        if not isinstance(a, Value) and not isinstance(b, Value):
            return compute(op, a, b)
        if op == "@":
            return self.matmul(a, b)
        if op == "**":
            return self.power(a, b)
        if op in ("//", "%"):
            return self._divide_whole(op, a, b)
        a, b, dt = self.operands(a, b)
        if op == "/" and not dt.is_float:
            dt = computed_in(dtypes.default_fp())
        if dt.is_bool and op not in "&|^" and op not in ("max", "min"):
            dt = state.options.default_ip
        # A constant NaN counts as a number that is not known.
        is_constant = [v.const is not None and v.const == v.const for v in (a, b)]
        if op in ("<<", ">>") and not dt.is_float:
            check_shift(op, a, b, dt)
        a, b = self.unify(a, b, dt)
        ordered = state.options.ad_ties == "second" and not all(is_constant)
        if op in _TIES and dt.is_float and ordered:
            return self._pick(op, a, b, *is_constant)
        forms = _ARITHMETIC[op]
        name = forms[0] if dt.is_float else forms[1] if dt.kind == "i" else forms[2]
        if name is None:
            raise TaiTypeError(
                f"'{op}' takes whole numbers, but got {a.kind_name}", "convert it: int(…)"
            )
        if a.shape and not dt.is_float and (a.elements or b.elements):
            pairs = zip(a.scalars(), b.scalars(), strict=True)
            return self.matrix([self.binary(op, p, q) for p, q in pairs], dt, a.shape)
        if a.const is not None and b.const is not None and dt.is_int and op in "+-*":
            number = PYTHON[op](a.const, b.const)
            if dt.min <= number <= dt.max:
                return self.constant(number, dt)
        if op in ("<<", ">>"):
            return shift(self, op, name, a, b)
        made = self.elementwise(name, [a, b], dt)
        if dt.kind == "i" and not a.shape and op in ("+", "-", "*"):
            known = a.index is not None or b.index is not None
            if known and (op != "*" or a.const is not None or b.const is not None):
                made.index = (op, a, b)
        return made

    def _pick(
        self, op: str, a: Value, b: Value, first_is_constant: bool, second_is_constant: bool
    ) -> Value:
        """Maximum or minimum as a choice, which says which side wins a tie.

        The second operand wins, and gets the gradient. The maximum's own op would not do:
        it commutes, so that an operand that turns out to be constant is moved to its second
        place, and max(y, x) is taken for the same as max(x, y). If one of the operands is NaN, the
        other is the result, as with that op.
        """

        first = self.compare_by(_TIES[op][first_is_constant], a, b)
        if not first_is_constant and not second_is_constant:
            first = self.elementwise("arith.ori", [first, self.compare_by(IS_NAN, b, b)], u1)
        return self.select(first, a, b)

    def _divide_whole(self, op: str, a: Any, b: Any) -> Any:
        """Division that rounds down, and its remainder, which has the sign of the divisor."""
        a, b, dt = self.operands(a, b)
        if dt.is_bool:
            dt = state.options.default_ip
        a, b = self.unify(a, b, dt)
        if a.shape and not dt.is_float and (a.elements or b.elements):
            pairs = zip(a.scalars(), b.scalars(), strict=True)
            return self.matrix([self._divide_whole(op, p, q) for p, q in pairs], dt, a.shape)
        check_division(a, b, dt)
        if dt.is_float:
            return self._divide_floats(op, a, b)
        if dt.kind == "u":
            name = "arith.divui" if op == "//" else "arith.remui"
            return self.elementwise(name, [a, b], dt)
        rest = self.elementwise("arith.remsi", [a, b], dt)
        zero = self.broadcast(self.constant(0, dt), a.shape)
        if b.const is not None and b.const > 0:
            wrong = self.compare("<", rest, zero)
        else:
            wrong = self.binary(
                "&",
                self.compare("!=", rest, zero),
                self.compare("<", self.elementwise("arith.xori", [rest, b], dt), zero),
            )
        if op == "%":
            return self.select(wrong, self.binary("+", rest, b), rest)
        quotient = self.elementwise("arith.divsi", [a, b], dt)
        return self.select(wrong, self.binary("-", quotient, 1), quotient)

    def _divide_floats(self, op: str, a: Value, b: Value) -> Value:
        """Emits the floor division of floats. A quotient just below a whole number is rounded up to
        it, which the remainder shows: it is exact if it is rounded once.
        """
        whole = self.unary("floor", self.binary("/", a, b))
        rest = self.elementwise("math.fma", [self.unary("neg", whole), b, a], a.dt)
        wrong = self.compare("<", rest, 0.0)
        if b.const is None or b.const < 0:
            above = self.compare(">", rest, 0.0)
            wrong = self.select(self.compare("<", b, 0.0), above, wrong)
        if op == "%":
            return self.select(wrong, self.binary("+", rest, b), rest)
        return self.select(wrong, self.binary("-", whole, 1.0), whole)

    def power(self, a: Any, b: Any) -> Any:
        """Emits `a ** b`: whole powers by multiplication."""
        exponent = b.const if isinstance(b, Value) else b
        if isinstance(exponent, (int, np.integer)) and not isinstance(exponent, bool):
            return self._whole_power(self.to_computed(self.as_value(a)), int(exponent))
        if isinstance(exponent, float):
            if exponent.is_integer() and abs(exponent) <= 64:
                return self._whole_power(self.to_float(a), int(exponent))
            if exponent == 0.5:
                return self.unary("sqrt", a)
        a, b, dt = self.operands(a, b)
        if not dt.is_float:
            return integer_power(self, a, b, dt)
        a, b = self.unify(a, b)
        check_power(self, a, b)
        return self.elementwise("math.powf", [a, b], a.dt)

    def _whole_power(self, base: Any, exponent: int) -> Any:
        if base.dt.is_bool:
            base = self.cast(base, state.options.default_ip)
        if exponent < 0:
            if not base.dt.is_float:
                raise TaiTypeError(
                    "a whole number has no negative powers among whole numbers",
                    "use a float base: float(x) ** -1",
                )
            # The power is not computed as 1 / base ** -exponent: the adjoint of that power leaves
            # the range of floats where the derivative does not, for x ** -2 at 1e-100.
            return self._whole_power(self.binary("/", 1.0, base), -exponent)
        result = None
        while exponent:
            if exponent & 1:
                result = base if result is None else self.binary("*", result, base)
            exponent >>= 1
            if exponent:
                base = self.binary("*", base, base)
        if result is None:
            return self.broadcast(self.constant(1, base.dt), base.shape)
        return result

    def compare(self, op: str, a: Any, b: Any) -> Any:
        if not isinstance(a, Value) and not isinstance(b, Value):
            return {"==": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le,
                    ">": operator.gt, ">=": operator.ge}[op](a, b)  # fmt: skip
        check_signs(op, a, b)
        a, b = self.unify(a, b)
        dt = a.dt
        if a.shape and not dt.is_float and (a.elements or b.elements):
            pairs = zip(a.scalars(), b.scalars(), strict=True)
            return self.matrix([self.compare(op, p, q) for p, q in pairs], u1, a.shape)
        if dt.is_float:  # NaN is different from all
            predicates = UNORDERED if op == "!=" else ORDERED
        else:
            predicates = SIGNED if dt.kind == "i" else UNSIGNED
        return self.compare_by(predicates[op], a, b)

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        condition = self.as_value(condition)
        condition = self.cast(condition, u1)
        a, b = self.unify(a, b)
        if condition.shape and not a.shape:
            a, b = self.broadcast(a, condition.shape), self.broadcast(b, condition.shape)
        if condition.shape and condition.shape != a.shape:
            raise TaiTypeError(f"a {condition.kind_name} cannot select among {a.kind_name}s")
        if a.shape and not a.dt.is_float and (a.elements or b.elements):
            conditions = condition.scalars() if condition.shape else [condition] * len(a.scalars())
            triples = zip(conditions, a.scalars(), b.scalars(), strict=True)
            return self.matrix([self.select(*t) for t in triples], a.dt, a.shape)
        type_ = self.type_of(a.dt, a.shape)
        handle = self.builder.select(condition.handle, a.handle, b.handle, type_)
        return self.value(handle, a.dt, a.shape)

    def reduce(self, op: str, values: list[Value]) -> Value:
        result = values[0]
        for value in values[1:]:
            result = self.binary(op, result, value)
        return result

    def matmul(self, a: Any, b: Any) -> Any:
        a, b = self.same_type(a, b)
        if len(a.shape) == 1 and len(b.shape) == 2 and b.shape[0] == 1:
            return a.outer_product(self.vector(b.scalars(), b.dt))
        if len(a.shape) != 2 or not b.shape or a.shape[1] != b.shape[0]:
            raise TaiTypeError(
                f"a {a.kind_name} and a {b.kind_name} cannot be multiplied by '@'",
                "the columns of the left one must be as many as the rows of the right one",
            )
        return self.matrix_op(self.builder.matmul, [a, b], a.dt, (a.shape[0], *b.shape[1:]))

    def check_fraction(self, value: Any, dt: DataType, what: str) -> None:
        """Warns where a float goes into a whole number without a conversion."""
        if not dt.is_int:
            return
        if isinstance(value, Value):
            loses = value.dt.is_float and (value.const is None or value.const % 1 != 0)
        else:
            loses = isinstance(value, float) and value % 1 != 0 and math.isfinite(value)
        if loses:
            self.warn_of_fraction(what)

    def check_small(self, matrix: MatrixValue, what: str) -> None:
        if matrix.shape[0] > 4:
            raise TaiTypeError(f"{what} of a {matrix.kind_name}: at most 4×4")

    def decompose(self, name: str, matrix: Any, results: list[tuple[int, ...]]) -> tuple:
        """The factors of a decomposition of a matrix, with the given shapes; for `name` see the
        builder.
        """
        matrix = self.to_float(matrix)
        types = [self.type_of(matrix.dt, shape) for shape in results]
        made = self.builder.decompose(name, matrix.handle, types)
        pairs = zip(made, results, strict=True)
        return tuple(self.value(handle, matrix.dt, shape) for handle, shape in pairs)

    def solve(self, matrix: Any, rhs: Any) -> MatrixValue:
        a, b = self.same_type(self.to_float(matrix), self.to_float(rhs))
        return self.matrix_op(self.builder.solve, [a, b], a.dt, b.shape)

    def random(self, dt: DataType) -> Value:
        if dt.is_bool:
            raise TaiTypeError("ti.random makes floats and whole numbers")
        handle = self.builder.random(self.num_random, self.type_of(dt))
        self.num_random += 1
        return Value(self, handle, dt)

    def bit_cast(self, value: Any, dt: DataType) -> Any:
        value = self.as_value(value)
        if value.dt.bits != dt.bits:
            raise TaiTypeError(f"bit_cast from {value.dt} to {dt}: the widths differ")
        if value.dt.mlir == dt.mlir:
            return self.value(value.handle, dt, value.shape)
        return self.elementwise("arith.bitcast", [value], dt)


def _cast_op(source: DataType, dt: DataType) -> str | None:
    if source.is_float:
        if dt.is_float:
            return "arith.extf" if dt.bits > source.bits else "arith.truncf"
        if dt.kind == "i":
            return "arith.fptosi"
        return "arith.fptoui" if dt.bits == 64 else None
    if dt.is_float:
        return "arith.sitofp" if source.kind == "i" else "arith.uitofp"
    if dt.bits < source.bits:
        return "arith.trunci"
    return "arith.extsi" if source.kind == "i" else "arith.extui"
