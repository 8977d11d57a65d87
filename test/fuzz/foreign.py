"""Differentiates random functions of upstream dialects.

They use scf, affine, arith, math, memref, linalg and vector. Every seed gives one `func.func` over
two arrays, smooth where it is evaluated. A batch of them is one module, which both pipelines must
take without a crash; with `--compare`, gradients of stock lowering are compared with central
differences, values and gradients of code without optimisation with those of `-O3`, and those of
functions whose ops the interpreter knows with its own.

    python test/fuzz/foreign.py --seeds 0:2000
    python test/fuzz/foreign.py --seeds 0:40 --compare
    python test/fuzz/foreign.py --print 17
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "test/AD/Foreign/Inputs"))
import check_foreign  # noqa: E402

SIZE = 6
ARRAY = f"memref<{SIZE}xf64>"


class Function:
    """The text of a random function."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)
        self.lines: list[str] = []
        self.count = 0
        self.arrays = ["%x", "%y"]
        self.name = f"f{seed}"
        for value in range(SIZE + 1):
            self.emit(f"%c{value} = arith.constant {value} : index")
        for _ in range(self.random.randint(2, 4)):
            self.statement(depth=0)
        # The result depends on the inputs, whatever came before.
        self.loop(lambda i: self.store(self.expression(i, 2), "%y", i))

    def emit(self, line: str) -> None:
        self.lines.append("  " + line)

    def new(self, text: str) -> str:
        self.count += 1
        self.emit(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def load(self, index: str) -> str:
        return self.new(f"memref.load {self.random.choice(self.arrays)}[{index}] : {ARRAY}")

    def store(self, value: str, array: str, index: str) -> None:
        self.emit(f"memref.store {value}, {array}[{index}] : {ARRAY}")

    def expression(self, index: str, depth: int) -> str:
        kind = self.random.randrange(5) if depth else 0
        if kind == 0:
            return self.load(self.random.choice([index, f"%c{self.random.randrange(SIZE)}"]))
        first = self.expression(index, depth - 1)
        if kind == 1:
            return self.new(f"math.{self.random.choice(['sin', 'tanh', 'cos'])} {first} : f64")
        second = self.expression(index, depth - 1)
        if kind == 2:
            bound = self.new(f"math.tanh {second} : f64")
            return self.new(f"arith.mulf {first}, {bound} : f64")
        return self.new(f"arith.{self.random.choice(['addf', 'subf'])} {first}, {second} : f64")

    def loop(self, body) -> None:
        kind = self.random.choice(["scf", "affine", "down"])
        self.count += 1
        index = f"%i{self.count}"
        if kind == "affine":
            self.emit(f"affine.for {index} = 0 to {SIZE} {{")
            body(index)
        elif kind == "down":
            self.emit(f"scf.for {index} = %c0 to %c{SIZE} step %c2 {{")
            body(self.new(f"arith.subi %c{SIZE - 1}, {index} : index"))
        else:
            self.emit(f"scf.for {index} = %c0 to %c{SIZE} step %c1 {{")
            body(index)
        self.emit("}")

    def statement(self, depth: int) -> None:
        kind = self.random.choice(
            ["store", "branch", "carry", "local", "linalg", "vector"]
            + ["while", "switch", "view", "transfer", "parallel", "unsigned"]
        )
        target = self.random.choice(self.arrays)
        known = list(self.arrays)
        if kind == "store":
            self.loop(lambda i: self.store(self.expression(i, 2), target, i))
        elif kind == "branch":

            def branch(index):
                test = self.new(f"arith.cmpi slt, {index}, %c3 : index")
                self.emit(f"scf.if {test} {{")
                self.store(self.expression(index, 2), target, index)
                self.emit("} else {")
                self.store(self.expression(index, 1), target, "%c1")
                self.emit("}")

            self.loop(branch)
        elif kind == "carry":
            first = self.load("%c0")
            self.count += 1
            name, index, carried = (f"%{c}{self.count}" for c in "ria")
            self.emit(
                f"{name} = scf.for {index} = %c0 to %c{SIZE} step %c1 "
                f"iter_args({carried} = {first}) -> f64 {{"
            )
            value = self.new(f"math.sin {carried} : f64")
            total = self.new(f"arith.addf {value}, {self.expression(index, 1)} : f64")
            self.emit(f"scf.yield {total} : f64")
            self.emit("}")
            self.store(name, target, "%c2")
        elif kind == "local":
            array = self.new(f"memref.alloc() : {ARRAY}")
            self.emit(f"memref.copy {target}, {array} : {ARRAY} to {ARRAY}")
            self.arrays.append(array)
            if depth < 2:
                self.statement(depth + 1)
            self.loop(lambda i: self.store(self.expression(i, 1), target, i))
            self.arrays = known
            self.emit(f"memref.dealloc {array} : {ARRAY}")
        elif kind == "while":
            self.while_loop(target)
        elif kind == "switch":
            self.switch(target)
        elif kind == "view":
            offset = self.random.randrange(SIZE - 2)
            view = f"memref<3xf64, strided<[1], offset: {offset}>>"
            part = self.new(f"memref.subview {target}[{offset}] [3] [1] : {ARRAY} to {view}")
            first = self.new(f"memref.load {part}[%c0] : {view}")
            second = self.new(f"math.sin {self.load('%c2')} : f64")
            product = self.new(f"arith.mulf {first}, {second} : f64")
            self.emit(f"memref.store {product}, {part}[%c1] : {view}")
        elif kind == "transfer":
            index = self.random.randrange(SIZE - 1)
            pad = self.new("arith.constant 0.5 : f64")
            part = self.new(
                f"vector.transfer_read {target}[%c{index}], {pad} : {ARRAY}, vector<4xf64>"
            )
            bound = self.new(f"math.tanh {part} : vector<4xf64>")
            mixed = self.new(f"vector.interleave {bound}, {bound} : vector<4xf64> -> vector<8xf64>")
            even = self.new(
                f"vector.extract_strided_slice {mixed} "
                "{offsets = [1], sizes = [4], strides = [1]} : vector<8xf64> to vector<4xf64>"
            )
            self.emit(f"vector.transfer_write {even}, {target}[%c{index}] : vector<4xf64>, {ARRAY}")
        elif kind == "parallel":
            source = self.random.choice([a for a in self.arrays if a != target])
            self.count += 1
            index = f"%i{self.count}"
            self.emit(f"scf.parallel ({index}) = (%c0) to (%c{SIZE}) step (%c1) {{")
            old = self.new(f"memref.load {target}[{index}] : {ARRAY}")
            other = self.new(f"memref.load {source}[{index}] : {ARRAY}")
            bound = self.new(f"math.tanh {other} : f64")
            self.store(self.new(f"arith.mulf {old}, {bound} : f64"), target, index)
            self.emit("scf.reduce")
            self.emit("}")
        elif kind == "unsigned":
            self.count += 1
            index = f"%i{self.count}"
            low, high = (self.new(f"arith.constant {v} : i32") for v in (1, SIZE))
            step = self.new(f"arith.constant {self.random.randint(1, 3)} : i32")
            self.emit(f"scf.for unsigned {index} = {low} to {high} step {step} : i32 {{")
            place = self.new(f"arith.index_cast {index} : i32 to index")
            self.store(self.expression(place, 2), target, place)
            self.emit("}")
        elif kind == "linalg":
            source = self.random.choice([a for a in self.arrays if a != target])
            self.emit(
                "linalg.generic {indexing_maps = [affine_map<(i) -> (i)>, affine_map<(i) -> (i)>], "
                f'iterator_types = ["parallel"]}} ins({source} : {ARRAY}) '
                f"outs({target} : {ARRAY}) {{"
            )
            self.count += 1
            a, b = f"%a{self.count}", f"%b{self.count}"
            self.emit(f"^bb0({a}: f64, {b}: f64):")
            bound = self.new(f"math.tanh {a} : f64")
            product = self.new(f"arith.mulf {bound}, {b} : f64")
            self.emit(f"linalg.yield {product} : f64")
            self.emit("}")
        else:
            index = self.random.randrange(SIZE - 3)
            source = self.random.choice(self.arrays)
            a = self.new(f"vector.load {source}[%c{index}] : {ARRAY}, vector<4xf64>")
            b = self.new(f"math.sin {a} : vector<4xf64>")
            total = self.new(f"vector.reduction <add>, {b} : vector<4xf64> into f64")
            self.store(total, target, f"%c{self.random.randrange(SIZE)}")

    def while_loop(self, target: str) -> None:
        self.count += 1
        n = self.count
        first = self.load("%c1")
        limit = self.random.randint(1, SIZE)
        self.emit(
            f"%r{n}:2 = scf.while (%s{n} = %c0, %q{n} = {first}) : (index, f64) -> (index, f64) {{"
        )
        test = self.new(f"arith.cmpi slt, %s{n}, %c{limit} : index")
        self.emit(f"scf.condition({test}) %s{n}, %q{n} : index, f64")
        self.emit("} do {")
        self.emit(f"^bb0(%t{n}: index, %u{n}: f64):")
        bound = self.new(f"math.sin %u{n} : f64")
        total = self.new(f"arith.addf {bound}, {self.expression(f'%t{n}', 1)} : f64")
        self.store(total, target, f"%t{n}")
        more = self.new(f"arith.addi %t{n}, %c1 : index")
        self.emit(f"scf.yield {more}, {total} : index, f64")
        self.emit("}")
        self.store(f"%r{n}#1", target, "%c3")

    def switch(self, target: str) -> None:
        def body(index):
            self.count += 1
            name = f"%r{self.count}"
            self.emit(f"{name} = scf.index_switch {index} -> f64")
            for case in "case 1", "case 4", "default":
                self.emit(f"{case} {{")
                self.emit(f"scf.yield {self.expression(index, 1)} : f64")
                self.emit("}")
            self.store(name, target, index)

        self.loop(body)

    @property
    def text(self) -> str:
        head = (
            f"func.func @{self.name}(%x: {ARRAY}, %y: {ARRAY}) attributes {{tai.differentiate}} {{"
        )
        return "\n".join([head, *self.lines, "  return", "}"])


def differentiate(tai_opt: str, text: str, pipeline: str) -> str:
    run = subprocess.run([tai_opt, pipeline], input=text, capture_output=True, text=True)
    if run.returncode:
        sys.exit(f"{pipeline}: {run.returncode}\n{run.stderr[:3000]}\n{text}")
    return run.stdout


LOOPS = (
    "builtin.module(func.func(convert-linalg-to-loops,lower-affine),"
    "func.func(convert-vector-to-scf{full-unroll=true},canonicalize,memref-expand))"
)
UNKNOWN = "vector.|memref.(subview|copy|cast)"


def interpret(tools: SimpleNamespace, text: str, numbers: dict[str, list]) -> int:
    """Compares with the interpreter what compiled functions did to given arrays.

    `numbers` has arrays before and after each call. Returns the number of calls compared.
    """
    copies = re.sub(
        r"memref\.copy (%\S+), (%\S+) : (\S+) to (\S+)",
        r"linalg.copy ins(\1 : \3) outs(\2 : \4)",
        text,
    )
    run = subprocess.run(
        [tools.mlir_opt, f"--pass-pipeline={LOOPS}"], input=copies, capture_output=True, text=True
    )
    if run.returncode:
        sys.exit(f"loops: {run.stderr[:3000]}")
    bodies = re.findall(r"^  func\.func .*?^  }\n", run.stdout, re.S | re.M)
    known = [body for body in bodies if not re.search(UNKNOWN, body)]
    calls = []
    names = [re.search(r"@(\w+)", body)[1] for body in known]
    for name in names:
        given, wanted = numbers[name]
        calls.append(f"  func.call @call_{name}() : () -> ()\n")
        lines = [f"%c{i} = arith.constant {i} : index" for i in range(SIZE)]
        for k, array in enumerate(given):
            lines.append(f"%a{k} = memref.alloc() : {ARRAY}")
            for i, value in enumerate(array):
                lines.append(f"%v{k}_{i} = arith.constant {value:.17e} : f64")
                lines.append(f"memref.store %v{k}_{i}, %a{k}[%c{i}] : {ARRAY}")
        arrays = ", ".join(f"%a{k}" for k in range(len(given)))
        lines.append(f"func.call @{name}({arrays}) : ({', '.join([ARRAY] * len(given))}) -> ()")
        for k, array in enumerate(wanted):
            for i, value in enumerate(array):
                lines.append(f"%w{k}_{i} = arith.constant {value:.17e} : f64")
                lines.append(f"%g{k}_{i} = memref.load %a{k}[%c{i}] : {ARRAY}")
                lines.append(f"tai_check.close %g{k}_{i}, %w{k}_{i} tolerance 1.0e-11 : f64")
            lines.append(f"memref.dealloc %a{k} : {ARRAY}")
        body = "".join(f"  {line}\n" for line in lines)
        known.append(f"func.func @call_{name}() {{\n{body}  return\n}}\n")
    program = "".join(known) + "func.func @main() {\n" + "".join(calls) + "  return\n}\n"
    with tempfile.NamedTemporaryFile("w", suffix=".mlir") as file:
        file.write(program)
        file.flush()
        run = subprocess.run(
            [tools.tai_run, "--interpret", file.name], capture_output=True, text=True
        )
    if run.returncode:
        errors = [line for line in run.stderr.splitlines() if "error:" in line]
        sys.exit("the interpreter differs: " + "\n".join(errors[:5]) + "\n" + program)
    return len(names)


def compare(tools: SimpleNamespace, functions: list[Function], text: str) -> int:
    """Compares the gradient of each function with differences of the fourth order, and with
    other ways to run it. Returns the number of functions that the interpreter has run.
    """
    numbers = {}
    with tempfile.TemporaryDirectory() as name:
        check_foreign.translate(tools, text, Path(name), "functions")
        library, plain = (
            check_foreign.build(tools, Path(name), "functions", level) for level in ("-O3", "-O0")
        )
    kind = check_foreign.Type(ARRAY)
    rng = np.random.default_rng(1)
    for function in functions:

        def run(values, library=library):
            values = [v.copy() for v in values]
            check_foreign.call(library, function.name, [kind] * 2, [], values)
            return values

        def differentiate(library):
            adjoints = [s.copy() for s in seeds]
            arrays = [g.copy() for g in given] + adjoints
            check_foreign.call(library, f"{function.name}_grad", [kind] * 4, [], arrays)
            return adjoints

        before, seeds, direction = ([rng.uniform(-1, 1, SIZE) for _ in "xy"] for _ in range(3))
        attributes = check_foreign.signature(text, f"{function.name}_grad")[2]
        restored = (
            "reads_before = array<i64: "
            + attributes.partition("reads_before = array<i64: ")[2].partition(">")[0]
        )
        after = run(before)
        given = [(before if str(i) in restored.partition(": ")[2] else after)[i] for i in (0, 1)]
        adjoints = differentiate(library)
        for fast, slow in zip(after + adjoints, run(before, plain) + differentiate(plain)):
            if not np.allclose(fast, slow, rtol=1e-12, atol=1e-12):
                sys.exit(f"-O0 and -O3 differ: {function.name}\n{function.text}")
        numbers[function.name] = (before, after)
        numbers[f"{function.name}_grad"] = (given + seeds, given + adjoints)
        h = 1e-3

        def at(step):
            moved = run([v + step * d for v, d in zip(before, direction)])
            return sum(float(s @ m) for s, m in zip(seeds, moved))

        wanted = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        got = sum(float(g @ d) for g, d in zip(adjoints, direction))
        if not abs(got - wanted) <= 1e-6 * max(1.0, abs(wanted)):
            sys.exit(f"wrong: {function.name}: {got}, differences say {wanted}\n{function.text}")
    return interpret(tools, text, numbers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="0:200")
    parser.add_argument("--batch", type=int, default=50)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--print", type=int, metavar="SEED")
    parser.add_argument("--tai-opt", default=str(ROOT / "build/bin/tai-opt"))
    parser.add_argument("--llvm-bin", default="/usr/lib/llvm-22/bin")
    given = parser.parse_args()
    if given.print is not None:
        print(Function(given.print).text)
        return
    tools = SimpleNamespace(
        mlir_opt=f"{given.llvm_bin}/mlir-opt",
        translate=f"{given.llvm_bin}/mlir-translate",
        clang=f"{given.llvm_bin}/clang",
        tai_run=str(Path(given.tai_opt).with_name("tai-run")),
        llvm_lib=os.path.realpath(f"{given.llvm_bin}/../lib"),
    )
    first, last = map(int, given.seeds.split(":"))
    interpreted = 0
    for begin in range(first, last, given.batch):
        functions = [Function(seed) for seed in range(begin, min(begin + given.batch, last))]
        text = "\n".join(f.text for f in functions)
        made = differentiate(given.tai_opt, text, "--tai-autodiff")
        differentiate(given.tai_opt, text, "--tai-autodiff-forward")
        if given.compare:
            interpreted += compare(tools, functions, made)
    right = f", all gradients right; {interpreted} calls interpreted" if given.compare else ""
    print(f"{last - first} functions: no crash{right}")


if __name__ == "__main__":
    main()
