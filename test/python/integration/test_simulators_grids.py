"""The simulators of grids and particles, against measured values and against NumPy.

Where a test gives numbers without a source, they were measured on the paper's published programs,
in f32 and with atomics.
"""

import os
import random
import subprocess
import sys

import numpy as np
import pytest
import tai as ti
from PIL import Image

from reference import mpm3d
from simulators import EXAMPLES, ROUNDING, descent, printed, start, table

sys.path.insert(0, str(EXAMPLES))

import diffmpm3d  # noqa: E402
import splatter  # noqa: E402


def close(found, expected, rtol):
    np.testing.assert_allclose(found[: len(expected)], expected, rtol=rtol)


def same(one, other, rtol):
    """All columns of two runs."""
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], rtol=rtol, err_msg=name)


def refused(name, folder, *options):
    """The one line with which a program ends."""
    done = start(name, folder, *options)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    return line


# Waves


def test_wave(tmp_path):
    found = descent("wave", tmp_path, "--iterations", 6)
    close(found["loss"], [0.246378, 0.224315, 0.207216, 0.193836, 0.183272, 0.174855], 5e-4)


def test_wave_in_place(tmp_path):
    options = ("--n", 40, "--steps", 50, "--iterations", 3, "--double")
    slots = descent("wave", tmp_path, *options)
    for state in ("saved", "recomputed"):
        same(descent("wave", tmp_path, *options, "--state", state), slots, 1e-11)


def test_wave_in_place_keeps_nothing(tmp_path):
    output = printed("wave", tmp_path, "--n", 40, "--iterations", 2, "--state", "saved")
    # Two fields with gradients, in f32.
    assert f"memory   {2 * 2 * 4 * 40**2 / 1024:.4g} KiB of state, 0 B of tape" in output


@pytest.mark.parametrize("name, rate", [("wave", 1), ("smoke", 20)])
def test_single_precision(tmp_path, name, rate):
    options = ("--n", 40, "--steps", 30, "--iterations", 3, "--rate", rate)
    single = descent(name, tmp_path, *options)
    same(single, descent(name, tmp_path, *options, "--double"), 2e-4)


# Smoke


@pytest.mark.parametrize(
    "setting, losses",
    [
        ("chequers", [0.5, 0.320631, 0.227978, 0.185877]),
        ("stripes-yin-yang", [0.525455, 0.426514, 0.363348, 0.332309]),
    ],
)
def test_smoke(tmp_path, setting, losses):
    found = descent("smoke", tmp_path, "--setting", setting, "--iterations", 4)
    close(found["loss"], losses, 5e-4)


def test_smoke_becomes_the_sign_of_peace(tmp_path):
    options = ("--setting", "stripes-peace", "--iterations", 5)
    found = descent("smoke", tmp_path, *options)["loss"]
    assert (np.diff(found) < 0).all() and found[-1] < 0.5 * found[0]


def test_smoke_in_place(tmp_path):
    # An odd number of sweeps: the two fields of the pressure swap their roles in each step.
    options = ("--n", 20, "--steps", 12, "--sweeps", 5, "--iterations", 3, "--double", "--rate", 10)
    slots = descent("smoke", tmp_path, *options)
    for state in ("saved", "recomputed"):
        same(descent("smoke", tmp_path, *options, "--state", state), slots, 1e-10)


@pytest.mark.parametrize("name", ["wave", "smoke"])
def test_a_picture_as_target(tmp_path, name):
    grey = np.add.outer(np.arange(50), np.arange(30)).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "target.png")
    options = ("--target", tmp_path / "target.png", "--n", 16, "--iterations", 1)
    (loss,) = descent(name, tmp_path, *options)["loss"]
    resized = Image.fromarray(grey).resize((16, 16), Image.Resampling.BILINEAR)
    picture = np.asarray(resized) / 255
    before = np.add.outer(np.arange(16) // 2, np.arange(16) // 2) % 2
    expected = picture - grey.mean() / 255 if name == "wave" else picture - before
    assert loss == pytest.approx((expected**2).mean(), rel=1e-5)


# The material point method


def test_diffmpm_gradients(tmp_path):
    found = descent("diffmpm", tmp_path, "--iterations", 2)
    close(found["loss"], [-0.250387, -0.257541], 2e-5)
    close(found["|dw|"], [0.245075, 0.228868], 5e-4)
    close(found["|db|"], [0.126742, 0.117341], 5e-4)


def scene(liquid):
    """One particle to a cell; 985 of the robot, 420 of the liquid."""
    random.seed(0)
    made = diffmpm3d.Scene(density=1)
    made.robot(block=0.08 if liquid else 0.1)
    if liquid:
        made.pool(corner=(0.1, 0.15, 0.1), size=(0.2, 0.05, 0.2))
    return made


def learned():
    """Weights and biases that set the muscles going."""
    generator = np.random.default_rng(0)
    return 0.5 * generator.standard_normal((16, 4)), 0.3 * generator.standard_normal(16)


def simulated(made, steps):
    """Loss and gradients, by weights and by biases."""
    simulation = diffmpm3d.Simulation(made, steps)
    weights, bias = learned()
    simulation.weights.from_numpy(weights)
    simulation.bias.from_numpy(bias)
    with ti.ad.Tape(simulation.loss):
        simulation.forward()
    gradients = simulation.weights.grad.to_numpy(), simulation.bias.grad.to_numpy()
    return simulation.loss[None], *gradients


@pytest.mark.parametrize("liquid", [False, True])
def test_three_dimensions(liquid):
    made, steps = scene(liquid), 20
    ti.init(default_fp=ti.f64)
    loss, by_weights, by_bias = simulated(made, steps)

    position, muscle, solid = map(np.array, (made.position, made.muscle, made.solid))

    def expected(weights, bias):
        return -mpm3d.mean_x(position, muscle, solid, weights, bias, steps)

    weights, bias = learned()
    assert loss == pytest.approx(expected(weights, bias), rel=1e-12)
    # The slope along the gradient itself is its length.
    length = np.sqrt((by_weights**2).sum() + (by_bias**2).sum())
    ahead, back = (
        expected(weights + s * by_weights / length, bias + s * by_bias / length)
        for s in (1e-4, -1e-4)
    )
    assert length > 1e-6
    assert (ahead - back) / 2e-4 == pytest.approx(length, rel=1e-5)


@pytest.mark.parametrize("liquid", [False, True])
def test_three_dimensions_in_single_precision(liquid):
    ti.init(default_fp=ti.f64)
    double = simulated(scene(liquid), 32)
    ti.init(default_fp=ti.f32)
    single = simulated(scene(liquid), 32)
    for one, other in zip(single, double, strict=True):
        scale = np.abs(other).max()
        np.testing.assert_allclose(np.divide(one, scale), np.divide(other, scale), atol=1e-3)


def test_scenes_of_the_paper():
    robot = diffmpm3d.Scene()
    robot.robot(block=0.1)
    assert (len(robot.solid), max(robot.muscle)) == (30495, 15)
    pool = diffmpm3d.Scene()
    pool.robot(block=0.08)
    pool.pool(corner=(0.1, 0.15, 0.1), size=(0.2, 0.05, 0.2))
    assert (sum(pool.solid), len(pool.solid)) == (15150, 15150 + 12996)


@pytest.mark.parametrize("name", ["diffmpm3d", "liquid"])
def test_movies_of_particles(tmp_path, name):
    options = ["--density", 1, "--steps", 20, "--iterations", 2, "--start", "sines"]
    command = [sys.executable, EXAMPLES / f"{name}.py", *options, "--out", tmp_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    picture = Image.open(tmp_path / f"{name}.gif")
    assert picture.size == (640, 360)
    assert len(table(tmp_path / f"{name}.losses.csv")["loss"]) == 2


def test_the_nearest_ball_is_seen():
    ti.init()
    camera = splatter.Splatter(160, 90, radius=0.03, eye=(0, 0.3, 2), target=(0, 0.3, 0))
    positions = np.array([[0, 0.3, 0.2], [0, 0.3, 0.4], [0.3, 0.3, 0.2]])
    colours = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.0]])
    for order in ([0, 1, 2], [2, 1, 0]):
        pixels = camera.picture(positions[order], colours[order]).astype(int)
        assert pixels.shape == (90, 160, 3)
        red, green, blue = pixels[45, 80]
        assert green > 2 * max(red, blue, 1)
        # The blue one is to the right, as far as the camera's focal length says.
        column = 80 + round(1.6 * 160 * 0.3 / 1.8)
        red, green, blue = pixels[45, column]
        assert blue > 2 * max(red, green, 1)
        assert abs(pixels[45, 10] - pixels[45, 150]).max() < 20  # both are background
    empty = camera.picture(np.zeros((0, 3)), np.zeros((0, 4)))
    assert empty[0, 0].tolist() == empty[0, -1].tolist()


# Checkpoints


def test_all_checkpoints_give_one_gradient(tmp_path):
    # A device keeps fields whole, where a CPU keeps the elements that a launch changes.
    budget = 2 if os.environ.get("TI_ARCH") == "cuda" else 1
    options = ("--side", 12, "--steps", 60, "--segment", 7, "--budget", budget, "--double")
    lines = printed("checkpointing", tmp_path, *options).splitlines()
    names, numbers = [], []
    for line in lines:
        name, memory, _, _, _, kept, *_ = line.split()
        values = line.partition("loss")[2].replace("gradient", "").replace(",", "").split()
        names.append(name)
        numbers.append([float(memory), float(kept), *map(float, values)])
    assert names == ["stored", "grid", "segments", "tape", "budget"]
    table = np.array(numbers)
    np.testing.assert_allclose(table[:, 2:], table[:1, 2:].repeat(5, 0), atol=1.1e-6)
    fields, kept = table[:, 0], table[:, 1]
    assert (np.diff(fields[:4]) < 0).all() and fields[4] == fields[3]
    assert (kept[:3] == 0).all() and 0 < kept[4] <= budget < kept[3]


@pytest.mark.parametrize("scheme", ["stored", "grid", "segments", "tape", "budget"])
def test_descent_by_each_scheme(tmp_path, scheme):
    options = ("--side", 10, "--steps", 40, "--segment", 39, "--iterations", 3, "--double")
    expected = descent("checkpointing", tmp_path, *options, "--scheme", "stored")
    found = descent("checkpointing", tmp_path, *options, "--scheme", scheme)
    same(found, expected, 1e-10)


def test_segments_of_the_published_scene(tmp_path):
    found = descent("checkpointing", tmp_path, "--scheme", "segments", "--iterations", 2)
    close(found["loss"], [0.0525562, 0.0428122], 1e-3)
    close(found["|dv|"], [0.0358795, 0.0225001], 2e-2)


# Pictures to volumes


def test_volume_renderer(tmp_path):
    options = ("--res", 128, "--views", 3, "--samples", 120, "--iterations", 3)
    found = descent("volume_renderer", tmp_path, *options)
    close(found["loss"], [0.00380715, 0.00300069, 0.00236825], 1e-5)
    close(found["|d density|"], [0.00755186, 0.00668752, 0.00592488], 1e-4)
    options = ("--res", 64, "--views", 3, "--iterations", 10)
    found = descent("volume_renderer", tmp_path, *options)["loss"]
    close(found, [0.00379664, 0.00129887, 0.000452985], 1e-5)
    close(found[9:], [5.17796e-06], 1e-3)


def test_volumes_of_files(tmp_path):
    body = np.random.default_rng(0).random((8, 8, 8), np.float32)
    np.save(tmp_path / "body.npy", body)
    body.tofile(tmp_path / "body.raw")
    options = ("--n", 8, "--res", 16, "--views", 2, "--iterations", 2)
    first = descent("volume_renderer", tmp_path, *options, "--volume", tmp_path / "body.npy")
    second = descent("volume_renderer", tmp_path, *options, "--volume", tmp_path / "body.raw")
    same(first, second, ROUNDING)
    line = refused("volume_renderer", tmp_path, "--volume", tmp_path / "body.raw")
    assert "body.raw" in line and "not 128³ numbers" in line


# Water above a picture


def test_water_renderer(tmp_path):
    pytest.importorskip("torch")
    found = descent("water_renderer", tmp_path, "--quick")
    assert found["probability"][-1] > found["probability"][0]
    # If a run is in two parts, too, the first probability is that before the first step.
    first = f"{100 * found['probability'][0]:.2f} % -> "
    assert first in printed("water_renderer", tmp_path, "--quick", "--iterations", 4, "--resume")
    assert "classes are 0 to 3" in refused("water_renderer", tmp_path, "--quick", "--label", 4)


@pytest.mark.parametrize(
    "error, words",
    [
        ("ModuleNotFoundError('none', name='torch')", "is not installed: pip install torch"),
        ("ModuleNotFoundError('no fsspec', name='fsspec')", "cannot be loaded: no fsspec"),
        ("ImportError('no libcudnn.so')", "cannot be loaded: no libcudnn.so"),
    ],
)
def test_water_renderer_without_torch(tmp_path, error, words):
    (tmp_path / "torch.py").write_text(f"raise {error}")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "water_renderer.py"), "--out", str(tmp_path)],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.endswith(words)


# Bad input


@pytest.mark.parametrize(
    "name, options",
    [
        ("checkpointing", ("--side", 12, "--steps", 20, "--scheme", "grid", "--rate", 1e9)),
        ("diffmpm3d", ("--density", 0.8, "--steps", 48, "--rate", 1e8)),
    ],
)
def test_particles_that_leave_the_grid(tmp_path, name, options):
    """A step of descent that is far too long makes them leave; the parameters learned before it
    stay."""
    done = start(name, tmp_path, *options, "--iterations", 3)
    assert done.returncode == 2, done.stderr
    assert "the loss of iteration 1 is not finite" in done.stderr.splitlines()[-1]
    assert len(table(tmp_path / f"{name}.losses.csv")["loss"]) == 1


@pytest.mark.parametrize(
    "name, options, words",
    [
        ("wave", ["--n", 1], ["--n", "at least 2"]),
        ("wave", ["--steps", 2], ["--steps", "at least 3"]),
        ("wave", ["--target", "missing.png"], ["missing.png", "not a picture"]),
        ("smoke", ["--setting", "fog"], ["--setting", "fog", "stripes-peace"]),
        ("smoke", ["--sweeps", 0], ["--sweeps", "at least 1"]),
        ("smoke", ["--n", 2**31 - 1], ["does not fit into memory", "64-bit"]),
        ("checkpointing", ["--budget", 1e300], ["--budget", "at most"]),
        ("checkpointing", ["--side", 181], ["--side", "at most 180"]),
        ("diffmpm3d", ["--density", 0.5], ["--density", "at least 0.8"]),
        ("checkpointing", ["--scheme", "none"], ["--scheme", "segments"]),
        ("volume_renderer", ["--volume", "missing.npy"], ["missing.npy"]),
    ],
)
def test_bad_input(tmp_path, name, options, words):
    line = refused(name, tmp_path, *options)
    for word in words:
        assert word in line
