"""Programs as people write them run as scripts, and give the numbers that were measured.

Each file in `programs/` is a whole script for ``import tai as ti``. The expected numbers were
measured on another implementation in single precision, so tolerances are those of single
precision over the length of the simulation.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import layouts  # noqa: E402
from reference import mpm3d  # noqa: E402

PROGRAMS = Path(__file__).parents[1] / "programs"


def run(name, *arguments, cwd=PROGRAMS):
    """The report of the program when it runs on its own."""
    environment = dict(os.environ, PYTHONWARNINGS="error::SyntaxWarning")
    # Programs run on the CPU, also those that ask for a GPU.
    environment.setdefault("TI_ARCH", "cpu")
    done = subprocess.run(
        [*layouts.command(), str(PROGRAMS / f"{name}.py"), *map(str, arguments)],
        cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_mass_spring_robot():
    # 150 steps are few enough for single precision to agree; the second gradient moves by per
    # cents where a weight moves by an ulp.
    found = run("mass_spring", 0, "--steps", 150)
    np.testing.assert_allclose(found["losses"][:2], [-0.232538, -0.242773], rtol=2e-4)
    np.testing.assert_allclose(found["losses"][2], -0.256238, rtol=5e-3)
    np.testing.assert_allclose(found["norms"], [0.290718, 0.102484, 0.203013, 0.0501982], rtol=2e-3)


@pytest.mark.parametrize(
    ("robot", "losses", "squared_norms"),
    [
        (1, [-0.215316, -0.225342], [0.022721, 0.0066432]),
        (2, [-0.212226, -0.215992], [0.112978, 0.065969]),
    ],
)
def test_mass_spring_robot_walks(robot, losses, squared_norms):
    found = run("mass_spring", robot, "--iterations", 2)
    np.testing.assert_allclose(found["losses"], losses, rtol=2e-4)
    np.testing.assert_allclose(found["squared_norms"], squared_norms, rtol=2e-3)


def test_rigid_body_with_a_joint():
    found = run("rigid_body", 0, "--steps", 160)
    np.testing.assert_allclose(found["losses"], [0.606082, 0.605667, 0.605252], rtol=1e-5)
    np.testing.assert_allclose(
        found["norms"], [0.0183956, 0.00654129, 0.00597741, 0.00471118], rtol=1e-4
    )


@pytest.mark.parametrize(
    ("robot", "losses", "squared_norm"),
    [(1, [0.75281, 0.744555], 0.0074156), (2, [0.586751, 0.547042], 0.0681988)],
)
def test_rigid_body_robots(robot, losses, squared_norm):
    found = run("rigid_body", robot, "--iterations", 2)
    np.testing.assert_allclose(found["losses"], losses, rtol=1e-4)
    np.testing.assert_allclose(found["squared_norms"][0], squared_norm, rtol=1e-3)


def test_time_of_impact_turns_the_gradient_right():
    found = run("rigid_body_toi")
    offsets = 0.02 * np.arange(15)
    naive, toi = np.array(found["naive"]), np.array(found["toi"])
    np.testing.assert_allclose(naive[:, 0], 0.512 - offsets, atol=3e-6)
    np.testing.assert_allclose(toi[:, 0], 0.512001 - offsets, atol=3e-6)
    np.testing.assert_allclose(naive[:, 1], 1, rtol=1e-5)
    np.testing.assert_allclose(toi[:, 1], -1, rtol=1e-5)
    np.testing.assert_allclose(naive[:, 2], -0.006 + offsets, atol=3e-6)
    np.testing.assert_allclose(toi[:, 2], -0.406, rtol=1e-5)
    np.testing.assert_allclose(found["naive_zoom"][:3], [0.251999, 0.244099, 0.244199], atol=2e-6)
    np.testing.assert_allclose(found["toi_zoom"][:2], [0.252001, 0.251901], atol=2e-6)


def test_discontinuity():
    found = run("discontinuity", "--indices=-20,-2,-1,0,1,19")
    x0, x1 = np.array(found["x0"]), np.array(found["x1"])
    np.testing.assert_allclose(x0, np.tile([0.290623, 0, 1], (6, 1)), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(
        x1[:, 0], [0.29642, 0.30539, 0.30545, 0.40093, 0.40109, 0.40244], atol=1e-5
    )
    np.testing.assert_allclose(x1[1:5, 1], [0.049434, 0.050130, 0.021874, 0.022018], rtol=1e-4)
    np.testing.assert_allclose(
        np.array(found["y1"])[[0, 2, 3, 5]], [0.44250, 0.44557, 0.40340, 0.40342], atol=1e-5
    )


def test_gradient_explosion():
    found = run("gradient_explosion")
    values = {
        "alpha0": [1.225, 19.9, 61.075, 124.75, 210.925, 319.6, 450.775],
        "alpha1": [1.20564, 18.6494, 54.5676, 106.387, 171.892, 249.178, 336.602],
        "alpha3": [1.16830, 16.4841, 44.3957, 80.3387, 121.403, 165.732, 212.144],
        "alpha10": [1.05084, 11.3667, 25.3799, 40.2181, 55.2403, 70.3037, 85.3762],
    }
    for name, losses in values.items():
        of = np.array(found[name])
        np.testing.assert_allclose(of[:, 0], losses, rtol=1e-5)
        np.testing.assert_allclose(of[:, 1], losses, rtol=2e-5)  # linear in the force
    np.testing.assert_allclose(
        np.array(found["alpha0"])[:, 2],
        [19.6, 1313.4, 7084.7, 20708.5, 45559.7, 85013, 142444],
        rtol=1e-5,
    )
    np.testing.assert_allclose(
        np.array(found["alpha10"])[:, 2],
        [15.588, 540.78, 1674.1, 3068.1, 4548.1, 6053.6, 7566.1],
        rtol=1e-4,
    )


def test_billiards(tmp_path):
    found = run("billiards", "--picture", tmp_path)
    np.testing.assert_allclose(
        found["losses"], [0.045418, 0.029303, 0.028748, 0.025674, 0.023475, 0.022155], rtol=1e-4
    )
    np.testing.assert_allclose(found["gradient"], [-0.51836, 1.12848, -0.69684, 1.27969], rtol=1e-4)
    np.testing.assert_allclose(
        found["scan"],
        [[0.066089, 0.065236, 0.045971, 0.039887, 0.066089],
         [0.031656, 0.036113, 0.045555, 0.059488, 0.065370]],
        atol=1e-6,
    )  # fmt: skip
    pictures = sorted(tmp_path.iterdir())
    assert [picture.name for picture in pictures] == [f"{t:04d}.png" for t in (255, 511, 767, 1023)]
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)


def test_electric():
    # The controller reads slots that hold values of the last run, and that are overwritten later.
    # The system of the paper takes the gradient of the first layer at the new values, so that only
    # results independent of it can be compared: see
    # test_slots_that_are_read_before_they_are_written.
    found = run("electric")
    np.testing.assert_allclose(found["losses"][0], 2.43744, rtol=1e-5)
    np.testing.assert_allclose(found["norms"][0][1], 2.86605, rtol=1e-5)


def test_electric_with_a_controller_that_reads_the_last_slot():
    found = run("electric", "--sane")
    np.testing.assert_allclose(found["losses"], [2.42679, 0.633628, 3.93690], rtol=1e-4)
    np.testing.assert_allclose(
        np.array(found["norms"])[:, :2],
        [[2.76690, 2.73279], [0.851932, 0.910163], [5.32497, 6.88746]],
        rtol=1e-4,
    )


def test_volume_renderer():
    found = run("volume_renderer")
    np.testing.assert_allclose(found["losses"], [0.00379664, 0.00129887, 0.000452985], rtol=2e-5)
    found = run("volume_renderer", "--res", 128, "--iterations", 2)
    np.testing.assert_allclose(found["losses"], [0.00380715, 0.00300069], rtol=2e-5)
    np.testing.assert_allclose(found["norms"], [0.00755186, 0.00668752], rtol=2e-5)


def test_grid_that_is_made_again_in_reverse():
    found = run("diffmpm_checkpointing", "--side", 16, "--steps", 40)
    np.testing.assert_allclose(found["losses"], [0.0823879, 0.0821625], rtol=1e-5)
    np.testing.assert_allclose(
        found["gradients"],
        [[-0.002169371, -0.004224936], [-0.002166397, -0.004219132]],
        rtol=1e-5,
    )


@pytest.mark.parametrize("liquid", [False, True])
def test_crawler_in_three_dimensions(liquid):
    options = ["--liquid"] if liquid else []
    found = run(
        "diffmpm3d", "--steps", 24, "--iterations", 1, "--density", 1, *options, "--particles"
    )
    x, muscle, solid = (np.array(found[name]) for name in ("x", "muscle", "solid"))
    weights, bias = np.array(found["weights"]), np.zeros(len(found["weights"]))
    assert solid.all() != liquid

    def loss(weights, bias):
        return -mpm3d.mean_x(x, muscle, solid == 1, weights, bias, 24)

    np.testing.assert_allclose(found["losses"][0], loss(weights, bias), rtol=1e-6)
    # The slope along each gradient, which is its norm.
    for number, (name, norm) in enumerate(zip(("dweights", "dbias"), found["norms"][0])):
        direction = np.array(found[name]) / norm
        ends = []
        for h in (1e-3, -1e-3):
            moved = [weights, bias]
            moved[number] = moved[number] + h * direction
            ends.append(loss(*moved))
        np.testing.assert_allclose(norm, (ends[0] - ends[1]) / 2e-3, rtol=1e-3)
