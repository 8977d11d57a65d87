"""Kernels that run in one thread while another one destroys trees or begins tapes."""

import os
import signal
import threading

import pytest
import tai as ti


class Runner:
    """A kernel that runs until it is let go, in a thread of its own, and changes `x` meanwhile."""

    def __init__(self, x=None):
        builder = ti.FieldsBuilder()
        flags, which = ti.field(ti.i64, name="flags"), ti.field(ti.i32)
        builder.dense(ti.i, 2).place(flags)
        builder.place(which)
        if x is None:
            x = ti.field(ti.f64, name="x")
            builder.dense(ti.i, 4).place(x)
        self.tree, self.x, self.flags = builder.finalize(), x, flags

        @ti.kernel
        def run():
            for _ in range(1):
                # The compiler cannot know which of the two is read.
                while flags[which[None]] == 0:
                    flags[1] += 1
                    x[0] += 1.0

        self.run, self.errors = run, []
        flags[0] = 1
        run()
        flags[0] = 0

    def work(self):
        try:
            self.run()
        except BaseException as error:  # noqa: BLE001
            self.errors.append(error)

    def __enter__(self):
        before = self.flags[1]
        self.thread = threading.Thread(target=self.work)
        self.thread.start()
        while self.flags[1] == before:
            pass
        return self

    def __exit__(self, *args):
        self.flags[0] = 1
        self.thread.join()
        self.flags[0] = 0


@pytest.fixture(params=[1, 2])
def runner(request):
    ti.init(cpu_max_num_threads=request.param)
    return Runner()


def test_a_tree_in_use_is_not_destroyed(runner):
    for _ in range(2):
        with runner:
            with pytest.raises(ti.TaiRuntimeError, match="another thread runs kernel 'run"):
                runner.tree.destroy()
            runner.x[1] = 5.0
        assert not runner.errors
    assert (runner.x[0] > 0.0, runner.x[1]) == (True, 5.0)
    runner.tree.destroy()
    with pytest.raises(ti.TaiRuntimeError):
        runner.x[1] = 5.0


def test_other_trees_are_destroyed(runner):
    builder = ti.FieldsBuilder()
    y = ti.field(ti.f64)
    builder.dense(ti.i, 100).place(y)
    tree = builder.finalize()

    @ti.kernel
    def fill():
        for i in y:
            y[i] = 1.0

    fill()
    with runner:
        tree.destroy()
        z = ti.field(ti.f64, shape=100)
        z.fill(3.0)
    assert not runner.errors
    assert z.to_numpy().sum() == 300.0


def test_a_signal_handler_destroys_what_runs(runner):
    errors = []

    def handle(*_):
        try:
            runner.tree.destroy()
        except ti.TaiRuntimeError as error:
            errors.append(str(error))
        runner.flags[0] = 1

    before = signal.signal(signal.SIGUSR1, handle)
    unchanged = runner.flags[1]

    def send():
        while runner.flags[1] == unchanged:
            pass
        os.kill(os.getpid(), signal.SIGUSR1)

    sender = threading.Thread(target=send)
    try:
        sender.start()
        runner.run()
    finally:
        sender.join()
        signal.signal(signal.SIGUSR1, before)
    assert len(errors) == 1
    assert "this thread runs kernel 'run" in errors[0]


def make_reader(x):
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def read():
        loss[None] += 2.0 * x[0]

    return loss, read


def test_a_tape_uses_what_a_running_kernel_changes():
    ti.init()
    x = ti.field(ti.f64, name="x", shape=4, needs_grad=True)
    runner = Runner(x)
    loss, read = make_reader(x)
    with runner:
        with pytest.raises(
            ti.TaiRuntimeError, match="another thread runs kernel 'run.*adds to.*x'"
        ):
            with ti.ad.Tape(loss):
                read()
        other = ti.field(ti.f64, shape=(), needs_grad=True)
        other_loss, read_other = make_other(other)
        with ti.ad.Tape(other_loss):
            read_other()
        assert other.grad[None] == 3.0
    assert not runner.errors
    with ti.ad.Tape(loss):
        read()
    assert x.grad[0] == 2.0


def make_other(other):
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def read_other():
        loss[None] += 3.0 * other[None]

    return loss, read_other
