# ruff: noqa: B007 -- loops over fields often only count
"""Sparse levels by the names that programs written for Taichi use."""

import ctypes
import random
import subprocess
import sys

import numpy as np
import pytest
import tai as ti


def blocks(kind="pointer", dtype=ti.i32):
    """A field of 8 blocks of 4 cells, and its two levels."""
    x = ti.field(dtype)
    outer = getattr(ti.root, kind)(ti.i, 8)
    inner = outer.dense(ti.i, 4)
    inner.place(x)
    return x, outer, inner


# Levels and fields as objects


def test_parents_up_to_the_root():
    x = ti.field(ti.i32)
    a = ti.root.pointer(ti.ij, 8)
    b = a.dense(ti.ij, (4, 2))
    c = b.bitmasked(ti.i, 2)
    c.place(x)
    assert x.parent() is c and x.parent(2) is b and x.parent(3) is a
    assert x.parent(4) == ti.root and ti.root == x.parent(4) and x.parent(5) is None
    assert x.parent(0) is x.snode and x.snode.parent() is c and a.parent(0) is a
    assert [n.shape for n in (x.snode, c, b, a)] == [(64, 16), (64, 16), (32, 16), (8, 8)]
    assert ti.root.shape == ()
    path = " => pointer [8, 8] => dense [32, 16] => bitmasked [64, 16]"
    assert str(c) == "ti.root" + path and str(x.snode) == "ti.root" + path + " => place [64, 16]"
    assert x.snode._path_from_root() == [ti.root, a, b, c, x.snode]
    assert a._get_children() == [b] and c._get_children() == [x.snode]
    assert x.snode._get_children() == []


def test_axes_of_indices():
    x = ti.field(ti.i32)
    a = ti.root.pointer(ti.ik, 8)
    a.dense(ti.k, 4).place(x)
    assert a._physical_index_position() == {0: 0, 1: 2} == x.snode._physical_index_position()


def test_sizes_and_offsets_are_those_in_memory():
    x = ti.Vector.field(3, ti.f32)
    y, z = ti.field(ti.f64), ti.field(ti.u8)
    a = ti.root.pointer(ti.i, 8)
    b = a.dense(ti.i, 4)
    b.place(x, y, z)
    third = x.get_scalar_field(2)
    assert (b._cell_size_bytes, a._cell_size_bytes, x.snode._cell_size_bytes) == (32, 128, 0)
    assert b._offset_bytes_in_parent_cell == 0
    offsets = [f.snode._offset_bytes_in_parent_cell for f in (x, third, y, z)]
    assert offsets == [0, 8, 16, 24]
    o = ti.field(ti.u64, shape=6)

    @ti.kernel
    def addresses():
        o[0], o[1] = ti.get_addr(x, 0), ti.get_addr(third, [0])
        o[2], o[3] = ti.get_addr(y, [0]), ti.get_addr(z, 0)
        o[4], o[5] = ti.get_addr(y, 1), ti.get_addr(y, 4)

    addresses()
    found = (o.to_numpy() - o[0]).tolist()
    assert found == [0, 8, 16, 24, 16 + b._cell_size_bytes, 16 + a._cell_size_bytes]


@pytest.mark.parametrize("seed", range(12))
def test_offsets_in_random_trees(seed):
    choice = random.Random(seed)
    fields = []

    def grow(node, depth):
        for _ in range(choice.randint(1, 3)):
            if depth < 3 and choice.random() < 0.5:
                kind = choice.choice(["dense", "pointer", "bitmasked", "hash"])
                grow(getattr(node, kind)(ti.i, choice.randint(1, 5)), depth + 1)
            else:
                dtype = choice.choice([ti.u8, ti.f16, ti.i32, ti.f64])
                n = choice.randint(1, 3)
                field = ti.field(dtype) if n == 1 else ti.Vector.field(n, dtype)
                node.place(field)
                fields.append(field)

    grow(ti.root.dense(ti.i, 3), 1)
    if choice.random() < 0.5:
        ti.root.lazy_grad()

    def offset(field):
        path = field.snode._path_from_root()
        return sum(level._offset_bytes_in_parent_cell for level in path)

    first = [field.storage()[0].core.address((0,)) for field in fields]
    expected = [offset(field) - offset(fields[0]) for field in fields]
    assert [address - first[0] for address in first] == expected
    for field in fields:
        storage, level = field.storage()[0], field.parent()
        if level.shape[0] > 1 and level.extents[0] > 1:
            size = storage.core.address((1,)) - storage.core.address((0,))
            assert size == level._cell_size_bytes


def test_addresses_hold_the_elements():
    x = ti.field(ti.f32)
    ti.root.pointer(ti.ij, (3, 5)).dense(ti.axes(1, 0), (2, 4)).place(x, offset=(-3, 1))
    shape = x.shape
    rows, columns = (range(-3, -3 + shape[0]), range(1, 1 + shape[1]))
    for i in rows:
        for j in columns:
            x[i, j] = 100 * i + j
    o = ti.field(ti.u64, shape=shape)

    @ti.kernel
    def addresses():
        for i, j in x:
            o[i + 3, j - 1] = ti.get_addr(x, [i, j])

    addresses()
    read = np.vectorize(lambda at: ctypes.c_float.from_address(int(at)).value)(o.to_numpy())
    np.testing.assert_array_equal(read, x.to_numpy())


def test_tree_numbers_count_up():
    x, _, _ = blocks()
    builder = ti.FieldsBuilder()
    y = ti.field(ti.f32)
    builder.bitmasked(ti.i, 4).place(y)
    assert builder.empty is False and builder.finalized is False
    x[0] = 1
    tree = builder.finalize()
    assert builder.finalized and (x.snode._snode_tree_id, tree.id) == (0, 1)
    assert y.parent()._snode_tree_id == 1
    assert len(ti.FieldsBuilder._finalized_roots()) == 2
    tree.destroy()
    assert len(ti.FieldsBuilder._finalized_roots()) == 1


def test_trees_come_and_go():
    for number in range(3):
        builder = ti.FieldsBuilder()
        x = ti.field(ti.i32)
        level = builder.pointer(ti.i, 8)
        level.dense(ti.i, 4).place(x)
        assert builder.root._get_children() == [level]
        tree = builder.finalize()
        x[5] = number + 1
        assert level.num_active == 1 and x.to_numpy().sum() == number + 1
        tree.destroy()


def test_layouts_of_vectors():
    a = ti.Vector.field(3, ti.f32, shape=8, layout=ti.Layout.SOA)
    b = ti.Matrix.field(2, 2, ti.f32, shape=8, layout=ti.Layout.AOS)
    a[1], b[1] = [1, 2, 3], [[1, 2], [3, 4]]
    parents = [a.get_scalar_field(k).parent() for k in range(3)]
    assert len(set(map(id, parents))) == 3
    assert [p._cell_size_bytes for p in parents] == [4, 4, 4]
    assert b.get_scalar_field(1, 1).parent()._cell_size_bytes == 16
    assert a.get_scalar_field(2)[1] == 3 and b.get_scalar_field(1, 1)[1] == 4


# Activity


@pytest.mark.parametrize("kind", ["pointer", "bitmasked", "hash"])
def test_deactivate_all_and_peak(kind):
    x, outer, _ = blocks(kind)
    x[3], x[20] = 5, 7
    assert outer.num_active == outer._num_dynamically_allocated == 2
    outer.deactivate_all()
    assert (x[3], x[20], outer.num_active) == (0, 0, 0)
    x[0] = 1
    # The peak counts the cells in use at one time.
    assert outer.num_active == 1 and outer._num_dynamically_allocated == 2


def test_peak_does_not_grow_with_what_comes_and_goes():
    x, outer, _ = blocks()
    for cell in range(8):
        x[4 * cell] = 1
        assert outer._num_dynamically_allocated == 1
        outer.deactivate_all()


def test_root_deactivates_all_trees():
    x, outer, _ = blocks()
    y = ti.field(ti.i32, shape=3)
    x[3], y[0] = 3, 2
    z, other, _ = blocks("bitmasked")
    z[9] = 4
    ti.root.deactivate_all()
    assert (x[3], y[0], z[9]) == (0, 2, 0)
    assert outer.num_active == other.num_active == 0


def test_activity_in_kernels():
    x = ti.field(ti.i32)
    a = ti.root.pointer(ti.ij, 8)
    b = a.bitmasked(ti.ij, 4)
    b.place(x)
    out = ti.field(ti.i32, shape=9)

    @ti.kernel
    def run():
        ti.activate(a, [1, 2])
        out[0], out[1] = ti.is_active(a, [1, 2]), ti.is_active(b, [4, 8])
        ti.activate(x.parent(), ti.Vector([5, 9]))
        out[2], out[3] = ti.is_active(b, [5, 9]), ti.is_active(x.snode, [5, 10])
        up, down = ti.rescale_index(b, a, ti.Vector([9, 6])), ti.rescale_index(a, x, [1, 2])
        out[4], out[5], out[6], out[7] = up[0], up[1], down[0], down[1]
        ti.deactivate(a, [1, 2])
        out[8] = ti.is_active(b, [5, 9])

    run()
    assert out.to_numpy().tolist() == [1, 0, 1, 0, 2, 1, 4, 8, 0]


def test_levels_as_template_arguments():
    x, outer, _ = blocks()
    y, other, _ = blocks("bitmasked")

    @ti.func
    def remove(level: ti.template(), i):
        ti.deactivate(level, i)

    @ti.kernel
    def count(level: ti.template()) -> ti.i32:
        cells = 0
        for _ in level:
            cells += 1
        return cells

    @ti.kernel
    def drop(level: ti.template(), i: ti.i32):
        remove(level, i)

    x[2], x[9], y[31] = 1, 1, 1
    assert (count(outer), count(other)) == (2, 1)
    drop(outer, 2)
    drop(other, 3)
    assert (count(outer), count(other)) == (1, 1)
    assert count(x.snode) == 4


def test_loops_over_levels():
    x = ti.field(ti.i32)
    a = ti.root.pointer(ti.ij, 8)
    a.dense(ti.ij, 4).place(x)
    x[5, 6], x[31, 0] = 1, 2
    s = ti.field(ti.i32, shape=6)

    @ti.kernel
    def run():
        for i, j in a:
            s[0] += 1
            s[1] += i * 10 + j
        for i, j in x.parent():
            s[2] += 1
        for index in ti.grouped(x.parent(2)):
            s[3] += index[0] + index[1]
        for i, j in x:
            s[4] += 1
        for i, j in x.snode:
            s[5] += 1

    run()
    assert s.to_numpy().tolist() == [2, 81, 32, 9, 32, 32]


def test_loops_over_vector_fields_with_an_offset():
    x = ti.Vector.field(2, ti.f32)
    ti.root.pointer(ti.i, 8).dense(ti.i, 2).place(x, offset=-8)
    x[-3] = [5, 6]
    seen = ti.field(ti.f32, shape=3)

    @ti.kernel
    def run():
        for i in x:
            seen[0] += i
            seen[1] += x[i][1]
        for i in x.get_scalar_field(1):
            seen[2] += 1

    run()
    assert seen.to_numpy().tolist() == [-4 - 3, 6, 2]


def test_loop_goes_over_what_was_active_when_it_began():
    x, outer, _ = blocks()
    x[0] = 1
    seen = ti.field(ti.i32, shape=())

    @ti.kernel
    def spread():
        for i in outer:
            seen[None] += 1
            x[4 * (i + 1)] = 1

    @ti.kernel
    def clear():
        for i in outer:
            seen[None] += 1
            ti.deactivate(outer, (i + 1) % 8)

    spread()
    assert (seen[None], outer.num_active) == (1, 2)
    for first in range(2, 8):
        x[4 * first] = 1
    seen[None] = 0
    clear()
    assert (seen[None], outer.num_active) == (8, 0)
    clear()
    assert seen[None] == 8


def test_serialized_and_hinted_loops():
    x, _, _ = blocks("pointer", ti.f32)
    y = ti.field(ti.f32)
    ti.root.pointer(ti.i, 8).dense(ti.i, 4).place(y)
    order = ti.field(ti.i32, shape=())
    x[2], x[29] = 1.0, 4.0

    from tai.lang.misc import get_host_arch_list, loop_unique

    assert get_host_arch_list() == [ti.x64]

    @ti.kernel
    def serial():
        ti.loop_config(serialize=True)
        for i in x:
            order[None] = order[None] * 3 + i

    @ti.kernel
    def hinted():
        ti.loop_config(block_dim=64)
        ti.block_local(x)
        ti.no_activate(y)
        for i in x:
            y[loop_unique(i, [y])] = 2 * x[i]

    serial()
    expected = 0
    for i in [0, 1, 2, 3, 28, 29, 30, 31]:
        expected = expected * 3 + i
    assert order[None] == expected
    hinted()
    np.testing.assert_array_equal(y.to_numpy(), 2 * x.to_numpy())


# Lists


def test_lists():
    x = ti.field(ti.i32)
    lists = ti.root.dense(ti.i, 4).dynamic(ti.j, 32, chunk_size=8)
    lists.place(x)
    out = ti.field(ti.i32, shape=8)

    @ti.kernel
    def run():
        out[0], out[1] = ti.append(x.parent(), 1, 5), x[1].append(7)
        out[2], out[3], out[4] = ti.length(x.parent(), 1), x[1].length(), x[1, 1]
        x[2].append(3)
        x[2].deactivate()
        out[5], out[6] = x[2].length(), ti.length(lists, [0])
        x[3].append(1)
        ti.deactivate(lists, [3])
        out[7] = x[3].length()

    run()
    assert out.to_numpy().tolist() == [0, 1, 2, 2, 7, 0, 0, 0]
    assert lists.active_cells().tolist() == [[1, 0], [1, 1]]


def test_order_of_lists_in_deterministic_mode():
    ti.init(arch=ti.cpu, deterministic=True, cpu_max_num_threads=4, offline_cache=False)
    count = 1 << 16
    x = ti.field(ti.i32)
    lists = ti.root.dynamic(ti.i, count)
    lists.place(x)

    @ti.func
    def put(i):
        x.append(i)

    @ti.kernel
    def fill():
        for i in range(count):
            put(i)

    fill()
    np.testing.assert_array_equal(x.to_numpy(), np.arange(count))


def test_a_field_that_is_one_list():
    x, v = ti.field(ti.i32), ti.Vector.field(3, ti.f32)
    ti.root.dynamic(ti.i, 1024, chunk_size=32).place(x)
    ti.root.dynamic(ti.i, 64).place(v, offset=10)
    out = ti.field(ti.i32, shape=5)

    @ti.kernel
    def run():
        for i in range(100):
            x.append(i)
        for i in range(5):
            v.append(ti.Vector([1.0, i, 2.0]))

    @ti.kernel
    def ask():
        out[0], out[1] = x.length(), v.length()
        for i in x:
            out[2] += x[i]
        for i in v:
            out[3] += ti.cast(v[i][1], ti.i32)
        x.deactivate()
        out[4] = x.length()

    run()
    ask()
    assert out.to_numpy().tolist() == [100, 5, 4950, 10, 0]
    assert sorted(v.to_numpy()[:5, 1].tolist()) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("kind", ["dense", "pointer", "bitmasked", "hash"])
def test_levels_below_a_list(kind):
    x = ti.field(ti.i32)
    outer = ti.root.dense(ti.k, 2).dynamic(ti.i, 16)
    inner = getattr(outer, kind)(ti.j, 4)
    inner.place(x)
    out = ti.field(ti.i32, shape=3)

    @ti.kernel
    def run():
        x[9, 2, 1] = 4
        out[0], out[1] = ti.length(outer, [0]), ti.length(outer, [1])
        for i, j, k in x:
            out[2] += 1

    run()
    run()
    # Writing to cell 9 makes the list 10 long; a sparse level has one active cell in it.
    each = 40 if kind == "dense" else 1
    assert out.to_numpy().tolist() == [0, 10, 2 * each]
    assert x[9, 2, 1] == 4 and x.to_numpy().sum() == 4


def test_lists_of_lists():
    x = ti.field(ti.i32)
    inner = ti.root.dynamic(ti.i, 8).dynamic(ti.j, 8)
    inner.place(x)
    lengths = ti.field(ti.i32, shape=8)

    @ti.kernel
    def run():
        for i in range(5):
            for j in range(i):
                x[i].append(10 * i + j)
        for i in range(8):
            lengths[i] = ti.length(inner, i)

    run()
    assert lengths.to_numpy().tolist() == [0, 1, 2, 3, 4, 0, 0, 0]
    expected = np.zeros((8, 8), np.int32)
    for i in range(5):
        expected[i, :i] = 10 * i + np.arange(i)
    np.testing.assert_array_equal(x.to_numpy(), expected)


# Structs


def test_lists_of_structs():
    particle = ti.types.struct(a=ti.i32, b=ti.types.vector(2, ti.f32))
    f = particle.field()
    ti.root.dense(ti.i, 2).dynamic(ti.j, 64, chunk_size=32).place(f)
    n = ti.field(ti.i32, shape=3)

    @ti.kernel
    def run():
        for i in range(5):
            f[1].append(particle(i, [1.0, i]))
        n[0] = f[1].length()
        for i, j in f:
            n[1] += f[i, j].a
            n[2] += ti.cast(f[i, j].b.y, ti.i32)

    run()
    assert n.to_numpy().tolist() == [5, 10, 10]
    pairs = sorted((f[1, j].a, f[1, j].b[1]) for j in range(5))
    assert pairs == [(k, float(k)) for k in range(5)]


def test_structs_on_sparse_levels():
    @ti.dataclass
    class Cell:
        mass: ti.f32
        flow: ti.math.vec2

        @ti.func
        def energy(self):
            return 0.5 * self.flow.dot(self.flow) / self.mass

    f = Cell.field()
    level = ti.root.pointer(ti.i, 8)
    level.dense(ti.i, 4).place(f)
    f[5] = Cell(2.0, [3.0, 4.0])
    f[30].mass = 1.0

    @ti.kernel
    def run() -> ti.f32:
        moved = f[5]
        moved.flow.x += 1.0
        if moved.mass > 1.0:
            moved.mass = 4.0
        f[6] = moved
        f[7].flow[1] = 2.0
        total = 0.0
        for i in f:
            if f[i].mass > 0:
                total += f[i].energy()
        return total

    assert run() == pytest.approx(25 / 4 + 32 / 8)
    assert level.num_active == 2 and f.keys == ["mass", "flow"] and f.shape == (32,)
    assert (f[6].mass, f[6].flow.to_list()) == (4.0, [4.0, 4.0])
    assert f[7].to_dict() == {"mass": 0.0, "flow": [0.0, 2.0]}
    arrays = f.to_numpy()
    assert arrays["mass"][[5, 6, 30]].tolist() == [2, 4, 1] and arrays["flow"].shape == (32, 2)


def test_struct_gradients():
    f = ti.Struct.field({"a": ti.f32, "b": ti.types.vector(2, ti.f32), "n": ti.i32})
    ti.root.bitmasked(ti.i, 4).place(f)
    ti.root.lazy_grad()
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in f:
            loss[None] += f[i].a * f[i].b[1]

    f[2].a, f[2].b = 3.0, [1.0, 4.0]
    with ti.ad.Tape(loss):
        run()
    assert (f.grad[2].a, f.grad[2].b[1], f.a.grad[2], f.a.grad[1]) == (4, 3, 4, 0)
    assert f.parent().num_active == 1


def test_sparse_grids():
    grid = ti.sparse.grid({"pos": ti.math.vec2, "mass": ti.f32, "id": ti.i32}, shape=(100, 50))
    assert ti.sparse.usage(grid) == 0 and grid.shape == (100, 50)
    grid[0, 0].id = 3
    assert ti.sparse.usage(grid) == pytest.approx(1 / 5000)

    @ti.kernel
    def run() -> ti.i32:
        grid[50, 40].pos = ti.math.vec2(1.0, 2.0)
        grid[7, 3].mass = 4.0
        cells = 0
        for i, j in grid:
            cells += 1
        return cells

    run()
    assert run() == 3 and ti.sparse.usage(grid) == pytest.approx(3 / 5000)
    assert grid.parent().shape == (100, 50) and grid.parent(2) == ti.root


# Whole fields


def test_fill_is_for_active_cells():
    x, outer, _ = blocks()
    x[3] = 1
    x.fill(7)
    assert x.to_numpy().tolist() == [7] * 4 + [0] * 28 and outer.num_active == 1


@pytest.mark.parametrize("dtype", [ti.i32, ti.f64])
def test_arrays_activate_what_is_not_zero(dtype):
    x, outer, _ = blocks("pointer", dtype)
    x[3] = 1
    array = np.zeros(32, dtype.numpy)
    array[17] = 5
    x.from_numpy(array)
    assert outer.active_cells().tolist() == [[0], [4]]
    np.testing.assert_array_equal(x.to_numpy(), array)


def test_copies_between_layouts():
    x, outer, _ = blocks()
    y = ti.field(ti.i32, shape=32)
    z, other, _ = blocks("bitmasked")
    y[9] = 4
    x.copy_from(y)
    z.copy_from(x)
    assert outer.num_active == other.num_active == 1
    z[3] = 8
    y.copy_from(z)
    assert [i for i in range(32) if y[i]] == [3, 9] and y[3] == 8


def test_programs_for_taichi_run(tmp_path):
    script = """
import sys
import tai
sys.modules["taichi"] = tai
import taichi as ti
from taichi.lang import impl
from taichi.lang.exception import TaichiCompilationError, TaichiRuntimeError
from taichi.lang.misc import get_host_arch_list, loop_unique

ti.init(arch=get_host_arch_list(), require=ti.extension.sparse, device_memory_GB=1,
        demote_dense_struct_fors=False)
assert ti.extension.bls and impl.get_runtime().prog is not None
assert ti._lib.core.get_max_num_indices() == 12 and ti.root.parent() is None
x = ti.field(dtype=ti.i32)
block = ti.root.pointer(ti.axes(0), 4)
block.bitmasked(ti.i, 2).place(x)

@ti.kernel
def run():
    for i in range(3):
        x[loop_unique(i)] = i

run()
ti.sync()
assert block._num_dynamically_allocated == 2
block.deactivate_all()
assert x.to_numpy().sum() == 0
print("done")
"""
    program = tmp_path / "program.py"
    program.write_text(script)
    done = subprocess.run([sys.executable, program], capture_output=True, text=True)
    assert done.stdout == "done\n", done.stderr
