"""`copy_from` under tapes and in forward mode, against closed forms."""

import numpy as np
import pytest
import tai as ti

FLAGS = {"needs_grad": True, "needs_dual": True}


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64, offline_cache=False)


@ti.kernel
def cubes(y: ti.template(), loss: ti.template()):
    for at in ti.grouped(y):
        loss[None] += y[at] ** 3


def scalar_loss():
    return ti.field(ti.f64, shape=(), name="loss", **FLAGS)


def numbers(shape, dtype=np.float64):
    return (np.arange(np.prod(shape, dtype=int)).reshape(shape) % 7 + 1).astype(dtype)


def check(x, y, loss, tolerance=1e-13):
    """loss = Σ (x + 0)³ through y, in both modes and again."""
    start = x.to_numpy()
    y.fill(0)
    with ti.ad.Tape(loss) as tape:
        y.copy_from(x)
        cubes(y, loss)
    assert (y.to_numpy() == start).all()
    np.testing.assert_allclose(x.grad.to_numpy(), 3.0 * start**2, rtol=tolerance)
    # A replay copies the present values of the source.
    x.from_numpy(2 * start)
    tape.replay()
    np.testing.assert_allclose(loss[None], 8 * (1.0 * start**3).sum(), rtol=10 * tolerance)
    np.testing.assert_allclose(x.grad.to_numpy(), 12.0 * start**2, rtol=tolerance)
    x.from_numpy(start)
    loss[None] = 0
    seed = np.cos(np.arange(start.size)).reshape(start.shape)
    with ti.ad.FwdMode(loss, x, seed=seed):
        y.copy_from(x)
        cubes(y, loss)
    np.testing.assert_allclose(loss.dual[None], (3.0 * start**2 * seed).sum(), rtol=1e-5)


@pytest.mark.parametrize("shape", [1, 5, 65_537, (3, 4), (2, 3, 2)])
def test_fields_of_numbers(shape):
    x, y = (ti.field(ti.f64, shape=shape, **FLAGS) for _ in range(2))
    x.from_numpy(numbers(x.shape))
    check(x, y, scalar_loss())


@pytest.mark.parametrize("types", [(ti.f32, ti.f64), (ti.f64, ti.f32)])
def test_other_types(types):
    x, y = (ti.field(dtype, shape=9, **FLAGS) for dtype in types)
    x.from_numpy(numbers(9, x.dtype.numpy))
    check(x, y, scalar_loss(), 1e-6)


def test_other_layouts_and_offsets():
    x, y, z = (ti.field(ti.f64, needs_grad=True, needs_dual=True) for _ in range(3))
    ti.root.dense(ti.j, 5).dense(ti.i, 4).place(x)
    ti.root.dense(ti.ij, (2, 5)).dense(ti.ij, (2, 1)).place(y)
    ti.root.dense(ti.ij, (4, 5)).place(z, offset=(-2, 3))
    x.from_numpy(numbers((4, 5)))
    loss = scalar_loss()
    for target in (y, z):
        check(x, target, loss)
    z.from_numpy(numbers((4, 5)))
    check(z, y, loss)


def test_one_number():
    x, y = (ti.field(ti.f64, shape=(), **FLAGS) for _ in range(2))
    x[None], loss = 3, scalar_loss()
    with ti.ad.Tape(loss):
        y.copy_from(x)
        y.copy_from(y)
        cubes_of_one(y, loss)
    assert x.grad[None] == 27
    with ti.ad.FwdMode(loss, x):
        y.copy_from(x)
        cubes_of_one(y, loss)
    assert loss.dual[None] == 27


@ti.kernel
def cubes_of_one(y: ti.template(), loss: ti.template()):
    loss[None] += y[None] ** 3


@ti.kernel
def norms(y: ti.template(), loss: ti.template()):
    for at in ti.grouped(y):
        loss[None] += (y[at] * y[at]).sum()


@pytest.mark.parametrize("shape", [(), 4])
def test_vectors_and_matrices(shape):
    loss = scalar_loss()
    for make in (
        lambda **o: ti.Vector.field(3, ti.f64, shape=shape, **FLAGS, **o),
        lambda **o: ti.Matrix.field(2, 2, ti.f64, shape=shape, **FLAGS, **o),
    ):
        x, y = make(), make(layout=ti.Layout.SOA)
        start = numbers(x.shape + x.element_shape)
        for source, target in ((x, y), (y, x)):
            source.from_numpy(start)
            target.fill(0)
            with ti.ad.Tape(loss):
                target.copy_from(source)
                if shape == ():
                    norm_of_one(target, loss)
                else:
                    norms(target, loss)
            assert (source.grad.to_numpy() == 2 * start).all()
            assert (target.to_numpy() == start).all()


@ti.kernel
def norm_of_one(y: ti.template(), loss: ti.template()):
    loss[None] += (y[None] * y[None]).sum()


def test_components_of_vectors():
    v = ti.Vector.field(2, ti.f64, shape=4, **FLAGS)
    x, loss = ti.field(ti.f64, shape=4, **FLAGS), scalar_loss()
    x.from_numpy(numbers(4))
    with ti.ad.Tape(loss):
        v.get_scalar_field(1).copy_from(x)
        norms(v, loss)
    assert (x.grad.to_numpy() == 2 * numbers(4)).all()
    assert (v.to_numpy()[:, 1] == numbers(4)).all()
    with ti.ad.Tape(loss):
        x.copy_from(v.get_scalar_field(1))
        cubes(x, loss)
    assert (v.grad.to_numpy() == 3 * np.stack([np.zeros(4), numbers(4) ** 2], 1)).all()


def test_structs():
    kind = ti.types.struct(a=ti.f64, b=ti.types.vector(2, ti.f64), n=ti.i32)
    x, y = kind.field(shape=3, needs_grad=True), kind.field(shape=3, needs_grad=True)
    x.from_numpy({"a": numbers(3), "b": numbers((3, 2)), "n": np.arange(3)})
    loss = scalar_loss()
    with ti.ad.Tape(loss):
        y.copy_from(x)
        cubes(y.a, loss)
        norms(y.b, loss)
    assert (x.a.grad.to_numpy() == 3 * numbers(3) ** 2).all()
    assert (x.b.grad.to_numpy() == 2 * numbers((3, 2))).all()
    assert y.n.to_numpy().tolist() == [0, 1, 2]


def make_sparse(level):
    x = ti.field(ti.f64, needs_grad=True)
    getattr(ti.root, level)(ti.i, 4).dense(ti.i, 4).place(x, x.grad)
    return x


@pytest.mark.parametrize("level", ["pointer", "bitmasked"])
def test_sparse_fields(level):
    """Cells become active that get something else than zero, as outside of tapes."""
    x, y, z = make_sparse(level), make_sparse(level), ti.field(ti.f64, shape=16, needs_grad=True)
    loss = scalar_loss()

    def set_up():
        for field in (x, y):
            field.fill(0)
        for i in (0, 1, 9):
            x[i] = i + 1.0
        y[5] = 8.0

    values = np.zeros(16)
    values[[0, 1, 9]] = 1, 2, 10

    def active(field):
        return sorted(int(c[0]) for c in field.level.nearest_sparse().active_cells())

    set_up()
    with ti.ad.Tape(loss):
        y.copy_from(x)
        cubes(y, loss)
    assert (y.to_numpy() == values).all() and active(y) == [0, 1, 2]
    assert (x.grad.to_numpy() == 3 * values**2).all()
    with ti.ad.Tape(loss):
        z.copy_from(x)
        cubes(z, loss)
    assert (z.to_numpy() == values).all()
    assert (x.grad.to_numpy() == 3 * values**2).all()
    w = make_sparse(level)
    with ti.ad.Tape(loss):
        w.copy_from(z)
        cubes(w, loss)
    assert (w.to_numpy() == values).all() and active(w) == [0, 2]
    assert (z.grad.to_numpy() == 3 * values**2).all()


def test_whole_numbers():
    x, n = ti.field(ti.f64, shape=4, **FLAGS), ti.field(ti.i32, shape=4)
    x.from_numpy(np.array([1.5, -1.5, 2.0, 0.0]))
    loss = scalar_loss()
    with ti.ad.Tape(loss) as tape:
        n.copy_from(x)
        x.copy_from(n)
        cubes(x, loss)
    assert n.to_numpy().tolist() == [1, -1, 2, 0]
    assert x.to_numpy().tolist() == [1, -1, 2, 0]
    n.fill(9)
    x.fill(3.75)
    tape.replay(backward=False)
    assert loss[None] == 4 * 27


def test_arrays():
    loss = ti.ndarray(ti.f64, shape=(), needs_grad=True)
    x, y = (ti.Vector.ndarray(2, ti.f64, shape=3, needs_grad=True) for _ in range(2))
    f = ti.Vector.field(2, ti.f64, shape=3, offset=-1, needs_grad=True)

    @ti.kernel
    def norms_of_array(y: ti.types.ndarray(), loss: ti.types.ndarray()):
        for i in range(y.shape[0]):
            loss[None] += (y[i] * y[i]).sum()

    x.from_numpy(numbers((3, 2)))
    f.from_numpy(10 * numbers((3, 2)))
    with ti.ad.Tape(loss) as tape:
        y.copy_from(x)
        norms_of_array(y, loss)
        y.copy_from(f)
        norms_of_array(y, loss)
    assert (x.grad.to_numpy() == 2 * numbers((3, 2))).all()
    assert (f.grad.to_numpy() == 20 * numbers((3, 2))).all()
    assert (y.to_numpy() == 10 * numbers((3, 2))).all()
    x.from_numpy(np.ones((3, 2)))
    f.fill(0)
    tape.replay()
    assert loss[None] == 6
    one, other = (ti.ndarray(ti.f64, shape=(), needs_grad=True) for _ in range(2))
    one[None] = 4.0
    with ti.ad.Tape(loss):
        other.copy_from(one)
        loss.copy_from(other)
    assert one.grad[None] == 1 and loss[None] == 4


def test_what_cannot_be_copied():
    x, y = ti.field(ti.f64, shape=3, name="x", **FLAGS), ti.field(ti.f64, shape=4, name="y")
    a = ti.ndarray(ti.f64, shape=3)
    loss = scalar_loss()
    for _ in range(2):
        with pytest.raises(ti.TaiRuntimeTypeError, match="'x' expects .* but field 'y' has"):
            x.copy_from(y)
        with pytest.raises(ti.TaiRuntimeTypeError, match="copy_from expects a field"):
            x.copy_from(np.zeros(3))
        with pytest.raises(ti.TaiRuntimeTypeError, match="copy_from expects a ti.ndarray") as info:
            a.copy_from(np.zeros(3))
        assert "from_numpy" in info.value.hint
        with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array of shape"):
            a.copy_from(y)
    with ti.ad.Tape(loss), pytest.raises(ti.TaiRuntimeTypeError, match="expects an array"):
        x.copy_from(y)
    # Gradients and duals are numbers like others.
    x.grad.fill(2)
    y = ti.field(ti.f64, shape=3, **FLAGS)
    y.copy_from(x.grad)
    y.dual.copy_from(x.grad)
    assert y.to_numpy().tolist() == y.dual.to_numpy().tolist() == [2, 2, 2]
