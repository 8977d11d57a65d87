"""The output of `print_ir` and `TAI_COMPILE_PROFILE` on the standard error."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import tai as ti

ti.init(arch=ti.cpu, print_ir={stages!r})
x = ti.field(ti.f64, shape=8, needs_grad=True)
loss = ti.field(ti.f64, shape=(), needs_grad=True)


@ti.kernel
def square():
    for i in x:
        loss[None] += x[i] * x[i]


with ti.ad.Tape(loss):
    square()
"""


@pytest.mark.skipif(not hasattr(os, "pipe2"), reason="pipes that keep writes apart are Linux's")
@pytest.mark.parametrize("stages", ["", "autodiff"])
def test_a_report_is_written_at_once(stages, tmp_path):
    """Other threads write there too, so that a report written in parts would get their lines in
    between."""
    read, write = os.pipe2(os.O_DIRECT)  # each read returns one write
    environment = {
        **os.environ,
        "TAI_COMPILE_PROFILE": "1",
        "TAI_CACHE_DIR": str(tmp_path / "cache"),
    }
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(stages=stages))
    process = subprocess.Popen([sys.executable, program], stderr=write, env=environment)
    os.close(write)
    writes = []
    while text := os.read(read, 1 << 16):
        writes.append(text.decode())
    os.close(read)
    assert process.wait() == 0, "".join(writes)
    profiles = [text for text in writes if " miss " in text]
    assert len(profiles) == 2 and all(text.endswith(" ms\n") for text in profiles), writes
    assert all("link" in text for text in profiles), writes
    assert len(writes) == (3 if stages else 2), writes


BY_HAND = """
import tai as ti

ti.init(arch=ti.cpu)
x, y = (ti.field(ti.f64, shape=8, needs_grad=True) for _ in range(2))
loss = ti.field(ti.f64, shape=(), needs_grad=True)


@ti.kernel
def cube():
    for i in x:
        y[i] = x[i] ** 3


@ti.kernel
def add():
    for i in y:
        loss[None] += y[i] * (i + 1)


@ti.ad.grad_replaced
def advance():
    cube()


@ti.ad.grad_for(advance)
def advance_gradient():
    cube.grad()


x.fill(2.0)
for step in (advance, advance, cube):
    with ti.ad.Tape(loss):
        step()
        add()
    print(*x.grad.to_numpy())
"""


def test_a_gradient_launched_by_hand_is_compiled_once(tmp_path):
    """The compilation of the form that the launch takes begins with the kernel."""
    environment = {
        **os.environ,
        "TAI_COMPILE_PROFILE": "1",
        "TAI_CACHE_DIR": str(tmp_path / "cache"),
    }
    program = tmp_path / "program.py"
    program.write_text(BY_HAND)
    done = subprocess.run([sys.executable, program], capture_output=True, text=True,
                          env=environment)  # fmt: skip
    assert done.returncode == 0, done.stderr
    expected = [12.0 * (i + 1) for i in range(8)]
    assert [list(map(float, line.split())) for line in done.stdout.splitlines()] == 3 * [expected]
    forms = [line.split()[:2] for line in done.stderr.splitlines() if " miss " in line]
    assert sorted(forms) == [
        ["add", "adjoint"], ["add", "primal"], ["cube", "primal"], ["cube", "taking"],
    ]  # fmt: skip
