"""Functions on numbers, which work in Python and in kernels: `ti.sin`, `ti.max`, `ti.cast`, …"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError, TaiTypeError
from ..base import dtypes, state
from ..base.dtypes import cast as cast
from ..base.keywords import CELL_OPERATIONS
from . import of_two
from .division import check_division
from .matrix import Matrix, apply
from .value import stop_gradient


def _needs_emitter(*things: Any) -> bool:
    """Whether the result is a value of the kernel that is being compiled."""
    if state.emitter is None:
        return False
    return any(hasattr(t, "emit_operand") for t in things)


def _check_number(x: Any, name: str) -> None:
    if not isinstance(x, (bool, int, float, np.generic, Matrix)):
        raise TaiTypeError(f"ti.{name} takes numbers, but got {x!r}")


def _unary(name: str, scalar: Callable[[float], float], doc: str) -> Callable[[Any], Any]:
    array_function = np.frompyfunc(scalar, 1, 1)

    def function(x: Any) -> Any:
        if _needs_emitter(x):
            return state.emitter.unary(name, x)
        _check_number(x, name)
        if isinstance(x, Matrix):
            dtype = x.dtype.numpy if x.dtype.is_float else state.options.default_fp.numpy
            return Matrix._wrap(array_function(x.to_numpy()).astype(dtype))
        return scalar(x)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = doc
    return function


def _or_nan(
    function: Callable[[float], float], poles: dict[float, float] | None = None, odd: bool = False
) -> Callable[[float], float]:
    """Evaluates a function as in a kernel: outside of its domain, it gives NaN or infinity instead
    of an exception.

    Args:
        function: a Python function of numbers.
        poles: the values where the function is infinite.
        odd: where it overflows, the result has the sign of the argument.
    """

    def safe(x: float) -> float:
        try:
            return function(x)
        except ValueError:
            return (poles or {}).get(x, math.nan)
        except OverflowError:
            return math.copysign(math.inf, x) if odd else math.inf

    return safe


_AT_ZERO = {0.0: -math.inf}


def _reciprocal_root(x: float) -> float:
    if x == 0:
        return math.copysign(math.inf, x)
    return 1 / math.sqrt(x) if x > 0 else math.nan


sin = _unary("sin", _or_nan(math.sin), "Sine.")
cos = _unary("cos", _or_nan(math.cos), "Cosine.")
tan = _unary("tan", _or_nan(math.tan), "Tangent.")
asin = _unary("asin", _or_nan(math.asin), "Arc sine.")
acos = _unary("acos", _or_nan(math.acos), "Arc cosine.")
atan = _unary("atan", math.atan, "Arc tangent, between -π/2 and π/2.")
sinh = _unary("sinh", _or_nan(math.sinh, odd=True), "Hyperbolic sine.")
cosh = _unary("cosh", _or_nan(math.cosh), "Hyperbolic cosine.")
tanh = _unary("tanh", math.tanh, "Hyperbolic tangent.")
asinh = _unary("asinh", math.asinh, "Inverse of the hyperbolic sine.")
acosh = _unary("acosh", _or_nan(math.acosh), "Inverse of the hyperbolic cosine; NaN below 1.")
atanh = _unary(
    "atanh", _or_nan(math.atanh, {1.0: math.inf, -1.0: -math.inf}),
    "Inverse of the hyperbolic tangent; infinite at ±1, NaN beyond.",
)  # fmt: skip
exp = _unary("exp", _or_nan(math.exp), "e to the power of x.")
log = _unary("log", _or_nan(math.log, _AT_ZERO), "Natural logarithm.")
log1p = _unary("log1p", _or_nan(math.log1p, {-1.0: -math.inf}), "log(1 + x), also for small x.")
expm1 = _unary("expm1", _or_nan(math.expm1), "exp(x) - 1, also for small x.")
exp2 = _unary("exp2", _or_nan(lambda x: 2.0**x), "2 to the power of x.")
log2 = _unary("log2", _or_nan(math.log2, _AT_ZERO), "Logarithm to the base of 2.")
log10 = _unary("log10", _or_nan(math.log10, _AT_ZERO), "Logarithm to the base of 10.")
sqrt = _unary("sqrt", _or_nan(math.sqrt), "Square root.")
rsqrt = _unary("rsqrt", _reciprocal_root, "1 / √x.")
cbrt = _unary("cbrt", math.cbrt, "Cube root, also of negative numbers.")
erf = _unary("erf", math.erf, "Error function, 2/√π ∫ exp(-t²) from 0 to x.")
erfc = _unary("erfc", math.erfc, "1 - erf(x), also where that is small.")


def _rounding(name: str, scalar: Callable[[float], float], doc: str) -> Callable[..., Any]:
    plain = _unary(name, scalar, doc)

    def function(x: Any, dtype: Any = None) -> Any:
        result = plain(x)
        return result if dtype is None else cast(result, dtype)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = doc + " With `dtype`, converted to it."
    return function


def _whole(function: Callable[[float], int]) -> Callable[[float], float]:
    """A whole number as a float, with the sign of the argument where it is zero."""

    def rounded(x: float) -> float:
        if not math.isfinite(x):
            return float(x)
        return function(x) or math.copysign(0.0, x)

    return lambda x: float(rounded(x))


def _half_away(x: float) -> int:
    # Adding 0.5 is not used for rounding, because x + 0.5 would round the largest number below 0.5
    # to 1.
    whole = math.trunc(x)
    return whole + int(math.copysign(1, x)) if builtins.abs(x - whole) >= 0.5 else whole


floor = _rounding("floor", _whole(math.floor), "Rounds down.")
ceil = _rounding("ceil", _whole(math.ceil), "Rounds up.")
round = _rounding(
    "round", _whole(_half_away), "Rounds to the nearest whole number, halves away from zero."
)
trunc = _rounding("trunc", _whole(math.trunc), "Rounds toward zero.")


def abs(x: Any) -> Any:
    """Absolute value."""
    return state.emitter.unary("abs", x) if _needs_emitter(x) else builtins.abs(x)


def _fold(name: str, scalar: Callable[[Any, Any], Any], doc: str) -> Callable[..., Any]:
    def function(*values: Any) -> Any:
        if len(values) == 1:
            single = values[0]
            if isinstance(single, (list, tuple)):
                values = tuple(single)
            elif hasattr(single, name) and getattr(single, "is_matrix", False):
                return getattr(single, name)()
        if len(values) < 2:
            raise TaiTypeError(f"ti.{name} takes at least two numbers")
        result = values[0]
        for value in values[1:]:
            if _needs_emitter(result, value):
                result = state.emitter.binary(name, result, value)
            elif isinstance(result, Matrix) or isinstance(value, Matrix):
                numpy = np.maximum if name == "max" else np.minimum
                result = apply(numpy, result, value)
            else:
                result = scalar(result, value)
        return result

    function.__name__ = function.__qualname__ = name
    function.__doc__ = doc
    return function


max = _fold("max", builtins.max, "The greatest of its arguments, componentwise.")
min = _fold("min", builtins.min, "The least of its arguments, componentwise.")


def pow(x: Any, y: Any) -> Any:
    """Returns x to the power of y."""
    return state.emitter.power(x, y) if _needs_emitter(x, y) else x**y


def atan2(y: Any, x: Any) -> Any:
    """Returns the angle of the point (x, y)."""
    if _needs_emitter(x, y):
        return of_two.atan2(state.emitter, y, x)
    if isinstance(x, Matrix) or isinstance(y, Matrix):
        return apply(np.arctan2, y, x)
    return math.atan2(y, x)


def hypot(x: Any, y: Any) -> Any:
    """√(x² + y²), also where the squares overflow or vanish."""
    if _needs_emitter(x, y):
        return of_two.hypot(state.emitter, x, y)
    if isinstance(x, Matrix) or isinstance(y, Matrix):
        return apply(np.hypot, x, y)
    return math.hypot(x, y)


def copysign(x: Any, y: Any) -> Any:
    """|x| with the sign of y; the sign of -0.0 is negative."""
    if _needs_emitter(x, y):
        return of_two.copysign(state.emitter, x, y)
    if isinstance(x, Matrix) or isinstance(y, Matrix):
        return apply(np.copysign, x, y)
    return math.copysign(x, y)


def select(condition: Any, x: Any, y: Any) -> Any:
    """Returns x where the condition holds, else y; both are computed."""
    if _needs_emitter(condition, x, y):
        return state.emitter.select(condition, x, y)
    if any(isinstance(t, Matrix) for t in (condition, x, y)):
        where = np.asarray(condition)
        return apply(lambda a, b: np.where(where, a, b), x, y)
    return x if condition else y


def bit_cast(x: Any, dtype: Any) -> Any:
    """Returns the bits of a number as another type of the same width."""
    return _in_kernel("bit_cast").bit_cast(x, dtypes.to_dtype(dtype))


def bit_shr(x: Any, by: Any) -> Any:
    """x shifted to the right by a number of bits, with zeros from the left whatever its sign."""
    emitter = _in_kernel("bit_shr")
    x = emitter.as_value(x)
    if x.dt.kind != "i":
        return x >> by
    unsigned = getattr(dtypes, f"u{x.dt.bits}")
    return bit_cast(bit_cast(x, unsigned) >> cast(by, unsigned), x.dt)


def zero(x: Any) -> Any:
    """A zero of the type of x, also where x is infinite or not a number."""
    if not _needs_emitter(x):
        return Matrix._wrap(np.zeros_like(x.to_numpy())) if isinstance(x, Matrix) else type(x)(0)
    value = state.emitter.as_value(x)
    nothing = state.emitter.constant(0, value.dt)
    if not value.shape:
        return nothing
    return state.emitter.matrix([nothing] * math.prod(value.shape), value.dt, value.shape)


def one(x: Any) -> Any:
    """Returns a one of the type of x."""
    return zero(x) + 1


def logical_not(x: Any) -> Any:
    """Whether x is zero."""
    return state.emitter.unary("not", x) if _needs_emitter(x) else not x


def logical_and(a: Any, b: Any) -> Any:
    """Returns whether both numbers are true; both are computed."""
    if _needs_emitter(a, b):
        emitter = state.emitter
        return emitter.binary("&", emitter.to_bool(a), emitter.to_bool(b))
    return bool(a and b)


def logical_or(a: Any, b: Any) -> Any:
    """Returns whether one of two numbers is true; both are computed."""
    if _needs_emitter(a, b):
        emitter = state.emitter
        return emitter.binary("|", emitter.to_bool(a), emitter.to_bool(b))
    return bool(a or b)


def raw_mod(a: Any, b: Any) -> Any:
    """The remainder with the sign of a, as in C; 0 where a whole b is 0."""
    emitter = _in_kernel("raw_mod")
    a, b = emitter.unify(a, b)
    check_division(a, b, a.dt)
    forms = {"f": "arith.remf", "i": "arith.remsi", "u": "arith.remui"}
    return emitter.elementwise(forms[a.dt.kind], [a, b], a.dt)


def raw_div(a: Any, b: Any) -> Any:
    """Division that rounds whole numbers toward zero, as in C; 0 where a whole b is 0."""
    emitter = _in_kernel("raw_div")
    a, b = emitter.unify(a, b)
    check_division(a, b, a.dt)
    forms = {"f": "arith.divf", "i": "arith.divsi", "u": "arith.divui"}
    return emitter.elementwise(forms[a.dt.kind], [a, b], a.dt)


def count_bits(name: str, x: Any) -> Any:
    """Emits the operation "popcnt" or "clz", whose result has the type of x."""
    emitter = _in_kernel(f"math.{name}")
    x = emitter.as_value(x)
    if x.dt.is_float or x.dt.is_bool:
        raise TaiTypeError(f"ti.math.{name} takes whole numbers, but got {x.kind_name}")
    return emitter.elementwise({"popcnt": "math.ctpop", "clz": "math.ctlz"}[name], [x], x.dt)


def _in_kernel(name: str) -> Any:
    if state.emitter is None:
        raise TaiSyntaxError(f"ti.{name} stands in kernels and functions only")
    return state.emitter


def random(dtype: Any = float) -> Any:
    """A random number: a float in [0, 1), or a whole number of any value."""
    return _in_kernel("random").random(state.emitter.to_dtype(dtype))


def randn(dtype: Any = None) -> Any:
    """Returns a random number of the standard normal distribution."""
    emitter = _in_kernel("randn")
    dt = emitter.to_dtype(float if dtype is None else dtype)
    u1 = 1.0 - emitter.random(dt)  # in (0, 1]: the logarithm is finite
    u2 = emitter.random(dt)
    return sqrt(-2.0 * log(u1)) * cos(2.0 * math.pi * u2)


def stop_grad(x: Any) -> Any:
    """Returns a number or matrix that gradients take for a constant.

    Given a field, as a statement: reads of the field in this block are constants.
    """
    if hasattr(x, "emit_operand") or (state.emitter is not None and isinstance(x, Matrix)):
        return stop_gradient(state.emitter.as_value(x))
    return x


# Matrices


def polar_decompose(a: Any, dt: Any = None) -> Any:
    """A = R S with a rotation R and a symmetric S, of a 2×2 or 3×3 matrix."""
    matrix = square_matrix("polar_decompose", a)
    return state.emitter.decompose("polar", matrix, [matrix.shape] * 2)


def svd(a: Any, dt: Any = None) -> Any:
    """A = U Σ Vᵀ of a 2×2 or 3×3 matrix: `U, sigma, V`."""
    matrix = square_matrix("svd", a)
    u, sigma, v = state.emitter.decompose("svd", matrix, [matrix.shape] * 3)
    sigma.is_diagonal = True
    return u, sigma, v


def sym_eig(a: Any, dt: Any = None) -> Any:
    """Eigenvalues, greatest first, and eigenvectors (columns) of a symmetric matrix."""
    matrix = square_matrix("sym_eig", a)
    return state.emitter.decompose("sym_eig", matrix, [matrix.shape[:1], matrix.shape])


def solve(a: Any, b: Any, dt: Any = None) -> Any:
    """Returns the solution x of A x = b."""
    emitter = _in_kernel("solve")
    a, b = emitter.as_value(a), emitter.as_value(b)
    if len(a.shape) != 2 or a.shape[0] != a.shape[1] or b.shape != a.shape[:1]:
        raise TaiTypeError(
            "solve takes a square matrix and a vector of as many components, but got a "
            f"{a.kind_name} and a {b.kind_name}"
        )
    if a.shape[0] > 4:
        raise TaiTypeError("solve takes at most 4 unknowns")
    return emitter.solve(a, b)


def square_matrix(
    name: str, a: Any, sizes: tuple[int, ...] = (2, 3), hint: str | None = None
) -> Any:
    """The argument of `ti.<name>` in a kernel, which must be a square matrix of these sizes."""
    matrix = _in_kernel(name).as_value(a)
    if matrix.shape not in [(size, size) for size in sizes]:
        raise TaiTypeError(
            f"ti.{name} takes a {' or '.join(f'{size}×{size}' for size in sizes)} matrix, but got "
            + (f"a {matrix.kind_name}" if matrix.shape else f"a number of type {matrix.dt}"),
            hint,
        )
    return matrix


# Loops


class ndrange:  # noqa: N801
    """The product of ranges: `ti.ndrange(n, (1, m))`. In Python it yields tuples."""

    def __init__(self, *arguments: Any):
        self.arguments = arguments

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        import itertools

        ranges = [range(*(a if isinstance(a, (tuple, list)) else (0, a))) for a in self.arguments]
        return iter(itertools.product(*ranges))


class Grouped:
    """The indices of a loop as one vector for each iteration; see `grouped`."""

    def __init__(self, inner: Any):
        self.inner = inner

    def __iter__(self) -> Iterator[Any]:
        if not isinstance(self.inner, (ndrange, Grouped)):
            raise TaiTypeError("ti.grouped takes a field or a ti.ndrange")
        for item in self.inner:
            yield Matrix._wrap(np.array(item, np.int32))


def grouped(inner: Any) -> Grouped:
    """Makes a loop give all its indices as one vector: `for I in ti.grouped(x)`."""
    return Grouped(inner)


def static(*things: Any) -> Any:
    """Evaluates its argument at compile time: unrolls a loop, or chooses a branch."""
    return things[0] if len(things) == 1 else things


def static_print(*things: Any, **options: Any) -> None:
    """Prints while the kernel is compiled."""
    print(*things, **options)


def static_assert(condition: Any, message: str = "") -> None:
    """Fails at compile time unless the condition holds."""
    if not condition:
        raise TaiTypeError(
            message or "static assertion failed", "ti.static_assert is judged at compile time"
        )


def loop_config(**options: Any) -> None:
    """Sets options of the loop that follows, by names.

    Args:
        serialize: run it on one thread, in order.
        parallelize: 1 for the same.
        block_dim: threads of a block on a GPU, a multiple of 32 or a power of two, 1024 at most;
            0 for a size that suits the kernel. Without effect on the CPU.
        block_dim_adaptive: False for blocks of the usual size on a GPU where `block_dim` names
            none, whatever suits the kernel.
        halo: with a mesh, the rows on either side of those of a rank that indices which data choose
            may reach, or "all".
    """
    raise TaiSyntaxError(
        "ti.loop_config stands in kernels, before a loop",
        "write it in a @ti.kernel, on the line above the for",
    )


def block_local(*fields: Any) -> None:
    """A hint of Taichi for GPUs to keep fields in shared memory; it has no effect here."""


def cache_read_only(*fields: Any) -> None:
    """A hint of Taichi for GPUs to read fields through the cache; it has no effect here."""


def no_activate(*nodes: Any) -> None:
    """A promise that a loop writes to active cells only; it has no effect, since the compiler skips
    activation wherever it can show that by itself."""


def assume_in_range(value: Any, base: Any, low: Any, high: Any) -> Any:
    """A promise that base + low <= value < base + high; the value itself."""
    return value


def loop_unique(value: Any, covers: Any = None) -> Any:
    """A promise that iterations of a loop have different values; the value itself."""
    return value


# Operations of kernels; the functions below are their names in Python, and raise.


def _place_operation(name: str, doc: str) -> Callable[..., Any]:
    def function(*args: Any) -> Any:
        raise TaiSyntaxError(
            f"ti.{name} stands in kernels and functions only", CELL_OPERATIONS.get(name)
        )

    function.__name__ = function.__qualname__ = name
    function.__doc__ = doc
    return function


atomic_add = _place_operation("atomic_add", "x += y in one step; returns the old x.")
atomic_sub = _place_operation("atomic_sub", "x -= y in one step; returns the old x.")
atomic_mul = _place_operation("atomic_mul", "x *= y in one step; returns the old x.")
atomic_min = _place_operation("atomic_min", "x = min(x, y) in one step; returns the old x.")
atomic_max = _place_operation("atomic_max", "x = max(x, y) in one step; returns the old x.")
atomic_and = _place_operation("atomic_and", "x &= y in one step; returns the old x.")
atomic_or = _place_operation("atomic_or", "x |= y in one step; returns the old x.")
atomic_xor = _place_operation("atomic_xor", "x ^= y in one step; returns the old x.")
append = _place_operation("append", "Adds a cell to a dynamic list.")
activate = _place_operation("activate", "Makes a cell active.")
deactivate = _place_operation("deactivate", "Makes a cell inactive.")
is_active = _place_operation("is_active", "Whether a cell is active.")
length = _place_operation("length", "The number of cells of a dynamic list.")
rescale_index = _place_operation("rescale_index", "The index of a cell of another level.")
get_addr = _place_operation("get_addr", "The address of an element.")
