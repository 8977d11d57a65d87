"""The code that a GPU's compiler is given, seen by a driver without a GPU, which keeps it."""

import os
import subprocess
import sys

import pytest

from fake_driver import fake_driver

# As particles of a material point method: additions in fixed point, in each of three launches.
SCATTERS = """
import tai as ti
ti.init(deterministic=True, offline_cache=False)
x = ti.Vector.field(3, ti.f32, 4096, needs_grad=True)
mass = ti.field(ti.f32, (16, 16, 16), needs_grad=True)
momentum = ti.Vector.field(3, ti.f32, (16, 16, 16), needs_grad=True)
loss = ti.field(ti.f32, (), needs_grad=True)
@ti.kernel
def scatter():
    for p in x:
        base = ti.cast(x[p] * 8, ti.i32)
        for offset in ti.static(ti.grouped(ti.ndrange(WIDE, WIDE, WIDE))):
            mass[base + offset] += x[p][0]
            momentum[base + offset] += x[p] * x[p][1]
@ti.kernel
def judge():
    for i in ti.grouped(mass):
        loss[None] += mass[i]
for _ in range(12):
    with ti.ad.Tape(loss):
        for _ in range(8):
            scatter()
        judge()
"""


def images(folder, wide):
    """The code that is loaded where particles scatter to cubes of so many cells."""
    program, kept = folder / "program.py", folder / "kept"
    program.write_text(SCATTERS.replace("WIDE", str(wide)))
    kept.mkdir()
    environment = {
        **os.environ, "TI_ARCH": "cuda", "TAI_CUDA_EMULATION": "",
        "TAI_CUDA_DRIVER": str(fake_driver()), "TAI_FAKE_CUDA": "any-function",
        "TAI_FAKE_CUDA_IMAGES": str(kept), "TAI_BACKGROUND_PROGRAMS": "0",
    }  # fmt: skip
    command = [sys.executable, str(program)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [path.read_text() for path in sorted(kept.iterdir())]


@pytest.mark.parametrize("wide", [2, 3])
def test_kernels_that_are_long_are_not_made_into_a_program(tmp_path, wide):
    """A program holds its kernels twice; of 43,000 lines ptxas takes half a minute."""
    found = [(text, text.count("\n")) for text in images(tmp_path, wide)]
    (kernel,) = (lines for text, lines in found if ".entry scatter_0(" in text)
    programs = [lines for text, lines in found if ".entry tai_program(" in text]
    # The gradient is short, and always one.
    assert programs and (max(programs) > kernel) == (wide == 2)
