"""The simulators of springs, boxes and balls: losses and gradients of the paper's programs.

The expected numbers were measured on those programs, in f32. Where a scene is chaotic, only the
first losses can agree, or those of a shortened run.
"""

import re

import numpy as np
import pytest

from same_bits import processors
from simulators import ROUNDING, descent, printed, start, table


def close(found, expected, rtol, **more):
    np.testing.assert_allclose(found[: len(expected)], expected, rtol=rtol, **more)


def close_walks(found, losses):
    """Losses of the first iterations of a walk with impacts, in f32.

    Where one weight moves by an ulp, the second gradient moves by some per cent, and an impact of
    the third walk by a time step. Processors round differently; in f64 all agree.
    """
    close(found["loss"], losses[:2], 1e-4)
    close(found["loss"], losses, 5e-3)


# Points and springs


@pytest.mark.parametrize(
    "robot, losses, squares",
    [
        (1, [-0.215316, -0.225342, -0.222704], [0.022721, 0.0066432]),
        (2, [-0.212226, -0.215992, -0.250018], [0.112978, 0.065969]),
        (3, [-0.227929, -0.246183, -0.255849], []),
    ],
)
def test_robots_of_springs(tmp_path, robot, losses, squares):
    options = ("mass_spring", tmp_path, "--robot", robot, "--iterations", 3)
    close(descent(*options, "--double")["loss"], losses, 1e-4)
    found = descent(*options)
    close_walks(found, losses)
    lengths = [found[f"|d{name}|"] ** 2 for name in ("w1", "b1", "w2", "b2")]
    close(np.sum(lengths, axis=0), squares, 5e-3)


@pytest.mark.parametrize("processor", ["native", *processors()])
def test_a_short_walk_of_springs(tmp_path, monkeypatch, processor):
    monkeypatch.setenv("TI_TARGET_CPU", processor)
    losses = [-0.232538, -0.242773, -0.256238]
    options = ("mass_spring", tmp_path, "--robot", 0, "--steps", 150, "--iterations", 3)
    exact, found = descent(*options, "--double"), descent(*options)
    close(exact["loss"], losses, 1e-4)
    close_walks(found, losses)
    for name, length in (("w1", 0.290718), ("b1", 0.102484), ("w2", 0.203013), ("b2", 0.0501982)):
        close(exact[f"|d{name}|"], [length], 1e-4)
        close(found[f"|d{name}|"], [length], 3e-3)


@pytest.mark.parametrize("name", ["mass_spring", "rigid_body"])
def test_toi_changes_the_walk(tmp_path, name):
    options = ("--robot", 2, "--steps", 300, "--iterations", 1)
    with_toi = descent(name, tmp_path, *options)
    without = descent(name, tmp_path, *options, "--no-toi")
    assert with_toi["loss"] != without["loss"]
    assert with_toi["|dw1|"] != pytest.approx(without["|dw1|"], rel=1e-3)


# Balls


def test_billiards(tmp_path):
    exact, found = descent("billiards", tmp_path, "--double"), descent("billiards", tmp_path)
    expected = [0.045418, 0.029303, 0.028748, 0.025674, 0.023475, 0.022155]
    close(found["loss"], expected, 1e-4)
    close(exact["loss"][[10, 19, 49]], [0.0137214, 0.0060098, 7.0467e-4], 1e-4)
    # Bounds for f32: rounding moves the result of a descent by some thousandths.
    close(found["loss"][[10, 19, 49]], [0.013615, 0.005971, 7.05e-4], 1e-2)
    close(found["loss"][[99, 199]], [2.27e-5, 2.23e-5], 2e-2)
    slope = [found[name][0] for name in ("dx", "dy", "dvx", "dvy")]
    close(slope, [-0.51836, 1.12848, -0.69684, 1.27969], 1e-4)


def test_flat_land(tmp_path):
    output = printed("billiards", tmp_path, "--scan")
    for zoom, flat, least, best in (("1", 852, 0.02172, 15.210), ("0.23", 356, 0.02130, 15.049)):
        found = table(tmp_path / f"billiards.scan_{zoom}.csv")
        missed = np.abs(found["loss"] - 0.066089) < 1e-6
        assert missed.sum() == flat
        assert (found["slope"][missed] == 0).all() and (found["slope"][~missed] != 0).any()
        assert found["loss"].min() == pytest.approx(least, abs=1e-5)
        assert found["angle"][found["loss"].argmin()] == pytest.approx(best, abs=1e-3)
    samples = found["loss"][[400, 450, 500, 550, 600]]
    close(samples, [0.031656, 0.036113, 0.045555, 0.059488, 0.065370], 1e-4)
    assert re.search(r"health +the loss does not depend on 'push' here", output)


# Boxes


@pytest.mark.parametrize(
    "robot, losses, squares",
    [
        (1, [0.75281, 0.744555, 0.715419], [0.0074156, 0.0171666]),
        (2, [0.586751, 0.547042, 0.464287], [0.0681988, 0.241800]),
    ],
)
def test_robots_of_boxes(tmp_path, robot, losses, squares):
    options = ("rigid_body", tmp_path, "--robot", robot, "--iterations", 3)
    close(descent(*options, "--double")["loss"], losses, 1e-4)
    found = descent(*options)
    close_walks(found, losses)
    lengths = [found[f"|d{name}|"] ** 2 for name in ("w1", "b1", "w2", "b2")]
    close(np.sum(lengths, axis=0), squares, 5e-3)


def test_a_short_walk_of_boxes(tmp_path):
    found = descent("rigid_body", tmp_path, "--robot", 0, "--steps", 160, "--iterations", 3)
    close(found["loss"], [0.606082, 0.605667, 0.605252], 1e-5)
    lengths = {"w1": 0.0183956, "b1": 0.00654129, "w2": 0.00597741, "b2": 0.00471118}
    for name, length in lengths.items():
        close(found[f"|d{name}|"], [length], 1e-3)


def test_legs_walk(tmp_path):
    losses = descent("rigid_body", tmp_path, "--robot", 2)["loss"]
    assert len(losses) == 20 and losses.min() < 0.37


def test_the_bouncing_ball(tmp_path):
    printed("rigid_body_toi", tmp_path)
    found = table(tmp_path / "rigid_body_toi.heights.csv")
    np.testing.assert_allclose(found["naive by y"], 1, atol=1e-5)
    np.testing.assert_allclose(found["toi by y"], -1, atol=1e-5)
    np.testing.assert_allclose(found["toi by vy"], -0.406, atol=1e-5)
    np.testing.assert_allclose(found["naive"][[0, 1, 14]], [0.512, 0.492, 0.231999], atol=2e-6)
    np.testing.assert_allclose(found["toi"][[0, 1, 14]], [0.512001, 0.492001, 0.232001], atol=2e-6)
    np.testing.assert_allclose(found["naive by vy"][:4], [-0.006, 0.014, 0.034, 0.054], atol=1e-5)
    # The close-up: a saw tooth, and a line.
    tooth, line = np.diff(found["naive"][15:]), np.diff(found["toi"][15:])
    np.testing.assert_allclose(line, -1e-4, atol=1e-6)
    assert set(np.round(tooth, 4)) == {1e-4, -0.0079}
    assert found["naive"][-1] == pytest.approx(0.211899, abs=2e-6)


def test_the_box_on_its_corner(tmp_path):
    printed("rigid_body_discontinuity", tmp_path)
    found = table(tmp_path / "rigid_body_discontinuity.ends.csv")
    np.testing.assert_allclose(found["friction 0"], 0.290623, atol=2e-6)
    np.testing.assert_allclose(found["friction 0 by spin"], 0, atol=1e-6)
    np.testing.assert_allclose(found["friction 0 by x"], 1, atol=1e-6)
    rows = 20 + np.array([-20, -10, -2, -1, 0, 1, 10, 19])
    expected = [0.29642, 0.30144, 0.30539, 0.30545, 0.40093, 0.40109, 0.40182, 0.40244]
    # Rounding to f32 moves single values by 3e-5.
    np.testing.assert_allclose(found["friction 1"][rows], expected, atol=6e-5)
    slopes = [0.049434, 0.050130, 0.021874, 0.022018]
    np.testing.assert_allclose(found["friction 1 by spin"][18:22], slopes, rtol=1e-3)


def test_the_box_on_its_corner_in_y(tmp_path):
    printed("rigid_body_discontinuity", tmp_path, "--loss", "y")
    found = table(tmp_path / "rigid_body_discontinuity.ends.csv")
    ends = found["friction 1"][[0, 19, 20, 39]]
    np.testing.assert_allclose(ends, [0.44250, 0.44557, 0.40340, 0.40342], atol=1e-5)
    np.testing.assert_allclose(found["friction 0"], found["friction 0"][::-1], atol=1e-5)
    assert found["friction 0"].min() == pytest.approx(0.2934, abs=5e-5)


# The ball between electrodes


def test_electric_as_published(tmp_path):
    options = ("--controller", "published", "--gradient", "reread", "--iterations", 100)
    found = descent("electric", tmp_path, *options)
    expected = [2.43744, 0.643623, 3.64072, 0.329470, 2.87283, 0.538639, 1.07990, 1.02519]
    close(found["loss"], expected, 1e-4)
    assert found["loss"].mean() == pytest.approx(0.872, abs=2e-3)
    close(found["|dw1|"], [2.79924, 0.871001, 8.54408], 1e-3)
    close(found["|dw2|"], [2.86605, 0.946085, 10.7374], 1e-3)


def test_what_rereading_slots_costs(tmp_path):
    # Until the first gradient, all is the same; the values that the second layer has read did not
    # change.
    options = ("--controller", "published", "--iterations", 1)
    right = descent("electric", tmp_path, *options)
    wrong = descent("electric", tmp_path, *options, "--gradient", "reread")
    assert right["loss"] == pytest.approx(wrong["loss"], rel=ROUNDING)
    assert right["|dw2|"] == pytest.approx(wrong["|dw2|"], rel=1e-6)
    assert right["|dw1|"] == pytest.approx(2.90138, rel=1e-4)
    # A controller that sees the slot before it reads nothing that is overwritten.
    by_tape = descent("electric", tmp_path, "--iterations", 2)
    by_hand = descent("electric", tmp_path, "--iterations", 2, "--gradient", "reread")
    for name, values in by_tape.items():
        np.testing.assert_allclose(values, by_hand[name], rtol=1e-5, err_msg=name)


def test_the_published_controller_against_a_difference(tmp_path):
    options = ("--controller", "published", "--double", "--check")
    output = printed("electric", tmp_path, *options)
    off = dict(re.findall(r"^(\w+) .* off by (\S+)$", output, re.M))
    assert float(off["tape"]) < 1e-7 and float(off["reread"]) > 0.1


# Gradients that grow


def test_growing_gradients(tmp_path):
    printed("gradient_explosion", tmp_path)
    found = table(tmp_path / "gradient_explosion.growth.csv")
    expected = {
        0: [1.225, 19.9, 61.075, 124.75, 210.925, 319.6, 450.775],
        1: [1.20564, 18.6494, 54.5676, 106.387, 171.892, 249.178, 336.602],
        3: [1.16830, 16.4841, 44.3957, 80.3387, 121.403, 165.732, 212.144],
        10: [1.05084, 11.3667, 25.3799, 40.2181, 55.2403, 70.3037, 85.3762],
    }
    assert found["N"].tolist() == [50, 200, 350, 500, 650, 800, 950]
    for alpha, ways in expected.items():
        close(found[f"way, alpha {alpha}"], ways, 1e-5)
        close(found[f"by push, alpha {alpha}"], ways, 2e-5)
    by_decay = [19.6, 1313.4, 7084.7, 20708.5, 45559.7, 85013, 142444]
    close(found["by decay, alpha 0"], by_decay, 2e-5)
    close(found["by decay, alpha 10"], [15.588, 540.78, 1674.1, 3068.1, 4548.1, 6053.6], 2e-5)


def test_clipping(tmp_path):
    output = printed("gradient_explosion", tmp_path, "--descend")
    assert re.search(r"alpha 0, not clipped: .* flew off", output)
    last = dict(re.findall(r"(alpha \d+, .*): loss 1 -> (\S+) in 300$", output, re.M))
    assert float(last["alpha 0, clip 0.5"]) < 1e-3 and float(last["alpha 10, not clipped"]) < 1e-6


# In other ways

SHORT = {
    "mass_spring": ("--robot", 0, "--steps", 150, "--iterations", 1),
    "rigid_body": ("--robot", 0, "--steps", 160, "--iterations", 1),
    "billiards": ("--steps", 700, "--iterations", 1),
    "electric": ("--steps", 200, "--iterations", 2),
    "mass_spring_simple": ("--wall", "--iterations", 2),
}


@pytest.mark.parametrize("name", SHORT)
def test_f32_against_f64(tmp_path, name):
    single = descent(name, tmp_path, *SHORT[name])
    double = descent(name, tmp_path, *SHORT[name], "--double")
    rtol = 2e-3 if name == "mass_spring" else 2e-4  # springs of 14000: stiff, and soon chaotic
    for column, values in double.items():
        assert column == "iteration" or (values.astype(np.float32) != values).any()
        np.testing.assert_allclose(single[column], values, rtol=rtol, err_msg=column)


@pytest.mark.parametrize("name", ["mass_spring", "rigid_body", "billiards"])
def test_without_a_time_axis(tmp_path, name):
    options = (*SHORT[name], "--double")
    slots = descent(name, tmp_path, *options)
    for state in ("saved", "recomputed"):
        found = descent(name, tmp_path, *options, "--state", state)
        for column, values in slots.items():
            np.testing.assert_allclose(found[column], values, rtol=1e-9, err_msg=column)


def test_memory_of_all_states(tmp_path):
    output = printed("billiards", tmp_path, "--iterations", 2, "--state", "compare")
    blocks = re.findall(r"^(\w+): .*\n  loss.*\n  time.*\n  memory +(.*)$", output, re.M)
    slots, saved, recomputed = (words for _, words in blocks)
    assert [name for name, _ in blocks] == ["slots", "saved", "recomputed"]
    assert slots == "704 KiB of state, 0 B of tape"
    assert saved.startswith("704 B of state") and "launches run again" in recomputed
    kept = [float(re.search(r"(\S+) KiB of tape", words).group(1)) for words in (saved, recomputed)]
    assert 5 * kept[1] < kept[0] < 704


@pytest.mark.parametrize(
    "name, options",
    [
        ("mass_spring", ("--robot", 0, "--steps", 60)),
        ("rigid_body", ("--robot", 1, "--steps", 60)),
        ("billiards", ("--steps", 700)),
        ("electric", ("--controller", "published", "--steps", 100)),
        ("mass_spring_simple", ("--steps", 100)),
    ],
)
def test_going_on(tmp_path, name, options):
    options = (*options, "--deterministic")
    whole = descent(name, tmp_path / "whole", *options, "--iterations", 5)
    descent(name, tmp_path / "parts", *options, "--iterations", 2)
    resumed = descent(name, tmp_path / "parts", *options, "--iterations", 5, "--resume")
    for column, values in whole.items():
        assert resumed[column].tolist() == values.tolist(), column


@pytest.mark.parametrize(
    "name, options",
    [
        ("billiards", ("--iterations", 1)),
        ("billiards", ("--scan", "--samples", 2)),
        ("mass_spring", ("--iterations", 1, "--state", "recomputed")),
        ("rigid_body", ("--iterations", 1, "--robot", 1)),
        ("rigid_body_toi", ()),
        ("rigid_body_discontinuity", ("--samples", 1)),
        ("gradient_explosion", ("--descend", "--iterations", 1)),
        ("electric", ("--iterations", 1)),
        ("mass_spring_simple", ("--iterations", 1, "--wall")),
    ],
)
def test_the_shortest_runs_with_pictures(tmp_path, name, options):
    done = start(name, tmp_path, *options, "--steps", 2, pictures=True)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr and list(tmp_path.glob(f"{name}.*.png"))


@pytest.mark.parametrize(
    "name, options, line",
    [
        ("mass_spring", ("--robot", 7), "argument --robot: invalid choice: 7"),
        ("mass_spring", ("--steps", 1), "argument --steps: 1 is impossible; at least 2"),
        ("rigid_body", ("--rate", "nan"), "argument --rate: nan is impossible; at least 0"),
        ("billiards", ("--steps", 2**31 - 1), "this size does not fit into memory: out of memory"),
        (
            "rigid_body_discontinuity",
            ("--samples", 2**31 - 1),
            "this size does not fit into memory",
        ),
        ("mass_spring_simple", ("--target", "nan"), "argument --target: nan is impossible"),
        ("electric", ("--steps", 511), "--steps: the path has two halves"),
        ("gradient_explosion", ("--every", 0), "argument --every: 0 is impossible; at least 1"),
    ],
)
def test_bad_sizes(tmp_path, name, options, line):
    done = start(name, tmp_path, *options)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith(f"{name}: {line}") and done.stderr.count("\n") == 1
