"""Kernels under AddressSanitizer, in processes that have its run time."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tai as ti

PROGRAM = """
import numpy as np
import tai as ti

ti.init(arch=ti.cpu, sanitize="address", offline_cache=False, opt_level={level})
x = ti.field(ti.f32, 100, needs_grad=True)
loss = ti.field(ti.f32, (), needs_grad=True)
which = ti.field(ti.i32, ())
which[None] = {index}


@ti.kernel
def gather(a: ti.types.ndarray(ti.f32, ndim=1)):
    for i in x:
        x[i] = a[i]
    loss[None] += a[which[None]] * x[3]


@ti.kernel
def total():
    for i in x:
        loss[None] += x[i] ** 2


a = np.ones(100, np.float32)
gather(a)
with ti.ad.Tape(loss):
    total()
assert x.grad.to_numpy().sum() == 200
print("done")
"""


def run_time():
    """The library that a process must have from its start, or None."""
    clang = shutil.which("clang-22")
    if clang is None:
        return None
    command = [clang, "-print-file-name=libclang_rt.asan-x86_64.so"]
    path = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return path if Path(path).is_absolute() else None


def run(tmp_path, **values):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM.format(**values))
    options = "detect_leaks=0:allow_user_poisoning=0"
    environment = dict(os.environ, TI_ARCH="cpu", ASAN_OPTIONS=options)
    # A run with a sanitizer has it already.
    environment.setdefault("LD_PRELOAD", run_time())
    command = [sys.executable, str(file)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)


needs_run_time = pytest.mark.skipif(
    run_time() is None, reason="the run time of AddressSanitizer (libclang-rt-22-dev) is missing"
)


@needs_run_time
@pytest.mark.parametrize("level", [0, 3])
def test_an_array_that_is_too_short(tmp_path, level):
    done = run(tmp_path, index=100, level=level)
    assert done.returncode != 0
    assert "heap-buffer-overflow" in done.stderr
    assert "READ of size 4" in done.stderr
    assert "done" not in done.stdout


@needs_run_time
@pytest.mark.parametrize("level", [0, 3])
def test_a_program_without_errors(tmp_path, level):
    done = run(tmp_path, index=99, level=level)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


@pytest.mark.skipif("LD_PRELOAD" in os.environ, reason="the run time may be there")
def test_without_its_run_time():
    with pytest.raises(ti.TaiRuntimeError, match="no run time of AddressSanitizer"):
        ti.init(arch=ti.cpu, sanitize="address")
    with pytest.raises(ti.TaiRuntimeError, match="sanitize is '' or 'address'"):
        ti.init(arch=ti.cpu, sanitize="memory")


@pytest.mark.skipif("LD_PRELOAD" in os.environ, reason="the run time may be there")
def test_the_variable_asks_for_it_as_the_option_does(monkeypatch):
    monkeypatch.setenv("TI_SANITIZE", "address")
    with pytest.raises(ti.TaiRuntimeError, match="no run time of AddressSanitizer"):
        ti.init(arch=ti.cpu)
    ti.init(arch=ti.cpu, sanitize="")
