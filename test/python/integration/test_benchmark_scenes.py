"""The benchmark's programs on tai: losses and gradients of small versions against f64."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

import harness
import problems

if not (Path(__file__).resolve().parents[3] / "python" / "tai" / "__init__.py").exists():
    pytest.skip("the tree holds no Python package yet", allow_module_level=True)

import tai as ti

import tai_scenes

# The robot hits the ground, which amplifies f32 rounding; taichi is off by 2e-5 as well.
TOLERANCE = {"mass_spring": 3e-4}


@pytest.mark.parametrize("scene", list(problems.PROBLEMS))
def test_gradient(scene: str):
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    problem = problems.PROBLEMS[scene](True)
    loss, gradient = problem.reference()
    program = tai_scenes.SCENES[scene](problem)
    # The second run starts from the fields and adjoints that the first one left.
    for _ in range(2):
        program.run()
        assert program.loss() == pytest.approx(loss, rel=2e-5)
        error = harness.relative_error(program.gradient().astype(float), gradient)
        assert error < TOLERANCE.get(scene, 1e-5)


@pytest.mark.parametrize("scene", ["wave", "mass_spring"])
def test_replay(scene: str):
    """A recorded tape, replayed as one native call, gives the gradient of a fresh run."""
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    problem = problems.PROBLEMS[scene](True)
    _, gradient = problem.reference()
    program = tai_scenes.SCENES[scene](problem)
    program.run()
    for _ in range(2):
        assert program.replay() is not None
        error = harness.relative_error(program.gradient().astype(float), gradient)
        assert error < TOLERANCE.get(scene, 1e-5)


def test_whole_elements(monkeypatch):
    """The layout of diffmpm on a GPU: nodes of 16 bytes, particles by element."""
    monkeypatch.setattr(tai_scenes, "elements_whole", True)
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    problem = problems.mpm_problem(True)
    loss, gradient = problem.reference()
    program = tai_scenes.SCENES["diffmpm"](problem)
    program.run()
    assert program.replay() is not None
    assert program.loss() == pytest.approx(loss, rel=2e-5)
    assert harness.relative_error(program.gradient().astype(float), gradient) < 1e-5


@pytest.mark.parametrize("scene", list(problems.PROBLEMS))
def test_no_loop_on_a_device_asks_whether_it_goes_on(scene, monkeypatch, capfd):
    """The loops are short: what ends long ones costs these kernels and their gradients nothing."""
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda, default_fp=ti.f32, print_ir="nvvm", offline_cache=False)
    tai_scenes.SCENES[scene](problems.PROBLEMS[scene](True)).run()
    ti.sync()
    printed = "".join(capfd.readouterr())
    assert "gpu.kernel" in printed and "nvvm of the adjoint of" in printed
    assert "tai_rt_go_on" not in printed

    @ti.kernel
    def search(x: ti.types.ndarray()):
        for i in x:
            while x[i] < 1:
                x[i] += 1

    search(np.zeros(3, np.float32))
    assert "tai_rt_go_on" in "".join(capfd.readouterr())
