"""Gradients of programs on sparse layouts, against closed forms and complex steps in NumPy."""

import numpy as np
import pytest
import tai as ti

N = 24
OFFSET = -5


def pointer(axes, n):
    return ti.root.pointer(axes, n // 4).dense(axes, 4)


def bitmasked(axes, n):
    return ti.root.bitmasked(axes, n)


def hashed(axes, n):
    return ti.root.hash(axes, n // 3).dense(axes, 3)


def two_levels(axes, n):
    return ti.root.pointer(axes, n // 8).pointer(axes, 4).dense(axes, 2)


def mixed(axes, n):
    return ti.root.pointer(axes, n // 6).bitmasked(axes, 6)


def under_dense(axes, n):
    return ti.root.dense(axes, n // 6).pointer(axes, 3).dense(axes, 2)


def dynamic(axes, n):
    return ti.root.dynamic(axes, n)


KINDS = {
    "pointer": pointer,
    "bitmasked": bitmasked,
    "hash": hashed,
    "two_levels": two_levels,
    "mixed": mixed,
    "under_dense": under_dense,
    "dynamic": dynamic,
}
SAVING = [{}, {"checkpoint": "binomial"}, {"checkpoint": "periodic"}, {"checkpoint": 2}]


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64)


@pytest.fixture(params=KINDS, ids=str)
def kind(request):
    return KINDS[request.param]


@pytest.fixture(params=SAVING, ids=lambda options: str(options.get("checkpoint", "saves")))
def saving(request):
    return request.param


def real(*shape):
    return ti.field(ti.f64, shape=shape, needs_grad=True)


def sparse(kind, n=N, axes=ti.i, offset=None):
    field = ti.field(ti.f64, needs_grad=True)
    node = kind(axes, n)
    node.place(field, offset=offset)
    return field, node


def slopes(function, *arrays):
    """The gradient of `function(*arrays)` by each array, by complex steps."""
    result = []
    for k, array in enumerate(arrays):
        gradient = np.zeros(array.shape)
        for index in np.ndindex(array.shape):
            step = [a.astype(complex) for a in arrays]
            step[k][index] += 1e-30j
            gradient[index] = function(*step).imag / 1e-30
        result.append(gradient)
    return result


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=1e-13, atol=1e-13)


def numbers(*shape, seed=0):
    return np.random.default_rng(seed).uniform(0.5, 1.5, shape)


# Domains of loops


def test_stencil_reads_inactive_neighbours(kind):
    (x, _), y, loss = sparse(kind, offset=OFFSET), real(N), real()
    values = numbers(N)

    @ti.kernel
    def fill(at: ti.i32, value: ti.f64):
        x[at] = value

    @ti.kernel
    def gather():
        for i in y:
            if 0 < i and i < N - 1:
                a, b, c = x[i - 1 + OFFSET], x[i + OFFSET], x[i + 1 + OFFSET]
                y[i] = a * b + 0.5 * b * c * c

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (i + 1)

    inside = range(9)
    for i in inside:
        fill(i + OFFSET, values[i])
    with ti.ad.Tape(loss):
        gather()
        total()

    def reference(x):
        x = np.where(np.arange(N) < len(inside), x, 0)
        y = x[:-2] * x[1:-1] + 0.5 * x[1:-1] * x[2:] ** 2
        return np.sum(y * np.arange(2, N))

    (expected,) = slopes(reference, values)
    actual = x.grad.to_numpy()
    # A contribution of an inactive cell does not come from any input.
    close(actual[: len(inside)], expected[: len(inside)])
    close(loss[None], reference(values))


@pytest.mark.parametrize("host", [False, True], ids=["kernel", "host"])
def test_loop_goes_over_what_it_went_over(kind, host):
    (x, _), y, c, loss = sparse(kind), real(N), real(N), real()

    @ti.kernel
    def fill(begin: ti.i32, end: ti.i32):
        for i in range(begin, end):
            x[i] = i

    @ti.kernel
    def prepare():
        for i in y:
            y[i] = c[i]

    @ti.kernel
    def double():
        for i in x:
            y[i] = 2 * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * i

    fill(0, 6)
    with ti.ad.Tape(loss):
        prepare()
        double()
        if host:
            for i in range(18, 24):
                x[i] = 1.0
        else:
            fill(18, 24)
        total()
    # Cells that became active later were not visited: y kept its values.
    i = np.arange(N)
    block = {pointer: 4, hashed: 3}.get(kind, 2)
    reached = i < (6 + block - 1) // block * block
    close(x.grad.to_numpy(), np.where(reached, 2 * i, 0))
    close(c.grad.to_numpy(), np.where(reached, 0, i))


def test_steps_that_grow(kind, saving):
    (x, _), c, loss = sparse(kind), real(4), real()
    start, weights = numbers(3), numbers(4, seed=1)

    @ti.kernel
    def begin():
        for i in range(3):
            x[i] = c[i]

    @ti.kernel
    def step(t: ti.i32):
        for i in x:
            x[i] = x[i] * x[i] * c[t] + 0.1

    @ti.kernel
    def spread(t: ti.i32):
        for i in range(4):
            x[4 * t + i + 4] += x[i] * c[3] + x[4 * t + i + 4] * c[t]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * x[i]

    values = np.concatenate([start, weights[:1]])
    c.from_numpy(values)
    listed = kind is dynamic or kind is bitmasked or kind is mixed
    block = {pointer: 4, hashed: 3, two_levels: 2, under_dense: 2}.get(kind, 1)

    def reference(c):
        x, active = np.zeros(N, c.dtype), np.zeros(N, bool)

        def activate(i):
            if kind is dynamic:
                active[: i + 1] = True
            else:
                active[i // block * block : (i // block + 1) * block] = True

        for i in range(3):
            x[i] = c[i]
            activate(i)
        for t in range(3):
            x = np.where(active, x * x * c[t] + 0.1, x)
            new = x.copy()
            for i in range(4):
                at = 4 * t + i + 4
                activate(at)
                new[at] += x[i] * c[3] + x[at] * c[t]
            x = new
        return np.sum(np.where(active, x * x, 0))

    assert listed == (block == 1)
    with ti.ad.Tape(loss, **saving):
        begin()
        for t in range(3):
            step(t)
            spread(t)
        total()
    close(loss[None], reference(values))
    close(c.grad.to_numpy(), slopes(reference, values)[0])


def test_lists_of_one_kernel_that_differ():
    (x, _), loss = sparse(pointer), real()

    @ti.kernel
    def both():
        for i in x:
            loss[None] += x[i]
        for i in range(8):
            x[i + 8] = 1.0
        for i in x:
            loss[None] += 2.0 * x[i]

    x[0] = 1.0
    with pytest.raises(ti.TaiError, match="split the kernel"), ti.ad.Tape(loss):
        both()
    # The tape leaves activity as it was.
    assert x.parent().parent().num_active == 3


def test_kernel_grad_by_hand():
    (x, _), y = sparse(pointer), real(N)

    @ti.kernel
    def square():
        for i in x:
            y[i] = x[i] * x[i]

    for i in range(8):
        x[i] = i
    square()
    y.grad.fill(1)
    x[20] = 3.0
    square.grad()
    close(x.grad.to_numpy(), np.where(np.arange(N) < 8, 2.0 * np.arange(N), 0))
    x.parent().parent().deactivate_all()
    with pytest.raises(ti.TaiError, match="'pointer' level above @.* deactivated since .*square"):
        square.grad()


# Deactivation


def p2g_scene(kind, steps=3, particles=5):
    """Particles that scatter to a grid, which is cleared by deactivation each step."""
    p, v, loss = real(particles), real(steps + 1, particles), real()
    g, node = sparse(kind)

    @ti.kernel
    def scatter(t: ti.i32):
        for k in p:
            g[k * 2 + 3 * t] += v[t, k] * p[k]
            g[k * 2 + 3 * t + 1] += v[t, k] * v[t, k]

    @ti.kernel
    def change():
        for i in g:
            g[i] = g[i] * g[i] * 0.1 + 0.2 * g[i]

    @ti.kernel
    def gather(t: ti.i32):
        for k in p:
            at = k * 2 + 3 * t
            v[t + 1, k] = v[t, k] * 0.5 + g[at] + 0.3 * g[at + 1] * g[at]

    @ti.kernel
    def total():
        for k in p:
            loss[None] += v[steps, k] * (k + 1)

    top = node.path()[0]
    if top.kind == "dense":
        top = node.path()[1]

    def run(clear, **options):
        with ti.ad.Tape(loss, **options) as tape:
            for t in range(steps):
                clear(top)
                scatter(t)
                change()
                gather(t)
            total()
        return tape

    def reference(p, v):
        for t in range(steps):
            g = np.zeros(N, p.dtype)
            for k in range(particles):
                g[k * 2 + 3 * t] += v[k] * p[k]
                g[k * 2 + 3 * t + 1] += v[k] * v[k]
            g = g * g * 0.1 + 0.2 * g
            at = np.arange(particles) * 2 + 3 * t
            v = v * 0.5 + g[at] + 0.3 * g[at + 1] * g[at]
        return np.sum(v * (np.arange(particles) + 1))

    p.from_numpy(numbers(particles))
    start = np.zeros((steps + 1, particles))
    start[0] = numbers(particles, seed=1)
    v.from_numpy(start)
    return p, v, g, loss, top, run, reference


def check_p2g(scene):
    p, v, _, loss, _, _, reference = scene
    values = p.to_numpy(), v.to_numpy()[0]
    close(loss[None], reference(*values))
    by_p, by_v = slopes(reference, *values)
    close(p.grad.to_numpy(), by_p)
    close(v.grad.to_numpy()[0], by_v)


@pytest.mark.filterwarnings("error")
def test_grid_cleared_by_the_host(kind, saving):
    scene = p2g_scene(kind)
    _, _, g, _, top, run, _ = scene
    for _ in range(2):  # the second time, the grid of the first is active
        run(lambda level: level.deactivate_all(), **saving)
        check_p2g(scene)
    held = g.to_numpy()
    count = top.num_active
    tape = run(lambda level: level.deactivate_all(), **saving)
    assert count == top.num_active
    close(g.to_numpy(), held)
    tape.replay()
    check_p2g(scene)


@pytest.mark.filterwarnings("error")
def test_grid_cleared_by_a_kernel(saving):
    scene = p2g_scene(pointer)
    level = scene[4]
    g = scene[2]

    @ti.kernel
    def clear():
        for i in g:
            ti.deactivate(level, i // 4)

    for _ in range(2):
        scene[5](lambda _: clear(), **saving)
        check_p2g(scene)


def test_deactivation_overwrites_with_zeros(kind):
    (x, node), y, loss = sparse(kind), real(N), real()
    top = next(level for level in node.path() if level.kind != "dense")

    @ti.kernel
    def read(weight: ti.f64):
        for i in x:
            y[i] += weight * x[i] * x[i]

    @ti.kernel
    def write():
        for i in y:
            x[i] = 3.0

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    for i in range(6):
        x[i] = i + 1
    with ti.ad.Tape(loss):
        read(1.0)
        top.deactivate_all()
        write()
        read(10.0)
        total()
    values = np.where(np.arange(N) < 6, np.arange(N) + 1.0, 0)
    close(x.grad.to_numpy(), 2 * values)
    close(x.to_numpy(), 3)


def test_gradient_lost_by_deactivation():
    (x, node), loss = sparse(pointer), real()

    @ti.kernel
    def read():
        for i in x:
            loss[None] += x[i] * x[i]

    x[3], x[10] = 2.0, 5.0
    with pytest.warns(ti.ad.TaiGradientWarning, match="lost in 2 cells of the 'pointer' level"), \
            ti.ad.Tape(loss):  # fmt: skip
        read()
        node.parent().deactivate_all()
    assert not x.grad.to_numpy().any()


def test_deactivation_after_the_tape():
    (x, node), y, loss = sparse(pointer), real(N), real()

    @ti.kernel
    def double():
        for i in x:
            y[i] = 2 * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    @ti.kernel
    def clear():
        for i in x:
            ti.deactivate(node.parent(), i // 4)

    for by_kernel in (False, True):
        x[3] = 1.0
        with ti.ad.Tape() as tape:
            double()
            total()
        if by_kernel:
            clear()
        else:
            node.parent().deactivate_all()
        loss.grad[None] = 1
        with pytest.raises(ti.TaiError, match="'pointer' level above @.* were deactivated after"):
            tape.grad()
        x.grad.fill(0)


# Values that the tape keeps


@pytest.mark.parametrize("saving", [*SAVING, {"validation": True}], ids=str)
def test_huge_box(saving):
    """Cost follows the number of active cells: the box has 2^36 elements."""
    box = 1 << 12
    x, y = (ti.field(ti.f32, needs_grad=True) for _ in range(2))
    block = ti.root.pointer(ti.ijk, box // 8)
    block.dense(ti.ijk, 8).place(x, y)
    loss = real()

    @ti.kernel
    def fill():
        for i, j, k in ti.ndrange(16, 8, 8):
            x[i + 800, j + 80, k + 160] = 1.0 + i

    @ti.kernel
    def step():
        for i, j, k in x:
            y[i, j, k] = x[i, j, k] * x[i, j, k]
        for i, j, k in x:
            x[i, j, k] = 0.5 * y[i, j, k] + 0.25

    @ti.kernel
    def total():
        for i, j, k in x:
            loss[None] += x[i, j, k]

    fill()
    if saving.get("validation"):
        # Not all rules are kept, which is found without looking at the whole box.
        with pytest.raises(ti.TaiAssertionError), ti.ad.Tape(loss, **saving):
            step()
            total()
        return
    with ti.ad.Tape(loss, **saving) as tape:
        for _ in range(3):
            step()
        total()
    values = 1.0 + np.arange(16)
    slope = np.ones(16)
    for _ in range(3):
        slope, values = slope * values, 0.5 * values**2 + 0.25
    for i in range(16):
        np.testing.assert_allclose(x.grad[i + 800, 80, 160], slope[i], rtol=1e-5)
    # At most 5 states of 2 fields in 2 blocks of 8^3 elements of 4 bytes.
    assert 0 < tape.stats().peak_bytes <= 5 * 2 * 2 * 8**3 * 4
    assert block.num_active == 2


def test_time_levels_are_kept_apart():
    steps = 12
    x, loss = ti.field(ti.f64, needs_grad=True), real()
    ti.root.pointer(ti.ij, (steps + 1, N // 4)).dense(ti.j, 4).place(x)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(8):
            x[t + 1, i] = x[t, i] * x[t, i] * 0.5 + 0.3

    @ti.kernel
    def total():
        for i in range(8):
            loss[None] += x[steps, i]

    for i in range(8):
        x[0, i] = 0.1 * i
    with ti.ad.Tape(loss) as tape:
        for t in range(steps):
            step(t)
        total()
    assert tape.stats().peak_bytes == 0
    value, slope = 0.1 * np.arange(8), np.ones(8)
    for _ in range(steps):
        slope, value = slope * value, 0.5 * value**2 + 0.3
    close(x.grad.to_numpy()[0, :8], slope)


# Activity as a value


def neighbours(rebuild):
    """Sums over lists that are built anew each step."""
    n, steps = 6, 3
    x, loss = real(steps + 1, n), real()
    ids = ti.field(ti.i32)
    lists = ti.root.dense(ti.i, n).dynamic(ti.j, 8)
    lists.place(ids)

    @ti.kernel
    def build(t: ti.i32):
        for i in range(n):
            for j in range(n):
                if (i * j + t) % 3 == 0:
                    ti.append(lists, [i], j)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            total = 0.0
            for k in range(ti.length(lists, [i])):
                total += x[t, ids[i, k]] * x[t, i]
            x[t + 1, i] = total + 0.5 * x[t, i]

    @ti.kernel
    def sum_up():
        for i in range(n):
            loss[None] += x[steps, i] * x[steps, i]

    def run(**options):
        with ti.ad.Tape(loss, **options):
            for t in range(steps):
                if rebuild or t == 0:
                    lists.deactivate_all()
                    build(t)
                step(t)
            sum_up()

    def reference(x):
        for t in range(steps):
            when = t if rebuild else 0
            near = [[j for j in range(n) if (i * j + when) % 3 == 0] for i in range(n)]
            x = np.array([sum(x[j] * x[i] for j in near[i]) + 0.5 * x[i] for i in range(n)])
        return np.sum(x * x)

    start = np.zeros((steps + 1, n))
    start[0] = 0.5 * numbers(n)
    x.from_numpy(start)
    return x, loss, run, reference


@pytest.mark.parametrize("rebuild", [False, True], ids=["once", "each_step"])
def test_neighbour_lists(rebuild, saving):
    x, loss, run, reference = neighbours(rebuild)
    for _ in range(2):
        run(**saving)
        values = x.to_numpy()[0]
        close(loss[None], reference(values))
        np.testing.assert_allclose(x.grad.to_numpy()[0], slopes(reference, values)[0], rtol=1e-12)


def test_branches_on_activity():
    (x, node), y, loss = sparse(pointer), real(N), real()

    @ti.kernel
    def pick(t: ti.i32):
        for i in y:
            if ti.is_active(node.parent(), i // 4):
                loss[None] += y[i] * y[i] * (t + 1)
            else:
                loss[None] += 10.0 * y[i]

    @ti.kernel
    def grow():
        for i in range(8, 12):
            x[i] = 1.0

    values = numbers(N)
    y.from_numpy(values)
    x[0] = 1.0
    with ti.ad.Tape(loss):
        pick(0)
        grow()
        pick(1)
    i = np.arange(N)
    first, second = i < 4, (i < 4) | ((i >= 8) & (i < 12))
    expected = np.where(first, 2 * values, 10) + np.where(second, 4 * values, 10)
    close(y.grad.to_numpy(), expected)
    assert node.parent().num_active == 2


def test_activity_that_the_kernel_changes():
    (x, node), y, loss = sparse(pointer), real(N), real()

    @ti.kernel
    def both():
        for i in y:
            if ti.is_active(node.parent(), i // 4):
                loss[None] += y[i] * y[i]
            x[i] = 1.0

    y.from_numpy(numbers(N))
    wanted = "kernel 'both.*' asks which cells of the 'pointer'.* the same kernel changes"
    with pytest.raises(ti.TaiError, match=wanted), ti.ad.Tape(loss):
        both()


def test_loops_over_nothing():
    (x, _), y, loss = sparse(pointer), real(N), real()

    @ti.kernel
    def visit():
        for i in x:
            y[i] += x[i] * x[i]

    @ti.kernel
    def fill():
        for i in range(4):
            x[i] = y[i] + 1.0

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    with ti.ad.Tape(loss):
        visit()
        fill()
        visit()
        total()
    close(y.grad.to_numpy()[:4], 3)
    visit.grad()
