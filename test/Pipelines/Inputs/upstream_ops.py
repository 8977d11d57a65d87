"""Runs each op of MLIR's dialects in a kernel, in its gradient and on the host.

The arguments: the folder of the tools, the table of ops, a folder to write to,
and LLVM's include folder. A row of the table names an op, the expected outcome,
the type of its result %r, code that uses the op, and, after `#=`, a formula where
the interpreter does not know the op. The letters of the outcome:

    K  a kernel with it runs, with the same numbers in all ways; k: it is refused;
       F: it runs where the optimiser removes the op, and is refused otherwise
    I  the interpreter knows it
    M  a host program with it runs; m: it is refused; N: as F
    C  tai-opt lowers it by the conversion of its own dialect, which tai-run does not
       have
    G  its gradient agrees with differences; g: it is refused; -: not asked

A refusal is an error at the line of the op, in terms of the program, after which
the tool ends by itself. The table names each op that the dialects have, or says
by a line `dialect *` that it shows some of them.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

TOOLS, TABLE, FOLDER, INCLUDE = (Path(word) for word in sys.argv[1:])
LLVM_TBLGEN = INCLUDE.parent / "bin/llvm-tblgen"

# Values that the code of a row may use, each with the values before it.
VALUES = {
    "x": "%x = tai.load @x[%k] : f64",
    "y": "%y = tai.load @y[%k] : f64",
    "ten": "%ten = arith.constant 10.0 : f64",
    "s": "%s = arith.truncf %x : f64 to f32",
    "k32": "%k32 = arith.index_cast %k : index to i32",
    "n0": "%n0 = arith.constant 0 : i32",
    "n1": "%n1 = arith.constant 1 : i32",
    "n2": "%n2 = arith.constant 2 : i32",
    "n3": "%n3 = arith.constant 3 : i32",
    "n": "%n = arith.addi %k32, %n1 : i32",
    "c0": "%c0 = arith.constant 0 : index",
    "c1": "%c1 = arith.constant 1 : index",
    "c2": "%c2 = arith.constant 2 : index",
    "c3": "%c3 = arith.constant 3 : index",
    "c4": "%c4 = arith.constant 4 : index",
    "b": "%b = arith.cmpi slt, %k, %c2 : index",
    "v": "%v = vector.from_elements %x, %y, %x, %ten : vector<4xf64>",
    "u": "%u = vector.from_elements %y, %x, %y, %x : vector<4xf64>",
    "vy": "%vy = vector.from_elements %x, %y : vector<2xf64>",
    "v22": "%v22 = vector.from_elements %x, %y, %ten, %x : vector<2x2xf64>",
    "vi": "%vi = arith.constant dense<[3, 1, 0, 2]> : vector<4xi32>",
    "mask": "%mask = arith.constant dense<[true, false, true, true]> : vector<4xi1>",
    "m": "%m = memref.alloca() : memref<4xf64> "
    + " ".join(
        f"memref.store %{value}, %m[%c{i}] : memref<4xf64>"
        for i, value in enumerate(["x", "y", "x", "ten"])
    ),
    "mm": "%mm = memref.alloca() : memref<4xf64> "
    "memref.store %y, %mm[%c0] : memref<4xf64> memref.store %y, %mm[%c1] : memref<4xf64>",
    "m2": "%m2 = memref.alloca() : memref<2x2xf64> "
    + " ".join(
        f"memref.store %{value}, %m2[%c{i}, %c{j}] : memref<2x2xf64>"
        for i, j, value in [(0, 0, "x"), (0, 1, "y"), (1, 0, "x"), (1, 1, "y")]
    ),
    "m42": "%m42 = memref.alloca() : memref<4x2xf64>",
}
COMPLEX = "%z = complex.create %x, %y : complex<f64>"
COUNT = 5
HEAD = """
tai.tree @t : !tai.root<dense<[i: 5], {x: f64, y: f64, xg: f64, yg: f64}>, {l: f64, lg: f64},
    dense<[i: ROWS, j: 5], {out: f64}>, dense<[i: ROWS], {host: f64}>>
tai.field @x = @t["x"] : f64, rank 1, adjoint @xg
tai.field @y = @t["y"] : f64, rank 1, adjoint @yg
tai.field @xg = @t["xg"] : f64, rank 1
tai.field @yg = @t["yg"] : f64, rank 1
tai.field @out = @t["out"] : f64, rank 2
tai.field @host = @t["host"] : f64, rank 1
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
memref.global "private" constant @numbers : memref<4xf64> = dense<[1.0, 2.0, 3.0, 4.0]>
memref.global "private" @written : memref<4xf64> = dense<0.0>
func.func private @outside(f64) -> f64
func.func private @half(%a: f64) -> f64 {
  %h = arith.constant 0.5 : f64
  %r = arith.mulf %a, %h : f64
  return %r : f64
}
tai.kernel @fill() {
  tai.parallel_for (%k) in @x {
    %i = arith.index_cast %k : index to i64
    %f = arith.sitofp %i : i64 to f64
    %c = arith.constant 0.137 : f64
    %d = arith.constant 0.211 : f64
    %a = arith.mulf %f, %c : f64
    %x = arith.addf %a, %d : f64
    %y = arith.divf %c, %x : f64
    tai.store %x, @x[%k] : f64
    tai.store %y, @y[%k] : f64
  }
  tai.return
}
"""


@dataclass
class Row:
    number: int
    op: str
    outcome: str
    kind: str
    code: str
    formula: str

    def body(self) -> str:
        """The code, with the values that it uses before, and %R made of %r after it."""
        needed: set[str] = set()
        pending = [self.code]
        while pending:
            for name in re.findall(r"%([a-z]\w*)", pending.pop()):
                if name in VALUES and name not in needed:
                    needed.add(name)
                    pending.append(VALUES[name])
        lines = [text for name, text in VALUES.items() if name in needed]
        end = {
            "f64": "%zero = arith.constant 0.0 : f64 %R = arith.addf %r, %zero : f64",
            "none": "%R = arith.constant 1.0 : f64",
            "index": "%wide = arith.index_cast %r : index to i64 "
            "%R = arith.sitofp %wide : i64 to f64",
        }
        for float_type in ["f16", "bf16", "f32"]:
            end[float_type] = f"%R = arith.extf %r : {float_type} to f64"
        for float_type in ["f80", "f128"]:
            end[float_type] = f"%R = arith.truncf %r : {float_type} to f64"
        # A mark by which the line of the code is found.
        lines += [f"// row {self.number}", self.code]
        lines.append(end.get(self.kind, f"%R = arith.sitofp %r : {self.kind} to f64"))
        return "".join(f"    {line}\n" for line in lines)

    def kernel(self, end: str) -> str:
        return (
            f"tai.kernel @k{self.number}() {{\n  tai.parallel_for (%k) in @x {{\n{self.body()}"
            f"    {end}\n  }}\n  tai.return\n}}\n"
        )

    def forward(self) -> str:
        number = self.number
        return self.kernel(
            f"%row = arith.constant {number} : index tai.store %R, @out[%row, %k] : f64"
        )

    def loss(self) -> str:
        return self.kernel("%old = tai.atomic add %R, @l[] : f64")

    def host(self) -> str:
        """The code in a region of its own, so that names do not meet."""
        return (
            f"  scf.execute_region {{\n    %k = arith.constant 2 : index\n{self.body()}"
            f"    %row = arith.constant {self.number} : index\n"
            "    tai.store %R, @host[%row] : f64\n    scf.yield\n  }\n"
        )


def read_table() -> tuple[list[Row], set[str]]:
    rows: list[Row] = []
    partial: set[str] = set()
    for line in TABLE.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        if line.endswith(" *"):
            partial.add(line.split()[0])
            continue
        text, _, formula = line.partition(" #= ")
        op, outcome, kind, code = text.split(maxsplit=3)
        if "%z" in code:
            code = f"{COMPLEX} {code}"
        rows.append(Row(len(rows), op, outcome, kind, code, formula))
    return rows, partial


def check_complete(rows: list[Row], partial: set[str]) -> None:
    """The table shows each op of the dialects."""
    dialects = {
        "Arith/IR/ArithOps.td",
        "Math/IR/MathOps.td",
        "SCF/IR/SCFOps.td",
        "MemRef/IR/MemRefOps.td",
        "Vector/IR/VectorOps.td",
        "ControlFlow/IR/ControlFlowOps.td",
        "GPU/IR/GPUOps.td",
        "Linalg/IR/LinalgStructuredOps.td",
        "Tensor/IR/TensorOps.td",
        "Complex/IR/ComplexOps.td",
        "Affine/IR/AffineOps.td",
        "Index/IR/IndexOps.td",
    }
    code = " ".join([HEAD, *(row.code for row in rows)])
    missing: list[str] = []
    for file in sorted(dialects):
        command = [LLVM_TBLGEN, "-dump-json", "-I", INCLUDE, INCLUDE / "mlir/Dialect" / file]
        records = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        for record in records.values():
            if not isinstance(record, dict) or "opName" not in record:
                continue
            dialect = records[record["opDialect"]["def"]]["name"]
            name = f"{dialect}.{record['opName']}"
            if dialect not in partial and not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", code):
                missing.append(name)
    assert not missing, f"the table lacks {missing}"


def run(*words: object) -> subprocess.CompletedProcess:
    return subprocess.run([str(word) for word in words], capture_output=True, text=True)


def read_field(text: str, name: str) -> list[list[float]]:
    body = text.split(f"@{name} : ", 1)[1].split("@", 1)[0].split("=", 1)[1]
    return [
        [float(number) for number in re.findall(r"-?(?:nan|inf|[0-9][0-9.e+-]*)", line)]
        for line in body.splitlines()
        if line.strip()
    ]


def is_close(row: Row, one: float, other: float) -> bool:
    if math.isnan(one) or math.isnan(other):
        return math.isnan(one) and math.isnan(other)
    tolerance = {"f16": 2e-3, "bf16": 2e-2, "f32": 1e-6}.get(row.kind, 1e-13)
    return one == other or abs(one - other) <= tolerance * max(abs(one), abs(other))


def main() -> None:
    rows, partial = read_table()
    check_complete(rows, partial)
    head = HEAD.replace("ROWS", str(len(rows)))
    failures: list[str] = []

    def run_program(name: str, kernels: str, main: str, *flags: str) -> str:
        path = FOLDER / f"{name}.mlir"
        path.write_text(
            f"{head}{kernels}func.func @main() {{\n  tai.launch @fill() : () -> ()\n{main}"
            "  return\n}\n"
        )
        result = run(TOOLS / "tai-run", path, "--no-cache", *flags)
        if result.returncode:
            failures.append(f"{name} {' '.join(flags)}: {result.stderr[:3000]}")
        return result.stdout

    def launch(chosen: list[Row]) -> str:
        return "".join(f"  tai.launch @k{row.number}() : () -> ()\n" for row in chosen)

    # The same numbers in all ways, and by a formula where one way is all there is.
    def compare(name: str, field: str, chosen: list[Row], texts: list[str]) -> None:
        if not all(texts):
            return
        numbers = [read_field(text, field) for text in texts]
        if field == "host":
            numbers = [[[number] for number in lines[0]] for lines in numbers]
        for row in chosen:
            columns = range(COUNT) if field == "out" else [0]
            for j in columns:
                values = [lines[row.number][j] for lines in numbers]
                if row.formula:
                    k = j if field == "out" else 2
                    x = 0.137 * k + 0.211
                    scope = {"x": x, "y": 0.137 / x, "k": k, "n": k + 1, "ten": 10.0}
                    values.append(float(eval(row.formula, {"math": math}, scope)))
                if not all(is_close(row, values[0], value) for value in values):
                    failures.append(f"{name}: {row.op} {row.code}: {values}")

    ran = [row for row in rows if "K" in row.outcome]
    kernels = "".join(row.forward() for row in ran)
    show = "--print-field=@out"
    texts = [
        run_program("kernels", kernels, launch(ran), show, "--threads=2"),
        run_program("kernels", kernels, launch(ran), show, "--opt-level=0"),
    ]
    compare("compiled", "out", ran, texts)
    folded = [row for row in rows if "F" in row.outcome]
    run_program("folded", "".join(row.forward() for row in folded), launch(folded), show)
    known = [row for row in ran if "I" in row.outcome]
    text = run_program(
        "known", "".join(row.forward() for row in known), launch(known), show, "--interpret"
    )
    compare("interpreted", "out", known, [texts[0], text])
    for row in ran:
        if "i" in row.outcome and row.kind != "none" and not row.formula:
            failures.append(f"{row.op} {row.code}: no formula, and the interpreter is no help")

    hosted = [row for row in rows if "M" in row.outcome]
    program = "".join(row.host() for row in hosted)
    show = "--print-field=@host"
    texts = [run_program("host", "", program, show)]
    texts.append(run_program("host", "", program, show, "--opt-level=0"))
    compare("host", "host", hosted, texts)

    derived = [row for row in rows if "G" in row.outcome]
    checks = "".join(
        "  tai_check.gradient loss(@l) wrt [@x, @y] tolerance 1.0e-6 {\n"
        f"    tai.launch @k{row.number}() : () -> ()\n  }}\n"
        for row in derived
    )
    run_program("gradients", "".join(row.loss() for row in derived), checks)

    # Refusals, each in a module of its own.
    def check_refused(name: str, chosen: list[Row], parts: list[str], *flags: str) -> None:
        path = FOLDER / f"{name}.mlir"
        lines = "\n// -----\n".join(head + part for part in parts).splitlines()
        path.write_text("\n".join(lines) + "\n")
        result = run(TOOLS / "tai-opt", path, "--split-input-file", *flags)
        if result.returncode != 1:
            failures.append(f"{name}: {result.returncode}: {result.stderr[-2000:]}")
        errors: dict[int, str] = {}
        for line in result.stderr.splitlines():
            if "error: " in line:
                found = re.match(rf"{re.escape(str(path))}:(\d+):\d+: error: (.*)", line)
                if not found:
                    failures.append(f"{name}: an error has no line: {line}")
                else:
                    errors.setdefault(int(found[1]), found[2])
        terms = r"was not lowered|unrealized|failed to legalize|inside the compiler|reproducer"
        places = {int(line.split()[-1]): i for i, line in enumerate(lines, 1) if "// row" in line}
        for row in chosen:
            mark = places[row.number]
            # A derivative that would pass through an array is refused at its stores.
            arrays = [i for i in range(mark - 9, mark) if "memref.store" in lines[i - 1]]
            found_errors = [errors.pop(i) for i in [mark + 1, *arrays] if i in errors]
            error = found_errors[0] if found_errors else None
            if error is None:
                failures.append(f"{name}: {row.op} {row.code}: is not refused at its line")
            elif re.search(terms, error):
                failures.append(f"{name}: {row.op} {row.code}: {error}")
        for line, error in errors.items():
            failures.append(f"{name}: {lines[line - 1].strip()}: {error}")

    refused = [row for row in rows if "k" in row.outcome]
    forward = [row.forward() for row in refused]
    check_refused("refused", refused, forward, "--tai-to-llvm")
    check_refused("device", refused, forward, "--tai-to-nvvm")
    unhosted = [row for row in rows if "m" in row.outcome]
    mains = [f"func.func @main() {{\n{row.host()}  return\n}}\n" for row in unhosted]
    check_refused("unhosted", unhosted, mains, "--tai-to-llvm")
    underived = [row for row in rows if "g" in row.outcome]
    check_refused(
        "underived", underived, [row.loss() for row in underived], "--tai-autodiff", "--tai-to-llvm"
    )

    # Each in a module of its own, too.
    converted = [row for row in rows if "C" in row.outcome]
    path = FOLDER / "converted.mlir"
    for flag in "--tai-to-llvm", "--tai-to-nvvm":
        path.write_text("\n// -----\n".join(head + row.forward() for row in converted))
        result = run(TOOLS / "tai-opt", path, "--split-input-file", flag)
        if result.returncode:
            failures.append(f"converted {flag}: {result.stderr[:2000]}")

    print("\n".join(failures))
    counts = [len(ran), len(known), len(hosted), len(derived), len(refused), len(underived)]
    print("runs, interpreted, on the host, derived, refused, not derived:", *counts)
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
