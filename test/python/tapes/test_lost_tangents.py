"""A tangent that ends in a field without a dual is said, once."""

import inspect
import warnings

import numpy as np
import pytest
import tai as ti

from lost_scene import N, Program


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def warnings_of(run, loss, param, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ti.ad.FwdMode(loss=loss, param=param, seed=np.ones(N), **options):
            run()
    assert all(issubclass(w.category, ti.ad.TaiGradientWarning) for w in caught)
    assert all(w.filename == __file__ for w in caught)
    return [str(w.message) for w in caught]


def silent(run, loss, param):
    assert warnings_of(run, loss, param) == []


def test_it_names_kernel_line_field_and_what_to_do():
    program = Program()
    (line,) = warnings_of(program.run, program.loss, program.x)
    source, first = inspect.getsourcelines(Program.__init__)
    number = first + next(n for n, text in enumerate(source) if "tmp[i] = 2" in text)
    assert f"{inspect.getsourcefile(Program)}:{number}" in line
    for part in ("'keep", "'x', which has a dual", "'tmp' has no dual", "needs_dual=True"):
        assert part in line
    silent(program.run, program.loss, program.x)


def test_jvp():
    program = Program()
    with pytest.warns(ti.ad.TaiGradientWarning, match="'tmp' has no dual") as caught:
        ti.ad.jvp(program.run, program.x, np.ones(N), program.loss)
    assert caught[0].filename == __file__


def test_jvp_of_a_tape():
    program = Program(needs_grad=True)
    with ti.ad.Tape(program.loss) as tape:
        program.run()
    with pytest.warns(ti.ad.TaiGradientWarning, match="'tmp' has no dual"):
        ti.ad.jvp(tape, program.x, np.ones(N), program.loss)


def test_an_error_leaves_forward_mode():
    program = Program()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with (
            pytest.raises(ti.ad.TaiGradientWarning),
            ti.ad.FwdMode(loss=program.loss, param=program.x, seed=np.ones(N)),
        ):
            program.run()
    silent(program.run, program.loss, program.x)


def test_each_field_on_the_way_is_named():
    program = Program()
    tmp, y = program.tmp, program.y
    other = ti.field(ti.f64, shape=N, name="other")

    @ti.kernel
    def keep_more():
        for i in tmp:
            other[i] = tmp[i] + 1

    @ti.kernel
    def use():
        for i in other:
            y[i] = other[i]

    def run():
        program.keep()
        keep_more()
        use()
        program.total()

    first, second = warnings_of(run, program.loss, program.x)
    assert "'tmp'" in first and "'other'" in second and "and so on a field" in second


def test_through_an_array():
    program, between = Program(), np.zeros(N)

    @ti.kernel
    def put(given: ti.types.ndarray(ti.f64, ndim=1)):
        for i in program.tmp:
            given[i] = program.tmp[i]

    @ti.kernel
    def take(given: ti.types.ndarray(ti.f64, ndim=1)):
        for i in program.y:
            program.y[i] = given[i]

    def run():
        program.keep()
        put(between)
        take(between)
        program.total()

    (line,) = warnings_of(run, program.loss, program.x)
    assert "'tmp' has no dual" in line


def test_tangents_of_before():
    program = Program()
    v = ti.field(ti.f64, shape=N, needs_dual=True, name="v")

    @ti.kernel
    def keep():
        for i in v:
            program.tmp[i] = v[i]

    def run():
        keep()
        program.go_on()
        program.total()

    # The value of v has no tangent by x.
    silent(run, program.loss, program.x)
    v.dual.fill(1.0)
    (line,) = warnings_of(run, program.loss, program.x, clear_gradients=False)
    assert "depends on 'v'" in line


# No false alarms


def test_fields_with_duals():
    program = Program(needs_dual=True)
    silent(program.run, program.loss, program.x)
    assert program.loss.dual[None] == 4 * 15


def test_what_is_meant():
    program = Program()

    @ti.kernel
    def keep():
        for i in program.x:
            program.tmp[i] = ti.stop_grad(2 * program.x[i])

    def run():
        keep()
        program.go_on()
        program.total()

    silent(run, program.loss, program.x)


def test_what_the_loss_does_not_depend_on():
    program = Program()

    @ti.kernel
    def use():
        for i in program.x:
            program.loss[None] += program.x[i]

    def run():
        program.keep()
        use()

    silent(run, program.loss, program.x)


def test_another_output():
    program = Program()
    other = ti.field(ti.f64, shape=N, needs_dual=True, name="other")

    @ti.kernel
    def copy():
        for i in other:
            other[i] = program.x[i]

    def run():
        program.run()
        copy()

    silent(run, other, program.x)


def test_what_is_overwritten_in_between():
    program = Program()

    @ti.kernel
    def reset():
        for i in program.tmp:
            program.tmp[i] = 1.0

    def run(overwrite):
        for _ in range(3):
            program.keep()
            overwrite()
            program.go_on()
        program.total()

    silent(lambda: run(reset), program.loss, program.x)
    silent(lambda: run(lambda: program.tmp.fill(1.0)), program.loss, program.x)


def test_the_point_is_said_inside():
    program = Program()

    def run():
        program.x.fill(2.0)
        program.run()

    assert len(warnings_of(run, program.loss, program.x)) == 1


def test_what_python_has_overwritten_has_no_tangent():
    program = Program()

    @ti.kernel
    def start():
        for i in program.y:
            program.y[i] = program.x[i]

    def run():
        start()
        program.x.fill(2.0)
        program.run()

    silent(run, program.loss, program.x)


def test_a_view_of_a_field_with_a_gradient_alone_carries_no_tangent():
    x = ti.field(ti.f64, shape=N, needs_grad=True)
    y, p = (ti.field(ti.f64, shape=N, needs_dual=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_dual=True)
    x.fill(2)
    view = np.from_dlpack(x)

    @ti.kernel
    def weigh():
        for i in y:
            loss[None] += y[i] * p[i]

    def run():
        y.from_numpy(view)
        weigh()

    silent(run, loss, p)
    assert loss.dual[None] == 2 * N
