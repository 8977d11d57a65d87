"""R3: random modules mean the same to the optimiser, to a GPU and to the interpreter.

    python test/reliability/r3_modules.py --one 17         # one module: its text, what differs

Each module runs on the CPU at -O0 and at -O3 with several threads, on the emulated GPU, and in
the interpreter, with the verifiers of MLIR and LLVM after every pass. Every field must hold the
same bits afterwards (any NaN is as good as another), and every level the same active cells.
Functions that are not exact may be off by some units in the last place; see random_modules.py.

A process that dies or hangs is a crash of the seed it was at.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import re
import select
import subprocess
import sys
import tempfile
import time

import numpy as np
import random_modules
from bars import Bar, build_folder, seconds_of

# Units in the last place for `near_…`, and relative error for `loose_…`.
NEAR = {"f16": 2, "f32": 4, "f64": 4}
LOOSE = {"f32": 2e-5, "f64": 1e-13}
DTYPES = {"i1": np.uint8, "i8": np.int8, "i16": np.int16, "i32": np.int32, "i64": np.int64,
          "f16": np.float16, "bf16": np.uint16, "f32": np.float32, "f64": np.float64}  # fmt: skip
# All other configurations are compared with the first one. Sums of floats are exact, and products
# keep their value only if nothing is contracted: in deterministic mode.
CONFIGURATIONS: dict[str, dict[str, str]] = {
    "interpreter": {"arch": "interpreter"},
    "interpreter-shuffled": {"arch": "interpreter", "order_seed": "7"},
    "O0": {"opt_level": "0", "threads": "1", "deterministic": "true"},
    "O3": {"opt_level": "3", "threads": "3", "deterministic": "true"},
    "O3-default": {"opt_level": "3", "threads": "2"},
    "emulated": {"arch": "cuda", "opt_level": "3", "deterministic": "true"},
    "cuda": {"arch": "cuda", "opt_level": "3", "deterministic": "true"},
}
# Messages of modules that are refused, rightly: a constant operation is known to fail.
REFUSALS = ("divided by zero", "is divided by -1")


class Error(ctypes.Structure):
    _fields_ = [("kind", ctypes.c_int), ("message", ctypes.c_char_p), ("file", ctypes.c_char_p),
                ("line", ctypes.c_int), ("column", ctypes.c_int),
                ("diagnostics", ctypes.c_char_p)]  # fmt: skip


class Refused(Exception):
    """A call of the library failed."""


def load_library() -> ctypes.CDLL:
    library = ctypes.CDLL(str(build_folder() / "lib" / "libtai.so"))
    library.taiContextCreate.restype = ctypes.c_void_p
    library.taiContextLastError.restype = Error
    library.taiContextLastError.argtypes = [ctypes.c_void_p]
    return library


class Context:
    """One configuration, in which module after module runs."""

    def __init__(self, library: ctypes.CDLL, options: dict[str, str]):
        self.library = library
        self.handle = ctypes.c_void_p(library.taiContextCreate())
        self.call("taiContextSetOption", b"cache_dir", b"")
        for name, value in options.items():
            self.call("taiContextSetOption", name.encode(), value.encode())

    def call(self, name: str, *arguments) -> None:
        if getattr(self.library, name)(self.handle, *arguments):
            self.fail()

    def fail(self) -> None:
        error = self.library.taiContextLastError(self.handle)
        raise Refused((error.diagnostics or error.message or b"").decode())

    def check(self, status: int) -> None:
        if status:
            self.fail()

    def run(self, module: random_modules.Module, inputs: dict[str, np.ndarray]) -> dict:
        """The elements of each field, and the active cells, after a launch."""
        library = self.library
        kernel = ctypes.c_void_p()
        made: list[str] = []
        handles: dict[str, ctypes.c_void_p] = {}
        try:
            for name, layout in module.trees.items():
                self.call("taiContextAddTree", name.encode(), layout.encode())
                made.append(name)
            for f in module.fields:
                handle = ctypes.c_void_p()
                self.call(
                    "taiContextAddField", module.declaration(f).encode(), ctypes.byref(handle)
                )
                handles[f.name] = handle
            for name, array in inputs.items():
                status = library.taiFieldCopyFromHost(
                    handles[name], array.ctypes.data_as(ctypes.c_void_p)
                )
                self.check(status)
            self.call("taiKernelParse", module.kernel().encode(), b"module.mlir", b"k",
                      ctypes.byref(kernel))  # fmt: skip
            slots = (ctypes.c_uint64 * max(1, len(module.arguments)))()
            for i, (type_, value) in enumerate(module.arguments):
                dtype = np.int64 if type_ == "index" else DTYPES[type_]
                raw = np.array(value).astype(dtype).tobytes()
                slots[i] = int.from_bytes(raw.ljust(8, b"\0"), "little")
            status = library.taiKernelLaunch(
                kernel, slots, ctypes.c_int64(len(module.arguments)), None
            )
            self.check(status)
            self.call("taiContextSynchronize")
            return self.contents(module, handles)
        finally:
            if kernel:
                library.taiKernelDestroy(kernel)
            for name in reversed(made):
                library.taiContextDestroyTree(self.handle, name.encode())

    def contents(self, module: random_modules.Module, handles: dict) -> dict:
        found: dict[str, np.ndarray] = {}
        for f in module.fields:
            shape, scalar = random_modules.split(f.type)
            array = np.zeros((*f.shape, *shape), DTYPES[scalar])
            self.check(
                self.library.taiFieldCopyToHost(
                    handles[f.name], array.ctypes.data_as(ctypes.c_void_p)
                )
            )
            found[f.name] = array
        for name, layout in module.trees.items():
            sparse = len(re.findall("pointer|bitmasked|hash|dynamic", layout))
            for level in range(sparse):
                info = (ctypes.c_int64 * 16)()
                self.call("taiContextGetSparseLevel", name.encode(), ctypes.c_int64(level), info)
                count = info[2]
                cells = np.zeros(count, np.int64)
                self.call("taiContextGetActiveCells", name.encode(), ctypes.c_int64(level),
                          cells.ctypes.data_as(ctypes.c_void_p), ctypes.c_int64(count))  # fmt: skip
                found[f"cells of level {level} of {name}"] = cells
        return found


def make_inputs(module: random_modules.Module) -> dict[str, np.ndarray]:
    """The fields before the launch: corner cases among the rest. Some stay zero."""
    rng = np.random.default_rng(module.seed)
    inputs = {}
    for f in module.fields:
        if f.is_list or (f.use in ("near", "loose")) or rng.random() < 0.15:
            continue
        shape, scalar = random_modules.split(f.type)
        shape = (*f.shape, *shape)
        if scalar == "i1":
            array = rng.integers(0, 2, shape).astype(np.uint8)
        elif scalar in random_modules.INTS:
            info = np.iinfo(DTYPES[scalar])
            array = rng.integers(info.min, info.max, shape, dtype=DTYPES[scalar], endpoint=True)
            corners = np.array([0, 1, -1, info.min, info.max, 2, -2, 7], dtype=DTYPES[scalar])
            array = np.where(rng.random(shape) < 0.6, rng.choice(corners, shape), array)
        elif f.use == "atomic" and f.kind in ("add", "sub"):
            array = rng.integers(-1, 2, shape).astype(np.float32)
        else:
            corners = np.array([0, -0.0, 1, -1, 0.5, -2.5, 3, 1e-5, 6e4, np.inf, -np.inf, np.nan,
                                1e-40, 2.0**31, -(2.0**31), 2.0**63, 255.5])  # fmt: skip
            array = rng.normal(0, 3, shape)
            array = np.where(rng.random(shape) < 0.4, rng.choice(corners, shape), array)
        if scalar == "bf16":
            array = np.where(np.abs(array) < 1e-30, 0, array)
            array = (np.ascontiguousarray(array, np.float32).view(np.uint32) >> 16).astype(
                np.uint16
            )
        with np.errstate(all="ignore"):
            inputs[f.name] = np.ascontiguousarray(array.astype(DTYPES[scalar]))
    return inputs


def ordered(array: np.ndarray) -> np.ndarray:
    """Floats as integers of which neighbours differ by one."""
    kind = {2: np.int16, 4: np.int32, 8: np.int64}[array.dtype.itemsize]
    bits = array.view(kind).astype(np.float64 if kind != np.int64 else np.longdouble)
    least = float(np.iinfo(kind).min)
    return np.where(bits < 0, least - bits, bits)


def differs(f: random_modules.Field | None, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where two results are not the same."""
    if a.shape != b.shape:
        return np.ones(1, bool)
    if f is None:
        return a != b
    scalar = random_modules.split(f.type)[1]
    if scalar == "bf16":
        nan = ((a & 0x7FFF) > 0x7F80) & ((b & 0x7FFF) > 0x7F80)
        # Denormals of bf16 are zero to some processors.
        tiny = ((a & 0x7FFF) < 0x80) & ((b & 0x7FFF) < 0x80)
        return (a != b) & ~nan & ~tiny
    if scalar not in random_modules.FLOATS:
        return a != b
    nan = np.isnan(a) & np.isnan(b)
    if f.use == "near":
        with np.errstate(all="ignore"):
            return ~(nan | (np.abs(ordered(a) - ordered(b)) <= NEAR[scalar]))
    if f.use == "loose":
        with np.errstate(all="ignore"):
            return ~(nan | (a == b) | (np.abs(a - b) <= LOOSE[scalar] * np.maximum(1, np.abs(a))))
    bits = {2: np.int16, 4: np.int32, 8: np.int64}[a.dtype.itemsize]
    return (a.view(bits) != b.view(bits)) & ~nan


class Judge:
    """Runs modules in all configurations."""

    def __init__(self, names: list[str]):
        self.library = load_library()
        self.contexts: dict[str, Context] = {}
        emulation = {"emulated": "1", "cuda": os.environ.get("TAI_CUDA_EMULATION", "")}
        for name in names:
            os.environ["TAI_CUDA_EMULATION"] = emulation.get(name, "")
            self.contexts[name] = Context(self.library, CONFIGURATIONS[name])

    def judge(self, seed: int) -> dict:
        """{"seed", "kind": same, refused, MISMATCH or ERROR, "detail"}."""
        module = random_modules.make(seed)
        inputs = make_inputs(module)
        results: dict[str, dict] = {}
        errors: dict[str, str] = {}
        for name, context in self.contexts.items():
            if name == "O3-default" and module.contracts:
                continue
            try:
                results[name] = context.run(module, inputs)
            except Refused as error:
                errors[name] = str(error).strip()
        if errors and all(any(r in e for r in REFUSALS) for e in errors.values()):
            if "interpreter" not in errors:
                return {"seed": seed, "kind": "refused", "detail": ""}
        if errors:
            lines = [f"{name}: {text[:600]}" for name, text in errors.items()]
            return {"seed": seed, "kind": "ERROR", "detail": "\n".join(lines)}
        expected = results.pop(next(iter(self.contexts)))
        fields = {f.name: f for f in module.fields}
        lines = []
        for name, found in results.items():
            for key, value in found.items():
                wrong = differs(fields.get(key), expected[key], value)
                if not wrong.any():
                    continue
                at = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(wrong)))
                shown = [np.atleast_1d(x)[at] if x.shape == wrong.shape else x.shape
                         for x in (expected[key], value)]  # fmt: skip
                type_ = fields[key].type if key in fields else ""
                lines.append(
                    f"{name}: {key} {type_} differs in {int(wrong.sum())} places, "
                    f"first at {list(at)}: {shown[1]!r}, interpreted {shown[0]!r}"
                )
        kind = "MISMATCH" if lines else "same"
        return {"seed": seed, "kind": kind, "detail": "\n".join(lines)}


def work(args: argparse.Namespace) -> int:
    """Judges seeds from standard input, one answer a line; what starts a seed is said first."""
    judge = Judge(args.configurations)
    for line in sys.stdin:
        seed = int(line)
        try:
            row = judge.judge(seed)
        except Exception as error:  # noqa: BLE001
            row = {"seed": seed, "kind": "ERROR", "detail": f"in the script: {error!r}"}
        sys.__stdout__.write(json.dumps(row) + "\n")
        sys.__stdout__.flush()
    return 0


class Worker:
    """A process that judges one seed after another."""

    def __init__(self, args: argparse.Namespace):
        command = [sys.executable, __file__, "--worker", "--configurations", *args.configurations]
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115, it lives as long as the process
        environment = {**os.environ, "TAI_VERIFY_EACH": "1", "TAI_CACHE_DIR": ""}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            env=environment,
        )  # fmt: skip
        os.set_blocking(self.process.stdout.fileno(), False)
        self.seed: int | None = None
        self.since = self.worked = 0.0
        self.text = b""

    def give(self, seed: int) -> None:
        self.seed, self.since = seed, time.monotonic()
        self.worked = seconds_of(self.process.pid)
        self.process.stdin.write(b"%d\n" % seed)
        self.process.stdin.flush()

    def answer(self, limit: float) -> dict | None:
        """The outcome of the seed, if it is there."""
        self.text += self.process.stdout.read() or b""
        if b"\n" in self.text:
            line, self.text = self.text.split(b"\n", 1)
            return json.loads(line)
        if self.process.poll() is not None:
            self.errors.seek(0)
            said = self.errors.read()[-800:]
            detail = f"the process ended with {self.process.returncode}\n{said}"
            return {"seed": self.seed, "kind": "CRASH", "detail": detail}
        if self.hangs(limit):
            self.process.kill()
            self.process.wait()
            return {"seed": self.seed, "kind": "CRASH", "detail": f"hangs for {limit:.0f} s"}
        return None

    def hangs(self, limit: float) -> bool:
        """Whether a module has taken more than `limit` seconds of a processor.

        By the clock it may be many times as long: other programs may have the processors.
        """
        waited = time.monotonic() - self.since
        if waited < limit:
            return False
        return seconds_of(self.process.pid) - self.worked > limit or waited > 20 * limit

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.stdin.close()
            self.process.wait(30)
        self.errors.close()


def run(args: argparse.Namespace) -> list[dict]:
    """Judges the seeds in several processes."""
    seeds = iter(range(args.seed, args.seed + args.count))
    end = time.monotonic() + args.seconds
    rows: list[dict] = []
    workers = [Worker(args) for _ in range(args.jobs)]
    busy = True
    while busy:
        busy = False
        for i, worker in enumerate(workers):
            if worker.seed is None:
                seed = next(seeds, None) if time.monotonic() < end else None
                if seed is None:
                    continue
                worker.give(seed)
            busy = True
            row = worker.answer(args.limit)
            if row is None:
                continue
            rows.append(row)
            if row["kind"].isupper():
                print(f"seed {row['seed']}: {row['kind']}\n{row['detail']}", flush=True)
            worker.seed = None
            if row["kind"] == "CRASH":
                worker.end()
                workers[i] = Worker(args)
        if all(worker.seed is not None for worker in workers):
            select.select([worker.process.stdout for worker in workers], [], [], 0.1)
    for worker in workers:
        worker.end()
    return rows


def main() -> int:
    bar = Bar(
        "R3", "random modules", full=20_000, short=60, adds=True,
        archs=("emulated", "cuda"),
        target="20,000 modules: the same at -O0, at -O3, on a GPU and in the interpreter",
        miss="a module that gives other bits somewhere, an error, a crash or a hang",
    )  # fmt: skip
    add = bar.parser.add_argument
    add("--jobs", type=int, default=1, help="processes")
    add("--limit", type=float, default=60, help="seconds of computing until a module hangs")
    add("--one", type=int, help="run one module in this process, and print it")
    add("--configurations", nargs="+", choices=CONFIGURATIONS, help="all of a device without it")
    add("--worker", action="store_true", help=argparse.SUPPRESS)
    args = bar.parse()
    other = "cuda" if args.arch == "emulated" else "emulated"
    args.configurations = args.configurations or [c for c in CONFIGURATIONS if c != other]
    os.environ["TAI_BUILD_DIR"] = str(args.build)
    if args.worker:
        return work(args)
    if args.one is not None:
        os.environ["TAI_VERIFY_EACH"] = "1"
        print(random_modules.make(args.one).text())
        row = Judge(args.configurations).judge(args.one)
        print(f"seed {args.one}: {row['kind']}\n{row['detail']}")
        return 1 if row["kind"].isupper() else 0
    rows = run(args)
    kinds = [row["kind"] for row in rows]
    bad = sum(kind.isupper() for kind in kinds)
    bar.report(
        f"{len(rows)} modules",
        f"{kinds.count('MISMATCH')} mismatches, {kinds.count('ERROR')} errors, "
        f"{kinds.count('CRASH')} crashes, {kinds.count('refused')} refused",
        met=bool(rows) and not bad,
    )


if __name__ == "__main__":
    sys.exit(main())
