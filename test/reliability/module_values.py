"""Expressions of random modules: every operation on numbers, vectors and matrices."""

from __future__ import annotations

import random

from module_text import (
    CMPF,
    CMPI,
    DIVISIONS,
    FLOATS,
    INT_BINARY,
    INTS,
    LARGEST,
    UNARY_EXACT,
    WIDTH,
    Field,
    Module,
    Scope,
    joined,
    split,
)


class Values:
    """Writes operations whose result is a value of some type. Every choice comes from the seed."""

    def __init__(self, seed: int):
        self.rng = random.Random(f"module {seed}")
        self.module = Module(seed)
        self.count = 0
        self.depth = 2
        self.locals: list[tuple[str, str]] = []
        # State of the current loop: indices, fields that may be read, fields that are written or
        # added to at those indices, and whether iterations come one after another.
        self.ivs: list[str] = []
        self.readable: list[Field] = []
        self.own: list[Field] = []
        self.atomics: list[Field] = []
        self.serial = False
        self.budget = 0
        # How often, at most, an iteration of the loop at hand comes to this place.
        self.inner_times = 1

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
            # The latest values are the most interesting ones.
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
            return self.op(
                f"arith.{rng.choice(('andi', 'ori', 'xori'))} {a}, {b} : i1", "i1", scope
            )
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
            # The choice between two zeros is not specified.
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
            return self.op(
                f"vector.insert {a}, {into} [{at}] : {scalar} into {type_}", type_, scope
            )
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
            at = ", ".join("0" for _ in shape)
            return self.op(f"vector.extract {a}[{at}] : {scalar} from {type_}", scalar, scope)
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
        return self.op(
            f"tai.load @{f.name}[{self.indices(f, scope, effort)}] : {type_}", type_, scope
        )
