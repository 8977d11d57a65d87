"""Fields: layouts, placement, element access from Python, copies."""

import numpy as np
import pytest
import tai as ti


def test_scalar_field():
    x = ti.field(ti.f32, shape=(2, 3), name="x")
    assert x.shape == (2, 3) and x.dtype is ti.f32
    x[1, 2] = 5
    assert x[1, 2] == 5.0 and x[0, 0] == 0.0
    x.fill(2)
    assert x.to_numpy().tolist() == [[2.0] * 3] * 2
    x.from_numpy(np.arange(6).reshape(2, 3))
    assert x[1, 0] == 3
    assert str(x) == str(x.to_numpy())


def test_types():
    for dtype in (ti.i8, ti.i16, ti.i32, ti.i64, ti.u8, ti.u16, ti.u32, ti.u64, ti.f32, ti.f64):
        x = ti.field(dtype, shape=3)
        x[1] = 100
        assert x.to_numpy().dtype == dtype.numpy
        assert x.to_numpy().tolist() == [0, 100, 0]
    x = ti.field(ti.u8, shape=2)
    x[0] = 250
    assert x[0] == 250
    y = ti.field(float, shape=1)
    assert y.dtype is ti.f32


def test_zero_dimensions():
    x = ti.field(ti.i32, shape=())
    x[None] = 3
    assert x[None] == 3 and x.shape == ()
    assert x.to_numpy() == 3


def test_vector_field():
    v = ti.Vector.field(3, ti.f64, shape=2)
    assert (v.n, v.m, v.shape) == (3, 1, (2,))
    v[0] = [1, 2, 3]
    v[1][2] = 5
    v[1].x = 4
    assert v.to_numpy().tolist() == [[1, 2, 3], [4, 0, 5]]
    assert v[0].norm_sqr() == 14
    assert v[0][1] == 2
    v.fill(7)
    assert v[1].to_list() == [7, 7, 7]
    v.fill(ti.Vector([1.0, 2.0, 3.0]))
    assert v[1].to_list() == [1, 2, 3]
    assert v.get_scalar_field(1)[0] == 2
    v.get_scalar_field(1)[0] = 9
    assert v[0].to_list() == [1, 9, 3]


def test_matrix_field():
    m = ti.Matrix.field(2, 3, ti.f32, shape=(2, 2))
    assert (m.n, m.m) == (2, 3)
    m[1, 1] = [[1, 2, 3], [4, 5, 6]]
    m[0, 1][1, 2] = 8
    array = m.to_numpy()
    assert array.shape == (2, 2, 2, 3)
    assert array[1, 1].tolist() == [[1, 2, 3], [4, 5, 6]] and array[0, 1, 1, 2] == 8
    m.from_numpy(array * 2)
    assert m[1, 1][1, 0] == 8
    assert m.get_scalar_field(1, 2).to_numpy()[0, 1] == 16


# Shapes by the rule of the index: the axes in their order i, j, k, l, whatever the tree.
PLACEMENTS = [
    (lambda r, f: r.dense(ti.l, 5).dense(ti.i, 3).place(f), (3, 5)),
    (lambda r, f: r.dense(ti.j, 2).dense(ti.i, 3).place(f), (3, 2)),
    (lambda r, f: r.dense(ti.k, 4).dense(ti.ij, (2, 3)).place(f), (2, 3, 4)),
    (lambda r, f: r.dense(ti.i, 2).dense(ti.jk, (3, 4)).place(f), (2, 3, 4)),
    (lambda r, f: r.dense(ti.i, 2).dense(ti.ij, (3, 4)).place(f), (6, 4)),
    (lambda r, f: r.dense(ti.ij, (2, 3)).dense(ti.i, 4).place(f), (8, 3)),
    (lambda r, f: r.dense(ti.ij, 4).place(f), (4, 4)),
    (lambda r, f: r.dense(ti.axes(1, 0), (2, 3)).place(f), (3, 2)),
    (lambda r, f: r.dense(ti.ijkl, (2, 1, 3, 2)).place(f), (2, 1, 3, 2)),
    (lambda r, f: r.place(f), ()),
]


@pytest.mark.parametrize("number", range(len(PLACEMENTS)))
def test_layouts_agree(number):
    place, shape = PLACEMENTS[number]
    x, y = ti.field(ti.i32), ti.Vector.field(2, ti.f32)
    place(ti.root, x)
    place(ti.root, y)
    assert x.shape == shape and y.shape == shape

    @ti.kernel
    def kernel():
        for I in ti.grouped(x):
            digest = 0
            for d in ti.static(range(len(shape))):
                digest = digest * 10 + I[d]
            x[I] = digest
            y[I] = ti.Vector([digest, -digest])

    if shape:
        kernel()
    else:
        x[None] = 0
    expected = np.zeros(shape, int)
    for index in np.ndindex(*shape):
        for number in index:
            expected[index] = expected[index] * 10 + number
    assert x.to_numpy().tolist() == expected.tolist()
    assert y.to_numpy()[..., 1].tolist() == (-expected).tolist()


@pytest.mark.parametrize("order", ["ij", "ji"])
def test_order(order):
    x = ti.field(ti.i32, shape=(2, 3), order=order)
    assert x.shape == (2, 3)

    @ti.kernel
    def kernel():
        for i, j in x:
            x[i, j] = 10 * i + j

    kernel()
    assert x.to_numpy().tolist() == [[0, 1, 2], [10, 11, 12]]


def test_offset():
    x = ti.field(ti.i32, shape=(4, 4), offset=(-2, 10))

    @ti.kernel
    def kernel():
        for i, j in x:
            x[i, j] = 100 * i + j

    kernel()
    assert x[-2, 10] == -190 and x[1, 13] == 113
    assert x.to_numpy()[0, 0] == -190
    with pytest.raises(ti.TaiIndexError, match="-2 to 1"):
        _ = x[2, 10]


def test_one_extent_holds_for_all_axes():
    for extent in (4, (4,), [4]):
        x = ti.field(ti.f32)
        ti.root.pointer(ti.ij, extent).dense(ti.ij, extent).place(x)
        assert x.shape == (16, 16)


def test_components_placed_one_by_one():
    v = ti.Vector.field(2, ti.f64)
    for i in range(2):
        ti.root.dense(ti.i, 4).place(v.get_scalar_field(i))
    ti.root.lazy_grad()
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def fill():
        for i in v:
            v[i] = ti.Vector([i, 10.0 * i])
            v[i][1] += 1
            v[i] += ti.Vector([0.5, 0.5])

    @ti.kernel
    def energy():
        for i in v:
            loss[None] += v[i].dot(v[i]) + v[i].x

    fill()
    expected = np.array([[i + 0.5, 10 * i + 1.5] for i in range(4)])
    assert v.to_numpy().tolist() == expected.tolist()
    v[2] = [3, 4]
    assert v[2].to_list() == [3, 4]
    v.from_numpy(expected)
    with ti.ad.Tape(loss):
        energy()
    assert loss[None] == pytest.approx((expected**2).sum() + expected[:, 0].sum())
    assert v.grad.to_numpy().tolist() == (2 * expected + [1, 0]).tolist()


def test_structure_of_arrays():
    a = ti.Matrix.field(2, 2, ti.f32, shape=3, layout=ti.Layout.SOA, needs_grad=True)

    @ti.kernel
    def kernel():
        for i in a:
            a[i] = ti.Matrix([[1, 2], [3, i]])

    kernel()
    assert a.to_numpy().tolist() == [[[1, 2], [3, i]] for i in range(3)]
    assert a.grad.to_numpy().shape == (3, 2, 2)
    a.fill(4)
    assert a[1].to_list() == [[4, 4], [4, 4]]


def test_gradients_are_placed_beside():
    x, y, n = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.i32)
    ti.root.dense(ti.i, 4).place(x, n)
    ti.root.dense(ti.i, 4).place(y, y.grad)
    ti.root.lazy_grad()
    assert x.grad.shape == (4,) and y.grad.shape == (4,)
    assert n.grad is None
    x.grad[2] = 3
    assert x.grad.to_numpy().tolist() == [0, 0, 3, 0]


def test_fields_made_later():
    x = ti.field(ti.i32, shape=2)
    x[0] = 1
    y = ti.field(ti.i32, shape=3)
    ti.root.dense(ti.i, 2).place(z := ti.field(ti.i32))

    @ti.kernel
    def kernel():
        for i in y:
            y[i] = x[0] + i
        for i in z:
            z[i] = 7

    kernel()
    assert y.to_numpy().tolist() == [1, 2, 3] and z[1] == 7


def test_copies():
    x = ti.field(ti.f32, shape=3)
    y = ti.field(ti.f32, shape=3)
    x.from_numpy(np.array([1, 2, 3], np.float32))
    y.copy_from(x)
    assert y.to_numpy().tolist() == [1, 2, 3]
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"\(3,\)"):
        y.from_numpy(np.zeros(4))


def test_snode_queries():
    x = ti.field(ti.f32)
    block = ti.root.dense(ti.i, 4)
    leaf = block.dense(ti.ij, (2, 3))
    leaf.place(x)
    assert x.snode.parent() is leaf and x.parent() is leaf and x.parent(2) is block
    assert leaf.shape == (8, 3) and block.shape == (4,)
    assert leaf.parent() is block


def test_fields_builder():
    builder = ti.FieldsBuilder()
    x = ti.field(ti.f32)
    builder.dense(ti.i, 4).place(x)
    tree = builder.finalize()

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = i

    kernel()
    assert x.to_numpy().tolist() == [0, 1, 2, 3]
    tree.destroy()
    with pytest.raises(ti.TaiRuntimeError, match="freed"):
        _ = x[0]


def test_large_fields():
    """Two fields far apart in one tree: offsets beyond 2^28 bytes."""
    far = ti.field(ti.f32, shape=1 << 27)
    near = ti.field(ti.f32, shape=8)
    last = ti.field(ti.f32, shape=1 << 27)

    @ti.kernel
    def kernel():
        for i in near:
            near[i] = i
            far[(1 << 27) - 1 - i] = i
            last[(1 << 27) - 1 - i] = -i

    kernel()
    assert near.to_numpy().tolist() == list(range(8))
    assert far[(1 << 27) - 3] == 2 and last[(1 << 27) - 6] == -5


def test_names_in_the_ir():
    pressure = ti.field(ti.f32, shape=3)

    @ti.kernel
    def kernel():
        for i in pressure:
            pressure[i] = 1.0

    kernel()
    assert "@pressure" in kernel.mlir()


@pytest.mark.parametrize("stage", ["tai", "autodiff", "scf", "llvm", "llvmir", "asm"])
def test_stages(stage):
    x = ti.field(ti.f32, shape=4, needs_grad=True)

    @ti.kernel
    def kernel(a: ti.f32):
        for i in x:
            x[i] += a

    text = kernel.mlir(stage=stage)
    assert len(text) > 100


def test_no_memory_for_a_tree():
    huge = ti.field(ti.f64, shape=(1 << 30, 1 << 20))
    with pytest.raises(ti.TaiMemoryError):
        huge[0, 0] = 1


def test_fill_between_fields_of_one_cell():
    """Rows of a field that lie apart, each without gaps: those of other fields are between."""
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    rows = ti.root.dense(ti.i, 5)
    rows.dense(ti.j, 4).place(x)
    rows.dense(ti.j, 3).place(y)

    @ti.kernel
    def write():
        for i, j in x:
            x[i, j] = 10.0 * i + j
        for i, j in y:
            y[i, j] = 100.0 + 10.0 * i + j

    write()
    expected = y.to_numpy()
    write()
    x.fill(7)
    np.testing.assert_array_equal(x.to_numpy(), np.full((5, 4), 7, np.float32))
    np.testing.assert_array_equal(y.to_numpy(), expected)
    assert expected[4, 2] == 142


@pytest.mark.parametrize("components", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rows", [1, 7, 20000])
def test_fill_among_others(components, rows):
    """A field that lies element by element among others is filled alone."""
    a = ti.Vector.field(components, ti.f32)
    b = ti.Vector.field(2, ti.f32)
    ti.root.dense(ti.i, rows).dense(ti.j, 3).place(a, b)
    b.fill(7.0)
    a.fill(-2.5)
    assert (a.to_numpy() == -2.5).all()
    assert (b.to_numpy() == 7.0).all()
    a.fill(0.0)
    assert (a.to_numpy() == 0.0).all()
    assert (b.to_numpy() == 7.0).all()


def test_elements_of_one_column_are_vectors_in_arrays():
    column = ti.Matrix.field(4, 1, ti.f32, shape=2)
    row = ti.Matrix.field(1, 4, ti.f32, shape=2)
    column[1] = [[1], [2], [3], [4]]
    assert column.to_numpy().tolist() == [[0] * 4, [1, 2, 3, 4]]
    assert column.to_numpy(keep_dims=True).shape == (2, 4, 1)
    assert row.to_numpy().shape == (2, 1, 4)
    for shape in ((2, 4), (2, 4, 1)):
        column.from_numpy(np.arange(8.0).reshape(shape))
        assert column.to_numpy().tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
        column.fill(0)


def test_vector_and_matrix_types_as_types_of_fields():
    v = ti.field(ti.math.vec3, shape=2, needs_grad=True)
    m = ti.field(dtype=ti.types.matrix(2, 3, ti.i32), shape=(2,))
    placed = ti.field(ti.math.ivec2)
    ti.root.dense(ti.i, 3).place(placed)
    v[1] = [1, 2, 3]
    m[0] = [[1, 2, 3], [4, 5, 6]]
    placed.fill(7)
    assert v.to_numpy().tolist() == [[0, 0, 0], [1, 2, 3]] and v.grad.shape == (2,)
    assert m.to_numpy()[0].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert placed.to_numpy().tolist() == [[7, 7]] * 3


def test_more_cells_than_can_be_counted():
    # A size that does not fit, as those that can be counted and not be had.
    ti.init()
    with pytest.raises(ti.TaiMemoryError, match="more cells than a 64-bit number can count"):
        ti.field(ti.f32, shape=(2**32, 2**31))


@pytest.mark.parametrize(
    ("shape", "hint"),
    [
        ((1 << 60,), "make its shape smaller"),
        ((1 << 31, 1 << 31, 4), "make the extents smaller"),
        ((1 << 40,), "make the extents smaller"),
    ],
)
def test_fields_that_no_memory_holds(shape, hint):
    with pytest.raises(ti.TaiMemoryError) as caught:
        ti.field(ti.f64, shape=shape).fill(0)
    assert caught.value.hint == hint


@pytest.mark.parametrize(
    "use",
    [
        lambda v: v[0],
        lambda v: ti.optim.SGD([v]),
        lambda v: np.from_dlpack(v),
        lambda v: v.__setitem__(0, [1, 2]),
        lambda v: v.to_numpy(),
        lambda v: v.from_numpy(np.ones((3, 2))),
        lambda v: v.fill(1),
    ],
    ids=["read", "optimise", "share", "write", "to_numpy", "from_numpy", "fill"],
)
def test_vector_fields_have_to_be_placed_before_they_are_used(use):
    v = ti.Vector.field(2, ti.f64, name="v")
    with pytest.raises(ti.TaiRuntimeError, match="field 'v' is not placed") as caught:
        use(v)
    assert "give it a shape, or place it" in caught.value.hint
    ti.root.dense(ti.i, 3).place(v)
    ti.root.lazy_grad()
    use(v)


def test_a_gradient_is_placed_by_hand_where_components_have_levels_of_their_own():
    v = ti.Vector.field(2, ti.f64, name="v")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    for component in range(2):
        ti.root.dense(ti.i, 3).place(v.get_scalar_field(component))
    level = ti.root.dense(ti.i, 3)
    level.place(v.grad)
    with pytest.raises(ti.TaiRuntimeError, match="is placed already"):
        level.place(v.grad)

    @ti.kernel
    def add():
        for i in range(3):
            loss[None] += (i + 1) * v[i].norm_sqr()

    v.fill(0.5)
    with ti.ad.Tape(loss):
        add()
    assert v.grad.to_numpy().tolist() == [[1, 1], [2, 2], [3, 3]]


pressure = None


@ti.kernel
def read_pressure(i: ti.i32) -> ti.f32:
    return pressure[i]


def test_fields_are_called_as_the_variable_of_the_program():
    """In errors and in the IR: here one of the module."""
    global pressure  # noqa: PLW0603
    ti.init(debug=True, offline_cache=False)
    pressure = ti.field(ti.f32, shape=4)
    with pytest.raises(ti.TaiAssertionError, match="'pressure'"):
        read_pressure(7)
    assert pressure.name == "pressure"


def test_a_component_is_no_field_by_itself():
    whole = ti.Vector.field(2, ti.f32, shape=(), needs_grad=True, name="whole")
    whole.fill(3)
    component = whole.get_scalar_field(1)
    assert component[None] == 3
    with pytest.raises(ti.TaiRuntimeError, match=r"'whole\[1\]' is no field by itself") as caught:
        component.materialize()
    assert "layout=ti.Layout.SOA" in caught.value.hint
    own = ti.Vector.field(2, ti.f32, shape=(), needs_grad=True, layout=ti.Layout.SOA)
    with ti.ad.Tape(own.get_scalar_field(1)):
        pass
    ti.init()
    with pytest.raises(ti.TaiRuntimeError, match="was made before the last ti.init"):
        component.materialize()
