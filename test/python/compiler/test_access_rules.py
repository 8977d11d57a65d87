"""`ti.ad.Tape(loss, validation=True)`: the global data access rules, element by element."""

import inspect
import types

import numpy as np
import pytest
import tai as ti
from tai._impl.ad import validation

N = 6


class Fields:
    """The fields of the kernels below."""

    def __init__(self, dtype=ti.f64):
        self.x = ti.field(dtype, shape=N, needs_grad=True, name="x")
        self.y = ti.field(dtype, shape=N, needs_grad=True, name="y")
        self.b = ti.field(dtype, shape=(), needs_grad=True, name="b")
        self.v = ti.Vector.field(2, dtype, shape=(2, 3), needs_grad=True, name="v")
        self.loss = ti.field(dtype, shape=(), needs_grad=True)
        self.x.from_numpy(np.arange(1.0, N + 1))
        self.b[None] = 3.0


def line_of(function, mark: str) -> int:
    """The line of this file on which `function` has a comment that is `mark`."""
    lines, first = inspect.getsourcelines(inspect.unwrap(function))
    (found,) = [i for i, line in enumerate(lines) if line.rstrip().endswith(f"  # {mark}")]
    return first + found


def run(loss, *kernels, **options):
    with ti.ad.Tape(loss, **options):
        for kernel in kernels:
            kernel()


def violations(loss, *kernels):
    with pytest.raises(ti.TaiAssertionError) as caught:
        run(loss, *kernels, validation=True)
    assert isinstance(caught.value, AssertionError)
    return caught.value


@pytest.fixture(params=[1, 3])
def fields(request):
    ti.init(arch=ti.cpu, offline_cache=False, cpu_max_num_threads=request.param)
    return Fields()


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize("name", ["validation", "validate"])
def test_rules_that_hold(dtype, name):
    f = Fields(getattr(ti, dtype))
    state = ti.field(getattr(ti, dtype), shape=(4, N), needs_grad=True)

    @ti.kernel
    def start():
        for i in f.x:
            f.y[i] = 0.0  # cleared, and then summed up
            f.y[i] += f.x[i]
            state[0, i] = f.y[i]

    @ti.kernel
    def step(t: ti.i32):
        for i in f.x:
            state[t, i] = state[t - 1, i] * state[t - 1, (i + 1) % N]

    @ti.kernel
    def total():
        for i in f.x:
            f.loss[None] += state[3, i]

    def simulate():
        start()
        for t in range(1, 4):
            step(t)
        total()

    run(f.loss, simulate)
    expected, loss = f.x.grad.to_numpy(), f.loss[None]
    run(f.loss, simulate, **{name: True})
    assert np.any(expected != 0)
    assert f.loss[None] == loss
    np.testing.assert_array_equal(f.x.grad.to_numpy(), expected)


def test_overwritten_after_it_was_read(fields):
    f = fields

    @ti.kernel
    def scale():
        for i in f.x:
            f.y[i] = f.x[i] * f.b[None]  # read

    @ti.kernel
    def change():
        f.b[None] = 10.0  # write

    error = violations(f.loss, scale, change)
    (found,) = error.violations
    assert found.message == "'b'[None] is overwritten after it was read"
    assert (found.field, found.index, found.component) == ("b", (), None)
    assert found.access.kernel == "change"
    assert found.access.launch == 1
    assert found.access.lineno == line_of(test_overwritten_after_it_was_read, "write")
    assert found.earlier.kernel == "scale"
    assert found.earlier.launch == 0
    assert found.earlier.lineno == line_of(test_overwritten_after_it_was_read, "read")
    assert error.lineno == found.access.lineno
    text = str(error)
    assert "f.b[None] = 10.0" in text
    assert "f.y[i] = f.x[i] * f.b[None]" in text
    assert "launch 1 of the tape" in text
    # The gradients are left alone.
    assert f.x.grad.to_numpy().tolist() == [0] * N


def test_accumulated_after_it_was_read(fields):
    f = fields

    @ti.kernel
    def use():
        for i in f.x:
            f.loss[None] += f.x[i] * f.b[None]

    @ti.kernel
    def add():
        f.b[None] += 1.0

    (found,) = violations(f.loss, use, add).violations
    assert found.message == "'b'[None] is accumulated after it was read"
    assert found.access.kernel == "add"
    assert found.earlier.kernel == "use"


def test_stored_twice(fields):
    f = fields

    @ti.kernel
    def first():
        for i in f.x:
            f.y[i] = f.x[i]

    @ti.kernel
    def second():
        for i in range(2, 4):
            f.y[i] = 2 * f.x[i]

    found = violations(f.loss, first, second).violations
    assert [(v.index, v.access.kernel, v.earlier.kernel) for v in found] == [
        ((2,), "second", "first"),
        ((3,), "second", "first"),
    ]
    assert found[0].message == "'y'[2] is written a second time, not by an accumulation"


def test_one_component(fields):
    f = fields

    @ti.kernel
    def whole():
        for i, j in f.v:
            f.v[i, j] = ti.Vector([f.x[i], f.x[j]])

    @ti.kernel
    def part():
        f.v[1, 2][1] = f.x[0]

    @ti.kernel
    def apart():
        for i, j in f.v:
            f.v[i, j][0] = f.x[i]
            f.v[i, j][1] = f.v[i, j][0]

    (found,) = violations(f.loss, whole, part).violations
    assert (found.field, found.index, found.component) == ("v", (1, 2), 1)
    run(f.loss, apart, validation=True)


def test_in_place_in_one_kernel(fields):
    f = fields

    @ti.kernel
    def damp():
        for i in f.x:
            f.x[i] = f.x[i] * f.b[None]

    found = violations(f.loss, damp).violations
    assert len(found) >= 4  # several, not only the first
    assert {v.message[v.message.index("]") :] for v in found} == {
        "] is overwritten after it was read"
    }
    assert found[0].access.lineno == found[0].earlier.lineno
    assert found[0].access.column < found[0].earlier.column


def test_race(fields):
    f = fields

    @ti.kernel
    def halve():
        for i in f.x:
            f.y[i // 2] = f.x[i]

    error = violations(f.loss, halve)
    assert {v.index for v in error.violations} <= {(0,), (1,), (2,)}
    assert "is written by two iterations of one loop" in str(error)


def test_read_before_the_sum_is_done():
    ti.init(arch=ti.cpu, offline_cache=False, cpu_max_num_threads=1)
    f = Fields()
    shift = ti.field(ti.i32, shape=())  # A constant would tell the compiler that they meet.
    shift[None] = 1

    @ti.kernel
    def early():
        for i in f.x:
            f.y[i % 3] += f.x[i]
            f.loss[None] += f.y[(i + shift[None]) % 3]

    error = violations(f.loss, early)
    messages = {v.message for v in error.violations}
    # In ascending order: y[1] is read before it is written, y[0] after.
    assert "'y'[1] is accumulated after it was read" in messages
    assert "'y'[0] is read while other iterations of the loop still write it" in messages


def test_debug_mode_finds_races_alone():
    ti.init(arch=ti.cpu, offline_cache=False, debug=True)
    f = Fields()

    @ti.kernel
    def first():
        for i in f.x:
            f.y[i] = f.x[i]

    @ti.kernel
    def halve():
        for i in f.x:
            f.y[i // 2] = f.x[i]

    run(f.loss, first, first)  # elements that the tape saves are no error
    with pytest.raises(ti.TaiAssertionError, match="is written by two iterations of one loop"):
        run(f.loss, halve)


def test_all_are_counted():
    x = ti.field(ti.f64, shape=500, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    @ti.kernel
    def reset():
        for i in x:
            x[i] = 1.0

    def simulate():
        for _ in range(40):
            square()
            reset()

    error = violations(loss, simulate)
    assert "broken 20000 times" in str(error)
    assert len(error.violations) == 100


def test_functions_and_indices_from_fields(fields):
    f = fields
    p = ti.field(ti.i32, shape=N)
    p.from_numpy(np.array([0, 1, 2, 3, 4, 2], np.int32))

    @ti.func
    def put(i, value):
        f.y[p[i]] = value  # put

    @ti.kernel
    def scatter():
        for i in f.x:
            put(i, f.x[i])

    (found,) = violations(f.loss, scatter).violations
    assert found.index == (2,)
    assert found.access.lineno == line_of(test_functions_and_indices_from_fields, "put")


def test_what_is_not_recorded_is_not_checked(fields):
    f = fields

    @ti.kernel
    def change():
        f.b[None] = f.b[None] + 1.0

    @ti.ad.no_grad
    def quietly():
        change()

    @ti.kernel
    def use():
        f.loss[None] += f.x[0]

    def simulate():
        quietly()
        use()

    run(f.loss, simulate, validation=True)
    assert f.b[None] == 4.0
    assert f.x.grad[0] == 1.0


def test_a_kernel_checked_and_not(fields):
    f = fields

    @ti.kernel
    def store():
        for i in f.x:
            f.y[i] = f.x[i]

    @ti.kernel
    def total():
        for i in f.x:
            f.loss[None] += f.y[i]

    for validates in (True, False, True):
        run(f.loss, store, total, validation=validates)
        assert f.x.grad.to_numpy().tolist() == [1] * N
    violations(f.loss, store, total, store)


def test_names_of_errors():
    from tai.lang.exception import (
        TaichiAssertionError,
        TaichiCompilationError,
        TaichiIndexError,
        TaichiNameError,
        TaichiRuntimeError,
        TaichiRuntimeTypeError,
        TaichiSyntaxError,
        TaichiTypeError,
    )

    assert TaichiAssertionError is ti.TaichiAssertionError
    assert TaichiCompilationError is ti.TaichiCompilationError
    for error, bases in [
        (TaichiSyntaxError, (TaichiCompilationError, SyntaxError)),
        (TaichiNameError, (TaichiCompilationError, NameError)),
        (TaichiTypeError, (TaichiCompilationError, TypeError)),
        (TaichiIndexError, (TaichiCompilationError, IndexError)),
        (TaichiRuntimeError, (RuntimeError,)),
        (TaichiRuntimeTypeError, (TaichiRuntimeError, TypeError)),
        (TaichiAssertionError, (TaichiRuntimeError, AssertionError)),
    ]:
        for base in bases:
            assert issubclass(error, base)
    assert not issubclass(TaichiAssertionError, TaichiCompilationError)


def test_a_write_that_was_lost_in_a_race_has_no_place():
    """As the core tells it: the launch of an access that nothing is known of is -1."""
    known, unknown = ("halve.0", 0, 2, __file__, 7, 5), ("", -1, 0, "", 0, 0)
    rows = [(3, "y", (1,), -1, known, unknown), (3, "y", (2,), -1, known, known)]
    tape = types.SimpleNamespace(violations=lambda: (2, rows))
    total, (lost, kept) = validation.take_violations(tape)
    assert total == 2 and lost.earlier is None
    assert kept.earlier == ("halve", 0, __file__, 7, 5)
    assert lost.message == "'y'[1] is written by two iterations of one loop"
