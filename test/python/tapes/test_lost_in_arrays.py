"""A gradient that ends in an array of the caller without one is said, once."""

import inspect
import warnings

import numpy as np
import pytest
import tai as ti

N = 5
Array = ti.types.ndarray(ti.f64, ndim=1)


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


class Program:
    """x (with gradient) -> an array -> y (with) -> loss."""

    def __init__(self):
        x = self.x = ti.field(ti.f64, shape=N, needs_grad=True, name="x")
        y = self.y = ti.field(ti.f64, shape=N, needs_grad=True, name="y")
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
        x.from_numpy(np.arange(1.0, N + 1))

        @ti.kernel
        def keep(kept: Array):
            for i in x:
                kept[i] = 2 * x[i]

        @ti.kernel
        def go_on(given: Array):
            for i in x:
                y[i] = given[i] * x[i]

        @ti.kernel
        def total():
            for i in y:
                loss[None] += y[i]

        self.keep, self.go_on, self.total = keep, go_on, total

    def run(self, kept, given=None):
        self.keep(kept)
        self.go_on(kept if given is None else given)
        self.total()


def warnings_of(run, *losses, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ti.ad.Tape(*losses, **options) as tape:
            run()
    assert all(issubclass(w.category, ti.ad.TaiGradientWarning) for w in caught)
    return [str(w.message) for w in caught], tape


def make(kind):
    if kind == "numpy":
        return np.zeros(N)
    if kind == "ndarray":
        return ti.ndarray(ti.f64, N)
    if kind == "strided":
        return np.zeros(2 * N)[::2]
    if kind == "reversed":
        return np.zeros(N)[::-1]
    torch = pytest.importorskip("torch")
    return torch.zeros(N, dtype=torch.float64)


@pytest.mark.parametrize("kind", ["numpy", "ndarray", "strided", "reversed", "torch"])
def test_it_names_kernel_line_array_and_what_to_do(kind):
    program, kept = Program(), make(kind)
    (line,), tape = warnings_of(lambda: program.run(kept), program.loss)
    source, first = inspect.getsourcelines(Program.__init__)
    number = first + next(n for n, text in enumerate(source) if "kept[i] = 2" in text)
    assert f"{__file__}:{number}" in line
    for part in ("'keep", "array 'kept'", "'x'", "needs_grad=True", "requires_grad", "stop_grad"):
        assert part in line
    # Once: not by another iteration, nor by another sweep, nor for another array.
    again, _ = warnings_of(lambda: program.run(make(kind)), program.loss)
    assert again == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tape.replay()
        tape.grad()


@pytest.mark.parametrize("checkpoint", ["periodic", "binomial"])
def test_with_checkpoints(checkpoint):
    program, kept = Program(), np.zeros(N)
    found, _ = warnings_of(lambda: program.run(kept), program.loss, checkpoint=checkpoint)
    assert len(found) == 1


def test_over_steps():
    program, kept = Program(), np.zeros(N)

    @ti.kernel
    def grow(state: Array):
        for i in program.x:
            state[i] += program.x[i]

    def run():
        for _ in range(20):
            grow(kept)
        program.go_on(kept)
        program.total()

    found, _ = warnings_of(run, program.loss)
    assert len(found) == 1 and "'state'" in found[0]


def test_parts_of_one_array():
    program, kept = Program(), np.zeros((N, 2))
    # The columns lie between each other.
    silent(lambda: program.run(kept[:, 0], kept[:, 1]), program.loss)
    found, _ = warnings_of(lambda: program.run(kept[:, 0], kept.ravel()[:-1:2]), program.loss)
    assert len(found) == 1
    # A view of the same elements.
    ti.init(default_fp=ti.f64, offline_cache=False)
    program, kept = Program(), np.zeros(N + 1)
    found, _ = warnings_of(lambda: program.run(kept[1:], kept[:-1]), program.loss)
    assert len(found) == 1


def test_the_same_kernels_on_other_arrays():
    program, kept, given = Program(), np.zeros(N), np.ones(N)
    silent(lambda: program.run(kept, given), program.loss)
    found, _ = warnings_of(lambda: program.run(kept), program.loss)
    assert len(found) == 1


def test_what_comes_from_an_array_with_a_gradient():
    source = ti.ndarray(ti.f64, N, needs_grad=True)
    tmp = ti.field(ti.f64, shape=N, name="tmp")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def keep(a: Array):
        for i in tmp:
            tmp[i] = a[i] ** 2

    @ti.kernel
    def total():
        for i in tmp:
            loss[None] += tmp[i]

    def run():
        keep(source)
        total()

    (line,), _ = warnings_of(run, loss)
    assert "the field 'tmp' what depends on 'a', which has a gradient" in line


def test_what_comes_from_a_number_with_a_gradient():
    number = ti.ad.variable(2.0)
    tmp = ti.field(ti.f64, shape=N, name="tmp")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def keep(r: ti.f64):
        for i in tmp:
            tmp[i] = r * i

    @ti.kernel
    def total():
        for i in tmp:
            loss[None] += tmp[i]

    def run():
        keep(number)
        total()

    found, _ = warnings_of(run, loss)
    (line,) = (one for one in found if "needs_grad=True" in one)
    assert "'tmp' what depends on 'r', which has a gradient" in line


def test_a_loss_that_is_an_array():
    program, kept = Program(), np.zeros(N)
    loss = ti.ndarray(ti.f64, (), needs_grad=True)

    @ti.kernel
    def total(out: ti.types.ndarray(ti.f64, ndim=0), given: Array):
        for i in program.x:
            out[None] += given[i]

    def run():
        program.keep(kept)
        total(loss, kept)

    found, _ = warnings_of(run, loss)
    assert len(found) == 1 and "array 'kept'" in found[0]


@pytest.mark.parametrize("wanted", [True, False])
def test_a_loss_that_is_returned(wanted):
    program, kept = Program(), np.zeros(N)

    @ti.kernel
    def mean(given: Array) -> ti.f64:
        total = 0.0
        for i in range(N):
            total += given[i]
        return total

    @ti.kernel
    def square() -> ti.f64:
        total = 0.0
        for i in range(N):
            total += program.x[i] ** 2
        return total

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with ti.ad.Tape() as tape:
            program.keep(kept)
            one, other = mean(kept), square()
        tape.backward(one if wanted else other)
    assert len([w for w in caught if "'kept'" in str(w.message)]) == int(wanted)


# No false alarms


def silent(run, *losses):
    found, _ = warnings_of(run, *losses)
    assert found == []


def test_arrays_with_a_gradient():
    program, kept = Program(), ti.ndarray(ti.f64, N, needs_grad=True)
    silent(lambda: program.run(kept), program.loss)
    assert program.x.grad[1] == 8


def test_what_is_meant():
    program, kept = Program(), np.zeros(N)

    @ti.kernel
    def keep(kept: Array):
        for i in program.x:
            kept[i] = ti.stop_grad(2 * program.x[i])

    def run():
        keep(kept)
        program.go_on(kept)
        program.total()

    silent(run, program.loss)


def test_whole_numbers():
    program, kept = Program(), np.zeros(N, np.int64)

    @ti.kernel
    def keep(kept: ti.types.ndarray(ti.i64, ndim=1)):
        for i in program.x:
            kept[i] = ti.cast(program.x[i], ti.i64)

    @ti.kernel
    def go_on(given: ti.types.ndarray(ti.i64, ndim=1)):
        for i in program.x:
            program.y[i] = given[i] * program.x[i]

    def run():
        keep(kept)
        go_on(kept)
        program.total()

    silent(run, program.loss)


def test_what_the_loss_does_not_depend_on():
    program, image, given = Program(), np.zeros(N), np.ones(N)

    @ti.kernel
    def show(given: Array, image: Array):
        for i in program.x:
            image[i] = given[i] + program.x[i]

    def run():
        program.keep(image)
        show(image, np.zeros(N))
        program.go_on(given)
        program.total()

    silent(run, program.loss)


def test_what_is_read_before_it_is_stored():
    program, kept = Program(), np.ones(N)

    def run():
        program.go_on(kept)
        program.total()
        program.keep(kept)

    silent(run, program.loss)


@pytest.mark.parametrize("bound", ["array", "constant"])
def test_what_a_kernel_overwrites_in_between(bound):
    program, kept = Program(), np.zeros(N)

    @ti.kernel
    def reset(kept: Array):
        if ti.static(bound == "array"):
            for i in range(kept.shape[0]):
                kept[i] = 1.0
        else:
            for i in program.x:
                kept[i] = 1.0

    def run():
        program.keep(kept)
        reset(kept)
        program.go_on(kept)
        program.total()

    silent(run, program.loss)


@pytest.mark.parametrize("length", [N, 10_000])
@pytest.mark.parametrize("step", [1, 2])
def test_what_python_overwrites_in_between(length, step):
    program, kept = Program(), np.zeros(length * step)[::step]

    @ti.kernel
    def use(given: Array):
        for i in program.y:
            program.y[i] += given[i]

    def run():
        for _ in range(3):
            program.keep(kept)
            kept[:] = 1.0
            use(kept)
        program.total()

    silent(run, program.loss)

    # If Python writes earlier, the kernel's values are read.
    def run_before():
        for _ in range(3):
            kept[:] = 1.0
            program.keep(kept)
            use(kept)
        program.total()

    found, _ = warnings_of(run_before, program.loss)
    assert len(found) == 1


def test_no_grad():
    program, kept = Program(), np.zeros(N)

    @ti.ad.no_grad
    def keep():
        program.keep(kept)

    def run():
        keep()
        program.go_on(kept)
        program.total()

    silent(run, program.loss)


@pytest.mark.parametrize("n", [0, 3])
def test_nothing_is_lost_in_an_array_without_elements(n):
    """A kernel has stored to it, but its memory cannot be told apart."""

    @ti.kernel
    def square(a: Array, b: Array):
        for i in range(a.shape[0]):
            b[i] = a[i] * a[i]

    @ti.kernel
    def weigh(a: Array, w: Array, b: Array):
        for i in range(a.shape[0]):
            b[i] = a[i] * w[i]

    given, middle = np.ones(n), np.zeros(n)
    w, y = (ti.ndarray(ti.f64, n, needs_grad=True) for _ in range(2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ti.ad.Tape() as tape:
            square(given, middle)
            weigh(middle, w, y)
        y.grad.fill(1)
        tape.grad()
    assert w.grad.to_numpy().tolist() == [1] * n
