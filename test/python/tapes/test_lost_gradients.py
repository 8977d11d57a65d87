"""A gradient that ends in a field without one is reported, once; gradients that are meant to end,
and zero ones, are not."""

import inspect
import warnings

import numpy as np
import pytest
import tai as ti

from lost_scene import N, Program


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def warnings_of(run, loss, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ti.ad.Tape(loss, **options) as tape:
            run()
    assert all(issubclass(w.category, ti.ad.TaiGradientWarning) for w in caught)
    return [str(w.message) for w in caught], tape


def test_it_names_kernel_line_field_and_what_to_do():
    program = Program()
    found, tape = warnings_of(program.run, program.loss)
    (line,) = found
    source, first = inspect.getsourcelines(Program.__init__)
    number = first + next(n for n, text in enumerate(source) if "tmp[i] = 2" in text)
    assert f"{inspect.getsourcefile(Program)}:{number}" in line
    for part in ("'keep", "'tmp", "'x'", "needs_grad=True", "ti.stop_grad"):
        assert part in line
    # Once: not by another iteration, nor by another sweep of this one.
    assert warnings_of(program.run, program.loss)[0] == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tape.replay()
        tape.grad()


def test_each_kernel_and_field_is_named():
    program = Program()
    other = ti.field(ti.f64, shape=N, name="other")
    x, y, tmp = program.x, program.y, program.tmp

    @ti.kernel
    def keep_more():
        for i in x:
            other[i] = tmp[i] + 1

    @ti.kernel
    def use():
        for i in x:
            y[i] += other[i]

    def run():
        program.keep()
        keep_more()
        use()
        program.total()

    found, _ = warnings_of(run, program.loss)
    assert len(found) == 2
    assert "'keep" in found[0] and "'tmp'" in found[0]
    assert "'keep_more" in found[1] and "'other'" in found[1]
    assert "'tmp', and so on a field that has a gradient" in found[1]


@pytest.mark.parametrize("kind", ["vector", "struct", "sparse", "lazy", "f32"])
def test_fields_of_all_kinds(kind):
    x = ti.field(ti.f64, shape=N, needs_grad=True, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
    if kind == "vector":
        tmp = ti.Vector.field(2, ti.f64, shape=N)
    elif kind == "struct":
        tmp = ti.Struct.field({"a": ti.f64, "b": ti.f64}, shape=N)
    else:
        tmp = ti.field(ti.f32 if kind == "f32" else ti.f64, name="tmp")
        if kind == "sparse":
            ti.root.pointer(ti.i, 2).dense(ti.i, 4).place(tmp)
        else:
            ti.root.dense(ti.i, N).place(tmp)

    @ti.kernel
    def keep():
        for i in x:
            if ti.static(kind == "vector"):
                tmp[i] = ti.Vector([x[i], 2 * x[i]])
            elif ti.static(kind == "struct"):
                tmp[i].a = x[i]
            else:
                tmp[i] += x[i]

    @ti.kernel
    def total():
        for i in x:
            if ti.static(kind == "vector"):
                loss[None] += tmp[i].sum()
            elif ti.static(kind == "struct"):
                loss[None] += tmp[i].a
            else:
                loss[None] += tmp[i]

    def run():
        keep()
        total()

    found, _ = warnings_of(run, loss)
    own = [line for line in found if "needs_grad=True" in line]
    assert len(own) == 1


def test_a_check_says_why_it_disagrees():
    program = Program()
    result = ti.ad.check(program.run, loss=program.loss)
    assert not result
    assert "'tmp' has none, so that the derivative ends there" in str(result)


def test_within_one_kernel():
    program = Program()
    x, tmp, y = program.x, program.tmp, program.y

    @ti.kernel
    def both():
        for i in x:
            tmp[i] = x[i] ** 2
        for i in x:
            y[i] = tmp[i]

    def run():
        both()
        program.total()

    found, _ = warnings_of(run, program.loss)
    assert len([line for line in found if "'tmp'" in line]) == 1


def test_the_way_through_branches_and_loops():
    program = Program()
    x, tmp = program.x, program.tmp

    @ti.kernel
    def keep():
        for i in x:
            total = 0.0
            for j in range(i + 1):
                if x[j] > 1.5:
                    total += x[j]
            tmp[i] = total

    def run():
        keep()
        program.go_on()
        program.total()

    found, _ = warnings_of(run, program.loss)
    assert len(found) == 1 and "'tmp'" in found[0]


# No false alarms


def silent(run, loss):
    found, _ = warnings_of(run, loss)
    assert found == []


def test_what_is_meant():
    program = Program()
    x, tmp = program.x, program.tmp

    @ti.kernel
    def keep():
        for i in x:
            tmp[i] = ti.stop_grad(2 * x[i])

    def run():
        keep()
        program.go_on()
        program.total()

    silent(run, program.loss)
    # Where it is read, too.
    other = ti.field(ti.f64, shape=N, name="other")

    @ti.kernel
    def keep_other():
        for i in x:
            other[i] = x[i]

    @ti.kernel
    def go_on():
        for i in x:
            program.y[i] = x[i] + ti.stop_grad(other[i])

    def run_other():
        keep_other()
        go_on()
        program.total()

    silent(run_other, program.loss)


def test_no_grad():
    program = Program()

    @ti.ad.no_grad
    def keep():
        program.keep()

    def run():
        keep()
        program.go_on()
        program.total()

    silent(run, program.loss)


def test_constants_and_what_depends_on_nothing():
    program = Program()
    x, tmp = program.x, program.tmp

    @ti.kernel
    def keep(dt: ti.f64):
        for i in x:
            tmp[i] = dt * i + ti.floor(x[i])
            if x[i] > 2:
                tmp[i] = 7.0

    def run():
        keep(0.5)
        program.go_on()
        program.total()

    silent(run, program.loss)


def test_integers():
    program = Program(dtype=ti.i32)
    x, tmp = program.x, program.tmp

    @ti.kernel
    def keep():
        for i in x:
            tmp[i] = ti.cast(x[i], ti.i32)

    def run():
        keep()
        program.go_on()
        program.total()

    silent(run, program.loss)


def test_what_the_loss_does_not_depend_on():
    program = Program()
    x, tmp, loss = program.x, program.tmp, program.loss
    image = ti.field(ti.f64, shape=N, name="image")

    @ti.kernel
    def validate():
        for i in x:
            image[i] = 0.5 * (x[i] + tmp[i])

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        program.keep()
        validate()
        total()

    silent(run, loss)


def test_what_is_read_before_it_is_stored():
    program = Program()

    def run():
        program.go_on()
        program.total()
        program.keep()

    silent(run, program.loss)


def test_what_is_overwritten_in_between():
    program = Program()
    tmp = program.tmp

    @ti.kernel
    def reset():
        for i in tmp:
            tmp[i] = 1.0

    def run():
        program.keep()
        reset()
        program.go_on()
        program.total()

    silent(run, program.loss)

    def run_with_the_host():
        program.keep()
        tmp.fill(1.0)
        program.go_on()
        program.total()

    silent(run_with_the_host, program.loss)


def test_a_tape_that_starts_elsewhere():
    program = Program()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ti.ad.Tape() as tape:
            program.keep()
            program.go_on()
        tape.backward({program.y: np.ones(N)})
    assert len([w for w in caught if "'tmp'" in str(w.message)]) == 1
