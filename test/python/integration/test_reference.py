"""The NumPy references against the published numbers and against finite differences.

The measured numbers were taken in f32 with another system, so each comparison carries the
tolerance that such a run is reproducible to. Gradients are checked in f64 by a ladder of
central differences along signed random directions.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from reference import diffmpm, scenes, smoke, wave
from reference import mass_spring as springs

Arrays = dict[str, np.ndarray]


def ladder_error(
    loss: Callable[[Arrays], float], at: Arrays, gradient: Arrays, directions: int = 4
) -> float:
    """Largest relative error of the directional derivatives, best step of a ladder each.

    Steps are extrapolated once (Richardson), so the truncation error is of fourth order.
    """
    random = np.random.default_rng(7)
    worst = 0.0
    for _ in range(directions):
        way = {name: random.standard_normal(value.shape) for name, value in at.items()}
        expected = sum(float(np.sum(gradient[name] * way[name])) for name in at)
        scale = max(abs(expected), 1e-30)

        def difference(eps: float, way: Arrays = way) -> float:
            ahead = loss({name: value + eps * way[name] for name, value in at.items()})
            behind = loss({name: value - eps * way[name] for name, value in at.items()})
            return (ahead - behind) / (2.0 * eps)

        errors = []
        for eps in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
            value = (4.0 * difference(eps / 2.0) - difference(eps)) / 3.0
            errors.append(abs(value - expected) / scale)
        worst = max(worst, min(errors))
    return worst


def norm(array: np.ndarray) -> float:
    return float(np.linalg.norm(array))


def test_ladder_sees_a_wrong_gradient():
    at = {"x": np.array([0.3, -0.7, 1.1])}
    right = {"x": np.cos(at["x"])}
    assert ladder_error(lambda a: float(np.sin(a["x"]).sum()), at, right) < 1e-9
    wrong = {"x": right["x"] * (1.0 + 1e-5)}
    assert ladder_error(lambda a: float(np.sin(a["x"]).sum()), at, wrong) > 5e-6


@pytest.mark.parametrize(("n", "mean"), [(256, 0.561737), (128, 0.560181), (110, 0.562479)])
def test_symbol_mean(n: int, mean: float):
    assert scenes.yy(n).mean() == pytest.approx(mean, abs=1e-6)


def test_robot_sizes():
    sizes = [(len(b.points), len(b.springs)) for b in map(scenes.robot, range(4))]
    assert sizes == [(6, 11), (14, 30), (20, 46), (26, 61)]
    position, muscles = scenes.crawler()
    assert np.bincount(muscles + 1).tolist() == [1824, 288, 288, 288, 288]
    assert position[:, 0].mean() == pytest.approx(0.25)


class TestTriangle:
    def test_first_gradient(self):
        loss, gradient = springs.triangle_gradient(springs.TRIANGLE_REST)
        assert loss == pytest.approx(0.0090264, abs=1e-7)
        assert gradient == pytest.approx([-0.0056597, -0.0056597, -0.0026957], abs=2e-7)

    def test_first_positions(self):
        _, x, _ = springs.triangle_forward(springs.TRIANGLE_REST)
        expected = [[0.3000151, 0.4999549], [0.3000292, 0.4000292], [0.3999549, 0.4000151]]
        # The same run in f32 gives these digits; its rounding is what separates them.
        assert np.abs(x[-1] - expected).max() < 3e-6

    def test_descent_reaches_the_printed_lengths(self):
        losses, rest = springs.triangle_descent(25)
        first = [0.0090264, 0.0086433, 0.0081431, 0.0075076, 0.0067249, 0.0058002]
        assert losses[:6] == pytest.approx(first, abs=1e-6)
        assert rest == pytest.approx([0.60004, 0.60004, 0.52851], abs=1e-4)

    def test_descent_to_the_larger_area(self):
        losses, rest = springs.triangle_descent(25, setup=springs.Triangle(target=0.2))
        first = [0.0380279, 0.0362849, 0.0333052, 0.0284935, 0.0214859, 0.0130292]
        assert losses[:6] == pytest.approx(first, abs=2e-6)
        assert rest == pytest.approx([0.85833, 0.85833, 0.76215], abs=1e-4)

    def test_descent_with_wall(self):
        losses, rest = springs.triangle_descent(25, setup=springs.Triangle(wall=True))
        first = [0.0090264, 0.0087149, 0.0083950, 0.0080345, 0.0076322, 0.0071869]
        assert losses[:6] == pytest.approx(first, abs=1e-6)
        assert rest == pytest.approx([0.64986, 0.73094, 0.67605], abs=2e-3)

    @pytest.mark.parametrize("wall", [False, True])
    def test_against_differences(self, wall: bool):
        setup = springs.Triangle(slots=200, wall=wall)
        rest = {"rest": np.array([0.16, 0.13, 0.19])}
        gradient = {"rest": springs.triangle_gradient(rest["rest"], setup)[1]}
        error = ladder_error(
            lambda a: springs.triangle_forward(a["rest"], setup)[0], rest, gradient
        )
        assert error < 1e-7


class TestRobots:
    @pytest.mark.parametrize(
        ("number", "losses", "squared_norm"),
        [
            (1, (-0.215316, -0.225342), 0.022721),
            (2, (-0.212226, -0.215992), 0.112978),
            (3, (-0.227929, -0.246183), None),
        ],
    )
    def test_first_losses(self, number, losses, squared_norm):
        body = scenes.robot(number)
        weights = scenes.robot_weights(body)
        loss, gradient = springs.robot_gradient(body, weights)
        after = springs.robot_forward(body, springs.robot_update(weights, gradient))[0]
        assert (loss, after) == pytest.approx(losses, abs=2e-5)
        if squared_norm is not None:
            total = sum(norm(g) ** 2 for g in gradient.values())
            assert total == pytest.approx(squared_norm, rel=1e-3)

    def test_short_soft_robot(self):
        body, walk = scenes.robot(0), springs.Walk(slots=150)
        weights = scenes.robot_weights(body)
        loss, gradient = springs.robot_gradient(body, weights, walk)
        after = springs.robot_forward(body, springs.robot_update(weights, gradient), walk)[0]
        assert (loss, after) == pytest.approx((-0.232538, -0.242773), abs=2e-5)
        norms = {name: norm(g) for name, g in gradient.items()}
        expected = {"w1": 0.290718, "b1": 0.102484, "w2": 0.203013, "b2": 0.0501982}
        assert norms == pytest.approx(expected, rel=2e-4)

    @pytest.mark.parametrize("toi", [False, True])
    def test_against_differences(self, toi: bool):
        body, walk = scenes.robot(1), springs.Walk(slots=60, toi=toi)
        weights = scenes.robot_weights(body)
        weights["b1"] = 0.1 * np.cos(np.arange(len(weights["b1"])))
        weights["b2"] = 0.1 * np.sin(np.arange(len(weights["b2"])))
        gradient = springs.robot_gradient(body, weights, walk)[1]
        error = ladder_error(lambda a: springs.robot_forward(body, a, walk)[0], weights, gradient)
        assert error < 1e-7

    def test_contact_is_exercised(self):
        """The difference tests above mean little unless points do hit the ground."""
        body, walk = scenes.robot(1), springs.Walk(slots=60)
        _, stored = springs.robot_forward(body, scenes.robot_weights(body), walk)
        free, x = stored["free"][1:], stored["x"][:-1]
        reach = x[..., 1] + walk.dt * free[..., 1] < walk.ground
        assert (reach & (free[..., 1] < -1e-4)).sum() > 10


class TestWave:
    def test_first_losses(self):
        losses, _ = wave.descent(scenes.wave_target(128), wave.Wave(), 4)
        assert losses == pytest.approx([0.246349, 0.224315, 0.207216, 0.193836], abs=1e-4)

    @pytest.mark.parametrize("damping", [0.0, 1e-3])
    def test_against_differences(self, damping: float):
        setup = wave.Wave(n=12, slots=20, damping=damping)
        target = scenes.wave_target(12)
        at = {"u": scenes.smooth_wave(12)}
        gradient = {"u": wave.gradient(at["u"], target, setup)[1]}
        error = ladder_error(lambda a: wave.forward(a["u"], target, setup)[0], at, gradient)
        assert error < 1e-9


class TestSmoke:
    def test_first_losses(self):
        losses, norms = smoke.descent(
            scenes.stripes(110), scenes.yy(110), smoke.Smoke(), 3, rate=100.0
        )
        assert losses == pytest.approx([0.525441, 0.426514, 0.363348], abs=1e-4)
        # Measured with a picture that agrees with the symbol on 96 % of the pixels.
        assert norms[0] == pytest.approx(0.114573, rel=1e-3)

    def test_first_losses_of_the_picture_setting(self):
        losses, _ = smoke.descent(
            scenes.checkerboard(128), scenes.yy(128), smoke.Smoke(128, 100, 10), 2, rate=400.0
        )
        assert losses == pytest.approx([0.5, 0.320631], abs=1e-4)

    @pytest.mark.parametrize("sweeps", [1, 2, 6])
    def test_against_differences(self, sweeps: int):
        n = 10
        setup = smoke.Smoke(n=n, slots=6, sweeps=sweeps)
        i = np.arange(n)
        density = np.sin(2.0 * np.pi * i / n)[:, None] + 0.5 * np.cos(2.0 * np.pi * i / n)
        # Small enough for no gather to cross a cell within the differences' steps.
        at = {"v": 0.31 * scenes.smooth_velocity(n) + 0.4}
        target = scenes.yy(n)
        gradient = {"v": smoke.gradient(at["v"], density, target, setup)[1]}
        error = ladder_error(
            lambda a: smoke.forward(a["v"], density, target, setup)[0], at, gradient
        )
        assert error < 1e-7


class TestMpm:
    def test_first_loss_of_the_block(self):
        material = diffmpm.Material()
        x = scenes.mpm_block(60, 0.7, material.dx)
        target = np.array([0.3, 0.6])
        loss, _ = diffmpm.block_forward(x, np.zeros_like(x), target, material, 1024)
        assert loss == pytest.approx(0.050466, abs=2e-6)

    def test_first_loss_of_the_crawler(self):
        x, muscles = scenes.crawler()
        loss, _ = diffmpm.crawler_forward(x, muscles, scenes.crawler_weights())
        assert loss == pytest.approx(-0.250387, abs=2e-6)

    @pytest.mark.parametrize(("sticky", "each"), [(False, False), (True, True)])
    def test_block_against_differences(self, sticky: bool, each: bool):
        material = diffmpm.Material(n=40, sticky=sticky)
        # Touches the floor and the left wall, so that both are on the tested path.
        x = scenes.mpm_block(6, 0.7, material.dx) - material.dx * np.array([7.3, 22.4])
        at = {"x": x, "v": scenes.smooth_particle_velocity(x) - 1.0}
        rest = (np.array([0.3, 0.6]), material, 20)
        _, gx, gv = diffmpm.block_gradient(at["x"], at["v"], *rest, segment=6, each=each)
        error = ladder_error(
            lambda a: diffmpm.block_forward(a["x"], a["v"], *rest, each=each)[0],
            at,
            {"x": gx, "v": gv},
        )
        assert error < 1e-7

    def test_crawler_against_differences(self):
        x, muscles = scenes.crawler()
        x, muscles = x[::16], muscles[::16]
        material = replace(diffmpm.CRAWLER, n=64)
        weights = {"weights": 2.0 * scenes.crawler_weights()["weights"], "bias": np.ones(4)}
        gradient = diffmpm.crawler_gradient(x, muscles, weights, 30, material)[1]
        error = ladder_error(
            lambda a: diffmpm.crawler_forward(x, muscles, a, 30, material)[0], weights, gradient
        )
        assert error < 1e-7
