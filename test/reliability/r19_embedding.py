"""R19: tai in programs that hold more than tai.

Several contexts at once; an LLVM of another version in the process, before tai and after it; a
program with a static LLVM of its own, or with threads that each have an MLIRContext; the plugin in
a stock mlir-opt, next to other plugins; libraries that are built elsewhere against the headers of
tai. No case may meet an option or an object of another copy, and all must get right results.
"""

from __future__ import annotations

import ctypes
import glob
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from bars import ROOT, Bar

LLVM = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
FOREIGN = sorted(glob.glob("/usr/lib/*/libLLVM-1?.so.1"))

# Run in a process of its own; the gradient goes through all that is linked.
GRADIENT = """
import ctypes, os, sys
before, library = sys.argv[1] == "before", sys.argv[2]
load = lambda: ctypes.CDLL(library, ctypes.RTLD_GLOBAL)
if before: load()
import tai as ti
def run():
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, shape=8, needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    x.fill(3.0)
    with ti.ad.Tape(y):
        kernel(x, y)
    assert y[None] == 72.0 and x.grad.to_numpy().tolist() == [6.0] * 8
@ti.kernel
def kernel(x: ti.template(), y: ti.template()):
    for i in x:
        y[None] += x[i] ** 2
run()
other = load()
run()
other.LLVMContextCreate.restype = ctypes.c_void_p
assert other.LLVMContextCreate()
"""


def start(command: list[object], **options) -> str:
    """The fault of a command, or nothing."""
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True, **options)
    return f"ended with {run.returncode}:\n{run.stdout}{run.stderr}" if run.returncode else ""


def lit(build: Path, names: str) -> str:
    problem = start([sys.executable, LLVM / "lit", "-sv", f"--filter={names}", build / "test"])
    return problem


def contexts_of_one_process(build: Path) -> str:
    """Random modules with the same names, in turns, while other contexts come and go."""
    os.environ["TAI_BUILD_DIR"] = str(build)
    import random_modules
    from r3_modules import CONFIGURATIONS, Context, Refused, differs, load_library, make_inputs

    library = load_library()
    library.taiContextDestroy.argtypes = [ctypes.c_void_p]
    options = CONFIGURATIONS["O3"]
    kept = [Context(library, options) for _ in range(2)]
    for seed in range(12):
        module = random_modules.make(seed)
        inputs = make_inputs(module)
        passing = Context(library, options)
        try:
            results = [context.run(module, inputs) for context in (*kept, passing)]
        except Refused:
            continue
        finally:
            library.taiContextDestroy(passing.handle)
        fields = {f.name: f for f in module.fields}
        for found in results[1:]:
            for name, value in found.items():
                if differs(fields.get(name), results[0][name], value).any():
                    return f"module {seed}: {name} differs between contexts"
    return ""


def another_llvm(library: str, when: str) -> Callable[[Path], str]:
    def check(build: Path) -> str:
        with tempfile.NamedTemporaryFile("w", suffix=".py") as file:
            file.write(GRADIENT)
            file.flush()
            return start([sys.executable, file.name, when, library])

    check.__name__ = f"{Path(library).name} {when} tai"
    return check


def plugin_of_a_stock_tool(build: Path) -> str:
    return lit(build, "Tools/(plugin|foreign-ops-invalid)")


def c_api(build: Path) -> str:
    return lit(build, "CAPI/")


def libraries_from_outside(build: Path) -> str:
    return lit(build, "Downstream/")


def programs_with_llvm(build: Path) -> str:
    """The programs of embedding/, which CMake builds against the installed headers."""
    folder = build / "reliability/embedding"
    configure = ["cmake", "-G", "Ninja", "-S", ROOT / "test/reliability/embedding", "-B", folder,
                 f"-DTai_DIR={build}/lib/cmake/tai", "-DCMAKE_CXX_FLAGS=-O0",
                 "-DCMAKE_C_COMPILER=clang-22", "-DCMAKE_CXX_COMPILER=clang++-22"]  # fmt: skip
    return (
        start(configure)
        or start(["cmake", "--build", folder])
        or start([folder / "own_llvm", build / "lib/libtai.so"])
        or start([folder / "contexts", ROOT / "test/Tools/plugin.mlir"])
    )


QUICK: list[Callable[[Path], str]] = [
    contexts_of_one_process,
    plugin_of_a_stock_tool,
    c_api,
    *[another_llvm(library, when) for library in FOREIGN for when in ("before", "after")],
]
SLOW = [programs_with_llvm, libraries_from_outside]
# With two other versions of LLVM. The page of all bars does not depend on the machine.
FULL = 9


def main() -> None:
    bar = Bar(
        "R19", "tai inside other programs", full=FULL, short=len(QUICK),
        target="contexts, foreign LLVMs, a static LLVM, plugins, outside builds: all pass",
        miss="a program that does not build or start, aborts, or gets other results",
    )  # fmt: skip
    args = bar.parse()
    checks = [*QUICK, *SLOW]
    if args.count != FULL:
        checks = checks[: args.count]
    wrong = 0
    for check in checks:
        if problem := check(args.build):
            wrong += 1
            print(f"{check.__name__}: {problem[-3000:]}", flush=True)
    bar.report(
        f"{len(checks)} checks, {len(FOREIGN)} other versions of LLVM here",
        f"{wrong} failed", met=not wrong,
    )  # fmt: skip


if __name__ == "__main__":
    main()
