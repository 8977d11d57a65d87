"""Released objects leave nothing behind: the program's counts of objects, round after round."""

import gc
import threading

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def program():
    ti.init()
    yield
    ti.reset()


def held():
    """How many of each thing there are, in C++ and in Python."""
    from tai._impl.base.program import get_program

    program = get_program()
    gc.collect()
    gc.collect()
    program.symbols.settle()
    counts = dict(program.context.count_objects())
    counts["symbols"] = len(program.symbols)
    counts["python fields"] = len(program.fields)
    counts["python functions"] = len(program.kernel_functions)
    counts["python kernels"] = len(program.kernels)
    return counts


def check_flat(one_round, rounds=20, before=6):
    """After some rounds, further ones add nothing."""
    for _ in range(before):
        one_round()
    first = held()
    for _ in range(rounds):
        one_round()
    assert held() == first


def make_tree(*fields, n=16):
    builder = ti.FieldsBuilder()
    builder.dense(ti.i, n).place(*fields)
    return builder.finalize()


def test_trees():
    def one_round():
        x = ti.field(ti.f32, needs_grad=True)
        v = ti.Vector.field(3, ti.f32)
        tree = make_tree(x, v)
        x[3] = 1.0
        tree.destroy()

    check_flat(one_round)


def test_trees_that_kernels_use():
    def one_round():
        x = ti.field(ti.f32)
        tree = make_tree(x)

        @ti.kernel
        def fill():
            for i in x:
                x[i] += 1.0

        fill()
        assert x[3] == 1.0
        tree.destroy()

    check_flat(one_round)


def test_one_kernel_for_many_trees():
    @ti.kernel
    def fill(x: ti.template()):
        for i in x:
            x[i] += 1.0

    def one_round():
        x = ti.field(ti.f32)
        tree = make_tree(x)
        fill(x)
        assert x[3] == 1.0
        tree.destroy()

    check_flat(one_round)
    assert not fill._specializations


def test_tapes_of_trees():
    @ti.kernel
    def add_up(x: ti.template(), loss: ti.template()):
        for i in x:
            loss[None] += x[i] * x[i]

    def one_round():
        x = ti.field(ti.f32, needs_grad=True)
        loss = ti.field(ti.f32, needs_grad=True)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, 16).place(x)
        builder.place(loss)
        tree = builder.finalize()
        x.fill(2.0)
        with ti.ad.Tape(loss):
            add_up(x, loss)
        assert x.grad[5] == 4.0
        tree.destroy()

    check_flat(one_round)


def test_kernels_that_are_defined_again():
    x = ti.field(ti.f32, shape=16, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    def one_round():
        @ti.kernel
        def add_up():
            for i in x:
                loss[None] += 3.0 * x[i]

        with ti.ad.Tape(loss):
            add_up()
        assert x.grad[5] == 3.0

    check_flat(one_round)


def test_kernels_that_do_not_compile():
    x = ti.field(ti.f32, shape=16)

    def one_round():
        @ti.kernel
        def bad():
            for i in x:
                x[i] = missing  # noqa: F821

        with pytest.raises(ti.TaiError):
            bad()

    check_flat(one_round)


def test_tapes_and_arrays():
    x = ti.field(ti.f32, shape=16, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def add_up(a: ti.types.ndarray()):
        for i in x:
            loss[None] += a[i] * x[i]

    def one_round():
        a = ti.ndarray(ti.f32, 16, needs_grad=True)
        a.fill(2.0)
        with ti.ad.Tape(loss):
            add_up(a)
            add_up(np.ones(16, np.float32))
        assert x.grad[5] == 3.0

    check_flat(one_round)


def test_threads_that_end():
    x = ti.field(ti.f32, shape=16)

    @ti.kernel
    def fill():
        for i in x:
            x[i] += 1.0

    def one_round():
        thread = threading.Thread(target=fill)
        thread.start()
        thread.join()

    check_flat(one_round)


def test_programs():
    """Nothing stays of a program that is over; the next one has the same counts."""

    def one_round():
        ti.init()
        x = ti.field(ti.f32, shape=16)

        @ti.kernel
        def fill():
            for i in x:
                x[i] += 1.0

        fill()

    check_flat(one_round, rounds=4, before=2)
    from tai._impl.base.program import Program

    gc.collect()
    assert sum(isinstance(thing, Program) for thing in gc.get_objects()) == 1


def test_names_that_come_again_are_other_things():
    """A kernel that a tape holds keeps its name, and a gradient that has gone stays gone."""
    x = ti.field(ti.f64, name="x", needs_grad=True)
    loss = ti.field(ti.f64, name="loss", needs_grad=True)
    builder = ti.FieldsBuilder()
    builder.dense(ti.i, 4).place(x)
    builder.place(loss)
    builder.finalize()

    def define(factor):
        @ti.kernel
        def step():
            for i in x:
                loss[None] += factor * x[i]

        return step

    step = define(2.0)
    with ti.ad.Tape(loss) as tape:
        step()
    del step
    held()
    for factor in (3.0, 5.0, 7.0):
        other = define(factor)
        other()
        del other
        held()
    tape.replay()
    assert x.grad[1] == 2.0
    assert tape.explain().count("@step:") == 1


def test_a_gradient_that_goes_is_not_taken_for_the_next_of_its_name():
    x = ti.field(ti.f64, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    values = ti.FieldsBuilder()
    values.dense(ti.i, 4).place(x)
    gradients = ti.FieldsBuilder()
    gradients.dense(ti.i, 4).place(x.grad)
    values.finalize()
    tree = gradients.finalize()

    @ti.kernel
    def add_up():
        for i in x:
            loss[None] += 2.0 * x[i]

    with ti.ad.Tape(loss):
        add_up()
    assert x.grad[1] == 2.0
    tree.destroy()
    others = []
    for _ in range(4):
        other = ti.field(ti.f64, name="x_grad")
        make_tree(other, n=4)
        other.fill(9.0)
        others.append(other)
    add_up()
    with ti.ad.Tape(loss):
        add_up()
    for other in others:
        assert other.to_numpy().tolist() == [9.0] * 4


def test_a_kernel_of_a_tree_that_is_gone():
    x = ti.field(ti.f32, name="x")
    tree = make_tree(x)

    @ti.kernel
    def fill():
        for i in x:
            x[i] += 1.0

    fill()
    tree.destroy()
    y = ti.field(ti.f32, name="x")
    make_tree(y)
    with pytest.raises(ti.TaiError, match="destroyed"):
        fill()
    assert y[3] == 0.0
