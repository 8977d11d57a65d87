"""R18: each internal failure writes one reproducer, and its path is in the error.

A failure is injected into each step from a kernel to code that runs. The error of the Python
program must name the one file that was written, and `tai-opt --run-reproducer` must fail on it
as the program did, or, where passes were not what failed, pass. The joined code of several kernels
of a device is LLVM IR, for `opt`.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from bars import ROOT, Bar, package_folder

PROGRAM = ROOT / "test/reliability/r18_program.py"
LLVM_BIN = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
# The launch of the program, its device, and the steps that are made to fail. A gradient is compiled
# while its kernel is linked, and both would fail there.
PASSES = ("lower", "lower-invalid")
CODE = ("translate", "optimize", "emit")
CASES = [
    *[("launch", "cpu", step) for step in (*PASSES, *CODE, "link")],
    *[("gradient", "cpu", step) for step in ("autodiff", "autodiff-invalid", *PASSES, *CODE)],
    *[("tangent", "cpu", step) for step in ("forward", "forward-invalid", *PASSES, *CODE, "link")],
    *[("launch", "emulated", step) for step in (*PASSES, *CODE, "link", "load")],
    *[("gradient", "emulated", step) for step in ("autodiff", *PASSES, *CODE, "load")],
    *[("program", "emulated", step) for step in ("optimize", "emit")],
    *[("clamp", "cpu", step) for step in ("clamp", "clamp-invalid")],
    *[("checks", "cpu", step) for step in ("checks", "checks-invalid")],
]


def start(what: str, arch: str, cache: Path, files: Path, step: str = "") -> str:
    """Runs the program; returns its output."""
    environment = os.environ | {
        "PYTHONPATH": str(package_folder()),
        "TAI_CACHE_DIR": str(cache),
        "TMPDIR": str(files),
        "TAI_VERIFY_EACH": "1",
        "TAI_INJECT_FAILURE": step,
        "TI_ARCH": "cpu" if arch == "cpu" else "cuda",
        "TAI_CUDA_EMULATION": "" if arch == "cpu" else "1",
    }
    command = [sys.executable, PROGRAM, what]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    if result.returncode != 0:
        raise RuntimeError(f"the program ended with {result.returncode}:\n{result.stderr}")
    return result.stdout


def judge(build: Path, what: str, arch: str, step: str) -> str:
    """The fault of the reproducer of a case, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        cache, files = Path(folder) / "cache", Path(folder) / "files"
        files.mkdir()
        # A gradient follows on a launch, whose code comes from the cache then.
        # So does the code of the kernels of a program.
        if what in ("gradient", "tangent", "program"):
            start("program" if what == "program" else "launch", arch, cache, files)
        error = start(what, arch, cache, files, step)
        written = sorted(files.glob("tai-reproducer*"))
        if len(written) != 1:
            return f"{len(written)} files were written:\n{error}"
        if not re.search(rf"reproducer: {re.escape(str(written[0]))}$", error, re.MULTILINE):
            return f"the error does not name {written[0]}:\n{error}"
        tool = [build / "bin/tai-opt", "--run-reproducer", written[0], "-o", os.devnull]
        if written[0].suffix == ".ll":
            tool = [LLVM_BIN / "opt", "--passes=default<O3>", written[0], "-o", os.devnull]
        result = subprocess.run(tool, capture_output=True, text=True)
        fails = step.split("-")[0] not in (*CODE, "link", "load")
        if result.returncode != int(fails):
            return f"{tool[0].name} ended with {result.returncode}:\n{result.stderr[:2000]}"
        if step.endswith("-invalid") and "expects parent op 'tai.kernel'" not in result.stderr:
            return f"tai-opt fails in another way:\n{result.stderr[:2000]}"
    return ""


def main() -> None:
    bar = Bar(
        "R18", "reproducers of internal failures", full=len(CASES), short=5,
        target="each internal failure writes one reproducer, whose path is in the error",
        miss="a failure without a file, without its name in the error, or that it does not show",
    )  # fmt: skip
    args = bar.parse()
    # Every so many, so that a short run has some of each kind.
    count = min(args.count, len(CASES))
    chosen = [CASES[(args.seed + i * len(CASES) // count) % len(CASES)] for i in range(count)]
    missing = 0
    for case in chosen:
        if problem := judge(args.build, *case):
            missing += 1
            print(f"{', '.join(case)}: {problem}", flush=True)
    bar.report(f"{count} failures injected", f"{missing} without", met=missing == 0)


if __name__ == "__main__":
    main()
