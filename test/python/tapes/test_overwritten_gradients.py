"""One rule: after a sweep, `.grad` is by the value of the element when the tape began."""

import numpy as np
import pytest
import tai as ti

STEPS = 4
# Each program computes x[t + 1] = 2 x[t] and adds x[4] to the loss.
ONLY_THE_FIRST = [2.0**STEPS, 0, 0, 0, 0]


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def scalar(name="loss"):
    return ti.field(ti.f64, shape=(), needs_grad=True, name=name)


def series(name="x"):
    x = ti.field(ti.f64, shape=STEPS + 1, needs_grad=True, name=name)
    x[0] = 1.0
    return x


def by_argument(x):
    @ti.kernel
    def step(t: ti.i32):
        x[t + 1] = 2 * x[t]

    return lambda: [step(t) for t in range(STEPS)]


def by_two_arguments(x):
    @ti.kernel
    def step(t: ti.i32, s: ti.i32):
        x[s] = 2 * x[t]

    return lambda: [step(t, t + 1) for t in range(STEPS)]


def by_a_product(x):
    @ti.kernel
    def step(t: ti.i32):
        x[t * 1 + 2 - 1] = 2 * x[t]

    return lambda: [step(t) for t in range(STEPS)]


def by_constants(x):
    def make(t):
        @ti.kernel
        def step():
            x[t + 1] = 2 * x[t]

        return step

    kernels = [make(t) for t in range(STEPS)]
    return lambda: [kernel() for kernel in kernels]


def by_templates(x):
    @ti.kernel
    def step(t: ti.template()):
        x[t + 1] = 2 * x[t]

    return lambda: [step(t) for t in range(STEPS)]


def unrolled(x):
    @ti.kernel
    def steps():
        for t in ti.static(range(STEPS)):
            x[t + 1] = 2 * x[t]

    return steps


def serial(x):
    @ti.kernel
    def steps():
        for _ in range(1):
            for t in range(STEPS):
                x[t + 1] = 2 * x[t]

    return steps


def through_another_field(x):
    index = ti.field(ti.i32, shape=STEPS + 1)
    index.from_numpy(np.arange(STEPS + 1, dtype=np.int32))

    @ti.kernel
    def step(t: ti.i32):
        x[index[t + 1]] = 2 * x[index[t]]

    return lambda: [step(t) for t in range(STEPS)]


def under_a_condition(x):
    @ti.kernel
    def step(t: ti.i32):
        if x[t] > 0:
            x[t + 1] = 2 * x[t]

    return lambda: [step(t) for t in range(STEPS)]


def in_a_function(x):
    @ti.func
    def put(t, value):
        x[t] = value

    @ti.kernel
    def step(t: ti.i32):
        put(t + 1, 2 * x[t])

    return lambda: [step(t) for t in range(STEPS)]


def in_i64(x):
    @ti.kernel
    def step(t: ti.i64):
        x[t + 1] = 2 * x[t]

    return lambda: [step(t) for t in range(STEPS)]


def by_loop_bounds(x):
    @ti.kernel
    def step(lower: ti.i32, upper: ti.i32):
        for t in range(lower, upper):
            x[t + 1] = 2 * x[t]

    return lambda: [step(t, t + 1) for t in range(STEPS)]


FORMS = [
    by_argument, by_two_arguments, by_a_product, by_constants, by_templates, unrolled, serial,
    through_another_field, under_a_condition, in_a_function, in_i64, by_loop_bounds,
]  # fmt: skip


def last_of(x, loss):
    @ti.kernel
    def last():
        loss[None] += x[STEPS]

    return last


@pytest.mark.parametrize("form", FORMS)
def test_every_index_form(form):
    x, loss = series(), scalar()
    run, last = form(x), last_of(x, loss)
    for _ in range(2):  # the second recording has all code
        with ti.ad.Tape(loss) as tape:
            run()
            last()
        assert x.grad.to_numpy().tolist() == ONLY_THE_FIRST
    for _ in range(2):
        tape.replay()
        assert x.grad.to_numpy().tolist() == ONLY_THE_FIRST
    tape.grad()
    assert [x.grad[t] for t in range(STEPS + 1)] == ONLY_THE_FIRST
    assert loss.grad[None] == 1


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("options", [{"checkpoint": 2}, {"checkpoint": "periodic"}])
def test_recomputed(form, options):
    x, loss = series(), scalar()
    run, last = form(x), last_of(x, loss)
    with ti.ad.Tape(loss, **options):
        run()
        last()
    assert x.grad.to_numpy().tolist() == ONLY_THE_FIRST


@pytest.mark.parametrize("options", [{"fuse_launches": False}, {"deterministic": True}])
@pytest.mark.parametrize("form", FORMS)
def test_other_modes(form, options):
    ti.init(default_fp=ti.f64, offline_cache=False, **options)
    test_every_index_form(form)


def test_an_accumulation_ends_nothing():
    x, loss = series(), scalar()

    @ti.kernel
    def step(t: ti.i32):
        x[t + 1] += 2 * x[t]

    last = last_of(x, loss)
    with ti.ad.Tape(loss):
        for t in range(STEPS):
            step(t)
        last()
    assert x.grad.to_numpy().tolist() == [16, 8, 4, 2, 1]


def test_a_loss_that_is_stored():
    x, loss = series(), scalar()

    @ti.kernel
    def last():
        loss[None] = x[0] ** 2

    with ti.ad.Tape(loss):
        last()
    assert x.grad[0] == 2
    assert loss.grad[None] == 0


def test_a_constant_ends_the_gradient_of_what_it_overwrites():
    x, loss = series(), scalar()

    @ti.kernel
    def begin():
        x[0] = 3.0

    run, last = by_argument(x), last_of(x, loss)
    with ti.ad.Tape(loss):
        begin()
        run()
        last()
    assert x.grad.to_numpy().tolist() == [0, 0, 0, 0, 0]


@pytest.mark.parametrize("count", [1, 7, 65_537])
def test_elements_that_are_not_overwritten_keep_their_gradient(count):
    x = ti.field(ti.f64, shape=(3, count), needs_grad=True)
    loss = scalar()

    @ti.kernel
    def masked(t: ti.i32):
        for i in range(count):
            if i % 2 == 0:
                x[t, i] = 3 * x[t - 1, i]

    @ti.kernel
    def interior(t: ti.i32, first: ti.i32, last: ti.i32):
        for i in range(first, last):
            x[t, i] = 5 * x[t - 1, i]

    @ti.kernel
    def total():
        for i in range(count):
            loss[None] += x[2, i]

    odd = np.arange(count) % 2 == 1
    inside = (np.arange(count) >= 1) & (np.arange(count) < count - 1)
    with ti.ad.Tape(loss):
        masked(1)
        interior(2, 1, count - 1)
        total()
    expected = np.zeros((3, count))
    expected[2] = ~inside
    expected[1] = np.where(odd & inside, 5, 0)
    expected[0] = np.where(~odd & inside, 15, 0)
    np.testing.assert_array_equal(x.grad.to_numpy(), expected)


def test_a_loop_that_does_not_run_overwrites_nothing():
    x, loss = series(), scalar()

    @ti.kernel
    def repeat(times: ti.i32):
        for _ in range(1):
            for _ in range(times):
                x[4] = 7.0

    last = last_of(x, loss)
    for times, expected in ((0, 1), (1, 0)):
        with ti.ad.Tape(loss):
            repeat(times)
            last()
        assert x.grad[4] == expected


@pytest.mark.parametrize("axes", ["i", "j", "blocked"])
def test_the_time_axis_lies_anywhere(axes):
    x = ti.field(ti.f64, name="x")
    if axes == "i":
        ti.root.dense(ti.i, 4).dense(ti.j, 8).place(x, x.grad)
    elif axes == "j":
        ti.root.dense(ti.j, 8).dense(ti.i, 4).place(x, x.grad)
    else:
        ti.root.dense(ti.ij, (2, 2)).dense(ti.ij, (2, 4)).place(x, x.grad)
    loss = scalar()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(8):
            x[t, i] = 2 * x[t - 1, i]

    @ti.kernel
    def total():
        for i in range(8):
            loss[None] += i * x[3, i]

    with ti.ad.Tape(loss):
        for t in range(1, 4):
            step(t)
        total()
    expected = np.zeros((4, 8))
    expected[0] = 8 * np.arange(8)
    np.testing.assert_array_equal(x.grad.to_numpy(), expected)


def test_vectors_structs_and_offsets():
    state = ti.Struct.field(
        {"x": ti.types.vector(2, ti.f64), "v": ti.f64}, shape=(STEPS + 1, 3), needs_grad=True
    )
    shifted = ti.field(ti.f64, shape=(STEPS + 1, 3), offset=(-2, 5), needs_grad=True)
    loss = scalar()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(3):
            state[t + 1, i].x = 2 * state[t, i].x
            state[t + 1, i].v = 3 * state[t, i].v
            shifted[t - 1, i + 5] = 4 * shifted[t - 2, i + 5]

    @ti.kernel
    def total():
        for i in range(3):
            loss[None] += state[STEPS, i].x.sum() + state[STEPS, i].v + shifted[STEPS - 2, i + 5]

    with ti.ad.Tape(loss):
        for t in range(STEPS):
            step(t)
        total()
    for found, factor in ((state.x, 2), (state.v, 3), (shifted, 4)):
        gradient = found.grad.to_numpy()
        assert np.all(gradient[0] == factor**STEPS)
        assert np.all(gradient[1:] == 0)


@pytest.mark.parametrize("level", ["pointer", "bitmasked"])
def test_sparse(level):
    x = ti.field(ti.f64)
    getattr(ti.root, level)(ti.i, 4).dense(ti.i, 4).place(x, x.grad)
    loss = scalar()

    @ti.kernel
    def step(t: ti.i32):
        x[t + 4] = 2 * x[t]

    @ti.kernel
    def total():
        loss[None] += x[12]

    x[0] = 1.0
    with ti.ad.Tape(loss):
        for t in range(0, 12, 4):
            step(t)
        total()
    assert [x.grad[t] for t in (0, 4, 8, 12)] == [8, 0, 0, 0]


def looks_at(x, how):
    """The values of the gradient, as an observer that uses `how` sees them."""
    if how == "kernel":
        out = ti.field(ti.f64, shape=x.shape)

        @ti.kernel
        def copy():
            for i in x:
                out[i] = x.grad[i]

        return lambda: (copy(), out.to_numpy())[1]
    if how == "one element in a kernel":

        @ti.kernel
        def element(i: ti.i32) -> ti.f64:
            return x.grad[i]

        return lambda: np.array([element(i) for i in range(x.shape[0])])
    if how == "elements":
        return lambda: np.array([x.grad[i] for i in range(x.shape[0])])
    if how == "dlpack":
        if x.grad.__dlpack_device__()[0] != 1:
            pytest.skip("NumPy takes no memory of a GPU")
        return lambda: np.from_dlpack(x.grad).copy()
    if how == "torch":
        pytest.importorskip("torch")
        return lambda: x.grad.to_torch().cpu().numpy()
    return lambda: x.grad.to_numpy()


LOOKS = ["kernel", "one element in a kernel", "elements", "dlpack", "torch", "numpy"]


@pytest.mark.parametrize("how", LOOKS)
def test_whoever_looks_sees_zeros(how):
    x, loss = series(), scalar()
    run, last, look = by_argument(x), last_of(x, loss), looks_at(x, how)
    for _ in range(3):  # a launch that has been prepared, and memory that is lent, too
        with ti.ad.Tape(loss):
            run()
            last()
        assert look().tolist() == ONLY_THE_FIRST
        assert look().tolist() == ONLY_THE_FIRST


def test_what_is_written_afterwards_stays():
    x, loss = series(), scalar()
    run, last = by_argument(x), last_of(x, loss)

    @ti.kernel
    def put():
        x.grad[3] = 5.0

    def sweep():
        with ti.ad.Tape(loss):
            run()
            last()

    sweep()
    x.grad[3] = 5.0
    assert x.grad.to_numpy().tolist() == [16, 0, 0, 5, 0]
    sweep()
    put()
    assert x.grad.to_numpy().tolist() == [16, 0, 0, 5, 0]
    sweep()
    x.grad.from_numpy(np.arange(5.0))
    assert x.grad.to_numpy().tolist() == [0, 1, 2, 3, 4]
    sweep()
    x.grad.fill(2.0)
    assert x.grad.to_numpy().tolist() == [2, 2, 2, 2, 2]


def test_gradients_of_two_sweeps_add_up():
    x, loss = series(), scalar()
    run, last = by_argument(x), last_of(x, loss)
    ti.ad.clear_all_gradients()
    for times in (1, 2):
        with ti.ad.Tape(loss, clear_gradients=False):
            run()
            last()
        assert x.grad.to_numpy().tolist() == [16.0 * times, 0, 0, 0, 0]


def test_seeds_of_what_is_overwritten_are_used_up():
    x = series()
    run = by_argument(x)
    with ti.ad.Tape() as tape:
        run()
    for _ in range(2):
        tape.backward({x: np.array([0, 0, 1.0, 0, 1.0])})
        assert x.grad.to_numpy().tolist() == [4 + 16, 0, 0, 0, 0]


def test_by_hand():
    x = series()

    @ti.kernel
    def step(t: ti.i32):
        x[t + 1] = 2 * x[t]

    for t in range(STEPS):
        step(t)
    x.grad[STEPS] = 1.0
    for t in reversed(range(STEPS)):
        step.grad(t)
    assert x.grad.to_numpy().tolist() == ONLY_THE_FIRST


def test_a_gradient_of_the_programs_own_comes_last():
    x, loss = series(), scalar()

    @ti.kernel
    def step(t: ti.i32):
        x[t + 1] = 2 * x[t]

    @ti.ad.grad_replaced
    def touch():
        pass

    @ti.ad.grad_for(touch)
    def touch_gradient():
        x.grad[1] += 100.0  # by what x[1] held then

    last = last_of(x, loss)
    with ti.ad.Tape(loss):
        touch()
        for t in range(STEPS):
            step(t)
        last()
    assert x.grad.to_numpy().tolist() == [16, 100, 0, 0, 0]


def test_an_optimiser_that_reads_one_slot():
    """Its kernel meets nothing that is to be zeroed, and the next sweep starts from zeros."""
    count = 1000
    x = ti.field(ti.f64, shape=(5, count), needs_grad=True)
    loss = scalar()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(count):
            x[t, i] = 2 * x[t - 1, i]

    @ti.kernel
    def total():
        for i in range(count):
            loss[None] += x[4, i] ** 2

    @ti.kernel
    def descend(rate: ti.f64):
        for i in range(count):
            x[0, i] -= rate * x.grad[0, i]

    x.from_numpy(np.tile(np.linspace(1, 2, count), (5, 1)))
    expected = x.to_numpy()[0]
    for _ in range(4):
        with ti.ad.Tape(loss):
            for t in range(1, 5):
                step(t)
            total()
        descend(1e-4)
        expected = expected - 1e-4 * 512 * expected
    np.testing.assert_allclose(x.to_numpy()[0], expected, rtol=1e-13)
    assert np.all(x.grad.to_numpy()[1:] == 0)


def test_forward_over_reverse():
    x = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def step(t: ti.i32):
        x[t + 1] = x[t] ** 2

    @ti.kernel
    def total():
        loss[None] += x[2]

    def run():
        step(0)
        step(1)
        total()

    x[0] = 2.0
    direction = np.array([1.0, 0, 0])
    product = ti.ad.hvp(run, loss, x, direction)
    # x ** 4: 4 x ** 3 and 12 x ** 2.
    assert product.tolist() == [48, 0, 0]
    assert x.grad.to_numpy().tolist() == [32, 0, 0]
