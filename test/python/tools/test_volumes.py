"""Active cells to arrays and files, and back."""

import importlib.util

import numpy as np
import pytest
import tai as ti

HAS_OPENVDB = any(importlib.util.find_spec(name) for name in ("openvdb", "pyopenvdb"))


def make(dtype=ti.f32, n=None, kind="pointer", offset=None, rank=3):
    """A field of `rank` dimensions in blocks of two cells along each, and its sparse level."""
    x = ti.field(dtype) if n is None else ti.Vector.field(n, dtype)
    axes = ti.axes(*range(rank))
    level = getattr(ti.root, kind)(axes, (4, 3, 5)[:rank])
    level.dense(axes, 2).place(x, offset=offset)
    return x, level


def fill(x, count=7, seed=0):
    """Writes a few elements; returns the expected field, as a dense array from zero."""
    choice = np.random.default_rng(seed)
    expected = np.zeros(x.shape + x.element_shape, x.dtype.numpy)
    offset = np.array(x.offset or (0,) * len(x.shape))
    for _ in range(count):
        at = tuple(int(choice.integers(n)) for n in x.shape)
        expected[at] = choice.integers(1, 100, x.element_shape)
        x[tuple((np.array(at) + offset).tolist())] = expected[at]
    return expected


@pytest.mark.parametrize("kind", ["pointer", "bitmasked", "hash"])
@pytest.mark.parametrize("n", [None, 2])
@pytest.mark.parametrize("offset", [None, (-5, 3, 0)])
def test_active_elements(kind, n, offset):
    x, level = make(ti.f32, n, kind, offset)
    expected = fill(x)
    where, values = ti.volumes.to_numpy(x)
    assert where.shape == (8 * level.num_active, 3) and where.dtype == np.int64
    assert len(np.unique(where, axis=0)) == len(where)
    dense = np.zeros_like(expected)
    zero_based = where - np.array(offset or (0, 0, 0))
    dense[tuple(zero_based.T)] = values
    np.testing.assert_array_equal(dense, expected)
    # The voxels of the volume are those of the active blocks.
    blocks = {tuple(cell) for cell in (zero_based // 2).tolist()}
    assert blocks == {tuple(cell) for cell in level.active_cells().tolist()}


def test_exactly_these_cells():
    x, level = make()
    fill(x)
    where = np.array([[0, 0, 0], [7, 5, 9], [7, 5, 8]])
    ti.volumes.from_numpy(x, where, [1, 2, 3])
    assert level.active_cells().tolist() == [[0, 0, 0], [3, 2, 4]]
    assert (x[0, 0, 0], x[7, 5, 9], x[7, 5, 8], x[7, 5, 7]) == (1, 2, 3, 0)
    assert x.to_numpy().sum() == 6
    ti.volumes.write(x, [[1, 1, 1]], 9)
    assert x[1, 1, 1] == 9 and level.num_active == 2
    assert ti.volumes.read(x, [[1, 1, 1], [3, 3, 3]]).tolist() == [9, 0]
    assert level.num_active == 2


def test_levels_of_fewer_axes_and_lists():
    x = ti.field(ti.i64)
    ti.root.pointer(ti.j, 3).dense(ti.ij, (2, 2)).place(x)
    x[0, 5] = 1 << 40
    where, values = ti.volumes.to_numpy(x)
    assert sorted(where.tolist()) == [[0, 4], [0, 5], [1, 4], [1, 5]]
    assert values[where.tolist().index([0, 5])] == 1 << 40 and values.sum() == 1 << 40
    y = ti.field(ti.u8)
    ti.root.dense(ti.i, 3).dynamic(ti.j, 8).place(y)
    y[2, 1] = 255
    where, values = ti.volumes.to_numpy(y)
    assert where.tolist() == [[2, 0], [2, 1]] and values.tolist() == [0, 255]


def test_components_apart():
    x = ti.Vector.field(2, ti.f64)
    level = ti.root.pointer(ti.i, 4)
    level.place(x.get_scalar_field(0))
    level.place(x.get_scalar_field(1))
    ti.volumes.from_numpy(x, [2, 0], [[1, 2], [3, 4]])
    where, values = ti.volumes.to_numpy(x)
    assert where.tolist() == [[0], [2]] and values.tolist() == [[3, 4], [1, 2]]


def test_nothing_is_active():
    x, level = make()
    where, values = ti.volumes.to_numpy(x)
    assert where.shape == (0, 3) and values.shape == (0,)
    ti.volumes.from_numpy(x, where, values)
    assert level.num_active == 0


NEEDS_OPENVDB = pytest.mark.skipif(not HAS_OPENVDB, reason="needs OpenVDB for Python")


@pytest.mark.parametrize("suffix", ["npz", pytest.param("vdb", marks=NEEDS_OPENVDB)])
def test_files(tmp_path, suffix):
    x, level = make(offset=(-3, 0, 2))
    v, other = make(ti.f32, 3, "bitmasked")
    expected, flow = fill(x, 5, 1), fill(v, 5, 2)
    active = level.active_cells().tolist(), other.active_cells().tolist()
    path = tmp_path / f"scene.{suffix}"
    ti.volumes.save(path, density=x, flow=v)
    ti.root.deactivate_all()
    fill(x, 3, 3)
    ti.volumes.load(path, density=x, flow=v)
    np.testing.assert_array_equal(x.to_numpy(), expected)
    np.testing.assert_array_equal(v.to_numpy(), flow)
    assert (level.active_cells().tolist(), other.active_cells().tolist()) == active
    with pytest.raises(ti.TaiRuntimeError, match="no field 'smoke', but density, flow"):
        ti.volumes.load(path, smoke=x)
    np.testing.assert_array_equal(x.to_numpy(), expected)


@NEEDS_OPENVDB
def test_tiles_of_openvdb(tmp_path):
    vdb = ti.volumes._openvdb()
    grid = vdb.FloatGrid()
    grid.name = "box"
    grid.fill((0, 0, 0), (7, 7, 7), 2.5)
    grid.getAccessor().setValueOn((9, 1, 2), 4.0)
    grid.prune()
    vdb.write(str(tmp_path / "box.vdb"), grids=[grid])
    x = ti.field(ti.f32)
    level = ti.root.pointer(ti.ijk, 4)
    level.dense(ti.ijk, 4).place(x)
    ti.volumes.load(tmp_path / "box.vdb", box=x)
    assert level.num_active == 9
    assert x.to_numpy().sum() == 512 * 2.5 + 4 and x[9, 1, 2] == 4
    v, _ = make(ti.f32, 3)
    with pytest.raises(ti.TaiRuntimeError, match="is a FloatGrid, and field 'box' takes a Vec3S"):
        ti.volumes.load(tmp_path / "box.vdb", box=v)


@pytest.mark.skipif(HAS_OPENVDB, reason="OpenVDB is there")
def test_openvdb_is_not_there(tmp_path):
    x, _ = make()
    with pytest.raises(ti.TaiRuntimeError, match="need the Python module of OpenVDB"):
        ti.volumes.save(tmp_path / "x.vdb", x=x)


def test_refusals(tmp_path):
    dense = ti.field(ti.f32, shape=4, name="dense")
    x, _ = make()
    with pytest.raises(ti.TaiRuntimeError, match="'dense' exist: it is below no sparse level"):
        ti.volumes.to_numpy(dense)
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"have shape \(n, 3\), but got \(2,\)"):
        ti.volumes.write(x, [1, 2], 1)
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"have shape \(1,\), but got \(3,\)"):
        ti.volumes.write(x, [[1, 2, 3]], [1, 2, 3])
    with pytest.raises(ti.TaiRuntimeError, match="out of range"):
        ti.volumes.write(x, [[1, 2, 30]], 1)
    with pytest.raises(ti.TaiRuntimeError, match="suffixes are .npz and .vdb"):
        ti.volumes.save(tmp_path / "x.txt", x=x)
    with pytest.raises(ti.TaiRuntimeError, match="three dimensions, but field 'y' has 2"):
        ti.volumes.save(tmp_path / "y.vdb", y=make(rank=2)[0])
    with pytest.raises(ti.TaiRuntimeError, match="but field 'z' is of f64"):
        ti.volumes.save(tmp_path / "z.vdb", z=make(ti.f64)[0])
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ti.TaiRuntimeError, match="is not a file of ti.volumes.save"):
        ti.volumes.load(tmp_path / "other.npz", x=x)
    pair = ti.types.struct(a=ti.f32, b=ti.f32).field()
    ti.root.pointer(ti.i, 4).place(pair)
    with pytest.raises(ti.TaiRuntimeTypeError, match="the members of a struct field"):
        ti.volumes.to_numpy(pair)


def test_damaged_files(tmp_path):
    """Each is an error of the package, and leaves the field as it was; or it loads."""
    x, _ = make(n=2)
    expected = fill(x)
    path = tmp_path / "x.npz"
    ti.volumes.save(path, x=x)
    data, choice = path.read_bytes(), np.random.default_rng(0)
    refused = 0
    for number in range(400):
        damaged = bytearray(data)
        for _ in range(choice.integers(1, 4)):
            damaged[choice.integers(len(damaged))] = choice.integers(256)
        if number % 4 == 0:
            del damaged[choice.integers(len(damaged)) :]
        path.write_bytes(damaged)
        try:
            ti.volumes.load(path, x=x)
        except ti.TaiRuntimeError as error:
            refused += 1
            assert str(path) in str(error)
            np.testing.assert_array_equal(x.to_numpy(), expected)
        else:
            x.level.nearest_sparse().deactivate_all()
            assert (fill(x) == expected).all()
    assert refused > 200
    with pytest.raises(FileNotFoundError):
        ti.volumes.load(tmp_path / "none.npz", x=x)
    path.write_bytes(b"no archive at all")
    with pytest.raises(
        ti.TaiRuntimeError,
        match="damaged, or no file of ti.volumes.save: it is no archive of arrays",
    ) as info:
        ti.volumes.load(path, x=x)
    assert info.value.hint == "save it again"


def test_files_that_do_not_fit(tmp_path):
    x, _ = make()
    expected = fill(x)
    path = tmp_path / "x.npz"
    where, values = np.zeros((3, 3), np.int64), np.ones(3)
    for coordinates, numbers, message in (
        (where[:, :2], values, r"coordinates are of int64 and shape \(3, 2\)"),
        (where + 0.5, values, "coordinates are of float64"),
        (where, values[:2], r"values are of float64 and shape \(2,\)"),
        (where, np.ones((3, 2)), r"numbers of shape \(3,\)"),
        (where, np.array(["a", "b", "c"]), "must be numbers"),
        (where + [0, 0, 10], values, r"elements outside of \[0, 0, 0\] to \[7, 5, 9\]"),
        (where - 1, values, "elements outside"),
    ):
        parts = {"x.coordinates": coordinates, "x.values": numbers, "tai.volumes": np.array(1)}
        np.savez(path, **parts)
        with pytest.raises(ti.TaiRuntimeError, match=message):
            ti.volumes.load(path, x=x)
    np.testing.assert_array_equal(x.to_numpy(), expected)
    np.savez(path, **{"x.values": values, "tai.volumes": np.array(1)})
    with pytest.raises(ti.TaiRuntimeError, match="damaged"):
        ti.volumes.load(path, x=x)
    np.savez(path, **{"x.coordinates": where, "x.values": values, "tai.volumes": np.array(1)})
    ti.volumes.load(path, x=x)
    assert x[0, 0, 0] == 1
