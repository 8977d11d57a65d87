"""Names of compiled functions for the profiler of Linux."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import tai as ti

ti.init(offline_cache=False)
x = ti.field(float, 100_000)


@ti.kernel
def rise():
    for i in x:
        x[i] += 1.0


rise()
"""


def run(folder, **more):
    """The lines of the map of a process that compiles a kernel, or None."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen([sys.executable, program], env=os.environ | more)
    assert process.wait() == 0
    written = Path(f"/tmp/perf-{process.pid}.map")
    if not written.exists():
        return None
    lines = written.read_text().splitlines()
    written.unlink()
    return lines


def test_all_functions_have_names(tmp_path):
    functions = {}
    for line in run(tmp_path, TAI_PERF_MAP="1"):
        start, size, name = line.split(" ", 2)
        functions[name] = int(start, 16), int(size, 16)
    # The loop, which is nobody's but the kernel's, too.
    assert {"rise", "rise.loop0"} <= functions.keys()
    for start, size in functions.values():
        assert start > 0 and size > 0
    (kernel, size), (loop, _) = functions["rise"], functions["rise.loop0"]
    assert loop >= kernel + size or loop < kernel


def test_nothing_is_written_unasked(tmp_path):
    assert run(tmp_path, TAI_PERF_MAP="0") is None
