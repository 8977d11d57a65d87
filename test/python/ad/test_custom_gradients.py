"""Gradients that programs write themselves: complex kernels, `grad_replaced`, `no_grad`."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def run_svd(folder, *options):
    options = (*options, "--out", folder, "--no-picture")
    command = [sys.executable, str(EXAMPLES / "svd_gradient.py"), *map(str, options)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("matrices", [1, 16])
def test_the_svd_of_an_iterative_solver(tmp_path, matrices):
    output = run_svd(tmp_path, "--matrices", matrices, "--iterations", 300)
    slope, difference = map(float, re.search(r"slope\s+(\S+) .*, (\S+) by", output).groups())
    assert slope == pytest.approx(difference, rel=1e-7)
    first, last = map(float, re.search(r"loss\s+(\S+) -> (\S+)", output).groups())
    assert last < 0.02 * first


def test_matrices_of_the_svd_by_seed(tmp_path):
    slopes = [
        run_svd(tmp_path, "--iterations", 1, "--seed", seed).split("\n")[0] for seed in (3, 3, 4)
    ]
    assert slopes[0] == slopes[1] != slopes[2]


def test_the_svd_by_hand_agrees_with_the_op(tmp_path):
    """The gradient of the example's loss, against ti.svd in a program of its own."""
    program = (EXAMPLES / "svd_gradient.py").read_text().partition('if __name__ == "__main__"')[0]
    script = tmp_path / "compare.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(EXAMPLES)!r})\n"
        + program
        + """
@ti.kernel
def built_in():
    for i in range(n):
        u, s, v = ti.svd(M[i])
        rotation = u @ v.transpose() - wanted_rotation[i]
        stretch = s.trace() - wanted_sigma[i].sum()
        wanted = wanted_sigma[i][0] * wanted_sigma[i][1] * wanted_sigma[i][2]
        volume = s[0, 0] * s[1, 1] * s[2, 2]
        loss[None] += rotation.norm_sqr() + stretch**2 + (volume - wanted) ** 2

generator = np.random.default_rng(5)
start = np.eye(3) + 0.2 * generator.standard_normal((n, 3, 3))
start[0] = np.eye(3)  # equal singular values
M.from_numpy(start)
wanted_rotation.from_numpy(turn(generator))
wanted_sigma.from_numpy(generator.uniform(0.8, 1.5, (n, 3)))
with ti.ad.Tape(loss):
    forward()
by_hand, value = M.grad.to_numpy(), loss[None]
loss[None] = 0.0
with ti.ad.Tape(loss):
    built_in()
assert abs(loss[None] / value - 1) < 1e-12
assert np.abs(M.grad.to_numpy() - by_hand).max() < 1e-10, (M.grad.to_numpy() - by_hand)
"""
    )
    command = [sys.executable, str(script), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def cells():
    x = ti.field(ti.f64, shape=4, needs_grad=True, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
    x.from_numpy(np.arange(1.0, 5.0))
    return x, loss


@ti.kernel
def sum_squares(x: ti.template(), loss: ti.template()):
    for i in x:
        loss[None] += x[i] ** 2


@ti.kernel
def add_to_gradient(x: ti.template(), amount: ti.f64):
    for i in x:
        x.grad[i] += amount


@pytest.mark.parametrize(
    ("replaced", "defines"),
    [
        (ti.ad.grad_replaced, ti.ad.grad_for),
        (ti.ad.complex_kernel, ti.ad.complex_kernel_grad),
        (ti.complex_kernel, ti.complex_kernel_grad),
    ],
)
def test_the_other_function_runs_in_reverse(cells, replaced, defines):
    x, loss = cells

    @replaced
    def forward(amount, power=2):
        sum_squares(x, loss)
        return amount

    @defines(forward)
    def backward(amount, power=2):
        add_to_gradient(x, amount * power)

    with ti.ad.Tape(loss):
        assert forward(3.0, power=7) == 3.0
        sum_squares(x, loss)
    assert loss[None] == 60
    assert x.grad.to_numpy().tolist() == [21 + 2, 21 + 4, 21 + 6, 21 + 8]


def test_without_a_tape_it_is_a_function_like_any(cells):
    x, loss = cells

    @ti.ad.grad_replaced
    def forward():
        sum_squares(x, loss)
        return "done"

    assert forward() == "done"
    assert loss[None] == 30
    with pytest.raises(ti.TaiAutodiffError, match="'forward' .* has no gradient"):
        with ti.ad.Tape(loss):
            forward()
    # The tape is closed, and the next one works.
    with ti.ad.Tape(loss):
        sum_squares(x, loss)
    assert x.grad[3] == 8


def test_nested(cells):
    """Inside of a replaced function nothing is recorded, replaced or not."""
    x, loss = cells
    calls = []

    @ti.ad.grad_replaced
    def inner():
        calls.append("inner")
        sum_squares(x, loss)

    @ti.ad.grad_for(inner)
    def inner_gradient():
        calls.append("inner gradient")

    @ti.ad.grad_replaced
    def outer():
        inner()
        sum_squares(x, loss)

    @ti.ad.grad_for(outer)
    def outer_gradient():
        inner()  # forward again, as a checkpoint does
        add_to_gradient(x, 1.0)

    with ti.ad.Tape(loss) as tape:
        outer()
    assert calls == ["inner", "inner"]
    assert x.grad.to_numpy().tolist() == [1, 1, 1, 1]
    assert tape.num_records == 1


def test_the_gradient_of_a_kernel_inside_of_the_gradient(cells):
    """Recomputation within a step, as in the paper's appendix on checkpointing."""
    x, loss = cells
    y = ti.field(ti.f64, shape=4, needs_grad=True)

    @ti.kernel
    def cube():
        for i in x:
            y[i] = x[i] ** 3

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] ** 2

    @ti.ad.grad_replaced
    def step():
        cube()
        total()

    @ti.ad.grad_for(step)
    def step_gradient():
        y.fill(0.0)  # another step may have used the field
        cube()
        total.grad()
        cube.grad()

    with ti.ad.Tape(loss):
        step()
        y.fill(-1.0)
    np.testing.assert_allclose(x.grad.to_numpy(), 6 * np.arange(1.0, 5.0) ** 5, rtol=1e-14)


@ti.data_oriented
class Body:
    def __init__(self, stiffness):
        self.x = ti.field(ti.f64, shape=4, needs_grad=True)
        self.stiffness = stiffness
        self.x.fill(1.5)

    @ti.kernel
    def energy(self, loss: ti.template()):
        for i in self.x:
            loss[None] += self.stiffness * self.x[i] ** 2

    @ti.kernel
    def push(self, amount: ti.f64):
        for i in self.x:
            self.x.grad[i] += amount * self.stiffness

    @ti.ad.grad_replaced
    def advance(self, loss, amount):
        self.energy(loss)

    @ti.ad.grad_for(advance)
    def advance_gradient(self, loss, amount):
        self.push(amount)

    @ti.ad.no_grad
    def watch(self, loss):
        self.energy(loss)

    @ti.ad.no_grad
    @ti.kernel
    def watch_kernel(self, loss: ti.template()):
        for i in self.x:
            loss[None] += self.x[i]


def test_methods(cells):
    _, loss = cells
    soft, hard = Body(2.0), Body(10.0)
    with ti.ad.Tape(loss):
        soft.advance(loss, amount=0.25)
        hard.advance(loss, 0.5)
        hard.energy(loss)
        soft.watch(loss)
        soft.watch_kernel(loss)
    assert loss[None] == 4 * (2 + 10 + 10 + 2) * 2.25 + 6
    assert soft.x.grad.to_numpy().tolist() == [0.5] * 4
    assert hard.x.grad.to_numpy().tolist() == [5 + 30.0] * 4


def test_no_gradient_passes(cells):
    x, loss = cells

    @ti.ad.no_grad
    def outside():
        sum_squares(x, loss)

    with ti.ad.Tape(loss):
        outside()
        sum_squares(x, loss)
    assert loss[None] == 60
    assert x.grad.to_numpy().tolist() == [2, 4, 6, 8]


def test_replaced_runs_again_in_a_replay(cells):
    x, loss = cells

    @ti.ad.grad_replaced
    def forward():
        sum_squares(x, loss)

    @ti.ad.grad_for(forward)
    def backward():
        add_to_gradient(x, loss.grad[None] * x[0])

    with ti.ad.Tape(loss) as tape:
        forward()
    assert x.grad[2] == 1
    x[0] = 2.0
    loss[None] = 0
    tape.replay()
    assert loss[None] == 4 + 4 + 9 + 16
    assert x.grad[2] == 2


def test_errors(cells):
    x, loss = cells
    with pytest.raises(ti.TaiAutodiffError, match="'sum_squares' takes no gradient of its own"):
        ti.ad.grad_for(sum_squares)
    with pytest.raises(ti.TaiAutodiffError, match="takes no gradient of its own"):
        ti.ad.grad_for(lambda: None)

    @ti.ad.grad_replaced
    def fails():
        sum_squares(x, loss)
        raise ValueError("in the forward pass")

    @ti.ad.grad_for(fails)
    def never():
        raise AssertionError

    with pytest.raises(ValueError, match="in the forward pass"), ti.ad.Tape(loss):
        fails()

    @ti.ad.grad_replaced
    def works():
        sum_squares(x, loss)

    @ti.ad.grad_for(works)
    def wrong():
        raise ValueError("in the gradient")

    with pytest.raises(ValueError, match="in the gradient"), ti.ad.Tape(loss):
        works()
    with ti.ad.Tape(loss):
        sum_squares(x, loss)
    assert x.grad[0] == 2
