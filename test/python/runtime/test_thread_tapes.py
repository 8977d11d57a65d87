"""Tapes, forward mode, checks and compilation in several threads at once."""

import ast
import sys
import threading

import numpy as np
import pytest
import tai as ti
from tai._impl.base import parsing, texts


@pytest.fixture(autouse=True)
def program():
    ti.init(cpu_max_num_threads=1)
    yield
    ti.reset()


def in_threads(*tasks, barrier=None):
    """Runs functions, each in a thread of its own, and raises an exception that one of them has
    raised.

    One that fails does not come to the barrier any more: the others wait no longer.
    """
    failures = []

    def run(task):
        try:
            task()
        except threading.BrokenBarrierError:
            pass
        except BaseException as error:  # noqa: BLE001
            failures.append(error)
            if barrier:
                barrier.abort()

    threads = [threading.Thread(target=run, args=(task,)) for task in tasks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]


class Problem:
    """A small simulation with fields and kernels of its own, and its results."""

    steps, n = 6, 40

    def __init__(self, number):
        x = self.x = ti.field(ti.f64, shape=(self.steps + 1, self.n), needs_grad=True)
        v = self.v = ti.field(ti.f64, shape=self.n, needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        self.start = 1.0 + 0.1 * number + np.arange(self.n) / self.n
        k = 0.1 + 0.01 * number

        @ti.kernel
        def step(t: ti.i32):
            for i in range(Problem.n):
                v[i] += -k * ti.sin(x[t, i])
                x[t + 1, i] = x[t, i] + v[i] * v[i] * 0.1

        @ti.kernel
        def measure(t: ti.i32):
            for i in range(Problem.n):
                loss[None] += x[t, i] * x[t, i] + v[i]

        self.step, self.measure = step, measure

    def set_state(self):
        self.x.from_numpy(np.tile(self.start, (self.steps + 1, 1)))
        self.v.from_numpy(0.5 * self.start)

    def run(self):
        for t in range(self.steps):
            self.step(t)
        self.measure(self.steps)

    def gradient(self, pause=lambda: None, **options):
        self.set_state()
        pause()
        with ti.ad.Tape(self.loss, **options) as tape:
            for t in range(self.steps):
                self.step(t)
                pause()
            self.measure(self.steps)
        pause()
        return tape, self.result()

    def result(self):
        return (self.loss[None], self.x.grad.to_numpy().tobytes(), self.v.grad.to_numpy().tobytes())


@pytest.mark.parametrize("options", [{}, {"checkpoint": "periodic"}, {"checkpoint": 2}])
def test_gradients_of_many_threads(options):
    count = 8
    problems = [Problem(number) for number in range(count)]
    expected = [problem.gradient(**options)[1] for problem in problems]
    assert len(set(expected)) == count
    # All record at the same time: nobody goes on before all have come here.
    barrier = threading.Barrier(count)

    def work(number):
        for _ in range(4):
            _, result = problems[number].gradient(barrier.wait, **options)
            barrier.wait()
            # Work of other threads meanwhile has changed nothing.
            assert result == expected[number]
            assert problems[number].result() == expected[number]

    in_threads(*(lambda n=n: work(n) for n in range(count)), barrier=barrier)


def test_a_thread_that_fails_holds_up_no_other():
    barrier = threading.Barrier(3)

    def fail():
        barrier.wait()
        raise ValueError("the second round is without this one")

    def wait():
        barrier.wait()
        barrier.wait()

    with pytest.raises(ValueError, match="second round"):
        in_threads(fail, wait, wait, barrier=barrier)


def test_replays_of_many_threads():
    count = 6
    problems = [Problem(number) for number in range(count)]
    recorded = [problem.gradient() for problem in problems]
    barrier = threading.Barrier(count)

    def work(number):
        tape, expected = recorded[number]
        for _ in range(5):
            problems[number].set_state()
            barrier.wait()
            tape.replay()
            barrier.wait()
            assert problems[number].result() == expected

    in_threads(*(lambda n=n: work(n) for n in range(count)), barrier=barrier)


def test_one_thread_compiles_while_others_sweep():
    problems = [Problem(number) for number in range(2)]
    expected = [problem.gradient()[1] for problem in problems]

    def sweep(number):
        for _ in range(30):
            assert problems[number].gradient()[1] == expected[number]

    def compile_more():
        for number in range(5):
            made = Problem(10 + number)
            first = made.gradient()[1]
            assert made.gradient()[1] == first

    in_threads(lambda: sweep(0), lambda: sweep(1), compile_more)


def test_forward_mode_in_threads():
    count = 4
    problems = []
    for number in range(count):
        a = ti.field(ti.f64, shape=(), needs_dual=True)
        out = ti.field(ti.f64, shape=(), needs_dual=True)
        a[None] = number + 1.0

        @ti.kernel
        def square(a: ti.template(), out: ti.template()):
            out[None] = a[None] * a[None]

        problems.append((a, out, square))

    def work(number):
        a, out, square = problems[number]
        for _ in range(10):
            with ti.ad.FwdMode(loss=out, param=a):
                square(a, out)
            assert out.dual[None] == 2 * (number + 1.0)

    in_threads(*(lambda n=n: work(n) for n in range(count)))


def test_forward_mode_is_of_its_thread():
    a = ti.field(ti.f64, shape=(), needs_dual=True)
    out = ti.field(ti.f64, shape=(), needs_dual=True)

    @ti.kernel
    def square():
        out[None] = a[None] * a[None]

    a[None] = 3.0
    with ti.ad.FwdMode(loss=out, param=a):
        square()
        out.dual[None] = 7.0
        in_threads(square)
        # A launch with tangents would have computed it again.
        assert out.dual[None] == 7.0


def test_check_in_threads():
    problems = [Problem(number) for number in range(3)]
    other = ti.field(ti.f64, shape=())

    @ti.kernel
    def count():
        other[None] += 1.0

    for problem in problems:
        problem.set_state()

    def check(problem):
        result = ti.ad.check(problem.run, loss=problem.loss, wrt=[problem.x])
        assert result, str(result)

    def go_on():
        for number in range(200):
            count()
            assert other[None] == number + 1.0

    in_threads(*(lambda p=p: check(p) for p in problems), go_on)
    assert other[None] == 200.0


def test_syntax_trees_that_another_thread_spoils(monkeypatch):
    """CPython's own count, which threads share; the same without threads."""
    parse, calls = ast.parse, []

    def spoiled(*args, **kwargs):
        calls.append(args)
        if len(calls) < 4:
            raise SystemError("AST constructor recursion depth mismatch (before=57, after=54)")
        return parse(*args, **kwargs)

    monkeypatch.setattr(ast, "parse", spoiled)
    monkeypatch.setattr(texts, "_texts", {})
    x = ti.field(ti.i32, shape=())

    @ti.kernel
    def count():
        x[None] += 1

    count()
    assert x[None] == 1 and len(calls) == 4
    monkeypatch.setattr(ast, "parse", lambda *_: spoiled(calls.clear()))
    with pytest.raises(SystemError):
        parsing.parse("1")


# Fields that threads share


def make_shared(needs_grad):
    w = ti.field(ti.f64, name="w", shape=4, needs_grad=needs_grad)
    w.fill(2.0)
    problems = []
    for _ in range(2):
        x = ti.field(ti.f64, shape=4, needs_grad=True)
        loss = ti.field(ti.f64, name="loss", shape=(), needs_grad=True)
        x.fill(3.0)

        @ti.kernel
        def use(x: ti.template(), loss: ti.template()):
            for i in x:
                loss[None] += w[i] * x[i]

        problems.append((x, loss, use))
    return w, problems


def test_tapes_that_read_one_field():
    _, problems = make_shared(needs_grad=False)
    (x, loss, use), (y, other_loss, other_use) = problems

    def work():
        with ti.ad.Tape(other_loss):
            other_use(y, other_loss)
        assert y.grad[1] == 2.0

    with ti.ad.Tape(loss):
        use(x, loss)
        in_threads(work)
    assert x.grad[1] == 2.0
    assert y.grad[1] == 2.0


def test_tapes_that_want_one_gradient():
    w, problems = make_shared(needs_grad=True)
    (x, loss, use), (y, other_loss, other_use) = problems

    def work():
        with pytest.raises(ti.TaiRuntimeError, match="gradient of field 'w'"):
            with ti.ad.Tape(other_loss):
                other_use(y, other_loss)

    with ti.ad.Tape(loss):
        use(x, loss)
        in_threads(work)
    assert w.grad[1] == 3.0

    def after():
        with ti.ad.Tape(other_loss):
            other_use(y, other_loss)

    y.fill(5.0)
    in_threads(after)
    # The last sweep's, not the sum.
    assert w.grad[1] == 5.0
    assert x.grad[1] == 2.0


def test_tapes_that_add_to_one_gradient():
    w, problems = make_shared(needs_grad=True)
    (x, loss, use), (y, other_loss, other_use) = problems
    y.fill(5.0)

    def work():
        with ti.ad.Tape(other_loss, clear_gradients=False):
            other_use(y, other_loss)

    with ti.ad.Tape(loss, clear_gradients=False):
        use(x, loss)
        in_threads(work)
    assert w.grad[1] == 8.0


def test_a_thread_that_changes_what_a_tape_uses():
    w, problems = make_shared(needs_grad=False)
    x, loss, use = problems[0]

    @ti.kernel
    def change():
        for i in w:
            w[i] = 9.0

    def by_kernel():
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape.*'w'"):
            change()

    def by_hand():
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape.*'w'"):
            w[1] = 9.0
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape.*'w'"):
            w.fill(9.0)

    change()
    w.fill(2.0)
    with ti.ad.Tape(loss):
        use(x, loss)
        in_threads(by_kernel, by_hand)
    assert x.grad[1] == 2.0
    # Without a tape, other threads may write to `w` again.
    in_threads(change)
    assert w[1] == 9.0


def test_one_loss_for_two_tapes():
    _, problems = make_shared(needs_grad=False)
    x, loss, use = problems[0]

    def work():
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape.*'loss'"):
            ti.ad.Tape(loss).__enter__()

    with ti.ad.Tape(loss):
        use(x, loss)
        in_threads(work)
    assert loss[None] == 24.0
    assert x.grad[1] == 2.0


def test_threads_one_after_the_other():
    """Whichever thread computed a gradient before, a tape begins with zero."""
    _, problems = make_shared(needs_grad=True)
    x, loss, use = problems[0]

    def work():
        with ti.ad.Tape(loss):
            use(x, loss)

    for _ in range(3):
        in_threads(work)
        assert x.grad[1] == 2.0
    work()
    assert x.grad[1] == 2.0
    ti.ad.clear_all_gradients()
    assert x.grad[1] == 0.0


def test_a_tape_that_is_swept_by_another_thread():
    _, problems = make_shared(needs_grad=True)
    x, loss, use = problems[0]
    with ti.ad.Tape(loss) as tape:
        use(x, loss)
    in_threads(tape.replay)
    assert x.grad[1] == 2.0
    in_threads(tape.grad)
    assert x.grad[1] == 2.0
    tape.grad()
    assert x.grad[1] == 2.0


def test_a_tape_that_fails_holds_nothing():
    w, problems = make_shared(needs_grad=False)
    x, loss, use = problems[0]
    with pytest.raises(ZeroDivisionError):
        with ti.ad.Tape(loss):
            use(x, loss)
            _ = 1 / 0
    in_threads(lambda: w.fill(4.0))
    assert w[1] == 4.0


def test_a_thread_that_ends_with_its_tape_open():
    _, problems = make_shared(needs_grad=False)
    x, loss, use = problems[0]

    def work():
        tape = ti.ad.Tape(loss)
        tape.__enter__()
        use(x, loss)

    in_threads(work)
    with ti.ad.Tape(problems[1][1]):
        problems[1][2](problems[1][0], problems[1][1])
    assert problems[1][0].grad[1] == 2.0


def test_tapes_on_one_sparse_tree():
    blocks = ti.root.pointer(ti.i, 8)
    x, y = ti.field(ti.f64), ti.field(ti.f64)
    blocks.dense(ti.i, 2).place(x, y)
    ti.root.lazy_grad()
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    other_loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def use(x: ti.template(), loss: ti.template()):
        for i in x:
            loss[None] += x[i] * x[i]

    x[3] = 3.0
    use(x, loss)
    use(y, other_loss)

    def work():
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape"):
            with ti.ad.Tape(other_loss):
                use(y, other_loss)
        with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape"):
            y[9] = 1.0

    with ti.ad.Tape(loss):
        use(x, loss)
        in_threads(work)
    assert x.grad[3] == 6.0


# What Python holds


def test_variables_and_arrays_of_threads():
    loss = [ti.field(ti.f64, shape=(), needs_grad=True) for _ in range(4)]

    @ti.kernel
    def use(a: ti.f64, b: ti.types.ndarray(), loss: ti.template()):
        for i in b:
            loss[None] += a * b[i] * b[i]

    arrays = [ti.ndarray(ti.f64, 4, needs_grad=True) for _ in loss]
    variables = [ti.ad.variable(1.0 + number) for number in range(4)]
    barrier = threading.Barrier(4)

    def work(number):
        array = arrays[number]
        array.fill(2.0)
        for _ in range(5):
            with ti.ad.Tape(loss[number]):
                use(variables[number], array, loss[number])
                barrier.wait()
            barrier.wait()
            assert variables[number].grad == 16.0
            assert array.grad[1] == 4.0 * (1 + number)

    in_threads(*(lambda n=n: work(n) for n in range(4)), barrier=barrier)
    # Their own by now: the next thread's tape takes them over.
    with ti.ad.Tape(loss[0]):
        use(variables[1], arrays[1], loss[0])
    assert variables[1].grad == 16.0
    assert arrays[1].grad[1] == 8.0


def test_one_variable_for_two_tapes():
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    other = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def use(a: ti.f64, loss: ti.template()):
        loss[None] += a * a

    a = ti.ad.variable(3.0)

    def work():
        with pytest.raises(ti.TaiRuntimeError, match="same variable"):
            with ti.ad.Tape(other):
                use(a, other)

    with ti.ad.Tape(loss):
        use(a, loss)
        in_threads(work)
    assert a.grad == 6.0


def test_the_depth_of_recursion_is_put_back():
    """Threads that compile at the same time share one limit."""
    before = sys.getrecursionlimit()

    def work():
        for _ in range(4):
            x = ti.field(ti.f64, shape=3)

            @ti.kernel
            def small(x: ti.template()):
                for i in x:
                    x[i] = i

            small(x)

    in_threads(*[work] * 6)
    assert sys.getrecursionlimit() == before
