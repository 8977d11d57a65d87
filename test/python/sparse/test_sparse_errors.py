# ruff: noqa: B007 -- loops over fields often only count
"""Operations that sparse levels refuse, and the messages."""

import numpy as np
import pytest
import tai as ti


def raises(kind, *parts):
    """Expects an error whose text holds all the parts."""

    class Expectation:
        def __enter__(self):
            self.context = pytest.raises(kind)
            self.info = self.context.__enter__()

        def __exit__(self, *what):
            done = self.context.__exit__(*what)
            text = str(self.info.value)
            for part in parts:
                assert part in text, text
            return done

    return Expectation()


def blocks(kind="pointer", **options):
    x = ti.field(ti.f32, **options)
    outer = getattr(ti.root, kind)(ti.i, 8)
    outer.dense(ti.i, 4).place(x)
    return x, outer


# Levels in impossible places


def test_lists_have_one_axis():
    with raises(ti.TaiRuntimeTypeError, "a dynamic level has one axis", "got ti.ij", "dense(ti.i"):
        ti.root.dynamic(ti.ij, 64)


@pytest.mark.parametrize("kind", ["dense", "pointer", "bitmasked", "hash"])
def test_the_axis_of_a_list_is_its_own(kind):
    above = getattr(ti.root, kind)(ti.i, 4)
    with raises(ti.TaiRuntimeTypeError, f"dynamic level cannot divide axis i, which a {kind}"):
        above.dynamic(ti.i, 8)
    lists = ti.root.dynamic(ti.j, 8)
    with raises(ti.TaiRuntimeTypeError, f"a {kind} level cannot divide axis j, which a dynamic"):
        getattr(lists, kind)(ti.ij, 4)
    # Nothing was added.
    assert above.children == [] and lists.children == []


def test_fields_hold_no_levels():
    x, outer = blocks()
    with raises(ti.TaiRuntimeError, "a field has no bitmasked level in it", "x.parent()"):
        x.snode.bitmasked(ti.i, 2)
    with raises(ti.TaiRuntimeError, "a field holds no other field"):
        x.snode.place(ti.field(ti.f32))


def test_a_tree_in_use_is_not_extended():
    x, outer = blocks()
    x[0] = 1
    with raises(ti.TaiRuntimeError, "in use already"):
        outer.dense(ti.i, 2)


def test_a_tree_that_cannot_be_addressed():
    x = ti.field(ti.f32)
    ti.root.pointer(ti.ijk, 2**12).dense(ti.ijk, 2**4).place(x)
    with raises(ti.TaiMemoryError, "TiB", "the most that can be addressed"):
        x[0, 0, 0] = 1
    # Other fields go on.
    y = ti.field(ti.f32, shape=2)
    y[1] = 3
    assert y[1] == 3


def test_a_tree_whose_cells_cannot_be_counted():
    x = ti.field(ti.f32)
    with raises(ti.TaiError, "more cells than"):
        ti.root.pointer(ti.ijk, 2**30).place(x)


def test_types_of_a_few_bits_are_refused():
    for use in (
        lambda: ti.types.quant.int(8),
        lambda: ti.types.quant.fixed(bits=8, max_value=2.0),
        lambda: ti.BitpackedFields(max_num_bits=32),
        lambda: ti.root.quant_array(ti.i, 4, max_num_bits=32),
    ):
        with raises(ti.TaiRuntimeError, "types of a few bits are not built in", "ti.i8"):
            use()


# Indices


def test_host_index_outside_the_tree():
    x, _ = blocks()
    with raises(ti.TaiIndexError, "index 32 is out of range", "from 0 to 31"):
        x[32] = 1
    with raises(IndexError, "index -1 is out of range"):
        x[-1]


def test_constant_index_outside_the_tree():
    x, _ = blocks()

    @ti.kernel
    def write():
        x[32] = 1.0

    with raises(ti.TaiIndexError, "index 32 is out of range", "x[32] = 1.0"):
        write()


@pytest.mark.parametrize("what", ["store", "add", "load", "activate", "deactivate", "is_active"])
def test_index_outside_the_tree_in_debug_mode(what):
    ti.init(arch=ti.cpu, debug=True, offline_cache=False)
    x, outer = blocks()

    @ti.kernel
    def run(i: ti.i32) -> ti.f32:
        result = 0.0
        if ti.static(what == "store"):
            x[i] = 1.0
        elif ti.static(what == "add"):
            x[i] += 1.0
        elif ti.static(what == "load"):
            result = x[i]
        elif ti.static(what == "activate"):
            ti.activate(outer, i)
        elif ti.static(what == "deactivate"):
            ti.deactivate(outer, i)
        else:
            result = float(ti.is_active(outer, i))
        return result

    run(3)
    with raises(ti.TaiAssertionError, "out of range", "of shape [32]", "test_sparse_errors.py"):
        run(100)
    run(4)


@pytest.mark.parametrize("what", ["append", "length"])
def test_list_outside_the_tree(what):
    ti.init(arch=ti.cpu, debug=True, offline_cache=False)
    x = ti.field(ti.i32)
    ti.root.dense(ti.i, 4).dynamic(ti.j, 8).place(x)

    @ti.kernel
    def run(i: ti.i32) -> ti.i32:
        result = 0
        if ti.static(what == "append"):
            result = x[i].append(1)
        else:
            result = x[i].length()
        return result

    run(3)
    for index in (4, -1, 1 << 30):
        with raises(ti.TaiAssertionError, "out of range", "test_sparse_errors.py"):
            run(index)


def test_outside_the_tree_without_checks():
    ti.init(bounds="off")
    x = ti.field(ti.i32)
    level = ti.root.pointer(ti.i, 8)
    level.place(x)
    which = ti.field(ti.i32, ())

    @ti.kernel
    def activate():
        ti.activate(level, which[None])

    with raises(ti.TaiAssertionError, "index out of range: there is no cell 100", "which has 8"):
        which[None] = 100
        activate()
        ti.sync()


@pytest.mark.parametrize("form", ["activate", "deactivate", "is_active"])
def test_number_of_indices(form):
    x = ti.field(ti.i32)
    level = ti.root.pointer(ti.ij, 8)
    level.place(x)
    function = getattr(ti, form)

    @ti.kernel
    def run():
        function(level, [1])

    with raises(ti.TaiIndexError, "the 'pointer' level over ij has 2 indices, but got 1", "run"):
        run()


def test_indices_of_lists():
    x = ti.field(ti.i32)
    lists = ti.root.dense(ti.i, 4).dynamic(ti.j, 8)
    lists.place(x)

    @ti.kernel
    def short() -> ti.i32:
        return ti.length(lists, [])

    @ti.kernel
    def long():
        ti.append(lists, [0, 1], 3)

    with raises(ti.TaiIndexError, "a list of the 'dynamic' level over ij has 1 indices"):
        short()
    with raises(ti.TaiIndexError, "but got 2"):
        long()


# Lists


@pytest.mark.parametrize("debug", [False, True])
def test_append_past_the_capacity(debug):
    ti.init(arch=ti.cpu, debug=debug, offline_cache=False)
    x = ti.field(ti.i32)
    lists = ti.root.dense(ti.i, 2).dynamic(ti.j, 4, chunk_size=2)
    lists.place(x)

    @ti.kernel
    def fill(count: ti.i32):
        for _ in range(count):
            x[1].append(7)

    fill(4)
    with raises(ti.TaiRuntimeError, "append to a full list", "above @x holds at most 4 cells",
                "x[1].append(7)"):  # fmt: skip
        fill(1)
        ti.sync()
    # The list is as it was, and can be emptied and used again.
    assert x.to_numpy().tolist() == [[0] * 4, [7] * 4]
    lists.deactivate_all()
    fill(2)
    assert lists.num_active == 2


def test_append_needs_a_list():
    x, outer = blocks()
    y, z = ti.field(ti.i32), ti.field(ti.i32)
    both = ti.root.dynamic(ti.i, 8)
    both.place(y, z)
    deep = ti.root.dynamic(ti.i, 8)
    w = ti.field(ti.i32)
    deep.dense(ti.j, 4).place(w)

    @ti.kernel
    def to_blocks():
        ti.append(outer, [], 1.0)

    @ti.kernel
    def to_both():
        ti.append(both, [], 1)

    @ti.kernel
    def to_deep():
        ti.append(deep, [], 1)

    @ti.kernel
    def to_field():
        x.append(1.0)

    with raises(ti.TaiTypeError, "takes a dynamic level, but this is the 'pointer' level"):
        to_blocks()
    with raises(ti.TaiTypeError, "holds 2 fields, but got one value"):
        to_both()
    with raises(ti.TaiTypeError, "there are levels in the 'dynamic' level over i"):
        to_deep()
    with raises(ti.TaiTypeError, "field 'x' has no attribute 'append'"):
        to_field()


def test_length_of_a_list_of_lists():
    x = ti.field(ti.i32)
    outer = ti.root.dynamic(ti.i, 8)
    outer.dynamic(ti.j, 8).place(x)

    @ti.kernel
    def run() -> ti.i32:
        return ti.length(outer, [])

    with raises(ti.TaiTypeError, "the innermost list", "keep the number"):
        run()


# Loops


def test_loop_over_a_field_that_is_not_placed():
    x = ti.field(ti.i32)

    @ti.kernel
    def run():
        for i in x:
            x[i] = 1

    with raises(ti.TaiRuntimeError, "field 'x' is not placed", "for i in x:", "dense(ti.i"):
        run()


def test_loop_over_a_level_without_fields():
    level = ti.root.pointer(ti.i, 8)

    @ti.kernel
    def run():
        for i in level:
            pass

    with raises(ti.TaiTypeError, "a level that holds a field", "for i in level"):
        run()


def test_loop_over_the_root():
    x = ti.field(ti.i32, shape=())

    @ti.kernel
    def run():
        for i in x.parent():
            pass

    with raises(ti.TaiTypeError, "ti.root cannot be looped over"):
        run()


def test_number_of_loop_variables():
    x = ti.field(ti.i32)
    level = ti.root.pointer(ti.ij, 8)
    level.dense(ti.ij, 2).place(x)

    @ti.kernel
    def run():
        for i in level:
            pass

    with raises(ti.TaiTypeError, "the loop has 1 variable, but runs over 2 dimensions"):
        run()


def test_a_number_is_no_level():
    x = ti.field(ti.i32, shape=())

    @ti.kernel
    def of_number():
        ti.activate(3, [0])

    @ti.kernel
    def of_root():
        ti.activate(x, [])

    with raises(ti.TaiTypeError, "ti.activate takes a level of a layout, but got 3"):
        of_number()
    with raises(ti.TaiTypeError, "takes a level of a layout", "stands in none"):
        of_root()


# Python


HINTS_IN_PYTHON = {
    "activate": "deactivate_all()", "deactivate": "deactivate_all()",
    "is_active": "level.active_cells()", "append": "at least 10 long",
    "length": "level.num_active",
}  # fmt: skip


@pytest.mark.parametrize("name", HINTS_IN_PYTHON)
def test_topology_is_for_kernels(name):
    x, outer = blocks()
    hint = HINTS_IN_PYTHON[name]
    with raises(ti.TaiSyntaxError, f"ti.{name} stands in kernels", f"ti.{name}(level, i", hint):
        getattr(ti, name)(outer, [0])
    vectors = ti.Vector.field(2, ti.f32, shape=3)
    for value in (x, outer, vectors, ti.root, ti.types.struct(a=ti.f32).field(shape=2)):
        with raises(AttributeError, f"'{name}'\n  hint: ", f"ti.{name}(level, i", hint):
            getattr(value, name)(1)
        assert not hasattr(value, name) and name not in dir(value)
    assert {"fill", "to_numpy"} <= set(dir(x)) and "num_active" in dir(outer)


def test_a_member_may_be_named_as_an_operation_of_cells():
    s = ti.types.struct(length=ti.f32, append=ti.i32).field(shape=2)
    s.length.fill(3)
    assert s[1].length == 3 and s.append[0] == 0


def test_a_list_in_python():
    x = ti.field(ti.i32, name="x")
    lists = ti.root.dense(ti.i, 4).dynamic(ti.j, 16)
    lists.place(x)
    for call in (lambda: x[0].append(1), lambda: x[0].length()):
        with raises(ti.TaiIndexError, "x[i] is a list", "x[i].append(value)"):
            call()
    with raises(ti.TaiIndexError, "expects 2 indices, but got 3", "one index for each dimension"):
        _ = x[0, 1, 2]
    x[0, 9] = 1
    assert lists.num_active == 10  # as the hint of append says

    @ti.kernel
    def push():
        x.append(1)

    with raises(ti.TaiTypeError, "'x' has no attribute 'append'", "by x[i].append(value)"):
        push()


def test_dense_levels_have_no_activity():
    x = ti.field(ti.i32)
    level = ti.root.dense(ti.i, 8)
    level.place(x)
    with raises(ti.TaiRuntimeError, "all cells of a dense level are active"):
        level.active_cells()
    y, outer = blocks()
    with raises(ti.TaiRuntimeError, "as those of the pointer level above it", "level.parent()"):
        y.parent().active_cells()
    y[0] = 1
    assert ti.sparse.usage(y) == 1 / 8
    with raises(ti.TaiRuntimeError, "it is below no sparse level"):
        ti.sparse.usage(x)


def test_sparse_grids_have_two_or_three_dimensions():
    with raises(ti.TaiRuntimeTypeError, "two or three dimensions, but got 1"):
        ti.sparse.grid({"m": ti.f32}, shape=100)


def test_structs():
    with raises(ti.TaiRuntimeTypeError, "an attribute 'shape' of its own"):
        ti.types.struct(shape=ti.f32).field()
    with raises(ti.TaiRuntimeTypeError, "member 'a' of a struct"):
        ti.types.struct(a="f32")
    pair = ti.types.struct(a=ti.f32, b=ti.f32)
    with raises(ti.TaiTypeError, "has 2 members, but got 3"):
        pair(1, 2, 3)
    f = pair.field(shape=2)

    @ti.kernel
    def add():
        f[0] += f[1]

    @ti.kernel
    def misspell():
        f[0].c = 1.0

    @ti.kernel
    def store():
        f[0] = 1.0

    with raises(ti.TaiTypeError, "structs have no arithmetic"):
        add()
    with raises(ti.TaiNameError, "the struct has no member 'c'"):
        misspell()
    with raises(ti.TaiTypeError, "expects a struct(a=f32, b=f32)"):
        store()


# Trees that are gone


def test_kernel_of_a_destroyed_tree():
    builder = ti.FieldsBuilder()
    x = ti.field(ti.i32)
    level = builder.pointer(ti.i, 8)
    level.place(x)
    tree = builder.finalize()

    @ti.kernel
    def run():
        for i in x:
            x[i] += 1

    x[3] = 1
    run()
    assert x[3] == 2
    tree.destroy()
    with raises(ti.TaiRuntimeError, "the tree of field 'x' has been destroyed", "for i in x"):
        run()
    with raises(ti.TaiRuntimeError, "the tree of field 'x' has been destroyed and freed"):
        x[3]
    with raises(ti.TaiRuntimeError, "the tree of this level has been destroyed"):
        level.active_cells()
    with raises(ti.TaiRuntimeError, "the tree is freed already"):
        tree.destroy()


def test_tree_destroyed_before_the_gradient():
    builder = ti.FieldsBuilder()
    x = ti.field(ti.f32)
    builder.pointer(ti.i, 8).place(x)
    builder.lazy_grad()
    tree = builder.finalize()
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            loss[None] += x[i] ** 2

    x[3] = 1
    with raises(ti.TaiRuntimeError, "which has been destroyed"):
        with ti.ad.Tape(loss):
            run()
            tree.destroy()
    # The next tape is none the worse.
    y = ti.field(ti.f32, shape=2, needs_grad=True)

    @ti.kernel
    def again():
        for i in y:
            loss[None] += 3 * y[i]

    with ti.ad.Tape(loss):
        again()
    assert y.grad.to_numpy().tolist() == [3, 3]


def test_level_of_an_earlier_program():
    x, outer = blocks()
    x[0] = 1
    ti.init(arch=ti.cpu, offline_cache=False)
    y = ti.field(ti.i32, shape=2)
    y[0] = 1
    with raises(ti.TaiRuntimeError, "made before the last ti.init"):
        outer.deactivate_all()


# Memory


def limited(**options):
    ti.init(arch=ti.cpu, memory_limit=1 << 20, offline_cache=False, **options)
    x = ti.field(ti.f32, name="x")
    level = ti.root.pointer(ti.i, 1 << 20)
    level.dense(ti.i, 1024).place(x)
    return x, level


@pytest.mark.parametrize("threads", [1, 4])
def test_out_of_memory_in_a_kernel(threads):
    x, level = limited(cpu_max_num_threads=threads)

    @ti.kernel
    def write(first: ti.i32, count: ti.i32):
        for b in range(first, first + count):
            x[1024 * b] = 1.0

    write(0, 100)
    with raises(
        ti.TaiMemoryError, "out of memory: one more cell", "the 'pointer' level above @x",
        "of 4.0 KiB each", "of 1.0 MiB", "x[1024 * b] = 1.0",
    ):  # fmt: skip
        write(100, 100000)
    assert 100 <= level.num_active <= 256 + threads
    # Existing cells keep their values, and freed memory can be used again.
    assert x[1024 * 99] == 1
    level.deactivate_all()
    write(500, 200)
    assert level.num_active == 200 and x[1024 * 600] == 1


def test_out_of_memory_in_python():
    x, level = limited()
    with raises(MemoryError, "out of memory", "the 'pointer' level above @x"):
        for block in range(1000):
            x[1024 * block] = 1
    assert level.num_active == 256
    level.deactivate_all()
    x[5] = 2
    assert x[5] == 2


def test_out_of_memory_of_an_array():
    ti.init(arch=ti.cpu, memory_limit=1 << 12, offline_cache=False)
    x = ti.field(ti.f32)
    level = ti.root.pointer(ti.i, 64)
    level.dense(ti.i, 64).place(x)
    x.from_numpy(np.eye(1, 4096, 100, dtype=np.float32)[0])
    assert level.num_active == 1
    with raises(ti.TaiMemoryError, "out of memory"):
        x.from_numpy(np.ones(4096, np.float32))


def test_dense_memory_has_the_same_limit():
    ti.init(arch=ti.cpu, memory_limit=1 << 20, offline_cache=False)
    x = ti.field(ti.f32, shape=1 << 20, name="x")
    with raises(ti.TaiMemoryError, "out of memory", "needs 4.0 MiB"):
        x[0] = 1
    y = ti.field(ti.f32, shape=4)
    y[1] = 2
    assert y[1] == 2
    with raises(ti.TaiRuntimeError, "field 'x' is not there", "needs 4.0 MiB"):
        x[0]


def test_a_tree_that_the_device_cannot_hold():
    """Cells have memory as long as there is some; the program goes on with those, and others."""
    ti.init(arch=ti.cpu, device_memory_limit=16 << 20, offline_cache=False)
    if ti.lang.impl.current_cfg().arch != ti.cuda:
        pytest.skip("the limit is that of a device")
    x, y = ti.field(ti.f32, name="x"), ti.field(ti.f32)
    level = ti.root.pointer(ti.i, 1024)
    level.dense(ti.i, 16384).place(x)

    @ti.kernel
    def write(cells: ti.i32):
        for c in range(cells):
            x[c * 16384 + 5] = 1.0

    write(3)
    assert level.num_active == 3
    with raises(ti.TaiMemoryError, "out of memory on the device: one more cell of the",
                "'pointer' level above @x; the active cells", "lie in pieces of"):  # fmt: skip
        write(1024)
        ti.sync()
    assert 3 <= level.num_active < 256
    assert x[5] == x[2 * 16384 + 5] == 1.0
    small = ti.FieldsBuilder()
    small.pointer(ti.i, 16).place(y)
    small.finalize()

    @ti.kernel
    def other():
        y[3] = 2.0

    other()
    assert y[3] == 2


def test_a_gradient_through_deactivated_cells_names_both_lines():
    x, loss = ti.field(ti.f32, name="x"), ti.field(ti.f32, shape=(), needs_grad=True)
    level = ti.root.pointer(ti.i, 8)
    level.dense(ti.i, 4).place(x, x.grad)

    @ti.kernel
    def clear():
        for i in range(8):
            loss[None] += x[4 * i] ** 2
            ti.deactivate(level, [i])

    with raises(ti.TaiAutodiffError, "deactivates cells of a tree", "ti.deactivate(level, [i])",
                "note: reads or writes it here", "loss[None] += x[4 * i] ** 2"):  # fmt: skip
        clear.grad()
