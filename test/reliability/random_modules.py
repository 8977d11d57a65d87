"""Random valid modules of tai IR, as text, whose results no order of iterations decides.

An iteration of a parallel loop writes to elements of its own, reads fields that the loop does not
write, and meets others in atomics alone, of one kind for each field, whose old values it does not
use. Sums of floats are of small whole numbers, which every order gets right, and of so few that
none leaves the whole numbers its type holds: a sum may be kept in a wider float. Operations with
undefined results are kept out: shifts are masked, casts clamped, indices taken modulo their extent.

Results of operations that are not exact (functions of libm, decompositions) go straight into
fields of their own, whose names say how near they must come: `near_…` to some units in the last
place, `loose_…` to a relative error.
"""

from __future__ import annotations

import math

from module_text import (
    FLOATS,
    INTS,
    UNARY_NEAR,
    Field,
    Module,
    Scope,
    joined,
    split,
)
from module_values import Values

# Up to here a float holds every whole number, less the one that a field holds before. The limits of
# f32 and f64 are beyond the sums of a module.
EXACT = {"bf16": 255, "f16": 2047}


class Generator(Values):
    """Writes one module: its declarations, and loops over its fields."""

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
        text = (
            level("pointer", outer) + level("bitmasked", inner) + level("dense", (1,) * len(shape))
        )
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
            "near": 0 if integral else rng.randint(0, 2),
            "loose": 0 if integral else rng.randint(0, 1),
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
                text, grown, sparse, levels, is_list = (
                    f"dense<[i: {shape[0]}], {{}}>",
                    shape,
                    0,
                    1,
                    False,
                )
                if rank == 2:
                    text = f"dense<[i: {shape[0]}, j: {shape[1]}], {{}}>"
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
            self.op(
                f"tai.is_active @{f.name}[{self.indices(f, scope, 1)}] level {level}", "i1", scope
            )
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
        # From -2 to 6.
        self.inner_times *= 8
        self.block(inner, nesting - 1)
        self.yielded(types, inner)
        self.inner_times //= 8
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
        # The condition holds five times at most.
        self.inner_times *= 6
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
        self.inner_times //= 6
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
            value = self.small(type_, scope, among=f)
        else:
            value = self.value(type_, scope)
        name = self.fresh()
        at = self.indices(f, scope, 1)
        self.line(f"{name} = tai.atomic {f.kind} {value}, @{f.name}[{at}]{component} : {type_}")
        if self.serial:
            scope.add(name, type_)

    def among_first(self, value: str, scalar: str, f: Field) -> str:
        """The number in as many iterations as keep the sums of the field exact; zero in others."""
        times = max(self.inner_times * math.prod(self.shape[1:]), 1)
        room = max(EXACT[scalar] - f.added, 0)
        first = min(room // times, self.shape[0])
        f.added += first * times
        none = Scope()
        zero = self.constant(scalar, none, "0.0")
        if first == 0:
            return zero
        end = self.constant("index", none, str(first))
        holds = self.op(f"arith.cmpi ult, {self.ivs[0]}, {end} : index", "i1", none)
        return self.op(f"arith.select {holds}, {value}, {zero} : {scalar}", scalar, none)

    def small(self, type_: str, scope: Scope, among: Field | None = None) -> str:
        """A whole number from -1 to 1, as a float; `among` is the field it is added to."""
        shape, scalar = split(type_)
        value = self.value("i32", scope, 1)
        two = self.constant("i32", Scope(), "2")
        value = self.op(f"arith.remsi {value}, {two} : i32", "i32", Scope())
        value = self.op(f"arith.sitofp {value} : i32 to {scalar}", scalar, Scope())
        if among is not None and scalar in EXACT:
            value = self.among_first(value, scalar, among)
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
                if name == "math.atan2":
                    # Upstream folds that of two zeros to NaN: no constants.
                    b = self.loaded(f.type, scope, 1)
                    name = name if b else "math.powf"
                    b = b or a
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
        at = ", ".join(
            self.in_range(n, o, inner, 1) for n, o in zip(f.shape, f.offset, strict=True)
        )
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
