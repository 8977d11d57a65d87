"""Known forms that lose digits, and what computes the same without that loss.

A form is searched at the place that a report of shadows names, and is proposed only if it is found
to be better: both are computed in the type of the program, next to hundreds of digits, at values at
which the present form loses as much as the report says.
"""

from __future__ import annotations

import ast
import functools
import linecache
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, DecimalException, localcontext
from typing import Any

import numpy as np

# What is written, and what is to be written in its place. Capital letters stand for any
# expression. `A * A` and `A ** 2` are one form, and so are the orders of sums and products.
_FORMS = [
    ("1 - cos(A)", "2 * sin(A / 2) ** 2"),
    ("cos(A) - 1", "-2 * sin(A / 2) ** 2"),
    ("1 - cos(A) ** 2", "sin(A) ** 2"),
    ("1 - sin(A) ** 2", "cos(A) ** 2"),
    ("1 - tanh(A) ** 2", "1 / cosh(A) ** 2"),
    ("A + B - B", "A"),
    ("A - (A + B)", "-B"),
    ("A - B - A", "-B"),
    ("A - (A - B)", "B"),
    ("exp(A) - 1", "expm1(A)"),
    ("1 - exp(A)", "-expm1(A)"),
    ("exp(A) - exp(-A)", "2 * sinh(A)"),
    ("log(1 + exp(A))", "max(A, 0) + log1p(exp(-abs(A)))"),
    ("log(exp(A) + exp(B))", "max(A, B) + log1p(exp(-abs(A - B)))"),
    ("log(1 + A)", "log1p(A)"),
    ("log(1 - A)", "log1p(-A)"),
    ("sqrt(A ** 2 + B ** 2)", "hypot(A, B)"),
    ("sqrt(A ** 2 + B ** 2 + C ** 2)", "hypot(hypot(A, B), C)"),
    ("sqrt(1 + A) - 1", "A / (sqrt(1 + A) + 1)"),
    ("1 - sqrt(1 + A)", "-A / (sqrt(1 + A) + 1)"),
    ("1 - sqrt(1 - A)", "A / (sqrt(1 - A) + 1)"),
    ("sqrt(A + B) - sqrt(A)", "B / (sqrt(A + B) + sqrt(A))"),
    ("sqrt(A) - sqrt(B)", "(A - B) / (sqrt(A) + sqrt(B))"),
    ("1 / (A + B) - 1 / A", "-B / (A * (A + B))"),
    ("1 / A - 1 / B", "(B - A) / (A * B)"),
    ("1 - 1 / (1 + A)", "A / (1 + A)"),
    ("1 / (1 + A) - 1", "-A / (1 + A)"),
    ("A ** 2 - B ** 2", "(A - B) * (A + B)"),
    ("A * B - A * C", "A * (B - C)"),
]
_IN_MATH = {"expm1", "log1p"}
_PLAIN = {"max", "abs"}
_VALUES = 600
_DIGITS = 150
_MANY_DIGITS = Context(prec=_DIGITS, Emin=MIN_EMIN, Emax=MAX_EMAX)
# Relative errors of these multiples of the rounding unit are as good as exact.
_UNITS = 16


@dataclass
class Rewrite:
    """Another form of an expression, which loses fewer digits.

    Attributes:
        before, after: the expressions, as source text.
        error, error_after: the greatest relative error of each, over the values that were tried;
            `inf` where it overflows.
        values: how many values were tried.
    """

    before: str
    after: str
    error: float
    error_after: float
    values: int

    def __str__(self) -> str:
        before = "overflow" if math.isinf(self.error) else f"error {self.error:.1e}"
        return (
            f"{self.before} → {self.after} ({before} → {self.error_after:.1e} "
            f"on {self.values} values)"
        )


def _parsed(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


_PARSED = [(_parsed(before), _parsed(after)) for before, after in _FORMS]


def _name_of(function: ast.expr) -> str:
    """The last part of a function's name: `cos` of `ti.math.cos`."""
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _same(a: ast.expr, b: ast.expr) -> bool:
    return ast.dump(a) == ast.dump(b)


def _factors_of_square(node: ast.expr) -> ast.expr | None:
    """Returns x of `x * x` and `x ** 2`."""
    if not isinstance(node, ast.BinOp):
        return None
    if isinstance(node.op, ast.Mult) and _same(node.left, node.right):
        return node.left
    is_square = isinstance(node.right, ast.Constant) and node.right.value == 2
    return node.left if isinstance(node.op, ast.Pow) and is_square else None


def _match(form: ast.expr, node: ast.expr, found: dict[str, ast.expr]) -> Iterator[dict]:
    """Yields all assignments of a form's letters for which it is the expression."""
    if isinstance(form, ast.Name):
        known = found.get(form.id)
        if known is None:
            yield {**found, form.id: node}
        elif _same(known, node):
            yield found
    elif isinstance(form, ast.Constant):
        if isinstance(node, ast.Constant) and node.value == form.value:
            yield found
    elif isinstance(form, ast.UnaryOp):
        if isinstance(node, ast.UnaryOp) and type(node.op) is type(form.op):
            yield from _match(form.operand, node.operand, found)
    elif isinstance(form, ast.Call):
        if not isinstance(node, ast.Call) or len(node.args) != 1 or node.keywords:
            return
        if _name_of(node.func) == _name_of(form.func):
            yield from _match(form.args[0], node.args[0], found)
    elif isinstance(form, ast.BinOp):
        base, other = _factors_of_square(form), _factors_of_square(node)
        if base is not None:
            if other is not None:
                yield from _match(base, other, found)
            return
        if not isinstance(node, ast.BinOp) or type(node.op) is not type(form.op):
            return
        for first in _match(form.left, node.left, found):
            yield from _match(form.right, node.right, first)
        if isinstance(form.op, (ast.Add, ast.Mult)):
            for first in _match(form.left, node.right, found):
                yield from _match(form.right, node.left, first)


class _Fill(ast.NodeTransformer):
    """Puts expressions in the place of a form's letters, and full names in that of functions."""

    def __init__(self, found: dict[str, ast.expr], alias: str):
        self.found, self.alias = found, alias

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.found.get(node.id, node)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = _name_of(node.func)
        inner = f"{self.alias}.math" if name in _IN_MATH else self.alias
        path = name if name == "abs" else f"{inner}.{name}"
        return ast.Call(_parsed(path), [self.visit(a) for a in node.args], [])


class _Unknown(Exception):
    """An expression that cannot be computed here, or not at this value."""


class _Numbers:
    """Computes in a floating-point type of NumPy, each operation rounded by itself."""

    FUNCTIONS = {"sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "log", "sqrt", "log1p",
                 "expm1", "hypot", "abs"}  # fmt: skip

    def __init__(self, kind: Any):
        self.kind = kind

    def constant(self, value: float) -> Any:
        return self.kind(value)

    def call(self, name: str, args: Sequence[Any]) -> Any:
        if name == "max":
            return max(args)
        return self.kind(getattr(np, name)(*args))


class _Decimals:
    """Computes with many digits."""

    FUNCTIONS = _Numbers.FUNCTIONS

    def constant(self, value: float) -> Decimal:
        return Decimal(value)

    def call(self, name: str, args: Sequence[Decimal]) -> Decimal:
        x = args[0]
        if name in ("sqrt", "exp"):
            return getattr(x, name)()
        if name == "log":
            return x.ln()
        if name == "max":
            return max(args)
        if name == "abs":
            return abs(x)
        if name == "log1p":
            return (1 + x).ln()
        if name == "expm1":
            return x.exp() - 1
        if name == "hypot":
            return (x * x + args[1] * args[1]).sqrt()
        if name in ("sinh", "cosh", "tanh"):
            up, down = x.exp(), (-x).exp()
            if name == "tanh":
                return (up - down) / (up + down)
            return (up - down if name == "sinh" else up + down) / 2
        if abs(x) > 40:
            raise _Unknown
        sine, cosine, term, power = Decimal(0), Decimal(0), Decimal(1), 0
        while abs(term) > Decimal(10) ** (-2 * _DIGITS):
            if power % 2:
                sine += term if power % 4 == 1 else -term
            else:
                cosine += term if power % 4 == 0 else -term
            power += 1
            term = term * x / power
            if term == 0:
                break
        return {"sin": sine, "cos": cosine, "tan": sine / cosine}[name]


def _compute(node: ast.expr, values: dict[str, Any], numbers: Any) -> Any:
    """The value of an expression; `values` are those of its leaves, by their text."""
    text = ast.dump(node)
    if text in values:
        return values[text]
    if isinstance(node, ast.Constant):
        return numbers.constant(node.value)
    if isinstance(node, ast.UnaryOp):
        operand = _compute(node.operand, values, numbers)
        return -operand if isinstance(node.op, ast.USub) else operand
    if isinstance(node, ast.Call):
        args = [_compute(a, values, numbers) for a in node.args]
        return numbers.call(_name_of(node.func), args)
    assert isinstance(node, ast.BinOp)
    left, right = (_compute(side, values, numbers) for side in (node.left, node.right))
    if isinstance(node.op, ast.Add):
        return left + right
    if isinstance(node.op, ast.Sub):
        return left - right
    if isinstance(node.op, ast.Mult):
        return left * right
    if isinstance(node.op, ast.Div):
        return left / right
    power = numbers.constant(1.0)
    for _ in range(int(ast.literal_eval(node.right))):
        power = power * left
    return power


def _leaves(node: ast.expr) -> list[str]:
    """The parts of an expression that are variables, elements or calls of other functions."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
            return []
        raise _Unknown
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
        return _leaves(node.operand)
    if isinstance(node, ast.BinOp):
        if isinstance(node.op, (ast.Add, ast.Sub, ast.Mult, ast.Div)):
            return list(dict.fromkeys(_leaves(node.left) + _leaves(node.right)))
        exponent = node.right
        if (isinstance(node.op, ast.Pow) and isinstance(exponent, ast.Constant)
                and isinstance(exponent.value, int) and 0 < exponent.value < 9):  # fmt: skip
            return _leaves(node.left)
    elif isinstance(node, ast.Call):
        known = _Numbers.FUNCTIONS | {"max"}
        if _name_of(node.func) in known and not node.keywords:
            return list(dict.fromkeys(leaf for a in node.args for leaf in _leaves(a)))
    return [ast.dump(node)]


def _draw(leaves: list[str], kind: Any, is_wide: bool) -> Iterator[dict[str, Any]]:
    """Draws values of variables: of all sizes, near 1 and right angles, near each other, or far
    smaller than one another.
    """
    chance = random.Random(1)
    bits = 24 if kind is np.float32 else 53
    widest = (120 if kind is np.float32 else 1000) if is_wide else 2 * bits
    for number in range(_VALUES):
        size = chance.uniform(-widest, widest) if number % 2 else chance.uniform(-6, 12)
        near = 1 + chance.uniform(-1, 1) * 2.0 ** chance.uniform(-bits, 0)
        near *= math.pi / 2 if number % 8 == 2 else 1.0
        first = chance.choice((-1, 1)) * (near if number % 4 == 2 else 2.0**size)
        drawn = []
        for place in range(len(leaves)):
            gap = 2.0 ** chance.uniform(-bits, 0 if number % 8 < 4 else 8 - bits)
            choice = (number + place) % 3 if place else 0
            drawn.append(
                first * [1.0 if not place else 1 + gap, gap, chance.uniform(-1, 1)][choice]
            )
        chance.shuffle(drawn)
        yield {leaf: kind(value) for leaf, value in zip(leaves, drawn, strict=True)}


def _errors(
    before: ast.expr, after: ast.expr, kind: Any, least: float, is_wide: bool
) -> list[tuple[float, float]]:
    """Relative errors of two forms at values where the first has at least `least`.

    Empty if there are no such values, or if the second is clearly worse anywhere.
    """
    leaves, numbers, found = _leaves(before), _Numbers(kind), []
    unit = float(np.finfo(kind).eps)
    greatest, smallest = float(np.finfo(kind).max), float(np.finfo(kind).tiny)
    for values in _draw(leaves, kind, is_wide):
        exactly = {leaf: Decimal(float(value)) for leaf, value in values.items()}
        try:
            exact = _compute(before, exactly, _Decimals())
            if not smallest <= abs(exact) <= greatest:
                continue
            pair = []
            for form in (before, after):
                value = float(_compute(form, values, numbers))
                is_finite = math.isfinite(value)
                pair.append(float(abs(Decimal(value) / exact - 1)) if is_finite else math.inf)
        except (_Unknown, DecimalException, ArithmeticError, ValueError):
            continue
        if pair[1] > max(_UNITS * unit, 4 * pair[0]):
            # It need not be better where the present form has an error of its inputs' size.
            return []
        if pair[0] >= least:
            found.append((pair[0], pair[1]))
    return found


def _text(node: ast.expr) -> str:
    return ast.unparse(ast.fix_missing_locations(node))


@functools.lru_cache(maxsize=256)
def _verify(before: str, after: str, bits: int, least: float, is_wide: bool) -> Rewrite | None:
    kind = np.float32 if bits == 24 else np.float64
    with np.errstate(all="ignore"), localcontext(_MANY_DIGITS):
        try:
            pairs = _errors(_parsed(before), _parsed(after), kind, least, is_wide)
        except _Unknown:
            return None
    if len(pairs) < 3:
        return None
    error, rest = (max(column) for column in zip(*pairs, strict=True))
    if not rest <= 0.01 * min(error, 1.0):
        return None
    return Rewrite(before, after, error, rest, len(pairs))


def _alias(tree: ast.Module) -> str:
    """The name under which a module has imported the package."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                if name.name == "tai":
                    return name.asname or "tai"
    return "ti"


@functools.lru_cache(maxsize=32)
def _tree(text: str) -> ast.Module | None:
    try:
        return ast.parse(text)
    except SyntaxError:
        return None


def _around(tree: ast.Module, line: int, column: int) -> list[ast.expr]:
    """The operations that hold a place, the innermost first; columns count from 1."""
    at = (line, column - 1)
    found: list[ast.expr] = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.BinOp, ast.Call)) and node.end_lineno is not None:
            end = (node.end_lineno, node.end_col_offset or 0)
            if (node.lineno, node.col_offset) <= at < end:
                found.append(node)
    return found[::-1]


def propose(
    filename: str | None, line: int, column: int, bits: int, error: float, overflows: bool
) -> Rewrite | None:
    """Proposes another form for the expression at a place that loses digits.

    Args:
        filename, line, column: the place; columns count from 1.
        bits: those of a number there, 24 or 53; 0 if they are not known.
        error: the relative error that was found there.
        overflows: results there are not finite, though exact ones are.

    Returns:
        The first known form that is better at all values that were tried, or None.
    """
    if filename is None or bits not in (0, 24, 53):
        return None
    tree = _tree("".join(linecache.getlines(filename)))
    if tree is None:
        return None
    alias = _alias(tree)
    least = math.inf if overflows else 0.1 * min(error, 1.0)
    for node in _around(tree, line, column):
        for form, other in _PARSED:
            for found in _match(form, node, {}):
                after = _Fill(found, alias).visit(_parsed(ast.unparse(other)))
                texts = _text(node), _text(after)
                made = [
                    _verify(*texts, b, least, overflows) for b in ([bits] if bits else (24, 53))
                ]
                if None not in made:
                    return made[0]
    return None
