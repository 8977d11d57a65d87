"""Vectors, matrices and boxes on sparse layouts, and the tools around gradients."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64)


def close(actual, expected, tolerance=1e-12):
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


# Boxes, vectors, matrices

SHAPE = (6, 15)
OFFSET = (-2, 7)


def blocks():
    return ti.root.pointer(ti.ij, (3, 5)).dense(ti.ij, (2, 3))


def deep():
    return ti.root.dense(ti.i, 3).hash(ti.j, 5).bitmasked(ti.ij, (2, 3))


def bits():
    return ti.root.bitmasked(ti.ij, SHAPE)


def rows():
    return ti.root.pointer(ti.i, 6).dense(ti.j, 15)


@pytest.mark.parametrize("soa", [False, True], ids=["aos", "soa"])
@pytest.mark.parametrize("layout", [blocks, deep, bits, rows])
@pytest.mark.parametrize("checkpoint", [None, "binomial"], ids=str)
def test_vectors_and_matrices(layout, soa, checkpoint):
    v = ti.Vector.field(2, ti.f64, needs_grad=True)
    m = ti.Matrix.field(2, 2, ti.f64, needs_grad=True)
    s = ti.field(ti.f64, needs_grad=True)
    node = layout()
    if soa:
        node.place(v, offset=OFFSET)
        node.place(m, s, offset=OFFSET)
    else:
        node.place(v, m, s, offset=OFFSET)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def fill(i: ti.i32, j: ti.i32, a: ti.f64):
        v[i, j] = ti.Vector([a, a * a])
        m[i, j] = ti.Matrix([[a, 0.3], [0.1 * a, 1.0 - a]])

    @ti.kernel
    def scatter():
        for I in ti.grouped(v):
            q = m[I] @ v[I]
            if I[1] < OFFSET[1] + SHAPE[1] - 2:
                s[I[0], I[1] + 2] += q.dot(v[I])
            s[I] += q[0] * s[I]

    @ti.kernel
    def step():
        for i, j in s:
            v[i, j] = v[i, j] * 0.5 + m[i, j] @ ti.Vector([s[i, j], 1.0]) * v[i, j][0]

    @ti.kernel
    def total():
        for i, j in s:
            loss[None] += s[i, j] * s[i, j] + v[i, j].sum()

    places = [(0, 0), (0, 1), (3, 7), (5, 14), (4, 4)]
    for i, j in places:
        fill(i + OFFSET[0], j + OFFSET[1], 0.4 + 0.1 * i + 0.02 * j)

    level = next(level for level in reversed(node.path()) if level.kind != "dense")

    def active():
        own = level.axis_extents()
        mask = np.zeros(SHAPE, bool)
        span = [n // own.get(a, 1) for a, n in enumerate(SHAPE)]
        for cell in level.active_cells():
            at = dict(zip(own, cell, strict=True))
            mask[tuple(slice(at.get(a, 0) * span[a], (at.get(a, 0) + 1) * span[a])
                       for a in (0, 1))] = True  # fmt: skip
        return mask

    masks = [active()]

    def reference(v, m, s):
        for first, second in masks[1:]:
            q = np.einsum("ijab,ijb->ija", m, v)
            dot = np.where(first, np.sum(q * v, -1), 0)
            new = s + np.where(first, q[..., 0] * s, 0)
            new[:, 2:] += dot[:, :-2]
            s = new
            column = np.stack([s, np.ones_like(s)], -1)
            moved = v * 0.5 + np.einsum("ijab,ijb->ija", m, column) * v[..., :1]
            v = np.where(second[..., None], moved, v)
        last = masks[-1][1]
        return np.sum(np.where(last, s * s + v.sum(-1), 0))

    start = [v.to_numpy(), m.to_numpy(), s.to_numpy()]
    with ti.ad.Tape(loss, checkpoint=checkpoint):
        for _ in range(2):
            first = active()
            scatter()
            masks.append((first, active()))
            step()
        total()
    close(loss[None], reference(*start))
    for place, field in enumerate((v, m)):
        expected = np.zeros(start[place].shape)
        for index in np.argwhere(np.broadcast_to(
                masks[0].reshape(SHAPE + (1,) * (expected.ndim - 2)), expected.shape)):  # fmt: skip
            moved = [a.astype(complex) for a in start]
            moved[place][tuple(index)] += 1e-30j
            expected[tuple(index)] = reference(*moved).imag / 1e-30
        # Compared where the field was active at the start.
        actual = field.grad.to_numpy()
        actual[~masks[0]] = 0
        close(actual, expected)


def test_loop_over_cells_of_a_level():
    x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    block = ti.root.pointer(ti.i, 6)
    block.dense(ti.i, 4).place(x)
    ti.root.dense(ti.i, 6).place(y)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def sums():
        for i in block:
            for k in range(4):
                y[i] += x[4 * i + k] * x[4 * i + k]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (i + 1)

    x[1], x[9] = 2.0, 3.0
    with ti.ad.Tape(loss):
        sums()
        x[20] = 5.0
        total()
    expected = np.zeros(24)
    expected[1], expected[9] = 4.0, 18.0
    close(x.grad.to_numpy(), expected)


# Tools


def small(growing=False):
    x = ti.field(ti.f64, needs_grad=True, needs_dual=True)
    y = ti.field(ti.f64, shape=24, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    block = ti.root.pointer(ti.i, 6)
    block.dense(ti.i, 4).place(x)

    @ti.kernel
    def square():
        for i in x:
            y[i] = 3.0 * x[i] + x[i] * x[i]

    @ti.kernel
    def grow():
        for i in range(16, 20):
            x[i] = y[i - 12] * x[i - 12]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += y[i] * x[i]

    def run():
        square()
        if growing:
            grow()
            square()
        total()

    for i in range(6):
        x[i] = 0.3 * i + 1
    return x, y, loss, block, run


def slope_of(growing):
    """The gradient by x of the program above, and its value, at the initial fields."""
    i = np.arange(24)
    x = np.where(i < 6, 0.3 * i + 1, 0.0)

    def value(x):
        active = i < 8
        y = np.where(active, 3 * x + x * x, 0)
        if growing:
            x = x.copy()
            x[16:20] = y[4:8] * x[4:8]
            active = active | ((i >= 16) & (i < 20))
            y = np.where(active, 3 * x + x * x, y)
        return np.sum(np.where(active, y * x, 0))

    result = np.zeros(24)
    for k in range(8):
        moved = x.astype(complex)
        moved[k] += 1e-30j
        result[k] = value(moved).imag / 1e-30
    return result, value(x)


@pytest.mark.parametrize("growing", [False, True])
def test_forward_mode(growing):
    x, _, loss, block, run = small(growing)
    expected, _ = slope_of(growing)
    # A tangent of an inactive cell is that of a constant, and activates nothing.
    direction = np.random.default_rng(0).standard_normal(24)
    start, count = x.to_numpy(), block.num_active
    found = ti.ad.jvp(run, x, direction, loss)
    close(found, expected[:8] @ direction[:8])
    assert block.num_active == count + growing
    for field in (x, loss):
        field.fill(0)
    block.deactivate_all()
    for k in range(6):
        x[k] = start[k]
    with ti.ad.FwdMode(loss=loss, param=x, seed=list(direction)):
        run()
    close(loss.dual[None], expected[:8] @ direction[:8])


def test_hessian_product():
    x, _, loss, _, run = small()
    direction = np.random.default_rng(0).standard_normal(24)
    start = x.to_numpy()
    found = ti.ad.hvp(run, loss, x, direction)
    # The loss is the sum of 3 x^2 + x^3.
    expected = np.where(np.arange(24) < 8, (6 + 6 * start) * direction, 0)
    close(found, expected)


@pytest.mark.parametrize("growing", [False, True])
def test_checks_leave_activity_alone(growing, capsys):
    x, _, loss, block, run = small(growing)
    expected, value = slope_of(growing)
    assert ti.ad.check(run, loss=loss, wrt=[x])
    assert ti.ad.check(run, loss=loss)
    assert block.num_active == 2
    start = x.to_numpy()
    with ti.ad.Tape(loss, grad_check=[x], health=True) as tape:
        run()
    assert "passes" in capsys.readouterr().out
    assert block.num_active == 2 + growing
    close(loss[None], value)
    close(x.grad.to_numpy()[:8], expected[:8])
    close(x.to_numpy()[:8], start[:8])
    assert tape.health() is not None


def test_check_of_a_huge_box():
    x = ti.field(ti.f64, needs_grad=True)
    ti.root.pointer(ti.ijk, 1 << 9).dense(ti.ijk, 8).place(x)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i, j, k in x:
            loss[None] += x[i, j, k] ** 2

    x[1, 2, 3] = 1.0
    with pytest.raises(ti.TaiError, match="too large to check its gradient"):
        ti.ad.check(run, loss=loss, wrt=[x])


def test_custom_gradient_in_a_growing_program():
    x, y, loss, block, _ = small()

    @ti.kernel
    def visit(t: ti.i32):
        for i in x:
            loss[None] += (t + 1) * x[i] * x[i]

    @ti.ad.grad_replaced
    def step(t):
        visit(t)

    @ti.ad.grad_for(step)
    def reverse_step(t):
        visit.grad(t)

    @ti.kernel
    def grow():
        for i in range(12, 16):
            x[i] = y[i]

    y.fill(2.0)
    with ti.ad.Tape(loss):
        for t in range(2):
            step(t)
            grow()
        loss_ends(loss)
    # The first visit knew nothing of the cells that came later.
    expected = np.where(np.arange(24) < 6, 6 * (0.3 * np.arange(24) + 1), 0)
    close(x.grad.to_numpy()[:12], expected[:12])
    close(y.grad.to_numpy()[12:16], 2 * 2 * 2.0)


def loss_ends(loss):
    """Adds nothing: it makes a launch the last record of the tape, as in most programs."""

    @ti.kernel
    def end():
        loss[None] += 0.0

    end()


def test_host_function_that_changes_what_it_loops_over():
    x, _, loss, _, _ = small()

    @ti.kernel
    def visit():
        for i in x:
            loss[None] += x[i] * x[i]

    @ti.ad.grad_replaced
    def step():
        visit()
        x[20] = 1.0

    @ti.ad.grad_for(step)
    def reverse_step():
        visit.grad()

    with pytest.raises(ti.TaiError, match="host function that launched it has changed them"), \
            ti.ad.Tape(loss):  # fmt: skip
        step()


def test_append_of_a_value_with_a_gradient():
    x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    items = ti.root.dynamic(ti.i, 16)
    items.place(x)
    ti.root.dense(ti.i, 4).place(y)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def add():
        for i in y:
            ti.append(items, [], y[i])

    @ti.kernel
    def store():
        for i in y:
            x[i] = y[i] * y[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * (i + 1)

    y.fill(3.0)
    with pytest.raises(ti.TaiAutodiffError, match="a derivative is lost in 'tai.append'.*\n.*"), \
            ti.ad.Tape(loss):  # fmt: skip
        add()
        total()
    # The remedy that the error names.
    items.deactivate_all()
    with ti.ad.Tape(loss):
        store()
        total()
    close(y.grad.to_numpy(), 6.0 * np.arange(1, 5))


def test_destroyed_tree():
    def scene():
        x = ti.field(ti.f64, needs_grad=True)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)
        builder = ti.FieldsBuilder()
        builder.pointer(ti.i, 6).dense(ti.i, 4).place(x)
        tree = builder.finalize()

        @ti.kernel
        def run():
            for i in x:
                loss[None] += x[i] * x[i]

        x[3] = 2.0
        return tree, loss, run

    tree, loss, run = scene()
    with ti.ad.Tape() as tape:
        run()
    tree.destroy()
    loss.grad[None] = 1
    with pytest.raises(ti.TaiError, match="'pointer' level above @.*, which has been destroyed"):
        tape.grad()
    with pytest.raises(ti.TaiError, match="the tree of field 'x' has been destroyed"):
        run.grad()


def test_gradient_below_another_level():
    x = ti.field(ti.f64, needs_grad=True)
    ti.root.dense(ti.i, 8).place(x)
    ti.root.pointer(ti.i, 8).place(x.grad)
    with pytest.raises(ti.TaiError, match="must lie below the same sparse level"):
        x[0] = 1.0


WRITES = {
    "fill with a number": lambda v: v.fill(1.0),
    "fill with a vector": lambda v: v.fill([1.0, 2.0]),
    "fill of a component": lambda v: v.get_scalar_field(0).fill(1.0),
    "element": lambda v: v.__setitem__(1, [1.0, 2.0]),
    "array": lambda v: v.from_numpy(np.ones((4, 2))),
    "active elements": lambda v: ti.volumes.write(v, [[1], [3]], [1.0, 2.0]),
}


@pytest.mark.parametrize("write", WRITES.values(), ids=WRITES)
def test_what_the_host_writes_has_no_tangent(write):
    """In forward mode as on a tape, whatever way it is written."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, 4, needs_grad=True, needs_dual=True)
    v = ti.Vector.field(2, ti.f64, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, (), needs_grad=True, needs_dual=True)
    ti.root.pointer(ti.i, 2).dense(ti.i, 2).place(v, v.grad, v.dual)
    x.from_numpy(np.arange(1.0, 5.0))

    @ti.kernel
    def spread():
        for i in x:
            v[i] = ti.Vector([x[i], 3 * x[i] ** 2])

    @ti.kernel
    def measure():
        for i in v:
            loss[None] += v[i].dot(v[i])

    def run():
        spread()
        write(v)
        measure()

    with ti.ad.Tape(loss):
        run()
    gradient = x.grad.to_numpy()
    loss[None] = 0
    for k in range(4):
        assert ti.ad.jvp(run, x, np.eye(4)[k], loss) == gradient[k]
