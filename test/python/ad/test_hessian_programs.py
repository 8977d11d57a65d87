"""Products of Hessians and vectors on smooth programs, most of which overwrite values.

They are compared with differences of gradients, and with the product of another direction.
"""

import numpy as np
import pytest
import tai as ti
from tai._impl.ad.mode import derivatives_of_gradients
from tai._impl.ad.snapshot import Snapshot

import smooth_types
from smooth_steps import PROGRAMS, both, squares_of

# Each of the two modules adds its own.
assert smooth_types.loss_of_a_mean in PROGRAMS.values()
assert len(PROGRAMS) == 49

MOSTLY_TAPES = [
    "pendulum_in_place", "fill_by_the_host", "accumulated_force", "sparse_grid_that_is_emptied",
    "swap_of_two_buffers", "time_loop_in_a_kernel",
]  # fmt: skip


def start_of(field, generator):
    """A point and a direction; a sparse field has them where it is active."""
    values = field.to_numpy()
    point = generator.uniform(0.55, 0.95, values.shape)
    if values.ndim > 2 and values.shape[-1] == values.shape[-2]:
        point = point + 0.8 * np.eye(values.shape[-1])
    direction = generator.standard_normal(values.shape)
    active = values != 0 if values.any() else np.ones(values.shape, bool)
    return np.where(active, point, 0.0), np.where(active, direction, 0.0)


def difference_of_gradients(gradients, h=1e-3):
    """Central differences with two steps of extrapolation, for each input."""

    def slopes(h):
        return [(a - b) / (2 * h) for a, b in zip(gradients(h), gradients(-h), strict=True)]

    table = [slopes(h / 2**k) for k in range(3)]
    for order in (4, 16):
        table = [
            [(order * fine - coarse) / (order - 1) for fine, coarse in zip(*pair, strict=True)]
            for pair in zip(table[1:], table, strict=False)
        ]
    return table[0]


class Case:
    """A program with a point and two directions."""

    def __init__(self, name):
        self.run, self.loss, self.inputs = PROGRAMS[name]()
        generator = np.random.default_rng(len(name))
        starts = [start_of(field, generator) for field in self.inputs]
        self.points = [point for point, _ in starts]
        self.directions = [direction for _, direction in starts]
        self.others = [start_of(field, generator)[1] for field in self.inputs]

    def begin(self, step=0.0):
        for field, point, direction in zip(self.inputs, self.points, self.directions, strict=True):
            field.from_numpy(point + step * direction)

    def gradients(self, step=0.0):
        with Snapshot():
            self.begin(step)
            with ti.ad.Tape(self.loss):
                self.run()
            return [field.grad.to_numpy() for field in self.inputs]

    def product(self, directions=None, run=None):
        """The product, with the gradient that the sweep leaves."""
        with Snapshot():
            self.begin()
            found = ti.ad.hvp(
                run or self.run, self.loss, self.inputs, directions or self.directions
            )
            return found, [field.grad.to_numpy() for field in self.inputs]


def agree(found, expected, tolerance):
    scale = max(np.abs(part).max() for part in expected)
    assert scale > 0
    for mine, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, wanted, rtol=tolerance, atol=tolerance * scale)


@pytest.mark.parametrize("name", PROGRAMS)
def test_program(name):
    ti.init(default_fp=ti.f64, offline_cache=False)
    case = Case(name)
    found, gradient = case.product()
    agree(gradient, case.gradients(), 1e-13)
    agree(found, difference_of_gradients(case.gradients), 1e-7)
    # The Hessian is symmetric: u · H v = v · H u.
    swapped, _ = case.product(case.others)
    one = sum(np.sum(u * hv) for u, hv in zip(case.others, found, strict=True))
    two = sum(np.sum(v * hu) for v, hu in zip(case.directions, swapped, strict=True))
    assert one == pytest.approx(two, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", MOSTLY_TAPES)
def test_emulated_device(name, threads, monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    found = []
    for arch in (ti.cpu, ti.cuda):
        ti.init(arch, default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=threads)
        found.append(Case(name).product()[0])
    agree(found[1], found[0], 1e-12)


@pytest.mark.parametrize("policy", ["binomial", "periodic", "mixed", 2])
@pytest.mark.parametrize("name", MOSTLY_TAPES)
def test_snapshots_hold_tangents(name, policy):
    ti.init(default_fp=ti.f64, offline_cache=False)
    case = Case(name)

    def product(**options):
        def sweep():
            with ti.ad.Tape(case.loss, **options):
                case.run()

        with Snapshot():
            case.begin()
            pairs = list(zip(case.inputs, case.directions, strict=True))
            return derivatives_of_gradients(sweep, case.loss, pairs)

    agree(product(checkpoint=policy), product(), 1e-13)


@pytest.mark.parametrize("options", [{}, {"checkpoint": "binomial"}])
@pytest.mark.parametrize("name", MOSTLY_TAPES)
def test_tape_that_was_recorded_before(name, options):
    ti.init(default_fp=ti.f64, offline_cache=False)
    case = Case(name)
    expected, _ = case.product()
    with Snapshot():
        case.begin()
        with ti.ad.Tape(case.loss, **options) as tape:
            case.run()
    for _ in range(2):
        agree(case.product(run=tape)[0], expected, 1e-13)
    # Out of forward mode, the same tape gives the same gradient as before.
    alone = case.gradients()
    with Snapshot():
        case.begin()
        tape.replay()
        agree([field.grad.to_numpy() for field in case.inputs], alone, 1e-13)


@pytest.mark.parametrize("options", [{}, {"checkpoint": "binomial"}])
def test_sweep_in_forward_mode_of_a_tape_recorded_outside(options):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = both(), both()

    @ti.kernel
    def step():
        x[None] = ti.sin(x[None])

    @ti.kernel
    def measure():
        loss[None] += x[None] ** 2

    x[None] = 0.7
    with ti.ad.Tape(loss, **options) as tape:
        step()
        step()
        measure()
    gradient = x.grad[None]
    with ti.ad.FwdMode(loss=loss, param=x):
        with pytest.raises(ti.TaiRuntimeError, match="without their tangents.*tape.replay"):
            tape.grad()
    tape.grad()
    assert x.grad[None] == gradient


def test_whole_hessian_of_a_simulator_in_place():
    ti.init(default_fp=ti.f64, offline_cache=False)
    state, loss = both(2), both()

    @ti.kernel
    def step():
        state[1] -= 0.1 * ti.sin(state[0])
        state[0] += 0.1 * state[1]

    measure = squares_of(state, loss)

    def run():
        for _ in range(20):
            step()
        measure()

    def gradient(point):
        state.from_numpy(point)
        with ti.ad.Tape(loss):
            run()
        return state.grad.to_numpy()

    point, h = np.array([0.8, -0.3]), 1e-5
    expected = [(gradient(point + h * e) - gradient(point - h * e)) / (2 * h) for e in np.eye(2)]
    state.from_numpy(point)
    found = ti.ad.hessian(run, loss, state)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(state.to_numpy(), point)
    operator = ti.ad.hessian_operator(run, loss, state)
    np.testing.assert_allclose(operator @ np.array([1.0, 2.0]), found @ [1, 2], rtol=1e-13)


def test_condition_of_the_gradient_where_values_between_are_overwritten():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, y, loss = both(3), both(3), both()

    @ti.kernel
    def begin():
        for i in x:
            y[i] = x[i]

    @ti.kernel
    def step():
        for i in y:
            y[i] = y[i] ** 2

    measure = squares_of(y, loss)
    x.from_numpy(np.array([0.8, 0.9, 1.1]))
    with ti.ad.Tape(loss) as tape:
        begin()
        step()
        step()
        measure()
    # Σ x^8: the gradient is 8 x^7, its derivative 56 x^6.
    assert tape.condition().loss == pytest.approx(8, rel=1e-12)
    assert tape.condition().gradient == pytest.approx(7, rel=1e-12)


def test_values_of_f32_and_a_large_field():
    ti.init(default_fp=ti.f32, offline_cache=False)
    n = 65_537
    x, loss = both(n, ti.f32), both((), ti.f32)

    @ti.kernel
    def step():
        for i in x:
            x[i] = x[i] ** 2

    measure = squares_of(x, loss)

    def run():
        step()
        step()
        measure()

    point = np.linspace(0.5, 1, n, dtype=np.float32)
    x.from_numpy(point)
    product = ti.ad.hvp(run, loss, x, np.ones(n, np.float32))
    np.testing.assert_allclose(product, 56 * point.astype(float) ** 6, rtol=1e-5)
