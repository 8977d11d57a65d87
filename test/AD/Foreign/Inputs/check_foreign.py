"""Compares derivatives of functions of upstream dialects with central differences.

`python check_foreign.py --tai-opt=... --llvm-bin=... [files]` prints one line for each file and
mode: `right`, `refused` with the errors, or `wrong`. All is lowered with stock `mlir-opt`. The
adjoint is seeded with weights w, and must be the derivative of the sum of w * after by the contents
before.
"""

import argparse
import ctypes
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ELEMENTS = {
    "f64": np.float64,
    "f32": np.float32,
    "i32": np.int32,
    "i64": np.int64,
    "index": np.int64,
    "complex<f64>": np.complex128,
    "complex<f32>": np.complex64,
}
CTYPES = {
    "f64": ctypes.c_double,
    "f32": ctypes.c_float,
    "i32": ctypes.c_int32,
    "i64": ctypes.c_int64,
}
CTYPES["index"] = ctypes.c_int64
DYNAMIC = 5
LOWER = (
    "builtin.module({tensors}func.func(lower-vector-multi-reduction,convert-linalg-to-loops,scf-forall-to-parallel,lower-affine),"
    "func.func(convert-vector-to-scf{{full-unroll=true}},canonicalize,memref-expand,llvm-request-c-wrappers),"
    "convert-complex-to-standard,"
    "convert-scf-to-cf,expand-strided-metadata,lower-affine,convert-complex-to-llvm,func.func(convert-math-to-llvm),"
    "convert-math-to-libm,convert-vector-to-llvm,convert-ub-to-llvm,finalize-memref-to-llvm,convert-arith-to-llvm,"
    "convert-func-to-llvm,convert-cf-to-llvm,convert-index-to-llvm,reconcile-unrealized-casts)"
)
TENSORS = (
    "one-shot-bufferize{bufferize-function-boundaries allow-return-allocs-from-loops "
    "function-boundary-type-conversion=identity-layout-map},"
)


class Refused(Exception):
    """The compiler refuses the function, with a message."""


def split(text):
    """The parts of a list between commas that stand in no brackets."""
    parts, depth, last = [], 0, 0
    for i, c in enumerate(text):
        if c in "<([{":
            depth += 1
        elif c in ">)]}" and text[i - 1 : i] != "-":
            depth -= 1
        elif c == "," and depth == 0:
            parts.append(text[last:i])
            last = i + 1
    parts.append(text[last:])
    return [part.strip() for part in parts if part.strip()]


def signature(text, name):
    """The types of the arguments and results of a function in printed IR, and its attributes."""
    start = re.search(rf"func\.func (?:\w+ )?@{name}\(", text).end()
    depth, end = 1, start
    while depth:
        depth += {"(": 1, ")": -1}.get(text[end], 0)
        end += 1
    inputs = [
        part.split(": ", 1)[1] if part.startswith("%") else part
        for part in split(text[start : end - 1])
    ]
    line = text[end : text.index("\n", end)]
    attributes = ""
    if "attributes {" in line:
        line, attributes = line.split("attributes {", 1)
    results = []
    if "->" in line:
        found = line.split("->", 1)[1].strip().rstrip("{").strip()
        results = split(found[1:-1]) if found.startswith("(") else [found]
    return inputs, results, attributes


class Type:
    """A number, or an array with its shape."""

    def __init__(self, text):
        match = re.match(r"(memref|tensor)<((?:[\d?]+x)*)(.+?)(?:, .*)?>$", text)
        self.is_array = bool(match)
        self.element = text
        self.shape = ()
        if match:
            self.element = match[3]
            self.shape = tuple(DYNAMIC if d == "?" else int(d) for d in match[2].split("x") if d)
        self.is_float = "f" in self.element
        # Records may hold vectors, which the host hands on as they are.
        self.dtype = ELEMENTS.get(self.element)

    def random(self, rng):
        if not self.is_float:
            return np.full(self.shape, 3, self.dtype)
        value = rng.uniform(0.4, 1.6, self.shape) * rng.choice([-1, 1], self.shape)
        if np.issubdtype(self.dtype, np.complexfloating):
            value = value + 1j * rng.uniform(0.4, 1.6, self.shape)
        return np.asarray(value, self.dtype)

    def descriptor(self, array):
        fields = [("base", ctypes.c_void_p), ("data", ctypes.c_void_p), ("offset", ctypes.c_int64)]
        rank = len(self.shape)
        if rank:
            fields += [("sizes", ctypes.c_int64 * rank), ("strides", ctypes.c_int64 * rank)]
        kind = type("Descriptor", (ctypes.Structure,), {"_fields_": fields})
        made = kind()
        if array is not None:
            made.base = made.data = array.ctypes.data
            for i in range(rank):
                made.sizes[i] = array.shape[i]
                made.strides[i] = array.strides[i] // array.itemsize
        return made


def translate(tools, text, directory, name):
    """Writes a module as LLVM IR."""
    if "@plain(" in text:
        # No stock pass lowers the function, which another one stands for.
        text = re.sub(r"^( *)func\.func @f\(.*?^\1}\n", "", text, flags=re.S | re.M)
    tensors = TENSORS if "tensor<" in text else ""
    (directory / f"{name}.mlir").write_text(text)
    lowered = subprocess.run(
        [
            tools.mlir_opt,
            f"--pass-pipeline={LOWER.format(tensors=tensors)}",
            directory / f"{name}.mlir",
        ],
        capture_output=True,
        text=True,
    )
    if lowered.returncode:
        raise RuntimeError("stock lowering: " + lowered.stderr.splitlines()[0])
    translated = subprocess.run(
        [tools.translate, "--mlir-to-llvmir"], input=lowered.stdout, capture_output=True, text=True
    )
    if translated.returncode:
        raise RuntimeError("translation: " + translated.stderr.splitlines()[0])
    printer = "\ndefine void @_mlir_ciface_printF64(double %x) {\n  ret void\n}\n"
    uses_printer = "declare void @_mlir_ciface_printF64" in translated.stdout
    code = re.sub(r"declare void @_mlir_ciface_printF64.*\n", "", translated.stdout)
    (directory / f"{name}.ll").write_text(code + printer if uses_printer else code)


def build(tools, directory, name, level="-O1"):
    """A shared library of a file of LLVM IR."""
    library = directory / f"lib{name}{level}.so"
    utilities = Path(tools.llvm_lib)
    subprocess.run(
        [
            tools.clang,
            "-shared",
            "-fPIC",
            level,
            "-Wno-override-module",
            directory / f"{name}.ll",
            "-o",
            library,
        ]
        + [f"-Wl,-rpath,{utilities}", f"-L{utilities}", "-lmlir_c_runner_utils", "-lm"],
        check=True,
        capture_output=True,
    )
    return ctypes.CDLL(str(library))


def lower(tools, text, directory, name):
    """A shared library of a module."""
    translate(tools, text, directory, name)
    return build(tools, directory, name)


def call(library, name, types, results, values):
    """Calls a function, which may change arrays among the values. Returns its results."""
    function = getattr(library, f"_mlir_ciface_{name}")
    keep, given = [], []
    made = None
    if any(r.is_array for r in results) or len(results) > 1:
        fields = [
            (f"r{i}", type(r.descriptor(None)) if r.is_array else CTYPES[r.element])
            for i, r in enumerate(results)
        ]
        made = type("Results", (ctypes.Structure,), {"_fields_": fields})()
        given.append(ctypes.byref(made))
    for kind, value in zip(types, values, strict=True):
        if kind.is_array:
            keep.append(kind.descriptor(value))
            given.append(ctypes.byref(keep[-1]))
        else:
            given.append(CTYPES[kind.element](value.item()))
    function.restype = None if made or not results else CTYPES[results[0].element]
    returned = function(*given)
    if made is None:
        return [np.asarray(returned, results[0].dtype)] if results else []
    out = []
    for i, r in enumerate(results):
        field = getattr(made, f"r{i}")
        if not r.is_array:
            out.append(np.asarray(field, r.dtype))
            continue
        count = int(np.prod(r.shape))
        raw = (ctypes.c_char * (count * np.dtype(r.dtype).itemsize)).from_address(field.data)
        out.append(np.frombuffer(raw, r.dtype, count).reshape(r.shape).copy())
    return out


def differentiate(tools, path, flag):
    """The module with the derivative, or an error."""
    run = subprocess.run(
        [tools.tai_opt, *flag.split(), path], capture_output=True, text=True, timeout=100
    )
    if run.returncode:
        lines = [
            line for line in run.stderr.splitlines() if ": error:" in line or ": note:" in line
        ]
        raise Refused(
            " | ".join(re.sub(r"^\S*?([^/]+\.mlir)", r"\1", line) for line in lines[:4]) or "crash"
        )
    return run.stdout


def inner(a, b):
    """The inner product of two lists of arrays; complex numbers are pairs."""
    return sum(
        float(np.sum((np.conj(x.astype(np.complex128)) * y.astype(np.complex128)).real))
        for x, y in zip(a, b)
    )


class Function:
    """`@f` of a file, as a map from the floats before it to those after it."""

    def __init__(self, tools, path, directory):
        text = path.read_text()
        self.inputs, self.results, attributes = (
            [Type(t) for t in signature(text, "f")[0]],
            [Type(t) for t in signature(text, "f")[1]],
            signature(text, "f")[2],
        )
        self.is_tensor = "tensor<" in "".join(signature(text, "f")[0])
        # `// Tolerance: 0.01`, of a function whose numbers have few digits.
        given = re.search(r"^// Tolerance: (\S+)$", text, re.M)
        self.tolerance = float(given[1]) if given else None
        plain = re.sub(r"tai\.[\w]+( = (array<[^>]*>|@\w+|\d+ : i64))?,? ?", "", text)
        plain = re.sub(r"attributes \{,? ?\}", "", plain).replace(", }", "}")
        self.name = "plain" if "@plain(" in text else "f"
        self.library = lower(tools, plain, directory, "primal")
        found = re.search(r"tai\.gradients = array<i64: ([^>]*)>", attributes)
        self.positions = [int(i) for i in found[1].split(",")] if found else None
        count = len(self.inputs)
        if self.positions is None:
            self.wrt = [i for i, t in enumerate(self.inputs) if t.is_array and t.is_float]
            self.of = [i for i, t in enumerate(self.results) if t.is_float]
        else:
            self.wrt = [i for i in self.positions if i < count]
            self.of = [i - count for i in self.positions if i >= count]

    def run(self, before):
        values = [v.copy() for v in before]
        results = call(self.library, self.name, self.inputs, self.results, values)
        return values, results

    def outputs(self, before):
        values, results = self.run(before)
        arrays = [] if self.is_tensor else [values[i] for i in self.wrt if self.inputs[i].is_array]
        return arrays + [results[i] for i in self.of]

    def directional(self, before, direction):
        """The derivative of the outputs in a direction of the inputs, of the fourth order."""
        single = any(t.element in ("f32", "complex<f32>") for t in self.inputs)
        h = 1e-2 if single else 2e-4

        def at(step):
            moved = [v.copy() for v in before]
            for i, d in zip(self.wrt, direction):
                moved[i] = np.array(moved[i] + step * d, moved[i].dtype)
            return [o.astype(np.complex128) for o in self.outputs(moved)]

        terms = zip(at(h), at(-h), at(2 * h), at(-2 * h))
        return [(8 * (a - b) - (c - d)) / (12 * h) for a, b, c, d in terms], (
            self.tolerance or (3e-3 if single else 2e-7)
        )


def compare(got, wanted, tolerance, what):
    scale = max(1.0, abs(wanted))
    if not np.isfinite(got) or abs(got - wanted) > tolerance * scale:
        raise AssertionError(f"wrong: {what} is {got:.9g}, differences say {wanted:.9g}")


def check_no_tai(text, name):
    body = re.search(rf"func\.func (?:\w+ )?@{name}\(.*?\n  }}\n", text, re.S)
    found = set(re.findall(r"\b(tai(?:_\w+)?\.\w+)(?= )", body[0].split("\n", 1)[1]))
    if found:
        raise AssertionError(f"wrong: {name} has ops of tai: {', '.join(sorted(found))}")


def check_reverse(tools, path, directory, function, rng):
    text = differentiate(tools, path, tools.reverse)
    inputs, results, attributes = signature(text, "f_grad")
    check_no_tai(text, "f_grad")
    library = lower(tools, text, directory, "reverse")
    types, returned = [Type(t) for t in inputs], [Type(t) for t in results]
    found = re.search(r"tai\.reads_before = array<i64(?:: ([^>]*))?>", attributes)
    restored = [int(i) for i in (found[1] or "").split(",") if i] if found else []
    for _ in range(3):
        before = [t.random(rng) for t in function.inputs]
        after, _ = function.run(before)
        # Stock bufferization lets a function of tensors reuse their memory.
        restored = range(len(before)) if function.is_tensor else restored
        given = [(before if i in restored else after)[i].copy() for i in range(len(before))]
        count = len(function.inputs)
        seeds = [t.random(rng) for t in types[count:]]
        state = [g.copy() for g in given]
        kept = [s.copy() for s in seeds]
        made = call(library, "f_grad", types, returned, state + kept)
        for i, (s, g) in enumerate(zip(state, given)):
            if not np.array_equal(s, g):
                raise AssertionError(f"wrong: the gradient changes argument {i}")
        direction = [function.inputs[i].random(rng) for i in function.wrt]
        moved, tolerance = function.directional(before, direction)
        if function.is_tensor:
            gradients, weights, constant = made, seeds, []
        else:
            n = len(function.wrt)
            gradients = kept[:n]
            arrays = [k for k in range(n) if function.inputs[function.wrt[k]].is_array]
            weights = [seeds[k] for k in arrays] + seeds[n:]
            # The adjoint of a number is added to.
            constant = [(seeds[k], direction[k]) for k in range(n) if k not in arrays]
        got = inner(gradients, direction) - sum(inner([s], [d]) for s, d in constant)
        compare(got, inner(weights, moved), tolerance, "the gradient")


def check_forward(tools, path, directory, function, rng):
    text = differentiate(tools, path, tools.forward)
    inputs, results, _ = signature(text, "f_fwd")
    check_no_tai(text, "f_fwd")
    library = lower(tools, text, directory, "forward")
    types, returned = [Type(t) for t in inputs], [Type(t) for t in results]
    count = len(function.inputs)
    for _ in range(3):
        before = [t.random(rng) for t in function.inputs]
        after, primal = function.run(before)
        direction = [function.inputs[i].random(rng) for i in function.wrt]
        moved, tolerance = function.directional(before, direction)
        state = [b.copy() for b in before]
        tangents = [d.copy() for d in direction]
        extra = [np.zeros(t.shape, t.dtype) for t in types[count + len(tangents) :]]
        made = call(library, "f_fwd", types, returned, state + tangents + extra)
        arrays = (
            []
            if function.is_tensor
            else [tangents[k] for k, i in enumerate(function.wrt) if function.inputs[i].is_array]
        )
        if function.is_tensor:
            # Results without floats are left out.
            primal = [primal[i] for i in function.of]
        is_returned = function.is_tensor or function.positions is not None
        got = arrays + (made[len(primal) :] if is_returned else extra)
        values = ([] if function.is_tensor else state) + made[: len(primal)]
        for value, wanted in zip(values, ([] if function.is_tensor else after) + primal):
            near = function.tolerance or 1e-5
            if not np.allclose(value, wanted, rtol=near, atol=near / 10):
                raise AssertionError("wrong: the tangent computes other values than the function")
        weights = [np.asarray(rng.uniform(-1, 1, m.shape)) for m in moved]
        compare(inner(weights, got), inner(weights, moved), tolerance, "the tangent")


def check_split(tools, path, directory, function, rng):
    """The augmented function, then the reverse with the tape of the first."""
    source = directory / "split_source.mlir"
    text = path.read_text()
    source.write_text(re.sub(r"(func\.func @f\([^{]*\{)", r"\1tai.split, ", text, count=1))
    text = differentiate(tools, source, tools.reverse)
    types, returned, _ = signature(text, "f_augmented")
    reversed_types, none, _ = signature(text, "f_reverse")
    for name in ("f_augmented", "f_reverse"):
        check_no_tai(text, name)
    library = lower(tools, text, directory, "split")
    inputs = [Type(t) for t in types]
    results = [Type(t) for t in returned]
    count, own = len(inputs), len(function.results)
    shadows = [Type(t) for t in reversed_types[count : len(reversed_types) - len(results) + own]]
    if none:
        raise AssertionError("wrong: the reverse returns something")
    for _ in range(3):
        before = [t.random(rng) for t in inputs]
        after, primal = function.run(before)
        state = [b.copy() for b in before]
        fields = [
            (f"r{i}", type(t.descriptor(None)) if t.is_array else CTYPES[t.element])
            for i, t in enumerate(results)
        ]
        made = type("Results", (ctypes.Structure,), {"_fields_": fields})()
        augmented = library._mlir_ciface_f_augmented
        descriptors = [t.descriptor(v) if t.is_array else v for t, v in zip(inputs, state)]

        def pass_on(kinds, values):
            return [
                ctypes.byref(v) if t.is_array else CTYPES[t.element](v.item())
                for t, v in zip(kinds, values, strict=True)
            ]

        single = len(results) == 1 and not results[0].is_array
        augmented.restype = CTYPES[results[0].element] if single else None
        out = [ctypes.byref(made)] if results and not single else []
        got = augmented(*out, *pass_on(inputs, descriptors))
        values = [got] if single else [getattr(made, name) for name, _ in fields]
        for value, wanted in zip(state + values[:own], after + primal):
            if not np.allclose(value, wanted, rtol=1e-5, atol=1e-6):
                raise AssertionError("wrong: the augmented function computes other values")
        for value, old in zip(state, before):
            # The host may reuse memory that the function has written.
            value[...] = np.where(value == old, value, np.asarray(77, value.dtype))
        seeds = [t.random(rng) for t in shadows]
        kept = [s.copy() for s in seeds]
        kinds = inputs + shadows + results[own:]
        arguments = descriptors + [t.descriptor(v) for t, v in zip(shadows, kept)] + values[own:]
        library._mlir_ciface_f_reverse(*pass_on(kinds, arguments))
        direction = [function.inputs[i].random(rng) for i in function.wrt]
        moved, tolerance = function.directional(before, direction)
        n = len(function.wrt)
        arrays = [k for k in range(n) if function.inputs[function.wrt[k]].is_array]
        weights = [seeds[k] for k in arrays] + seeds[n:]
        constant = [(seeds[k], direction[k]) for k in range(n) if k not in arrays]
        total = inner(kept[:n], direction) - sum(inner([s], [d]) for s, d in constant)
        compare(total, inner(weights, moved), tolerance, "the gradient in two functions")


def check(tools, path):
    lines = {}
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        function = None
        modes = {"reverse": check_reverse, "forward": check_forward, "split": check_split}
        for mode, run in modes.items():
            if tools.mode != mode and not (tools.mode == "both" and mode != "split"):
                continue
            try:
                function = function or Function(tools, path, directory)
                run(tools, path, directory, function, np.random.default_rng(1))
                lines[mode] = "right"
            except Refused as error:
                lines[mode] = f"refused: {error}"
            except (AssertionError, RuntimeError) as error:
                lines[mode] = str(error)
            except Exception as error:
                lines[mode] = f"wrong: {type(error).__name__}: {error}"
    return lines


def parse(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tai-opt", required=True)
    parser.add_argument("--llvm-bin", required=True)
    parser.add_argument("--mode", default="both", choices=["reverse", "forward", "split", "both"])
    parser.add_argument("--reverse", default="--tai-autodiff")
    parser.add_argument("--forward", default="--tai-autodiff-forward")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("files", nargs="*", type=Path)
    tools = parser.parse_args(arguments)
    tools.mlir_opt, tools.translate = (
        f"{tools.llvm_bin}/mlir-opt",
        f"{tools.llvm_bin}/mlir-translate",
    )
    tools.clang, tools.llvm_lib = (
        f"{tools.llvm_bin}/clang",
        os.path.realpath(f"{tools.llvm_bin}/../lib"),
    )
    tools.files = tools.files or sorted(HERE.glob("*.mlir"))
    return tools


def run(arguments):
    """The outcome of each file, by its name and mode."""
    tools = parse(arguments)
    with ThreadPoolExecutor(tools.jobs) as pool:
        return {
            path.stem: lines
            for path, lines in zip(tools.files, pool.map(lambda p: check(tools, p), tools.files))
        }


def main():
    outcomes = run(sys.argv[1:])
    for name, lines in outcomes.items():
        for mode, line in lines.items():
            print(f"{name} {mode}: {line}")
    every = [(mode, line) for lines in outcomes.values() for mode, line in lines.items()]
    for mode in ("reverse", "forward", "split"):
        said = [line for m, line in every if m == mode]
        if not said:
            continue
        counts = {k: sum(line.startswith(k) for line in said) for k in ("right", "refused")}
        print(
            f"{mode}: {counts['right']} right, {counts['refused']} refused, of {len(said)}",
            file=sys.stderr,
        )
    sys.exit(any(not line.startswith(("right", "refused")) for _, line in every))


if __name__ == "__main__":
    main()
