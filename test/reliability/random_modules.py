"""Random valid modules of tai IR, as text, whose results no order of iterations decides.

An iteration of a parallel loop writes to elements of its own, reads what the loop does not write,
and meets others in atomics alone, of one kind for each field, whose old values it does not use.
Sums of floats are of small whole numbers, which every order gets right. What an operation leaves
undefined is kept out: shifts are masked, casts clamped, indices taken modulo their extent.

Results of operations that are not exact (functions of libm, decompositions) go straight into
fields of their own, whose names say how near they must come: `near_…` to some units in the last
place, `loose_…` to a relative error.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

INTS = ("i8", "i16", "i32", "i64")
FLOATS = ("f16", "bf16", "f32", "f64")
WIDTH = {"i1": 1, "i8": 8, "i16": 16, "i32": 32, "i64": 64, "index": 64}
LARGEST = {"f16": 65504.0, "bf16": 3e38, "f32": 3e38, "f64": 1e308}
UNARY_EXACT = ("math.absf", "math.floor", "math.ceil", "math.trunc", "math.round",
               "math.roundeven", "math.sqrt", "arith.negf")  # fmt: skip
UNARY_NEAR = ("math.sin", "math.cos", "math.tan", "math.asin", "math.acos", "math.atan",
              "math.sinh", "math.cosh", "math.tanh", "math.exp", "math.log", "math.log1p",
              "math.expm1", "math.rsqrt", "math.exp2", "math.log2", "math.log10",
              "math.cbrt", "math.erf")  # fmt: skip
INT_BINARY = ("addi", "subi", "muli", "andi", "ori", "xori", "minsi", "maxsi", "minui", "maxui")
DIVISIONS = ("divsi", "divui", "remsi", "remui", "floordivsi", "ceildivsi", "ceildivui")
CMPI = ("eq", "ne", "slt", "sle", "sgt", "sge", "ult", "ule", "ugt", "uge")
CMPF = ("oeq", "ogt", "oge", "olt", "ole", "one", "ord", "ueq", "ugt", "uge", "ult", "ule", "une",
        "uno")  # fmt: skip


@dataclass
class Field:
    name: str
    type: str  # of an element
    shape: tuple[int, ...]
    tree: str
    use: str  # read, write, atomic, near, loose
    offset: tuple[int, ...] = ()
    kind: str = ""  # of atomics
    sparse: int = 0  # how many sparse levels lie above it
    levels: int = 1
    is_list: bool = False


@dataclass
class Module:
    """A module: its text, in parts, and what a launch is given."""

    seed: int
    trees: dict[str, str] = field(default_factory=dict)
    fields: list[Field] = field(default_factory=list)
    arguments: list[tuple[str, float | int]] = field(default_factory=list)
    body: list[str] = field(default_factory=list)
    # Whether a product may become part of a sum, and so change.
    contracts: bool = False

    def declaration(self, f: Field) -> str:
        offset = f", offset [{', '.join(map(str, f.offset))}]" if any(f.offset) else ""
        return f'tai.field @{f.name} = @{f.tree}["{f.name}"] : {f.type}, rank {len(f.shape)}{offset}'

    def kernel(self) -> str:
        arguments = ", ".join(f"%arg{i}: {t}" for i, (t, _) in enumerate(self.arguments))
        return "\n".join([f"tai.kernel @k({arguments}) {{", *self.body, "  tai.return", "}"])

    def text(self) -> str:
        trees = [f"tai.tree @{n} : {t}" for n, t in self.trees.items()]
        return "\n".join([*trees, *map(self.declaration, self.fields), self.kernel()]) + "\n"


def split(type_: str) -> tuple[tuple[int, ...], str]:
    """The shape and the scalar of a type."""
    if not type_.startswith("vector<"):
        return (), type_
    *shape, scalar = type_[7:-1].split("x")
    return tuple(map(int, shape)), scalar


def joined(shape: tuple[int, ...], scalar: str) -> str:
    return f"vector<{'x'.join([*map(str, shape), scalar])}>" if shape else scalar


class Scope:
    """Values that can be used here, by type."""

    def __init__(self, outer: Scope | None = None):
        self.values = {t: list(v) for t, v in outer.values.items()} if outer else {}

    def add(self, name: str, type_: str) -> str:
        self.values.setdefault(type_, []).append(name)
        return name


class Generator:
    """Writes one module. Every choice comes from the seed."""

    def __init__(self, seed: int):
        self.rng = random.Random(f"module {seed}")
        self.module = Module(seed)
        self.count = 0
        self.depth = 2
        self.locals: list[tuple[str, str]] = []
        # In the loop at hand: indices, what may be read, what is written or added to at
        # those indices, and whether iterations come one after another.
        self.ivs: list[str] = []
        self.readable: list[Field] = []
        self.own: list[Field] = []
        self.atomics: list[Field] = []
        self.serial = False
        self.budget = 0

    # Text.

    def fresh(self) -> str:
        self.count += 1
        return f"%v{self.count}"

    def line(self, text: str) -> None:
        self.module.body.append("  " * self.depth + text)

    def op(self, text: str, type_: str, scope: Scope) -> str:
        name = self.fresh()
        self.line(f"{name} = {text}")
        return scope.add(name, type_)

    # Declarations.

    def element_type(self, floats: bool = True) -> str:
        rng = self.rng
        scalar = rng.choice([*INTS, "i32", "i64", *(FLOATS + ("f32", "f64") if floats else ())])
        draw = rng.random()
        if draw < 0.25:
            return joined((rng.choice((2, 3, 4)),), scalar)
        if draw < 0.35:
            return joined((rng.choice((2, 3)), rng.choice((2, 3))), scalar)
        return "i1" if draw < 0.4 else scalar

    def layout(self, shape: tuple[int, ...]) -> tuple[str, tuple[int, ...], int, int, bool]:
        """A layout with `{}` for the places, its shape, its sparse levels, levels, listness."""
        rng = self.rng
        axes = "ij"[: len(shape)]

        def level(kind: str, extents: tuple[int, ...]) -> str:
            text = ", ".join(f"{a}: {n}" for a, n in zip(axes, extents, strict=True))
            return f"{kind}<[{text}], "

        draw = rng.random()
        if draw < 0.45:
            return level("dense", shape) + "{}>", shape, 0, 1, False
        inner = tuple(rng.choice((1, 2, 3, 4, 8)) for _ in shape)
        outer = tuple(max(1, -(-n // m)) for n, m in zip(shape, inner, strict=True))
        shape = tuple(a * b for a, b in zip(outer, inner, strict=True))
        if draw < 0.6:
            text = level("dense", outer) + level("dense", inner) + "{}>>"
            return text, shape, 0, 2, False
        if draw < 0.66 and len(shape) == 1:
            text = f"dense<[j: {rng.choice((1, 3))}], dynamic<[i: {shape[0]}], chunk 4, {{}}>>"
            return text, shape, 1, 2, True
        kind = rng.choice(("pointer", "bitmasked", "hash", "pointer"))
        if draw < 0.9:
            below = rng.choice(("dense", "dense", "bitmasked"))
            text = level(kind, outer) + level(below, inner) + "{}>>"
            return text, shape, 1 + (below == "bitmasked"), 2, False
        text = level("pointer", outer) + level("bitmasked", inner) + level("dense", (1,) * len(shape))
        return text + "{}>>>", shape, 2, 3, False

    def declare(self) -> None:
        rng, module = self.rng, self.module
        integral = rng.random() < 0.4
        self.integral = integral
        rank = rng.choice((1, 1, 1, 2))
        extent = rng.choice((1, 3, 8, 17, 33, 64, 65, 130, 300))
        shape = (extent,) if rank == 1 else (rng.choice((1, 3, 8, 9)), rng.choice((1, 4, 7, 16)))
        self.shape = shape
        uses = {
            "read": rng.randint(1, 3), "write": rng.randint(1, 3), "atomic": rng.randint(0, 2),
            "near": 0 if integral else rng.randint(0, 2), "loose": 0 if integral else rng.randint(0, 1),
        }  # fmt: skip
        fields = []
        for use, count in uses.items():
            for i in range(count):
                type_ = self.element_type(not integral)
                if use in ("near", "loose"):
                    type_ = rng.choice(("f32", "f64") if use == "loose" else ("f32", "f64", "f16"))
                fields.append(Field(f"{use}_{i}", type_, shape, "", use))
        rng.shuffle(fields)
        number = 0
        while fields:
            taken = [fields.pop() for _ in range(min(len(fields), rng.choice((1, 1, 2, 3))))]
            text, grown, sparse, levels, is_list = self.layout(shape)
            if is_list and (rank != 1 or any(f.use != "write" for f in taken)):
                text, grown, sparse, levels, is_list = "dense<[i: %d], {}>" % shape[0], shape, 0, 1, False
                if rank == 2:
                    text = "dense<[i: %d, j: %d], {}>" % shape
            tree = f"t{number}"
            number += 1
            places = ", ".join(f"{f.name}: {f.type}" for f in taken)
            module.trees[tree] = "!tai.root<" + text.replace("{}", "{" + places + "}") + ">"
            for f in taken:
                f.tree, f.sparse, f.levels, f.is_list = tree, sparse, levels, is_list
                f.shape = grown
                if is_list:
                    f.shape = (grown[0], int(text.split("j: ")[1].split("]")[0]))
                if rng.random() < 0.15:
                    f.offset = tuple(rng.randint(-5, 5) for _ in f.shape)
                else:
                    f.offset = (0,) * len(f.shape)
                if f.use == "atomic":
                    scalar = split(f.type)[1]
                    kinds = ["add", "sub", "min", "max"]
                    if scalar in INTS or scalar == "i1":
                        kinds += ["mul", "and", "or", "xor"]
                    f.kind = rng.choice(kinds)
                module.fields.append(f)
        for _ in range(rng.randint(0, 3)):
            type_ = rng.choice([*INTS, "index", *(("f32", "f64") if not integral else ())])
            module.arguments.append((type_, self.number(type_)))

    def number(self, type_: str) -> float | int:
        rng = self.rng
        if type_ == "index":
            return rng.choice((0, 1, 5, 7, -3))
        if type_ in WIDTH:
            width = WIDTH[type_]
            low, high = -(1 << (width - 1)), (1 << (width - 1)) - 1
            if width == 1:
                return rng.choice((0, 1))
            near = rng.randint(-9, 9)
            return rng.choice((0, 1, -1, low, high, near, near, 1 << rng.randint(0, width - 2),
                               rng.randint(low, high)))  # fmt: skip
        return rng.choice((0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, 1e-3, LARGEST[type_] / 4, 100.0,
                           float(rng.randint(-8, 8)), rng.uniform(-4, 4)))  # fmt: skip

    # Values.

    def literal(self, scalar: str) -> str:
        value = self.number(scalar)
        if scalar == "i1":
            return "true" if value else "false"
        if scalar in WIDTH:
            return str(value)
        if self.rng.random() < 0.06:
            bits = {"f16": (0x7E00, 0x7C00, 0xFC00, 1), "bf16": (0x7FC0, 0x7F80, 0xFF80, 1),
                    "f32": (0x7FC00000, 0x7F800000, 0xFF800000, 1),
                    "f64": (0x7FF8 << 48, 0x7FF << 52, 0xFFF << 52, 1)}[scalar]  # fmt: skip
            return hex(self.rng.choice(bits)).upper().replace("X", "x")
        return format(value, ".17e")

    def constant(self, type_: str, scope: Scope, text: str | None = None) -> str:
        shape, scalar = split(type_)
        value = text or self.literal(scalar)
        if shape:
            return self.op(f"arith.constant dense<{value}> : {type_}", type_, scope)
        if scalar == "i1":
            return self.op(f"arith.constant {value}", type_, scope)
        return self.op(f"arith.constant {value} : {scalar}", type_, scope)

    def value(self, type_: str, scope: Scope, effort: int = 2) -> str:
        """Some value of the type."""
        known = scope.values.get(type_, [])
        if known and (effort <= 0 or self.budget <= 0 or self.rng.random() < 0.45):
            # What was made last is most interesting.
            return known[-1 - min(int(self.rng.expovariate(0.4)), len(known) - 1)]
        if effort <= 0 or self.budget <= 0:
            return self.constant(type_, scope)
        self.budget -= 1
        shape, scalar = split(type_)
        if shape:
            return self.vector_value(shape, scalar, scope, effort)
        if scalar == "index":
            return self.index_value(scope, effort)
        if scalar == "i1":
            return self.truth(scope, effort)
        if scalar in INTS:
            return self.integer(scalar, scope, effort)
        return self.float(scalar, scope, effort)

    def index_value(self, scope: Scope, effort: int) -> str:
        source = self.rng.choice(INTS)
        value = self.value(source, scope, effort - 1)
        name = self.rng.choice(("index_cast", "index_castui"))
        return self.op(f"arith.{name} {value} : {source} to index", "index", scope)

    def truth(self, scope: Scope, effort: int) -> str:
        rng = self.rng
        draw = rng.random()
        if draw < 0.2:
            a, b = (self.value("i1", scope, effort - 1) for _ in "ab")
            return self.op(f"arith.{rng.choice(('andi', 'ori', 'xori'))} {a}, {b} : i1", "i1", scope)
        if draw < 0.6 or self.integral:
            type_ = rng.choice([*INTS, "index"])
            a, b = (self.value(type_, scope, effort - 1) for _ in "ab")
            return self.op(f"arith.cmpi {rng.choice(CMPI)}, {a}, {b} : {type_}", "i1", scope)
        type_ = rng.choice(FLOATS)
        a = self.value(type_, scope, effort - 1)
        if draw < 0.75:
            name = rng.choice(("isnan", "isinf", "isfinite"))
            return self.op(f"math.{name} {a} : {type_}", "i1", scope)
        b = self.value(type_, scope, effort - 1)
        return self.op(f"arith.cmpf {rng.choice(CMPF)}, {a}, {b} : {type_}", "i1", scope)

    def masked(self, type_: str, scope: Scope, effort: int) -> str:
        """A number of bits that the type has."""
        scalar = split(type_)[1]
        amount = self.value(type_, scope, effort - 1)
        mask = self.constant(type_, scope, str(WIDTH[scalar] - 1))
        return self.op(f"arith.andi {amount}, {mask} : {type_}", type_, scope)

    def integer(self, scalar: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        draw = rng.random()
        if draw < 0.12 and self.readable:
            found = self.loaded(scalar, scope, effort)
            if found:
                return found
        if draw < 0.24:
            return self.cast_to_integer(scalar, scope, effort)
        if draw < 0.3:
            a = self.value(scalar, scope, effort - 1)
            name = rng.choice(("math.absi", "math.ctpop", "math.ctlz", "math.cttz"))
            return self.op(f"{name} {a} : {scalar}", scalar, scope)
        if draw < 0.38:
            return self.select(scalar, scope, effort)
        return self.integer_binary(scalar, scope, effort)

    def integer_binary(self, type_: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        a = self.value(type_, scope, effort - 1)
        if rng.random() < 0.2:
            b = self.masked(type_, scope, effort)
            name = rng.choice(("shli", "shrsi", "shrui"))
        else:
            b = self.value(type_, scope, effort - 1)
            name = rng.choice((*INT_BINARY, *INT_BINARY, *DIVISIONS))
            if name in DIVISIONS and rng.random() < 0.6:
                odd = self.constant(type_, Scope(), "1")
                b = self.op(f"arith.ori {b}, {odd} : {type_}", type_, Scope())
        return self.op(f"arith.{name} {a}, {b} : {type_}", type_, scope)

    def cast_to_integer(self, scalar: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        width = WIDTH[scalar]
        draw = rng.random()
        if draw < 0.3 and not self.integral:
            source = rng.choice(FLOATS)
            a = self.value(source, scope, effort - 1)
            signed = rng.random() < 0.7
            high = min(2.0 ** (width - 1 - signed), LARGEST[source] / 2)
            low = self.constant(source, scope, format(-high if signed else 0.0, ".17e"))
            high_ = self.constant(source, scope, format(high, ".17e"))
            a = self.op(f"arith.maxnumf {a}, {low} : {source}", source, scope)
            a = self.op(f"arith.minnumf {a}, {high_} : {source}", source, scope)
            name = "fptosi" if signed else "fptoui"
            return self.op(f"arith.{name} {a} : {source} to {scalar}", scalar, scope)
        same = {"i16": ("f16", "bf16"), "i32": ("f32",), "i64": ("f64",)}.get(scalar)
        if draw < 0.4 and same and not self.integral:
            source = rng.choice(same)
            a = self.number_of(source, scope, effort)
            return self.op(f"arith.bitcast {a} : {source} to {scalar}", scalar, scope)
        source = rng.choice([t for t in (*INTS, "i1", "index") if t != scalar])
        a = self.value(source, scope, effort - 1)
        if source == "index":
            name = rng.choice(("index_cast", "index_castui"))
        elif WIDTH[source] > width:
            name = "trunci"
        else:
            name = rng.choice(("extsi", "extui"))
        return self.op(f"arith.{name} {a} : {source} to {scalar}", scalar, scope)

    def number_of(self, scalar: str, scope: Scope, effort: int) -> str:
        """A float that is a number: the bits and the sign of others are not said."""
        a = self.value(scalar, scope, effort - 1)
        zero = self.constant(scalar, scope, "0.0")
        holds = self.op(f"arith.cmpf ord, {a}, {a} : {scalar}", "i1", scope)
        return self.op(f"arith.select {holds}, {a}, {zero} : {scalar}", scalar, scope)

    def select(self, type_: str, scope: Scope, effort: int) -> str:
        condition = self.value("i1", scope, effort - 1)
        a, b = (self.value(type_, scope, effort - 1) for _ in "ab")
        return self.op(f"arith.select {condition}, {a}, {b} : {type_}", type_, scope)

    def float(self, scalar: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        draw = rng.random()
        if draw < 0.14 and self.readable:
            found = self.loaded(scalar, scope, effort)
            if found:
                return found
        if draw < 0.26:
            source = rng.choice([*INTS, *(t for t in FLOATS if t != scalar)])
            if {source, scalar} == {"f16", "bf16"}:
                source = "f32"
            a = self.value(source, scope, effort - 1)
            if source in INTS:
                name = rng.choice(("sitofp", "uitofp"))
            else:
                order = {"f16": 16, "bf16": 16, "f32": 32, "f64": 64}
                name = "extf" if order[source] < order[scalar] else "truncf"
            return self.op(f"arith.{name} {a} : {source} to {scalar}", scalar, scope)
        if draw < 0.32:
            same = {"f16": "i16", "bf16": "i16", "f32": "i32", "f64": "i64"}[scalar]
            a = self.value(same, scope, effort - 1)
            return self.op(f"arith.bitcast {a} : {same} to {scalar}", scalar, scope)
        if draw < 0.4:
            return self.select(scalar, scope, effort)
        return self.float_operation(scalar, scope, effort)

    def float_operation(self, type_: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        shape, scalar = split(type_)
        a = self.value(type_, scope, effort - 1)
        draw = rng.random()
        if draw < 0.2:
            return self.op(f"{rng.choice(UNARY_EXACT)} {a} : {type_}", type_, scope)
        if draw < 0.26 and not shape:
            b = self.number_of(scalar, scope, effort)
            return self.op(f"math.copysign {a}, {b} : {type_}", type_, scope)
        if draw < 0.36:
            # Which zero comes out of two is not said.
            b = self.value(type_, scope, effort - 1)
            name = rng.choice(("maxnumf", "minnumf"))
            a = self.op(f"arith.{name} {a}, {b} : {type_}", type_, Scope())
            zero = self.constant(type_, scope, "0.0")
            return self.op(f"arith.addf {a}, {zero} : {type_}", type_, scope)
        b = self.value(type_, scope, effort - 1)
        if draw < 0.42 and scalar in ("f32", "f64"):
            c = self.value(type_, scope, effort - 1)
            return self.op(f"math.fma {a}, {b}, {c} : {type_}", type_, scope)
        name = rng.choice(("addf", "subf", "mulf", "divf", "maximumf", "minimumf",
                           "addf", "mulf", "remf"))  # fmt: skip
        self.module.contracts |= name == "mulf"
        return self.op(f"arith.{name} {a}, {b} : {type_}", type_, scope)

    def vector_value(self, shape: tuple[int, ...], scalar: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        type_ = joined(shape, scalar)
        draw = rng.random()
        if draw < 0.2 and self.readable:
            found = self.loaded(type_, scope, effort)
            if found:
                return found
        if draw < 0.3:
            a = self.value(scalar, scope, effort - 1)
            return self.op(f"vector.broadcast {a} : {scalar} to {type_}", type_, scope)
        if draw < 0.4:
            count = shape[0] * (shape[1] if len(shape) == 2 else 1)
            parts = [self.value(scalar, scope, effort - 1) for _ in range(count)]
            return self.op(f"vector.from_elements {', '.join(parts)} : {type_}", type_, scope)
        if draw < 0.5:
            into, a = self.value(type_, scope, effort - 1), self.value(scalar, scope, effort - 1)
            at = ", ".join(self.position(n, scope, effort) for n in shape)
            return self.op(f"vector.insert {a}, {into} [{at}] : {scalar} into {type_}", type_, scope)
        if draw < 0.55 or scalar == "i1":
            return self.select(type_, scope, effort)
        if draw < 0.75 and (len(shape) == 2 or shape == (3,)) and scalar != "i1":
            return self.algebra(shape, scalar, scope, effort)
        if scalar in INTS:
            return self.integer_binary(type_, scope, effort)
        return self.float_operation(type_, scope, effort)

    def position(self, extent: int, scope: Scope, effort: int) -> str:
        """A component: a number, or an index that is computed."""
        if self.rng.random() < 0.6:
            return str(self.rng.randrange(extent))
        return self.in_range(extent, 0, scope, effort)

    def algebra(self, shape: tuple[int, ...], scalar: str, scope: Scope, effort: int) -> str:
        rng = self.rng
        type_ = joined(shape, scalar)
        self.module.contracts |= scalar in FLOATS
        if len(shape) == 1:
            a, b = (self.value(type_, scope, effort - 1) for _ in "ab")
            return self.op(f"tai.cross {a}, {b} : {type_}", type_, scope)
        n, m = shape
        draw = rng.random()
        if draw < 0.3:
            other = joined((m, n), scalar)
            a = self.value(other, scope, effort - 1)
            return self.op(f"tai.transpose {a} : {other} -> {type_}", type_, scope)
        if draw < 0.6:
            left, right = joined((n,), scalar), joined((m,), scalar)
            name = "tai.outer"
        else:
            inner = rng.choice((2, 3))
            left, right = joined((n, inner), scalar), joined((inner, m), scalar)
            name = "tai.matmul"
        a, b = self.value(left, scope, effort - 1), self.value(right, scope, effort - 1)
        return self.op(f"{name} {a}, {b} : ({left}, {right}) -> {type_}", type_, scope)

    def reduced(self, scalar: str, scope: Scope) -> str:
        """A number made from a vector."""
        rng = self.rng
        shape = rng.choice(((2,), (3,), (4,), (2, 2), (2, 3), (3, 3)))
        type_ = joined(shape, scalar)
        a = self.value(type_, scope, 1)
        draw = rng.random()
        if draw < 0.4:
            at = ", ".join(self.position(n, scope, 1) for n in shape)
            return self.op(f"vector.extract {a}[{at}] : {scalar} from {type_}", scalar, scope)
        if draw < 0.6 or scalar == "i1":
            return self.op(f"vector.extract {a}[{', '.join('0' for _ in shape)}] : {scalar} from {type_}",
                           scalar, scope)  # fmt: skip
        self.module.contracts |= scalar in FLOATS
        if draw < 0.75 and shape in ((2, 2), (3, 3)):
            return self.op(f"tai.trace {a} : {type_}", scalar, scope)
        if draw < 0.85:
            return self.op(f"tai.sum {a} : {type_}", scalar, scope)
        b = self.value(type_, scope, 1)
        return self.op(f"tai.dot {a}, {b} : {type_}", scalar, scope)

    # Fields.

    def in_range(self, extent: int, first: int, scope: Scope, effort: int) -> str:
        """Some index of a dimension."""
        value = self.value("index", scope, effort - 1)
        size = self.constant("index", Scope(), str(extent))
        index = self.op(f"arith.remui {value}, {size} : index", "index", Scope())
        return self.shifted(index, first, scope)

    def shifted(self, index: str, first: int, scope: Scope) -> str:
        if first == 0:
            return index
        offset = self.constant("index", Scope(), str(first))
        return self.op(f"arith.addi {index}, {offset} : index", "index", Scope())

    def own_indices(self, f: Field, scope: Scope) -> str:
        ivs = list(self.ivs) + ["%c0"] * (len(f.shape) - len(self.ivs))
        return ", ".join(self.shifted(i, o, scope) for i, o in zip(ivs, f.offset, strict=True))

    def indices(self, f: Field, scope: Scope, effort: int) -> str:
        if self.ivs and self.rng.random() < 0.5:
            return self.own_indices(f, scope)
        pairs = zip(f.shape, f.offset, strict=True)
        return ", ".join(self.in_range(n, o, scope, effort) for n, o in pairs)

    def loaded(self, type_: str, scope: Scope, effort: int) -> str | None:
        rng = self.rng
        exact = [f for f in self.readable if f.use not in ("near", "loose")]
        mine = [f for f in self.own if f.type == type_]
        if mine and rng.random() < 0.3:
            f = rng.choice(mine)
            at = self.own_indices(f, scope)
            return self.op(f"tai.load @{f.name}[{at}] : {type_}", type_, scope)
        whole = [f for f in exact if f.type == type_]
        parts = [f for f in exact if split(f.type)[0] and split(f.type)[1] == type_]
        if parts and (not whole or rng.random() < 0.4):
            f = rng.choice(parts)
            at = self.indices(f, scope, effort)
            component = ", ".join(
                self.in_range(n, 0, scope, effort) if rng.random() < 0.5
                else self.constant("index", Scope(), str(rng.randrange(n)))
                for n in split(f.type)[0]
            )  # fmt: skip
            text = f"tai.load @{f.name}[{at}] component [{component}] : {type_}"
            return self.op(text, type_, scope)
        if not whole:
            return None
        f = rng.choice(whole)
        return self.op(f"tai.load @{f.name}[{self.indices(f, scope, effort)}] : {type_}", type_, scope)

    # Statements.

    def statement(self, scope: Scope, nesting: int) -> None:
        rng = self.rng
        draw = rng.random()
        if draw < 0.12 and nesting > 0:
            return self.branch(scope, nesting)
        if draw < 0.24 and nesting > 0:
            return self.counted_loop(scope, nesting)
        if draw < 0.32 and nesting > 0:
            return self.conditional_loop(scope, nesting)
        if draw < 0.42:
            return self.local(scope)
        if draw < 0.6 and self.own:
            return self.store(scope)
        if draw < 0.75 and self.atomics:
            return self.atomic(scope)
        if draw < 0.82 and self.near:
            return self.inexact(scope)
        if draw < 0.87:
            scalar = rng.choice([*INTS, *(() if self.integral else FLOATS)])
            self.reduced(scalar, scope)
            return None
        changed = {f.tree for f in (*self.own, *self.atomics, *self.near)}
        asked = [f for f in self.readable if f.sparse and f.tree not in changed]
        if draw < 0.9 and asked:
            f = rng.choice(asked)
            level = rng.randint(1, f.levels)
            self.op(f"tai.is_active @{f.name}[{self.indices(f, scope, 1)}] level {level}", "i1", scope)
            return None
        self.value(self.any_type(scope), scope, 3)
        return None

    def any_type(self, scope: Scope) -> str:
        names = [*INTS, "i1", "index", *(() if self.integral else FLOATS)]
        names += [t for t in scope.values if split(t)[0]]
        return self.rng.choice(names)

    def block(self, scope: Scope, nesting: int, most: int = 4) -> None:
        self.depth += 1
        for _ in range(self.rng.randint(0, most)):
            if self.budget > 0:
                self.statement(scope, nesting)
        self.depth -= 1

    def carried_types(self, scope: Scope, most: int = 2) -> list[str]:
        return [self.any_type(scope) for _ in range(self.rng.randint(0, most))]

    def yielded(self, types: list[str], scope: Scope, keyword: str = "scf.yield") -> None:
        self.depth += 1
        values = [self.value(t, scope, 2) for t in types]
        if types:
            self.line(f"{keyword} {', '.join(values)} : {', '.join(types)}")
        else:
            self.line("scf.yield")
        self.depth -= 1

    def results(self, types: list[str]) -> tuple[str, list[str]]:
        if not types:
            return "", []
        name = self.fresh()
        if len(types) == 1:
            return f"{name} = ", [name]
        return f"{name}:{len(types)} = ", [f"{name}#{i}" for i in range(len(types))]

    def branch(self, scope: Scope, nesting: int) -> None:
        condition = self.value("i1", scope)
        types = self.carried_types(scope)
        head, names = self.results(types)
        arrow = f" -> ({', '.join(types)})" if types else ""
        self.line(f"{head}scf.if {condition}{arrow} {{")
        inner = Scope(scope)
        self.block(inner, nesting - 1)
        self.yielded(types, inner)
        if types or self.rng.random() < 0.5:
            self.line("} else {")
            inner = Scope(scope)
            self.block(inner, nesting - 1)
            self.yielded(types, inner)
        self.line("}")
        for name, type_ in zip(names, types, strict=True):
            scope.add(name, type_)

    def counted_loop(self, scope: Scope, nesting: int) -> None:
        rng = self.rng
        counter = rng.choice(("index", "index", "i32", "i64"))
        low = self.constant(counter, Scope(), str(rng.randint(-2, 3)))
        if rng.random() < 0.5:
            value = self.value(counter, scope)
            size = self.constant(counter, Scope(), str(rng.choice((2, 3, 5))))
            high = self.op(f"arith.remui {value}, {size} : {counter}", counter, Scope())
        else:
            high = self.constant(counter, Scope(), str(rng.randint(0, 6)))
        step = self.constant(counter, Scope(), str(rng.choice((1, 1, 2, 3))))
        types = self.carried_types(scope)
        initial = [self.value(t, scope) for t in types]
        head, names = self.results(types)
        inner = Scope(scope)
        iv = inner.add(self.fresh(), counter)
        carried = [inner.add(self.fresh(), t) for t in types]
        args = ""
        if types:
            pairs = ", ".join(f"{c} = {i}" for c, i in zip(carried, initial, strict=True))
            args = f" iter_args({pairs}) -> ({', '.join(types)})"
        suffix = "" if counter == "index" else f" : {counter}"
        self.line(f"{head}scf.for {iv} = {low} to {high} step {step}{args}{suffix} {{")
        self.block(inner, nesting - 1)
        self.yielded(types, inner)
        self.line("}")
        for name, type_ in zip(names, types, strict=True):
            scope.add(name, type_)

    def conditional_loop(self, scope: Scope, nesting: int) -> None:
        """A loop with a condition, which ends after some iterations whatever it says."""
        types = ["i32", *self.carried_types(scope)]
        zero = self.constant("i32", Scope(), "0")
        initial = [zero, *(self.value(t, scope) for t in types[1:])]
        head, names = self.results(types)
        outer = Scope(scope)
        before = [outer.add(self.fresh(), t) for t in types]
        pairs = ", ".join(f"{c} = {i}" for c, i in zip(before, initial, strict=True))
        listed = ", ".join(types)
        self.line(f"{head}scf.while ({pairs}) : ({listed}) -> ({listed}) {{")
        self.block(outer, 0, 2)
        self.depth += 1
        most = self.constant("i32", Scope(), str(self.rng.randint(0, 5)))
        first = self.op(f"arith.cmpi slt, {before[0]}, {most} : i32", "i1", Scope())
        wanted = self.value("i1", outer)
        both = self.op(f"arith.andi {first}, {wanted} : i1", "i1", Scope())
        passed = [before[0], *(self.value(t, outer, 1) for t in types[1:])]
        self.line(f"scf.condition({both}) {', '.join(passed)} : {listed}")
        self.depth -= 1
        self.line("} do {")
        inner = Scope(scope)
        after = [inner.add(self.fresh(), t) for t in types]
        args = ", ".join(f"{a}: {t}" for a, t in zip(after, types, strict=True))
        self.line(f"^bb0({args}):")
        self.block(inner, nesting - 1, 2)
        self.depth += 1
        one = self.constant("i32", Scope(), "1")
        more = self.op(f"arith.addi {after[0]}, {one} : i32", "i32", Scope())
        values = [more, *(self.value(t, inner, 2) for t in types[1:])]
        self.line(f"scf.yield {', '.join(values)} : {listed}")
        self.depth -= 1
        self.line("}")
        for name, type_ in zip(names, types, strict=True):
            scope.add(name, type_)

    def local(self, scope: Scope) -> None:
        """Reads or writes a variable of this iteration."""
        if not self.locals:
            return
        name, type_ = self.rng.choice(self.locals)
        if self.rng.random() < 0.5:
            self.op(f"tai.local_load {name} : {type_}", type_, scope)
        else:
            self.line(f"tai.local_store {self.value(type_, scope)}, {name} : {type_}")

    def store(self, scope: Scope) -> None:
        rng = self.rng
        f = rng.choice(self.own)
        shape, scalar = split(f.type)
        if shape and rng.random() < 0.4:
            value = self.value(scalar, scope)
            component = ", ".join(
                self.in_range(n, 0, scope, 1) if rng.random() < 0.5
                else self.constant("index", Scope(), str(rng.randrange(n)))
                for n in shape
            )  # fmt: skip
            at = self.own_indices(f, scope)
            self.line(f"tai.store {value}, @{f.name}[{at}] component [{component}] : {scalar}")
            return
        value = self.value(f.type, scope, 3)
        self.line(f"tai.store {value}, @{f.name}[{self.own_indices(f, scope)}] : {f.type}")

    def atomic(self, scope: Scope) -> None:
        rng = self.rng
        f = rng.choice(self.atomics)
        shape, scalar = split(f.type)
        component = ""
        type_ = f.type
        if shape and rng.random() < 0.4:
            component = f" component [{', '.join(self.in_range(n, 0, scope, 1) for n in shape)}]"
            type_ = scalar
        if scalar in FLOATS and f.kind in ("add", "sub"):
            value = self.small(type_, scope)
        else:
            value = self.value(type_, scope)
        name = self.fresh()
        at = self.indices(f, scope, 1)
        self.line(f"{name} = tai.atomic {f.kind} {value}, @{f.name}[{at}]{component} : {type_}")
        if self.serial:
            scope.add(name, type_)

    def small(self, type_: str, scope: Scope) -> str:
        """A whole number from -1 to 1, as a float."""
        shape, scalar = split(type_)
        value = self.value("i32", scope, 1)
        two = self.constant("i32", Scope(), "2")
        value = self.op(f"arith.remsi {value}, {two} : i32", "i32", Scope())
        value = self.op(f"arith.sitofp {value} : i32 to {scalar}", scalar, Scope())
        if shape:
            value = self.op(f"vector.broadcast {value} : {scalar} to {type_}", type_, Scope())
        return value

    def inexact(self, scope: Scope) -> None:
        rng = self.rng
        f = rng.choice(self.near)
        at = self.own_indices(f, scope)
        if f.use == "near":
            a = self.value(f.type, scope)
            if rng.random() < 0.2:
                b = self.value(f.type, scope)
                name = rng.choice(("math.atan2", "math.powf"))
                value = self.op(f"{name} {a}, {b} : {f.type}", f.type, Scope())
            else:
                value = self.op(f"{rng.choice(UNARY_NEAR)} {a} : {f.type}", f.type, Scope())
        else:
            value = self.decomposed(f.type, scope)
        self.line(f"tai.store {value}, @{f.name}[{at}] : {f.type}")

    def decomposed(self, scalar: str, scope: Scope) -> str:
        """A number from the algebra of a matrix that is far from singular."""
        rng = self.rng
        n = rng.choice((2, 3))
        matrix, vector = joined((n, n), scalar), joined((n,), scalar)
        none = Scope()
        parts = []
        for i in range(n * n):
            part = self.small(scalar, scope)
            half = self.constant(scalar, none, "0.5")
            part = self.op(f"arith.mulf {part}, {half} : {scalar}", scalar, none)
            if i % (n + 1) == 0:
                four = self.constant(scalar, none, f"{3 + i // (n + 1)}.0")
                part = self.op(f"arith.addf {part}, {four} : {scalar}", scalar, none)
            parts.append(part)
        a = self.op(f"vector.from_elements {', '.join(parts)} : {matrix}", matrix, none)
        draw = rng.randrange(5)
        at = ", ".join(str(rng.randrange(n)) for _ in "ab")
        if draw == 0:
            return self.op(f"tai.determinant {a} : {matrix}", scalar, none)
        if draw == 1:
            return self.op(f"tai.norm {a} : {matrix}", scalar, none)
        if draw == 2:
            a = self.op(f"tai.inverse {a} : {matrix}", matrix, none)
        elif draw == 3:
            pair = self.fresh()
            self.line(f"{pair}:2 = tai.polar {a} : {matrix}")
            a = f"{pair}#{rng.randrange(2)}"
        else:
            b = self.op(f"vector.from_elements {', '.join(parts[:n])} : {vector}", vector, none)
            x = self.op(f"tai.solve {a}, {b} : {matrix}, {vector}", vector, none)
            return self.op(f"vector.extract {x}[{at[0]}] : {scalar} from {vector}", scalar, none)
        return self.op(f"vector.extract {a}[{at}] : {scalar} from {matrix}", scalar, none)

    # Loops over everything.

    def top_level_loop(self, scope: Scope) -> None:
        rng, module = self.rng, self.module
        self.serial = rng.random() < 0.2
        dense = [f for f in module.fields if not f.is_list]
        written = [f for f in dense if f.use == "write" and rng.random() < 0.7]
        self.atomics = [f for f in module.fields if f.use == "atomic" and rng.random() < 0.8]
        self.near = [f for f in dense if f.use in ("near", "loose")]
        self.own = written
        self.readable = [
            f for f in dense
            if f.use not in ("near", "loose") and f not in written and f not in self.atomics
        ]  # fmt: skip
        outer = Scope(scope)
        self.ivs = [self.fresh() for _ in self.shape]
        names = ", ".join(self.ivs)
        over = [f for f in dense if f.shape == self.shape or f.sparse]
        serial = " serialize" if self.serial else ""
        if over and rng.random() < 0.4:
            f = rng.choice(over)
            level = ""
            if f.levels > 1 and rng.random() < 0.15:
                level = f" level {rng.randint(1, f.levels)}"
            shifted = [self.fresh() for _ in self.ivs] if any(f.offset) else self.ivs
            self.line(f"tai.parallel_for ({', '.join(shifted)}) in @{f.name}{level}{serial} {{")
            for a, b, first in zip(self.ivs, shifted, f.offset, strict=True):
                if a != b:
                    minus = self.constant("index", Scope(), str(first))
                    self.line(f"{a} = arith.subi {b}, {minus} : index")
            # Elements beyond the smallest field: layouts are rounded up to whole blocks.
            self.guarded = f.shape != self.shape
        else:
            lower = ", ".join("%c0" for _ in self.shape)
            sizes = [self.constant("index", Scope(), str(n)) for n in self.shape]
            if rng.random() < 0.2 and scope.values.get("i32"):
                value = self.value("index", scope, 1)
                size = self.constant("index", Scope(), str(self.shape[0] + 1))
                sizes[0] = self.op(f"arith.remui {value}, {size} : index", "index", Scope())
            self.line(f"tai.parallel_for ({names}) = ({lower}) to ({', '.join(sizes)}){serial} {{")
            self.guarded = False
        self.depth += 1
        for iv in self.ivs:
            outer.add(iv, "index")
        if self.guarded:
            inside = None
            for iv, n in zip(self.ivs, self.shape, strict=True):
                size = self.constant("index", Scope(), str(n))
                holds = self.op(f"arith.cmpi ult, {iv}, {size} : index", "i1", Scope())
                inside = holds if inside is None else self.op(
                    f"arith.andi {inside}, {holds} : i1", "i1", Scope())  # fmt: skip
            self.line(f"scf.if {inside} {{")
            self.depth += 1
        self.locals = []
        for _ in range(rng.randint(0, 2)):
            type_ = self.any_type(outer)
            if type_ == "index":
                continue
            name = self.fresh()
            self.line(f"{name} = tai.alloca : !tai.local<{type_}>")
            self.locals.append((name, type_))
        for f in self.readable[:2]:
            at = self.indices(f, outer, 1)
            self.op(f"tai.load @{f.name}[{at}] : {f.type}", f.type, outer)
        self.budget = rng.choice((6, 15, 30, 50))
        for _ in range(rng.randint(2, 8)):
            if self.budget > 0:
                self.statement(outer, 2)
        if self.own:
            self.store(outer)
        if self.guarded:
            self.depth -= 1
            self.line("}")
        self.depth -= 1
        self.line("}")
        self.locals = []
        self.ivs = []

    def topology_loop(self, scope: Scope) -> None:
        """Makes cells active or inactive, or appends to lists, and does nothing else."""
        rng = self.rng
        sparse = [f for f in self.module.fields if f.sparse]
        if not sparse:
            return
        f = rng.choice(sparse)
        i = self.fresh()
        size = self.constant("index", Scope(), str(rng.choice((1, 2, f.shape[0]))))
        serial = " serialize" if f.is_list else ""
        self.line(f"tai.parallel_for ({i}) = (%c0) to ({size}){serial} {{")
        self.depth += 1
        inner = Scope(scope)
        inner.add(i, "index")
        self.ivs, self.readable, self.own = [], [], []
        self.budget = 5
        if f.is_list:
            list_ = self.in_range(f.shape[1], f.offset[1], inner, 1)
            if rng.random() < 0.6:
                length = self.op(f"tai.length @{f.name}[{list_}]", "index", inner)
                most = self.constant("index", Scope(), str(f.shape[0]))
                room = self.op(f"arith.cmpi slt, {length}, {most} : index", "i1", inner)
                self.line(f"scf.if {room} {{")
                value = self.value(f.type, Scope(inner), 2)
                at = self.fresh()
                self.line(f"{at} = tai.append {value}, @{f.name}[{list_}] : {f.type}")
                self.line("}")
                self.depth -= 1
                self.line("}")
                return
        at = ", ".join(self.in_range(n, o, inner, 1) for n, o in zip(f.shape, f.offset, strict=True))
        name = "deactivate" if f.is_list else rng.choice(("activate", "deactivate"))
        self.line(f"tai.{name} @{f.name}[{at}] level {rng.randint(1, f.levels)}")
        self.depth -= 1
        self.line("}")

    def make(self) -> Module:
        self.declare()
        rng = self.rng
        scope = Scope()
        self.line("%c0 = arith.constant 0 : index")
        self.near = []
        for i, (type_, _) in enumerate(self.module.arguments):
            scope.add(f"%arg{i}", type_)
        self.budget = 6
        for _ in range(rng.randint(0, 3)):
            self.value(self.any_type(scope), scope)
        for _ in range(rng.choice((1, 1, 2, 3))):
            if rng.random() < 0.2:
                self.topology_loop(scope)
            self.top_level_loop(scope)
        return self.module


def make(seed: int) -> Module:
    return Generator(seed).make()


if __name__ == "__main__":
    import sys

    print(make(int(sys.argv[1])).text())
