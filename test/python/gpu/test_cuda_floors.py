"""The hand-written CUDA floors of the benchmark compute the benchmark's scenes.

Their kernels' bodies are compiled for the CPU and run one after another; loss and gradient are
compared with the f64 adjoints.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "benchmarks"))

from problems import PROBLEMS  # noqa: E402

# The robot's contacts amplify rounding over 2048 steps; smoke's gradient has kinks at cell
# borders, where f32 and f64 may choose different sides.
PROGRAMS = [
    ("mpm", "diffmpm", "graph", 1e-5),
    ("mpm", "diffmpm", "fused-graph", 1e-5),
    ("mpm", "diffmpm", "shared", 1e-5),
    ("smoke", "smoke", "graph", 1e-3),
    ("smoke", "smoke", "tiled-graph", 1e-3),
    ("robot", "mass_spring", "persistent", 5e-2),
]


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    compiler = next(filter(shutil.which, ("c++", "clang++-22", "g++", "clang++")), None)
    if not compiler:
        pytest.skip("no C++ compiler")
    out = tmp_path_factory.mktemp("floors")
    environment = {**os.environ, "HOST_CHECK": "1", "CXX": compiler}
    script = ROOT / "benchmarks/floor/cuda/build.sh"
    done = subprocess.run([script, out], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.parametrize(("program", "scene", "variant", "bound"), PROGRAMS)
def test_a_floor_has_the_gradient_of_its_scene(programs, program, scene, variant, bound):
    dump = programs / f"{program}-{variant}.f32"
    command = [programs / f"{program}-check", f"--dump={dump}", variant]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    record = json.loads(done.stdout)
    assert (record["scene"], record["variant"]) == (scene, variant)
    loss, gradient = PROBLEMS[scene](False).reference()
    assert record["loss"] == pytest.approx(loss, rel=1e-5)
    found = np.fromfile(dump, np.float32).astype(np.float64)
    assert found.shape == gradient.shape
    assert np.linalg.norm(found - gradient) <= bound * np.linalg.norm(gradient)
    assert record["gradient_norm"] == pytest.approx(float(np.linalg.norm(found)), rel=1e-6)
