"""Programs of many fields, in trees of many levels and places."""

import tai as ti
from tai._impl.base import native


def dense(count):
    fields = [ti.field(ti.f32, needs_grad=True) for _ in range(count)]
    for field in fields:
        ti.root.dense(ti.i, 4).place(field)
    ti.root.lazy_grad()
    return fields


def pointers(count):
    fields = [ti.field(ti.f32) for _ in range(count)]
    for field in fields:
        ti.root.pointer(ti.i, 2).dense(ti.i, 4).place(field)
    return fields


def one_record(count):
    fields = [ti.field(ti.f32) for _ in range(count)]
    ti.root.dense(ti.i, 4).place(*fields)
    return fields


def in_blocks(count):
    fields = [ti.field(ti.f32) for _ in range(count)]
    block = ti.root.dense(ti.i, 4)
    for field in fields:
        block.dense(ti.j, 2).place(field)
    return fields


LAYOUTS = {"dense": dense, "pointer": pointers, "record": one_record, "blocks": in_blocks}


def pytest_generate_tests(metafunc):
    if "lay_out" in metafunc.fixturenames:
        metafunc.parametrize("lay_out", LAYOUTS.values(), ids=LAYOUTS)


def test_fields_by_the_thousand(lay_out):
    # Where each took time in proportion to their number, this would take minutes, and be stopped.
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    fields = lay_out(5000)
    index = (0,) * len(fields[0].shape)
    fields[2500][index] = 3.0
    assert fields[2500][index] == 3.0
    assert fields[0][index] == 0


def test_elements_of_many_fields_do_not_meet(lay_out):
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    fields = lay_out(300)
    index = (1,) * len(fields[0].shape)
    for number, field in enumerate(fields):
        field[index] = number
    assert [field[index] for field in fields] == list(range(300))
    others = [field[(0,) * len(index)] for field in fields]
    assert others == [0] * 300


def test_a_kernel_uses_some_of_many_fields():
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    fields = dense(2000)
    loss = ti.field(ti.f32, (), needs_grad=True)
    x, y = fields[7], fields[1999]

    @ti.kernel
    def run():
        for i in x:
            y[i] = 2 * x[i]
        for i in y:
            loss[None] += y[i] * y[i]

    x.fill(3)
    with ti.ad.Tape(loss):
        run()
    assert loss[None] == 4 * 36
    assert x.grad.to_numpy().tolist() == [24] * 4
    assert fields[8].to_numpy().tolist() == [0] * 4


def test_partners_are_found_in_any_order():
    # Declared by hand: adjoints before and after their primals, and one that does not fit.
    context = native.Context()
    context.add_tree("t", "!tai.root<dense<[i: 4], {x: f32, dx: f32, y: f32, dy: f32, z: f64}>>")
    context.add_field('tai.field @x = @t["x"] : f32, rank 1, adjoint @dx')
    context.add_field('tai.field @dx = @t["dx"] : f32, rank 1')
    context.add_field('tai.field @dy = @t["dy"] : f32, rank 1')
    context.add_field('tai.field @y = @t["y"] : f32, rank 1, adjoint @dy')
    context.destroy_tree("t")
    context.add_tree("t", "!tai.root<dense<[i: 4], {x: f32, dx: i32}>>")
    context.add_field('tai.field @x = @t["x"] : f32, rank 1, adjoint @dx')
    try:
        context.add_field('tai.field @dx = @t["dx"] : i32, rank 1')
    except ti.TaiRuntimeError as error:
        assert "differ in shape or element type" in str(error)
    else:
        raise AssertionError("an adjoint of integers was taken")


def test_the_layout_of_one_field_is_refused_at_that_field():
    context = native.Context()
    context.add_tree("t", "!tai.root<dense<[i: 4], {x: f32}>>")
    for declaration, why in (
        ('tai.field @x = @t["y"] : f32, rank 1', "which the tree does not have"),
        ('tai.field @x = @t["x"] : f64, rank 1', "holds"),
        ('tai.field @x = @t["x"] : f32, rank 2', "divides 1 axes"),
        ('tai.field @x = @u["x"] : f32, rank 1', "which is not there"),
    ):
        try:
            context.add_field(declaration)
        except ti.TaiError as error:
            assert why in str(error), error
        else:
            raise AssertionError(declaration)
    # None of them has left anything behind.
    context.add_field('tai.field @x = @t["x"] : f32, rank 1')
    assert context.count_objects()["fields"] == 1
