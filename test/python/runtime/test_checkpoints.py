"""Saving, loading, pickling and copying fields, arrays and programs' states."""

import copy
import errno
import pickle

import numpy as np
import pytest
import tai as ti

Pair = ti.types.vector(2, ti.f32)
Particle = ti.types.struct(pos=Pair, mass=ti.f64)


@pytest.fixture(autouse=True)
def program(fresh_program):
    ti.init(offline_cache=False)


def _pickled(thing):
    return pickle.loads(pickle.dumps(thing))


WAYS = pytest.mark.parametrize("way", [_pickled, copy.copy, copy.deepcopy])


@WAYS
@pytest.mark.parametrize("dtype", "u1 i8 i64 u16 f16 bf16 f32 f64".split())
def test_numbers_of_each_type(way, dtype):
    x = ti.field(getattr(ti, dtype), shape=(2, 3), offset=(1, -1), name="x")
    x.from_numpy(np.array([[0, 1, 1], [1, 0, 1]]).astype(x.dtype.numpy))
    y = way(x)
    assert y is not x and y.dtype is x.dtype and y.offset == (1, -1)
    assert np.array_equal(y.to_numpy(), x.to_numpy())
    y.fill(0)
    assert x.to_numpy().sum() == 4


@WAYS
def test_gradients_go_along_and_work(way):
    x = ti.field(ti.f32, shape=5, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.fill(2)
    x.grad.fill(7)
    y, grad, total = way((x, x.grad, loss)) if way is not copy.copy else (
        copy.copy(x), None, copy.copy(loss))  # fmt: skip
    assert y.grad.to_numpy().tolist() == [7] * 5
    assert grad is None or grad is y.grad

    @ti.kernel
    def run(a: ti.template(), out: ti.template()):
        for i in a:
            out[None] += a[i] ** 2

    with ti.ad.Tape(total):
        run(y, total)
    assert y.grad.to_numpy().tolist() == [4] * 5
    assert total[None] == 20 and loss[None] == 0


@WAYS
def test_layouts_are_kept(way):
    v = ti.Vector.field(2, ti.f64, 4, layout=ti.Layout.SOA)
    v.fill(3)
    assert way(v).is_split and way(v).to_numpy().sum() == 24
    assert way(v.get_scalar_field(1)).to_numpy().tolist() == [3] * 4
    u, m = ti.field(ti.i32), ti.Vector.field(2, ti.f32)
    ti.root.pointer(ti.i, 4).bitmasked(ti.i, 2).place(u)
    ti.root.pointer(ti.ij, (40, 20)).dense(ti.ij, 2).place(m)
    u[3], u[4] = 5, 0  # active, too
    m[3, 1] = [1, 2]

    @ti.kernel
    def count(x: ti.template()) -> ti.i32:
        found = 0
        for _i in x:
            found += 1
        return found

    assert count(way(u)) == count(u) == 2
    assert np.array_equal(way(u).to_numpy(), u.to_numpy())
    assert way(m).parent().parent().num_active == 1
    assert way(m)[3, 1].to_list() == [1, 2]
    listed = ti.field(ti.i32)
    ti.root.dynamic(ti.i, 8).place(listed)
    with pytest.raises(ti.TaichiRuntimeTypeError, match="lies in lists"):
        way(listed)


@WAYS
def test_structs_arrays_and_objects_that_hold_them(way):
    s = Particle.field(shape=3, needs_grad=True)
    s.mass.fill(2)
    s.mass.grad.fill(3)
    t = way(s)
    assert t.mass.to_numpy().tolist() == [2] * 3 and t.grad.mass.to_numpy().tolist() == [3] * 3

    @ti.kernel
    def grow(x: ti.template()):
        for i in x:
            x[i].mass += i

    grow(t)
    if way is not copy.copy:  # a shallow copy has the same members
        assert s.mass.to_numpy().tolist() == [2] * 3
    assert t.mass.to_numpy().tolist() == [2, 3, 4]
    array = ti.Vector.ndarray(2, ti.f32, 3)
    array.fill(4)
    gradient = ti.ndarray(ti.f64, 2, needs_grad=True)
    gradient.grad.fill(1)
    assert way(array).to_numpy().tolist() == [[4, 4]] * 3
    assert way(gradient).grad.to_numpy().tolist() == [1, 1]


@ti.data_oriented
class Solver:
    def __init__(self):
        self.x = ti.field(ti.f32, shape=4, needs_grad=True)
        self.steps = 0

    @ti.kernel
    def step(self):
        for i in self.x:
            self.x[i] += i


@pytest.mark.parametrize("way", [_pickled, copy.deepcopy])
def test_simulators(way):
    solver = Solver()
    solver.step()
    other = way(solver)
    other.step()
    assert solver.x.to_numpy().tolist() == [0, 1, 2, 3]
    assert other.x.to_numpy().tolist() == [0, 2, 4, 6]


@pytest.fixture(params=["npz", "safetensors"])
def path(request, tmp_path):
    if request.param == "safetensors":
        pytest.importorskip("safetensors")
    return tmp_path / f"run.{request.param}"


def _scene():
    x = ti.field(ti.f32, shape=(2, 3), needs_grad=True)
    x.from_numpy(np.arange(6, dtype=np.float32).reshape(2, 3))
    x.grad.fill(9)
    s = Particle.field(shape=3)
    s.mass.fill(2)
    array = ti.ndarray(ti.i64, 3)
    array.fill(2**40)
    return x, s, array


def test_files(path):
    x, s, array = _scene()
    wanted = x.to_numpy()
    names = ti.checkpoint.save(path, x=x, s=s, both=[array, x])
    assert names == ["x", "s.pos", "s.mass", "both.0", "both.1"]
    for thing in (x, s, array):
        thing.fill(0)
    assert ti.checkpoint.load(path, x=x, s=s, both=[array, x]) == names
    assert np.array_equal(x.to_numpy(), wanted) and s[1].mass == 2 and array[2] == 2**40
    assert x.grad[0, 0] == 9  # not saved, and left alone
    ti.checkpoint.save(path, gradients=True, x=x)
    x.grad.fill(0)
    assert ti.checkpoint.load(path, x=x) == ["x", "x.grad"]
    assert x.grad[0, 0] == 9


def test_objects_and_dictionaries(path):
    solver = Solver()
    solver.step()
    ti.checkpoint.save(path, solver)
    solver.step()
    assert ti.checkpoint.load(path, {"x": solver.x}) == ["x"]
    assert solver.x.to_numpy().tolist() == [0, 1, 2, 3]


def test_the_state_of_a_program():
    x, s, _ = _scene()
    state = _pickled(ti.checkpoint.state())
    assert len(state) == 3
    x.fill(0)
    s.fill(0)
    ti.checkpoint.restore(state)
    assert x[1, 2] == 5 and s[0].mass == 2


def test_nothing_changes_unless_all_fits(path):
    x, s, array = _scene()
    ti.checkpoint.save(path, x=x, y=ti.field(ti.f32, shape=4))
    x.fill(0)
    wrong = [
        ({"x": x}, "holds 'y'"), ({"x": x, "y": s}, "holds no 'y.pos'"),
        ({"x": x, "y": ti.field(ti.f32, shape=5)}, "has shape"),
        ({"x": x, "y": ti.field(ti.i32, shape=4)}, "holds float32"),
    ]  # fmt: skip
    for fields, message in wrong:
        with pytest.raises(ti.TaiError, match=message):
            ti.checkpoint.load(path, fields)
        assert x.to_numpy().sum() == 0
    assert ti.checkpoint.load(path, {"x": x}, strict=False) == ["x"]
    with pytest.raises(ti.TaichiRuntimeTypeError, match="no field, array or object"):
        ti.checkpoint.save(path, x=3)


def test_a_file_that_is_no_checkpoint(path):
    x, _, _ = _scene()
    for content in (b"", b"PK\3\4 torn", b"\xff" * 64):
        path.write_bytes(content)
        with pytest.raises(ti.TaiRuntimeError, match="is no checkpoint"):
            ti.checkpoint.load(path, x=x)


def test_a_disk_that_is_full_leaves_the_old_file(path, monkeypatch):
    x, _, _ = _scene()
    ti.checkpoint.save(path, x=x)
    before = path.read_bytes()

    def full(number):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr("os.fsync", full)
    x.fill(0)
    with pytest.raises(OSError, match="no space"):
        ti.checkpoint.save(path, x=x)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]
