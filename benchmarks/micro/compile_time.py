"""Compile time by the size of a loop body: a line for each shape and size.

    compile_time.py [--arch cpu|cuda] [--only SHAPE] [--sizes N,N] [--limit SECONDS] [--forward]

For each size: processor seconds to build the kernel, to compile it, and to compile its gradient (or
its forward mode), each with its growth since the previous size divided by the growth of the size:
1.0 is linear. Each size has a process of its own, which is killed at the limit.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import textwrap
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent

# The sources of a kernel for `n` statements. `x`, `y`: fields; `m`: one of matrices.
SHAPES = {}


def shape(*sizes: int):
    def keep(make):
        SHAPES[make.__name__] = (make, sizes)
        return make

    return keep


def kernel(body: str, before: str = "") -> str:
    return f"{before}\n@ti.kernel\ndef run():\n" + textwrap.indent(body, "    ")


def loop(lines: list[str], head: str = "for i in x:") -> str:
    return head + "\n" + "\n".join("    " + line for line in lines)


@shape(250, 500, 1000, 3000)
def chained(n):
    """Each statement uses the one before."""
    lines = ["c = x[i]", "b = c", *["b = ti.sin(b) * 1.0001 + c"] * n, "y[i] = b"]
    return kernel(loop(lines))


@shape(64, 256, 1024)
def unrolled_sum(n):
    """Terms of a sum in an unrolled loop."""
    lines = [
        "s = 0.0",
        f"for k in ti.static(range({n})):",
        "    s += ti.sin(x[i] * (k + 1)) * ti.exp(-x[i] * k) + ti.sqrt(x[i] + k)",
        "y[i] = s",
    ]
    return kernel(loop(lines))


@shape(64, 256, 1024)
def scalar_sum(n):
    """The same, added to one number by all iterations."""
    lines = [
        f"for k in ti.static(range({n})):",
        "    s[None] += ti.sin(x[i] * (k + 1)) * ti.exp(-x[i] * k) + ti.sqrt(x[i] + k)",
    ]
    return kernel(loop(lines))


@shape(100, 400, 1600)
def long_sum(n):
    """One expression."""
    return kernel(loop(["y[i] = " + " + ".join(f"x[i] * {k}.5" for k in range(n))]))


@shape(100, 400, 1600)
def stores(n):
    """Reads and writes of neighbours."""
    lines = [f"z[i, {k}] = z[i, {k + 1}] * x[i] + y[i]" for k in range(n)]
    return kernel(loop(lines))


@shape(100, 400, 1600)
def additions(n):
    """Atomic additions."""
    lines = [f"z[i, {k}] += y[i] * x[i] * {k}.5" for k in range(n)]
    return kernel(loop(lines))


@shape(50, 200, 400)
def elifs(n):
    """One branch for each of many cases."""
    lines = ["b = x[i]", "if b < 0.5:", "    b = b * 2.0"]
    for k in range(n):
        lines += [f"elif b < {k}.75:", f"    b = ti.sin(b) + {k}.0"]
    return kernel(loop([*lines, "y[i] = b"]))


@shape(100, 400, 1600)
def branches(n):
    """Branches one after the other."""
    lines = ["b = x[i]"]
    for k in range(n):
        lines += [f"if b < {k}.5:", f"    b = ti.sin(b) + {k}.0"]
    return kernel(loop([*lines, "y[i] = b"]))


@shape(50, 200, 800)
def loops(n):
    """Serial loops one after the other, in the body."""
    lines = ["b = x[i]"]
    for k in range(n):
        lines += [f"for _ in range({k + 3}):", "    b = ti.sin(b) + x[i]"]
    return kernel(loop([*lines, "y[i] = b"]))


@shape(50, 200, 800)
def loops_that_add(n):
    """Serial loops one after the other, each of which adds to a field."""
    lines = []
    for k in range(n):
        lines += [f"for j in range({k + 3}):", f"    y[i] += x[i] * {k}.5 + j"]
    return kernel(loop(lines))


@shape(50, 200, 800)
def parallel_loops(n):
    """Parallel loops one after the other, in the kernel."""
    return kernel("\n".join(f"for i in x:\n    z[i, {k}] = ti.sin(x[i]) * {k}.5" for k in range(n)))


@shape(100, 300, 1000)
def calls(n):
    """Calls of functions."""
    before = textwrap.dedent("""
        @ti.func
        def g(a, b):
            c = ti.sin(a)
            if c > 0.5:
                c = c * b
            return c

        @ti.func
        def f(a, b):
            return g(a, b) * 0.5 + g(b, a)
    """)
    lines = ["b = x[i]", f"for k in ti.static(range({n})):", "    b = f(b, x[i])", "y[i] = b"]
    return kernel(loop(lines), before)


@shape(4, 8, 12)
def matrices(n):
    """Products of n x n matrices."""
    before = f"""
m = ti.Matrix.field({n}, {n}, ti.f32, 16, needs_grad=True)
w = ti.Matrix.field({n}, {n}, ti.f32, 16, needs_grad=True)
"""
    return kernel(loop(["w[i] = m[i] @ m[i] @ m[i].transpose()"], "for i in m:"), before)


@shape(50, 200, 800)
def fields(n):
    """A field for each statement."""
    before = f"fs = [ti.field(ti.f32, 64, needs_grad=True) for _ in range({n})]"
    lines = [f"for k in ti.static(range({n} - 1)):", "    fs[k + 1][i] = fs[k][i] * x[i]"]
    return kernel(loop(lines), before)


@shape(250, 1000, 2000)
def static_range(n):
    """A long unrolled loop of cheap statements."""
    lines = ["b = x[i]", f"for k in ti.static(range({n})):", "    b = b * x[i] + k", "y[i] = b"]
    return kernel(loop(lines))


@shape(100, 400, 1600)
def serial(n):
    """Chained statements in a serial loop."""
    lines = ["b = x[i]", "for _ in range(10):"]
    lines += ["    b = ti.sin(b) * 1.0001 + x[i]"] * n
    return kernel(loop([*lines, "y[i] = b"]))


@shape(100, 400, 1600)
def variables(n):
    """All `n` numbers are alive at once."""
    lines = [f"v{k} = ti.sin(x[i] + {k}.0)" for k in range(n)]
    lines += [f"v{k} = v{k} * v{(k * 7 + 1) % n}" for k in range(n)]
    lines += ["b = 0.0", *[f"b += v{k}" for k in range(n)], "y[i] = b"]
    return kernel(loop(lines))


def child(name: str, n: int, arch: str, forward: bool, grad: bool) -> None:
    """Prints the seconds of one size."""
    import linecache

    import tai as ti

    options = json.loads(os.environ.get("TAI_BENCH_OPTIONS", "{}"))
    ti.init(
        arch=getattr(ti, arch),
        default_fp=ti.f32,
        cpu_max_num_threads=1,
        offline_cache=False,
        **options,
    )
    x = ti.field(ti.f32, 64, needs_grad=True)
    y = ti.field(ti.f32, 64, needs_grad=True)
    s = ti.field(ti.f32, (), needs_grad=True)
    scope = {"ti": ti, "x": x, "y": y, "s": s}
    text = SHAPES[name][0](n)
    if "z[" in text:
        scope["z"] = ti.field(ti.f32, (64, n + 1), needs_grad=True)
    lines = text.splitlines(keepends=True)
    linecache.cache["<kernel>"] = (len(text), None, lines, "<kernel>")
    exec(compile(text, "<kernel>", "exec"), scope)
    run = scope["run"]
    times = {}
    start = time.process_time()
    found = run._specialize([])
    times["build"] = time.process_time() - start
    print(json.dumps(times), flush=True)
    start = time.process_time()
    if forward:
        with ti.ad.FwdMode(loss=y, param=x, seed=[1.0] * 64):
            run()
        times["forward"] = time.process_time() - start
    else:
        found.core.compile(False)
        times["kernel"] = time.process_time() - start
        print(json.dumps(times), flush=True)
        start = time.process_time()
        if grad:
            found.core.compile(True)
            times["gradient"] = time.process_time() - start
    times["MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(times), flush=True)


def measure(name: str, n: int, chosen: argparse.Namespace) -> dict[str, float]:
    command = [sys.executable, __file__, "--child", name, "--sizes", str(n), "--arch", chosen.arch]
    command += ["--forward"] * chosen.forward + ["--no-gradient"] * chosen.no_gradient

    def limit():
        resource.setrlimit(resource.RLIMIT_CPU, (chosen.limit, chosen.limit))

    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    rows = [line for line in done.stdout.splitlines() if line.startswith("{")]
    times = json.loads(rows[-1]) if rows else {}
    if done.returncode > 0:
        print(done.stderr.strip().splitlines()[-3:])
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--arch", default="cpu")
    parser.add_argument("--only", default=",".join(SHAPES))
    parser.add_argument("--sizes")
    parser.add_argument("--limit", type=int, default=60)
    parser.add_argument("--forward", action="store_true")
    parser.add_argument("--no-gradient", action="store_true")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        child(chosen.child, int(chosen.sizes), chosen.arch, chosen.forward, not chosen.no_gradient)
        return
    columns = ["build", "forward"] if chosen.forward else ["build", "kernel", "gradient"]
    print(f"{'shape':<16}{'size':>6}", *(f"{c + ', s':>18}" for c in columns), f"{'MB':>7}")
    for name in chosen.only.split(","):
        sizes = [int(n) for n in chosen.sizes.split(",")] if chosen.sizes else SHAPES[name][1]
        before: dict[str, float] = {}
        last = 0
        for n in sizes:
            times = measure(name, n, chosen)
            cells = []
            for c in columns:
                if c not in times:
                    cells.append(f"over {chosen.limit}      ")
                    continue
                cell = f"{times[c]:.2f}"
                growth = "      "
                if c in before and before[c] > 0:
                    growth = f" x{times[c] / before[c] / (n / last):4.2f}"
                cells.append(cell + growth)
            print(f"{name:<16}{n:>6}", *(f"{c:>18}" for c in cells),
                  f"{times.get('MB', math.nan):7.0f}", flush=True)  # fmt: skip
            before, last = times, n
            if len([c for c in columns if c not in times]) == len(columns):
                break


if __name__ == "__main__":
    main()
