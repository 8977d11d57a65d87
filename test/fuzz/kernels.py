"""Differentiates random kernels and compares each gradient with central differences.

Every seed gives one program: two kernels of nested branches, serial loops, while loops,
mutable variables, gathers and scatters over f64 fields, and a `main` that checks the
gradient of their loss. All functions in them are smooth where they are evaluated, so a
disagreement is an error of the compiler.

    python test/fuzz/kernels.py --tai-run build/bin/tai-run --seeds 0:100
    python test/fuzz/kernels.py --print 17
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys

FIELDS = """\
tai.tree @data : !tai.root<
    dense<[i: 8], {x: f64, x_grad: f64, y: f64, y_grad: f64, z: f64, z_grad: f64,
                   v: vector<2xf64>, v_grad: vector<2xf64>, n: i32}>,
    {a: f64, a_grad: f64, loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @z_grad = @data["z_grad"] : f64, rank 1
tai.field @v_grad = @data["v_grad"] : vector<2xf64>, rank 1
tai.field @a_grad = @data["a_grad"] : f64, rank 0
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @data["z"] : f64, rank 1, adjoint @z_grad
tai.field @v = @data["v"] : vector<2xf64>, rank 1, adjoint @v_grad
tai.field @a = @data["a"] : f64, rank 0, adjoint @a_grad
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad
tai.field @n = @data["n"] : i32, rank 1

// Floats in [-1, 1] and trip counts 0 to 3.
tai.kernel @fill() {
  %p = arith.constant 0.37 : f64
  %q = arith.constant 1.91 : f64
  %four = arith.constant 4 : i32
  tai.store %p, @a[] : f64
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %i : index to i32
    %f = arith.sitofp %k : i32 to f64
    %g = arith.mulf %f, %q : f64
    %h = arith.addf %g, %p : f64
    %s = math.sin %h : f64
    %c = math.cos %h : f64
    tai.store %s, @x[%i] : f64
    tai.store %c, @y[%i] : f64
    %e = vector.from_elements %c, %s : vector<2xf64>
    tai.store %e, @v[%i] : vector<2xf64>
    %m = arith.remsi %k, %four : i32
    tai.store %m, @n[%i] : i32
  }
  tai.return
}

tai.kernel @clear() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @z {
    tai.store %zero, @z[%i] : f64
  }
  tai.return
}
"""

MAIN = """\
func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x, @y, @v, @a] tolerance 1.0e-6 {
    tai.launch @clear() : () -> ()
    tai.store %zero, @loss[] : f64
    tai.launch @first() : () -> ()
    tai.launch @second() : () -> ()
  }
  return
}
"""

VECTOR = "vector<2xf64>"


class Scope:
    """The names of a statement: SSA values by their use."""

    def __init__(self, **names: list[str]):
        self.floats = list(names.get("floats", []))
        self.indices = list(names.get("indices", []))  # of elements, within 0..7
        self.bounds = list(names.get("bounds", []))  # of loops, at most 8
        self.conditions = list(names.get("conditions", []))
        self.variables = list(names.get("variables", []))
        self.scatters = bool(names.get("scatters"))

    def copy(self) -> Scope:
        other = Scope()
        other.__dict__ = {k: v[:] if isinstance(v, list) else v for k, v in vars(self).items()}
        return other


class Generator:
    """Writes the body of one kernel after another."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)
        self.count = 0
        self.lines: list[str] = []
        self.depth = 1

    def name(self, prefix: str = "t") -> str:
        self.count += 1
        return f"%{prefix}{self.count}"

    def emit(self, line: str) -> None:
        self.lines.append("  " * self.depth + line)

    def op(self, text: str) -> str:
        result = self.name()
        self.emit(f"{result} = {text}")
        return result

    def constant(self, value: float) -> str:
        return self.op(f"arith.constant {float(value)} : f64")

    def unary(self, op: str, operand: str, type_: str = "f64") -> str:
        return self.op(f"{op} {operand} : {type_}")

    def binary(self, op: str, lhs: str, rhs: str, type_: str = "f64") -> str:
        return self.op(f"{op} {lhs}, {rhs} : {type_}")

    def above(self, value: str, least: float) -> str:
        """value² + least: safe to divide by, and to take roots and logarithms of."""
        return self.binary(
            "arith.addf", self.binary("arith.mulf", value, value), self.constant(least)
        )

    def squash(self, value: str) -> str:
        """Keeps values that go round in loops from growing."""
        return self.unary("math.tanh", value)

    # Expressions

    def expression(self, scope: Scope, depth: int = 2) -> str:
        pick = self.random.choice
        if depth <= 0 or self.random.random() < 0.15:
            return pick(scope.floats)

        def part() -> str:
            return self.expression(scope, depth - 1)

        kind = self.random.randrange(16)
        if kind < 2:
            return self.unary(pick(["math.sin", "math.tanh", "math.cos", "math.atan"]), part())
        if kind < 6:
            return self.binary(pick(["arith.mulf", "arith.addf", "arith.subf"]), part(), part())
        if kind == 6:
            return self.binary("arith.divf", part(), self.above(part(), 1.0))
        if kind == 7:
            op = pick(["math.sqrt", "math.log", "math.rsqrt", "math.cbrt"])
            return self.unary(op, self.above(part(), 0.5))
        if kind == 8:
            return self.unary("math.exp", self.squash(part()))
        if kind == 9:
            vector = self.vector(scope, depth - 1)
            component = self.random.randrange(2)
            return self.op(f"vector.extract {vector}[{component}] : f64 from {VECTOR}")
        if kind == 10:
            lhs, rhs = self.vector(scope, depth - 1), self.vector(scope, depth - 1)
            return self.binary("tai.dot", lhs, rhs, VECTOR)
        if kind == 11:
            return self.op(f"arith.select {pick(scope.conditions)}, {part()}, {part()} : f64")
        if kind == 12:
            return self.binary("math.atan2", part(), self.above(part(), 0.5))
        if kind == 13:
            return self.op(f"tai.load @{pick('xy')}[{pick(scope.indices)}] : f64")
        if kind == 14:
            component = self.op(f"arith.constant {self.random.randrange(2)} : index")
            index = pick(scope.indices)
            return self.op(f"tai.load @v[{index}] component [{component}] : f64")
        parts = ", ".join(pick(scope.floats) for _ in range(4))
        matrix = self.op(f"vector.from_elements {parts} : vector<2x2xf64>")
        return self.unary("tai.determinant", matrix, "vector<2x2xf64>")

    def vector(self, scope: Scope, depth: int) -> str:
        kind = self.random.randrange(6)
        if kind == 0 or depth <= 0:
            return self.op(f"tai.load @v[{self.random.choice(scope.indices)}] : {VECTOR}")
        if kind == 1:
            parts = [self.expression(scope, depth - 1) for _ in range(2)]
            return self.op(f"vector.from_elements {', '.join(parts)} : {VECTOR}")
        if kind == 2:
            scalar = self.expression(scope, depth - 1)
            return self.op(f"vector.broadcast {scalar} : f64 to {VECTOR}")
        if kind == 3:
            op = self.random.choice(["arith.addf", "arith.mulf", "arith.subf"])
            lhs, rhs = self.vector(scope, depth - 1), self.vector(scope, depth - 1)
            return self.binary(op, lhs, rhs, VECTOR)
        if kind == 4:
            return self.unary("math.sin", self.vector(scope, depth - 1), VECTOR)
        scalar, vector = self.expression(scope, depth - 1), self.vector(scope, depth - 1)
        position = self.random.randrange(2)
        return self.op(f"vector.insert {scalar}, {vector} [{position}] : f64 into {VECTOR}")

    # Statements

    def block(self, outer: Scope, depth: int) -> Scope:
        """Writes a few statements; returns the scope after them."""
        scope = outer.copy()
        for _ in range(self.random.randrange(1, 5)):
            self.statement(scope, depth)
        return scope

    def statement(self, scope: Scope, depth: int) -> None:
        pick = self.random.choice
        kind = self.random.randrange(11)
        if kind < 3:
            scope.floats.append(self.expression(scope))
        elif kind == 3 and scope.variables:
            scope.floats.append(self.op(f"tai.local_load {pick(scope.variables)} : f64"))
        elif kind < 6 and scope.variables:
            value = self.squash(self.expression(scope))
            self.emit(f"tai.local_store {value}, {pick(scope.variables)} : f64")
        elif kind == 6:
            op = pick(["add", "sub"])
            self.emit(f"tai.atomic {op} {self.expression(scope)}, @loss[] : f64")
        elif kind == 7 and scope.scatters:
            value = self.expression(scope)
            self.emit(f"tai.atomic add {value}, @z[{pick(scope.indices)}] : f64")
        elif kind == 8 and depth > 0:
            self.branch(scope, depth)
        elif kind == 9 and depth > 0:
            self.loop(scope, depth)
        elif kind == 10 and depth > 0:
            self.while_loop(scope, depth)

    def nested(self, scope: Scope, depth: int) -> Scope:
        self.depth += 1
        inner = self.block(scope, depth - 1)
        self.depth -= 1
        return inner

    def end(self, text: str) -> None:
        self.depth += 1
        self.emit(text)
        self.depth -= 1

    def branch(self, scope: Scope, depth: int) -> None:
        condition = self.random.choice(scope.conditions)
        if self.random.random() < 0.5:
            self.emit(f"scf.if {condition} {{")
            self.nested(scope, depth)
            if self.random.random() < 0.5:
                self.emit("} else {")
                self.nested(scope, depth)
            self.emit("}")
            return
        result = self.name()
        self.emit(f"{result} = scf.if {condition} -> (f64) {{")
        for separator in ("} else {", "}"):
            self.depth += 1
            value = self.expression(self.block(scope, depth - 1))
            self.emit(f"scf.yield {value} : f64")
            self.depth -= 1
            self.emit(separator)
        scope.floats.append(result)

    def loop(self, scope: Scope, depth: int) -> None:
        pick = self.random.choice
        counter, carried, result = self.name("j"), self.name("w"), self.name()
        head = f"scf.for {counter} = {pick(['%c0', '%c1'])} to {pick(scope.bounds)} "
        head += f"step {pick(['%c1', '%c2'])}"
        inner = scope.copy()
        inner.indices.append(counter)
        inner.bounds.append(counter)
        carries = self.random.random() < 0.5
        if carries:
            inner.floats.append(carried)
            head = f"{result} = {head} iter_args({carried} = {pick(scope.floats)}) -> (f64)"
        self.emit(head + " {")
        self.depth += 1
        if self.random.random() < 0.5:
            variable = self.op("tai.alloca : !tai.local<f64>")
            inner.variables.append(variable)
        inner.conditions.append(self.is_even(counter))
        inner = self.block(inner, depth - 1)
        if carries:
            self.emit(f"scf.yield {self.squash(self.expression(inner))} : f64")
            scope.floats.append(result)
        self.depth -= 1
        self.emit("}")

    def while_loop(self, scope: Scope, depth: int) -> None:
        """A loop that ends by a computed value, or at a bound."""
        pick = self.random.choice
        value, count, result = self.name("w"), self.name("k"), self.name()
        bound = pick(scope.bounds)
        self.emit(
            f"{result}:2 = scf.while ({value} = {pick(scope.floats)}, {count} = %c0) : "
            "(f64, index) -> (f64, index) {"
        )
        self.depth += 1
        before = scope.copy()
        before.floats.append(value)
        before = self.block(before, 0)
        limit = self.constant(pick([0.3, 0.6, 5.0]))
        small = self.op(f"arith.cmpf olt, {value}, {limit} : f64")
        inside = self.op(f"arith.cmpi ult, {count}, {bound} : index")
        more = self.binary("arith.andi", small, inside, "i1")
        passed = self.squash(self.expression(before)) if self.random.random() < 0.5 else value
        self.emit(f"scf.condition({more}) {passed}, {count} : f64, index")
        self.depth -= 1
        self.emit("} do {")
        value, count = self.name("w"), self.name("k")
        self.emit(f"^bb0({value}: f64, {count}: index):")
        self.depth += 1
        after = scope.copy()
        after.floats.append(value)
        after.indices.append(count)
        after = self.block(after, depth - 1)
        following = self.squash(self.expression(after))
        self.emit(f"%next{count[1:]} = arith.addi {count}, %c1 : index")
        self.emit(f"scf.yield {following}, %next{count[1:]} : f64, index")
        self.depth -= 1
        self.emit("}")
        scope.floats.append(f"{result}#0")

    def is_even(self, index: str) -> str:
        bit = self.binary("arith.andi", index, "%c1", "index")
        return self.op(f"arith.cmpi eq, {bit}, %c0 : index")

    def kernel(self, name: str, into: str) -> str:
        """A kernel that reads @z and sums into the loss, or that scatters into @z."""
        self.lines = []
        for number in (0, 1, 2, 3, 5):
            self.emit(f"%c{number} = arith.constant {number} : index")
        scope = Scope(
            floats=[self.op("tai.load @a[] : f64"), self.constant(0.7)],
            indices=["%c1", "%c3"],
            bounds=["%c3", "%c5"],
            conditions=[self.op("arith.constant true")],
        )
        scope.scatters = into == "z"
        if self.random.random() < 0.5:
            scope = self.block(scope, 2)
        for number in range(self.random.randrange(1, 3)):
            self.parallel_loop(scope, f"%i{number}", into)
        return "\n".join([f"tai.kernel @{name}() {{", *self.lines, "  tai.return", "}", ""])

    def parallel_loop(self, outer: Scope, index: str, into: str) -> None:
        self.emit(f"tai.parallel_for ({index}) in @x {{")
        self.depth += 1
        scope = outer.copy()
        scope.indices.append(index)
        x = self.op(f"tai.load @x[{index}] : f64")
        scope.floats.append(x)
        if into == "loss":
            scope.floats.append(self.op(f"tai.load @z[{index}] : f64"))
        trips = self.op(f"tai.load @n[{index}] : i32")
        scope.bounds.append(self.op(f"arith.index_cast {trips} : i32 to index"))
        threshold = self.constant(0.111)
        scope.conditions += [
            self.is_even(index),
            self.op(f"arith.cmpf ogt, {x}, {threshold} : f64"),
        ]
        scope.variables = [self.op("tai.alloca : !tai.local<f64>") for _ in range(2)]
        self.emit(f"tai.local_store {x}, {scope.variables[0]} : f64")
        for _ in range(self.random.randrange(1, 4)):
            scope = self.block(scope, 3)
        last = [self.op(f"tai.local_load {variable} : f64") for variable in scope.variables]
        target = "@loss[]" if into == "loss" else f"@z[{index}]"
        self.emit(f"tai.atomic add {self.binary('arith.mulf', *last)}, {target} : f64")
        self.emit(f"tai.atomic add {self.expression(scope, 3)}, {target} : f64")
        self.depth -= 1
        self.emit("}")


def program(seed: int) -> str:
    """The program of a seed."""
    generator = Generator(seed)
    first, second = generator.kernel("first", "z"), generator.kernel("second", "loss")
    return "\n".join([FIELDS, first, second, MAIN])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tai-run", default="build/bin/tai-run", help="the program to test")
    parser.add_argument("--seeds", default="0:20", help="first:end")
    parser.add_argument("--print", type=int, metavar="SEED", help="print one program and stop")
    parser.add_argument("options", nargs="*", help="options of tai-run, after --")
    args = parser.parse_args()
    if args.print is not None:
        print(program(args.print))
        return 0
    first, end = map(int, args.seeds.split(":"))
    failed = 0
    for seed in range(first, end):
        command = [args.tai_run, "-", "--no-cache", *args.options]
        try:
            run = subprocess.run(
                command, input=program(seed), capture_output=True, text=True, timeout=120
            )
            message = run.stderr if run.returncode else ""
        except subprocess.TimeoutExpired:
            message = "timeout"
        if message:
            failed += 1
            print(f"seed {seed}: {message.splitlines()[0]}")
    print(f"{end - first - failed} gradients agree, {failed} do not")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
