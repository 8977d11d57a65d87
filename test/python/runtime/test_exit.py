"""The end of a process, and forks of it, while kernels are compiled ahead of need."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = '''
import atexit, contextlib, os, sys


def threads():
    """How many there are. One that was joined is listed until the system has cleared it away."""
    PF_EXITING = 4
    count = 0
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(OSError), open(f"/proc/self/task/{thread}/stat") as stat:
            count += not int(stat.read().rpartition(")")[2].split()[6]) & PF_EXITING
    return count


# Called last, being the first.
atexit.register(lambda: print("at the end", threads()))

import tai as ti

ti.init(arch=ti.cpu, cpu_max_num_threads=1)
x = ti.field(ti.f32, shape=64, needs_grad=True)
loss = ti.field(ti.f32, shape=(), needs_grad=True)


@ti.kernel
def long_to_compile():
    for i in x:
        v = x[i]
        for k in ti.static(range(100)):
            v += 0.01 * ti.sin(1.01 * v + k) * ti.cos(v)
        loss[None] += v


'''
# The kernel alone is in the cache then: its gradient is what takes long.
WITHOUT = """
long_to_compile()
"""
WITH = """
tape = ti.ad.Tape(loss)
tape.__enter__()
long_to_compile()
"""
END = """
raise RuntimeError("the tape is open")
"""
FORK = """
child = os.fork()
if child == 0:
    tape.__exit__(None, None, None)
    print("in the child", x.grad[3] != 0, flush=True)
    sys.exit(0)
print("child", os.waitpid(child, 0)[1])
tape.__exit__(None, None, None)
print("in the parent", x.grad[3] != 0)
"""


def run(folder, ending):
    path = folder / "program.py"
    kept = {k: v for k, v in os.environ.items() if k not in ("TI_ARCH", "TAI_CUDA_EMULATION")}
    kept["TAI_CACHE_DIR"] = str(folder / "cache")
    # NumPy has threads of its own.
    kept |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    for program in PROGRAM + WITHOUT, PROGRAM + WITH + ending:
        path.write_text(program)
        done = subprocess.run(
            [sys.executable, path], capture_output=True, text=True, env=kept, timeout=120
        )
    return done


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/task").is_dir(), reason="needs the threads of a process"
)


@needs_proc
def test_the_end_waits_for_what_is_compiled(tmp_path):
    done = run(tmp_path, END)
    assert "the tape is open" in done.stderr
    assert done.returncode == 1
    assert done.stdout.splitlines() == ["at the end 1"]


@needs_proc
def test_a_child_compiles_what_its_parent_has_not(tmp_path):
    done = run(tmp_path, FORK)
    assert done.returncode == 0, done.stderr
    expected = [
        "in the child True",
        "at the end 1",
        "child 0",
        "in the parent True",
        "at the end 1",
    ]
    assert done.stdout.splitlines() == expected
