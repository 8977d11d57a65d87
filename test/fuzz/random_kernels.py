"""Random programs of kernels, as a user would write them, to differentiate.

A program is the text of a Python module: fields, one to three kernels, and `run`, which
launches them and then sums all fields into the loss. Loops in kernels are parallel and free of
races, or serial and free to do anything: overwrite, update in place, recur along an axis,
break, continue, index by fields. Every choice comes from a `random.Random`, so a seed gives a
program, and hypothesis can draw and shrink one.

In *smooth* programs, functions are evaluated where they have a derivative (with probability
one), and values stay of moderate size. In *kinked* programs, the points are zeros of both
signs, ties, denormals and huge numbers, and functions are taken at the edge of their domain.
"""

from __future__ import annotations

import random

N = 5  # elements of the fields, unless a configuration has more; constant indices are below

HEADER = """\
import tai as ti

N = 5
x = ti.field(ti.f64, shape=N, needs_grad=True, needs_dual=True)
y = ti.field(ti.f64, shape=N, needs_grad=True, needs_dual=True)
z = ti.field(ti.f64, shape=N, needs_grad=True, needs_dual=True)
u = ti.field(ti.f64, shape=(N, 3), needs_grad=True, needs_dual=True)
s = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
v = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True, needs_dual=True)
m = ti.Matrix.field(2, 2, ti.f64, shape=N, needs_grad=True, needs_dual=True)
loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
p = ti.field(ti.i32, shape=N)
q = ti.field(ti.i32, shape=N)
k = ti.field(ti.i32, shape=N)


@ti.func
def pick(a, b):
    r = a * b
    if a > b:
        r = a - 0.5 * b
    return r


@ti.func
def power(a, n):
    r = 1.0
    for _ in range(n):
        r = r * a + 0.1
    return r


@ti.kernel
def total():
    for i in range(N):
        loss[None] += 0.7 * x[i] + y[i] * (i + 0.3) - z[i] * z[i]
        loss[None] += u[i, 0] - 0.4 * u[i, 1] + 0.9 * u[i, 2] * u[i, 0]
        loss[None] += v[i].dot(ti.Vector([0.6, -1.1])) + m[i].trace() * 0.8 - m[i][0, 1]
        if i == 0:
            loss[None] += 0.5 * s[None]
"""

FLOAT_FIELDS = ("x", "y", "z", "u", "s", "v", "m")
SMOOTH_UNARY = (
    "ti.sin", "ti.cos", "ti.tanh", "ti.atan2(1.3, {})", "ti.exp(ti.tanh({}))",
)  # fmt: skip
EDGE_UNARY = ("ti.sqrt", "ti.log", "ti.exp", "ti.asin", "ti.acos", "ti.rsqrt", "ti.tan", "abs",
              "1 / (1 + ti.exp(-({})))", "1 / ({})")  # fmt: skip
GUARDED_UNARY = ("ti.sqrt(0.5 + ({e}) * ({e}))", "ti.log(1.5 + ti.sin({e}))",
                 "ti.rsqrt(0.7 + abs({e}))", "ti.asin(0.9 * ti.sin({e}))",
                 "ti.acos(0.9 * ti.tanh({e}))", "ti.tan(ti.tanh({e}))",
                 "({e}) ** 2", "ti.tanh({e}) ** 3", "abs({e}) ** 1.5", "abs({e})",
                 "ti.pow(1.2 + ti.sin({e}), 0.3 * ti.cos({e}))", "(0.5 + abs({e})) ** -2",
                 "ti.math.fract({e})", "ti.math.sign({e}) * ({e})")  # fmt: skip
SPECIAL = (0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1.0, 1e-310, -1e-310, 5e-324, 1e-160, 0.0, 1.0,
           1.5707963267948966, 3.141592653589793, 0.0, 1.0, -1.0)  # fmt: skip
HUGE = (1e150, -1e200, 1e300, -1e18)


class Scope:
    """The names of a program: expressions of each type, and fields by the allowed accesses."""

    def __init__(self) -> None:
        self.floats: list[str] = []
        self.vectors: list[str] = []
        self.matrices: list[str] = []
        self.variables: list[str] = []  # floats that may be assigned
        self.vector_variables: list[str] = []
        self.indices: list[str] = []  # within 0 … N - 1
        self.trips: list[str] = ["2", "3"]  # of loops
        self.element: str | None = None  # of a parallel loop; None where anything goes
        self.own: set[str] = set()  # fields written at the element of the loop alone
        self.tidy = False  # written fields are not read
        self.sinks: set[str] = set()  # fields accumulated anywhere, and not read
        self.in_loop = False

    def copy(self) -> Scope:
        other = Scope()
        for name, value in vars(self).items():
            setattr(other, name, value.copy() if isinstance(value, (list, set)) else value)
        return other


class Generator:
    """Writes one program."""

    def __init__(self, rng: random.Random, kinked: bool, tidy: bool):
        self.rng, self.kinked, self.tidy = rng, kinked, tidy
        self.used: set[str] = set()  # fields that the program has named so far
        self.lines: list[str] = []
        self.count = 0
        self.budget = 0  # statements that the kernel may still have

    def pick(self, *options):
        return options[self.rng.randrange(len(options))]

    def chance(self, probability: float) -> bool:
        return self.rng.random() < probability

    def name(self, prefix: str) -> str:
        self.count += 1
        return f"{prefix}{self.count}"

    def emit(self, indent: int, text: str) -> None:
        self.lines.append("    " * indent + text)

    # Expressions

    def constant(self) -> str:
        if self.kinked and self.chance(0.6):
            return self.pick("0.0", "1.0", "-1.0", "0.5", "2.0")
        return f"{self.rng.randrange(-19, 20) / 10 + 0.05:.2f}"

    def index(self, scope: Scope) -> str:
        if scope.indices and self.chance(0.8):
            index = self.pick(*scope.indices)
            return self.pick(index, index, f"p[{index}]", f"q[{index}]", f"({index} + 1) % N")
        return str(self.rng.randrange(N))

    def reading_index(self, scope: Scope, name: str) -> str | None:
        """Where the field may be read, or None."""
        if name in scope.sinks or (scope.tidy and name in scope.own):
            return None
        if scope.element is not None and name in scope.own:
            return scope.element
        return self.index(scope)

    def at(self, name: str, index: str) -> str:
        self.used.add(name)
        if name == "s":
            return "s[None]"
        if name == "u":
            return f"u[{index}, {self.pick('0', '1', '2', f'({index}) % 3')}]"
        return f"{name}[{index}]"

    def element(self, scope: Scope, names: tuple[str, ...]) -> str | None:
        """An element of one of the fields, to read."""
        name = self.pick(*names)
        index = self.reading_index(scope, name)
        if index is None or (name == "s" and scope.element is not None and name in scope.own):
            return None
        return self.at(name, index)

    def leaf(self, scope: Scope) -> str:
        kind = self.rng.randrange(10)
        if kind < 4 and scope.floats:
            return self.pick(*scope.floats)
        if kind < 8:
            found = self.element(scope, ("x", "y", "z", "u", "s"))
            return found or self.constant()
        if kind == 8:
            vector = self.vector(scope, 0)
            return f"{vector}[{self.rng.randrange(2)}]"
        return self.constant()

    def real(self, scope: Scope, depth: int = 2) -> str:
        if depth <= 0 or self.chance(0.2):
            return self.leaf(scope)
        kind = self.rng.randrange(20)
        if kind < 7:
            a, b = self.real(scope, depth - 1), self.real(scope, depth - 1)
            return f"({a} {self.pick('+', '-', '*', '*')} {b})"
        if kind < 9:
            return self.apply(self.pick(*SMOOTH_UNARY), self.real(scope, depth - 1))
        if kind < 12:
            inner = self.real(scope, depth - 1)
            if self.kinked and self.chance(0.6):
                return self.apply(self.pick(*EDGE_UNARY), inner)
            return "(" + self.pick(*GUARDED_UNARY).format(e=inner) + ")"
        if kind < 14:
            a, b = self.real(scope, depth - 1), self.real(scope, depth - 1)
            if self.kinked and self.chance(0.5):
                return self.pick(f"({a} / {b})", f"ti.atan2({a}, {b})", f"({a} ** {b})",
                                 f"({a} % {b})")  # fmt: skip
            return self.pick(f"({a} / (1.5 + abs({b})))", f"({a} / (2.0 + ti.sin({b})))",
                             f"ti.atan2({a}, 1.2 + ti.cos({b}))",
                             f"(({a}) % (2.3 + ti.sin({b})))")  # fmt: skip
        if kind == 14:
            a, b = self.real(scope, depth - 1), self.real(scope, depth - 1)
            return self.pick(f"min({a}, {b})", f"max({a}, {b})", f"ti.max({a}, 0.0)",
                             f"ti.math.clamp({a}, -0.7, 0.8)",
                             f"ti.math.mix({a}, {b}, 0.3)")  # fmt: skip
        if kind == 15:
            a, b = self.real(scope, depth - 1), self.real(scope, depth - 1)
            condition = self.condition(scope)
            return self.pick(f"({a} if {condition} else {b})",
                             f"ti.select({condition}, {a}, {b})")  # fmt: skip
        if kind == 16:
            a, b = self.real(scope, depth - 1), self.real(scope, 0)
            return self.pick(f"pick({a}, {b})", f"power(ti.tanh({a}), {self.pick(*scope.trips)})")
        if kind == 17:
            vector, other = self.vector(scope, depth - 1), self.vector(scope, depth - 1)
            safe = "" if self.kinked else " + ti.Vector([3.1, 0.0])"
            return self.pick(f"({vector}).dot({other})", f"(ti.sin({vector}){safe}).norm()",
                             f"({vector}).sum()", f"({vector}).norm_sqr()", f"({vector}).max()",
                             f"(ti.cos({vector}){safe}).normalized()[1]")  # fmt: skip
        if kind == 18:
            matrix = self.matrix(scope, depth - 1)
            return self.pick(f"({matrix}).trace()", f"({matrix}).determinant()",
                             f"({matrix})[0, 1]", f"({matrix}).transpose()[1, 0]")  # fmt: skip
        a = self.real(scope, depth - 1)
        return self.pick(f"({a} + ti.floor({a}))", f"({a} * ti.cast(ti.cast({a}, ti.i32), ti.f64))",
                         f"ti.cast(ti.round({a}), ti.f64)", f"ti.abs({a})", f"(-{a})")  # fmt: skip

    @staticmethod
    def apply(function: str, operand: str) -> str:
        return f"({function.format(operand)})" if "{}" in function else f"{function}({operand})"

    def vector(self, scope: Scope, depth: int) -> str:
        kind = self.rng.randrange(7)
        if kind < 3 or depth <= 0:
            if scope.vectors and self.chance(0.5):
                return self.pick(*scope.vectors)
            return self.element(scope, ("v",)) or f"ti.Vector([{self.constant()}, 0.7])"
        if kind == 3:
            return f"ti.Vector([{self.real(scope, depth - 1)}, {self.real(scope, depth - 1)}])"
        if kind == 4:
            return f"({self.vector(scope, depth - 1)} {self.pick('+', '-', '*')} " \
                f"{self.vector(scope, depth - 1)})"  # fmt: skip
        if kind == 5:
            return f"({self.matrix(scope, depth - 1)} @ {self.vector(scope, depth - 1)})"
        return f"({self.real(scope, depth - 1)} * {self.vector(scope, depth - 1)})"

    def matrix(self, scope: Scope, depth: int) -> str:
        kind = self.rng.randrange(6)
        if kind < 2 or depth <= 0:
            if scope.matrices and self.chance(0.5):
                return self.pick(*scope.matrices)
            return self.element(scope, ("m",)) or "ti.Matrix([[1.1, 0.2], [-0.3, 0.8]])"
        if kind == 2:
            a, b = self.vector(scope, depth - 1), self.vector(scope, depth - 1)
            return f"({a}).outer_product({b})"
        if kind == 3:
            a, b = self.matrix(scope, depth - 1), self.matrix(scope, depth - 1)
            return f"({a} {self.pick('+', '-', '@')} {b})"
        if kind == 4:
            far = "" if self.kinked else " + ti.Matrix([[3.0, 0.0], [0.0, 2.5]])"
            return f"(ti.sin({self.matrix(scope, depth - 1)}){far}).inverse()"
        return f"ti.tanh({self.matrix(scope, depth - 1)})"

    def condition(self, scope: Scope) -> str:
        a = self.real(scope, 0)
        simple = f"{a} {self.pick('<', '>', '>=')} {self.real(scope, 0)}"
        if self.chance(0.3) and scope.indices:
            simple = f"{self.pick(*scope.indices)} % 2 == {self.pick('0', '1')}"
        if self.chance(0.2):
            return f"({simple} {self.pick('and', 'or')} {self.real(scope, 0)} < 0.4)"
        return f"({simple})"

    def squash(self, value: str) -> str:
        """Stored values stay of moderate size, most of all in smooth programs."""
        if self.kinked and self.chance(0.5):
            return value
        return self.pick(f"ti.tanh({value})", f"ti.sin({value})", f"(0.3 * ti.cos({value}))")

    # Statements

    def block(self, indent: int, outer: Scope, depth: int, most: int = 4) -> Scope:
        scope = outer.copy()
        before = len(self.lines)
        for _ in range(self.rng.randrange(1, most + 1)):
            self.budget -= 1
            self.statement(indent, scope, depth if self.budget > 0 else 0)
            if self.budget <= 0:
                break
        if len(self.lines) == before:
            self.emit(indent, f"loss[None] -= {self.squash(self.real(scope))}")
        return scope

    def statement(self, indent: int, scope: Scope, depth: int) -> None:
        kind = self.rng.randrange(20)
        if kind < 3:
            name = self.name("f")
            self.emit(indent, f"{name} = {self.squash(self.real(scope))}")
            scope.floats.append(name)
            scope.variables.append(name)
        elif kind < 5 and scope.variables:
            self.assign(indent, scope)
        elif kind == 5:
            name = self.name("c")
            if self.chance(0.6):
                self.emit(indent, f"{name} = ti.tanh({self.vector(scope, 2)})")
                scope.vectors.append(name)
                scope.vector_variables.append(name)
            else:
                self.emit(indent, f"{name} = ti.tanh({self.matrix(scope, 2)})")
                scope.matrices.append(name)
        elif kind == 6 and scope.vector_variables:
            name = self.pick(*scope.vector_variables)
            at = self.pick("0", "1", f"({self.pick(*scope.indices)}) % 2" if scope.indices else "0")
            self.emit(indent, f"{name}[{at}] = {self.squash(self.real(scope))}")
        elif kind < 12:
            self.store(indent, scope)
        elif kind < 14 and depth > 0:
            self.branch(indent, scope, depth)
        elif kind < 17 and depth > 0:
            self.loop(indent, scope, depth)
        elif kind == 17 and depth > 0:
            self.while_loop(indent, scope, depth)
        elif kind == 18 and scope.in_loop:
            # Under a condition, or what follows would be dead.
            self.emit(indent, f"if {self.condition(scope)}:")
            self.emit(indent + 1, self.pick("break", "continue"))
        else:
            self.emit(indent, f"loss[None] += {self.squash(self.real(scope))}")

    def assign(self, indent: int, scope: Scope) -> None:
        name, value = self.pick(*scope.variables), self.real(scope)
        text = self.pick(f"{name} = {self.squash(value)}", f"{name} += {self.squash(value)}",
                         f"{name} *= {self.squash(value)}", f"{name} -= {self.squash(value)}",
                         f"{name} = 0.9 * {name} + 0.1 * {self.squash(value)}")  # fmt: skip
        self.emit(indent, text)

    def store(self, indent: int, scope: Scope) -> None:
        """A store, an update in place, or an atomic operation."""
        if scope.element is None:
            name, index = self.pick(*FLOAT_FIELDS), self.index(scope)
        else:
            choices = sorted(scope.own) + sorted(scope.sinks)
            if not choices:
                return
            name = self.pick(*choices)
            index = scope.element if name in scope.own else self.index(scope)
            if name == "s" and name in scope.own:
                return
        target = self.at(name, index)
        if name == "v":
            if self.chance(0.3):
                target, name = f"{target}[{self.rng.randrange(2)}]", "x"
                value = self.squash(self.real(scope))
            else:
                value = f"ti.tanh({self.vector(scope, 2)})"
        elif name == "m":
            value = f"ti.tanh({self.matrix(scope, 2)})"
        else:
            value = self.squash(self.real(scope))
        anywhere = scope.element is not None and target.split("[")[0] in scope.sinks
        self.emit(indent, self.update(scope, name, target, value, anywhere))

    def update(self, scope: Scope, name: str, target: str, value: str, anywhere: bool) -> str:
        scalar = name not in "vm"
        kind = self.rng.randrange(12)
        if kind < 4 or scope.tidy:
            return f"{target} {self.pick('+=', '-=')} {value}"
        if anywhere:  # one kind for each field would be needed besides, so: sums only
            return f"ti.atomic_add({target}, {value})"
        if kind < 8 or not scalar:
            return f"{target} = {value}"
        if kind == 8:
            return f"{target} *= {value}"
        if kind == 9:
            function = self.pick("ti.atomic_max", "ti.atomic_min", "ti.atomic_mul")
            return f"{function}({target}, {value})"
        if kind == 10:
            name = self.name("f")
            scope.floats.append(name)
            return f"{name} = ti.{self.pick('atomic_add', 'atomic_sub')}({target}, {value})"
        return f"{target} = {target} * 0.8 + {value}"

    def branch(self, indent: int, scope: Scope, depth: int) -> None:
        self.emit(indent, f"if {self.condition(scope)}:")
        self.block(indent + 1, scope, depth - 1)
        if self.chance(0.3):
            self.emit(indent, f"elif {self.condition(scope)}:")
            self.block(indent + 1, scope, depth - 1)
        if self.chance(0.5):
            self.emit(indent, "else:")
            self.block(indent + 1, scope, depth - 1)

    def loop(self, indent: int, scope: Scope, depth: int) -> None:
        counter = self.name("j")
        inner = scope.copy()
        inner.in_loop = True
        trips = self.pick(*scope.trips)
        if scope.indices and self.chance(0.4):
            trips = f"k[{self.index(scope)}]"
        head = f"range({trips})"
        kind = self.rng.randrange(6)
        if kind == 0:
            head, inner.in_loop = f"ti.static(range({self.pick('2', '3')}))", False
        elif kind == 1:
            head = f"range(1, {trips})"
        inner.indices.append(counter)
        inner.trips.append(counter)
        self.emit(indent, f"for {counter} in {head}:")
        self.block(indent + 1, inner, depth - 1)

    def while_loop(self, indent: int, scope: Scope, depth: int) -> None:
        counter = self.name("n")
        self.emit(indent, f"{counter} = 0")
        inner = scope.copy()
        inner.in_loop = True
        stop = f" and {self.condition(scope)}" if self.chance(0.5) else ""
        self.emit(indent, f"while {counter} < {self.pick('2', '3', '4')}{stop}:")
        self.emit(indent + 1, f"{counter} += 1")
        inner.indices.append(f"({counter} % N)")
        self.block(indent + 1, inner, depth - 1)

    # Kernels

    def kernel(self, name: str) -> str:
        """Writes a kernel; returns how to call it (with `{t}` for a number)."""
        arguments, call = "", f"{name}()"
        takes = self.chance(0.4)
        if takes:
            arguments, call = "a: ti.f64, t: ti.i32", f"{name}({{a}}, {{t}})"
        self.emit(0, "")
        self.emit(0, "")
        self.emit(0, "@ti.kernel")
        self.emit(0, f"def {name}({arguments}):")
        for _ in range(self.pick(1, 1, 2)):
            self.budget = self.pick(3, 6, 10, 16)
            scope = Scope()
            if takes:
                scope.floats.append("a")
                scope.indices.append("t")
                scope.trips.append("t")
            if not self.tidy and self.chance(0.35):
                self.emit(1, "for _ in range(1):")
                self.block(2, scope, 3, 6)
                self.store(2, scope)
                continue
            index = self.name("i")
            written = [f for f in FLOAT_FIELDS if self.chance(0.3)]
            if self.tidy:
                written = [f for f in written if f not in self.used]
                scope.tidy = True
            for field in written:
                (scope.sinks if self.chance(0.4) or field == "s" else scope.own).add(field)
            scope.element = index
            scope.indices.append(index)
            self.emit(1, f"for {index} in {self.pick('range(N)', 'x')}:")
            self.block(2, scope, 3, 6)
            self.store(2, scope)
            self.emit(2, f"loss[None] += {self.squash(self.real(scope))}")
        return call

    def program(self) -> str:
        calls = [self.kernel(f"kernel{n}") for n in range(self.pick(1, 1, 2, 3))]
        self.emit(0, "")
        self.emit(0, "")
        self.emit(0, "def run():")
        for _ in range(1 if self.tidy else self.pick(1, 2, 3)):
            for call in calls:
                number = self.rng.randrange(4)
                self.emit(1, call.format(a=self.constant(), t=number))
        self.emit(1, "total()")
        return HEADER + "\n".join(self.lines) + "\n"


def resize(text: str, elements: int) -> str:
    """The program with fields of so many elements."""
    return text.replace(f"\nN = {N}\n", f"\nN = {elements}\n", 1)


def is_kinked(seed: int) -> bool:
    """Every third seed is of the other kind."""
    return seed % 3 == 2


def program(seed: int) -> str:
    """The program of a seed."""
    return draw(random.Random(seed), is_kinked(seed))


def draw(rng: random.Random, kinked: bool) -> str:
    """A program whose choices are made by `rng`."""
    return Generator(rng, kinked, tidy=rng.random() < 0.3).program()
