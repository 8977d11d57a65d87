"""Runs each pass and pipeline of tai-opt that upstream has not over a module.

The arguments: tai-opt, mlir-opt, the module without ops of tai, and code of tai
that is put beside it. No pass changes the module, neither on the whole of it
nor on its functions and inner modules. Beside code of tai, it stays as it is.
"""

import concurrent.futures
import re
import subprocess
import sys

TAI_OPT, UPSTREAM, FOREIGN, OURS = sys.argv[1:]
# The pipelines that bring every module of ours to an end.
COMPLETE = ["tai-autodiff", "tai-to-llvm", "tai-to-nvvm", "tai-autodiff,tai-to-llvm"]


def run(text: str, pipeline: str) -> subprocess.CompletedProcess:
    flags = ["-", "--allow-unregistered-dialect", "--mlir-print-debuginfo"]
    flags += ["--mlir-print-local-scope", f"--pass-pipeline={pipeline}"]
    return subprocess.run([TAI_OPT, *flags], input=text, capture_output=True, text=True)


def list_passes(tool: str) -> set[str]:
    """The passes and pipelines that a tool knows."""
    text = subprocess.run([tool, "--help"], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"^      --([a-z0-9-]+) ", text, re.MULTILINE))


def split(text: str) -> dict[str, str]:
    """The ops in the body of the module, by their names."""
    ops: dict[str, str] = {}
    op: list[str] = []
    for line in text.splitlines():
        if op and line[:3] != "   " and line[2:3] != "}" or line.startswith("}"):
            named = re.search(r"@(\w+)", op[0]) if op else None
            if named:
                ops[named[1]] = "\n".join(op)
            op = []
        if line.startswith("  "):
            op.append(line)
    return ops


def strip_locations(text: str) -> str:
    return re.sub(r" ?loc\((?:[^()\"]|\"[^\"]*\"|\([^()]*\))*\)", "", text)


def main() -> None:
    passes = sorted(list_passes(TAI_OPT) - list_passes(UPSTREAM))
    passes = [name for name in passes if "tai" in name]
    assert len(passes) > 45 and set(COMPLETE[:3]) <= set(passes), passes
    with open(FOREIGN) as file:
        foreign = file.read()
    # As large as the bodies that tai-simplify-huge-bodies takes.
    huge = ["  func.func @huge(%a0: f64) -> f64 {", "    %one = arith.constant 1.0 : f64"]
    huge += [f"    %a{i + 1} = arith.mulf %a{i}, %one : f64" for i in range(3000)]
    huge += ["    return %a3000 : f64", "  }", "}", ""]
    foreign = foreign.rstrip().removesuffix("}") + "\n".join(huge)
    with open(OURS) as file:
        mixed = foreign.rstrip().removesuffix("}") + file.read() + "}\n"
    plain = run(foreign, "builtin.module()")
    assert plain.returncode == 0, plain.stderr
    expected = split(strip_locations(plain.stdout))
    assert len(expected) > 25, list(expected)
    failures: list[str] = []
    scheduled = {"alone": 0, "nested": 0, "mixed": 0}

    def check_alone(pipeline: str, kind: str) -> None:
        result = run(foreign, pipeline)
        if "Can't add pass" in result.stderr:
            return
        scheduled[kind] += 1
        if result.returncode != 0:
            failures.append(f"{pipeline}: fails: {result.stderr[:500]}")
        elif result.stdout != plain.stdout:
            failures.append(f"{pipeline}: changes a module without ops of tai")

    def check_mixed(name: str) -> None:
        result = run(mixed, f"builtin.module({name})")
        if result.returncode != 0:
            # One step of a lowering by itself may ask for the steps before.
            if name in COMPLETE:
                failures.append(f"{name}: fails: {result.stderr[:500]}")
            return
        scheduled["mixed"] += 1
        after = split(strip_locations(result.stdout))
        for function, text in expected.items():
            if after.get(function) != text:
                failures.append(f"{name}: changes @{function}:\n{text}\n{after.get(function)}")

    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(check_alone, f"builtin.module({name})", "alone") for name in passes]
        for anchor in ["func.func", "llvm.func", "builtin.module", "gpu.module"]:
            for name in passes:
                pipeline = f"builtin.module({anchor}({name}))"
                jobs.append(pool.submit(check_alone, pipeline, "nested"))
        jobs += [pool.submit(check_mixed, name) for name in {*passes, *COMPLETE}]
        for job in jobs:
            job.result()
    print("\n".join(failures))
    print(scheduled)
    # Some run on kernels only.
    assert scheduled["alone"] > len(passes) - 4 and scheduled["nested"] > 80, scheduled
    assert scheduled["mixed"] > 30, scheduled
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
