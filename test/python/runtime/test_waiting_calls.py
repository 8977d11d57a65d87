"""Calls that wait for another thread's give Python's lock away, and return with it.

A thread holds the context while a large kernel is compiled, and other threads meanwhile query their
tapes by calls that cannot fail. A thread that goes on without the lock would end the process.
"""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
import tai as ti

PROGRAM = """
    import sys
    import threading

    import tai as ti

    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, shape=16, needs_grad=True, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def add_up():
        for i in x:
            loss[None] += x[i] ** 2

    @ti.kernel
    def large(a: ti.f64):
        for i in x:
            s = a
            for k in ti.static(range(150)):
                s += ti.sin(x[i] * k) * ti.exp(x[i] - k)
            x[i] = s

    def ask(core, what):
        if what == "release":
            ti.field(ti.f64, shape=4)[0] = 1.0
        elif what == "note_array_write":
            core.note_array_write(0, 8, 8, 8)
        elif what == "note_array_copy":
            core.note_array_copy(64, 0, 8, 8, 8)
        elif what == "kernel_of":
            core.kernel_of(0)
        else:
            answer = getattr(core, what)
            answer() if callable(answer) else answer

    with ti.ad.Tape(loss) as tape:
        add_up()
    compiling = threading.Event()

    def compile_large():
        compiling.set()
        large.compile(1.0)

    asked = 0
    thread = threading.Thread(target=compile_large)
    thread.start()
    compiling.wait()
    while thread.is_alive():
        ask(tape._core, sys.argv[1])
        # Python notices a thread without the lock where it looks whether another one wants it.
        sum(range(1000))
        asked += 1
    thread.join()
    print("asked", asked)
"""


ASKED = ["warnings", "explain", "records", "skipped", "kernel_of", "note_array_write",
         "note_array_copy", "release"]  # fmt: skip


@pytest.mark.parametrize("what", ASKED)
def test_tapes_are_asked_while_another_thread_compiles(what, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(PROGRAM))
    command = [sys.executable, program, what]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[:2000]
    assert run.stdout.startswith("asked ")


PLANNED = """
    import sys
    import threading

    import numpy as np
    import tai as ti

    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, shape=16, needs_grad=True, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    given = np.ones(16)

    @ti.kernel
    def first(a: ti.types.ndarray(ti.f64, ndim=1)):
        for i in x:
            loss[None] += a[i] * x[i]

    @ti.kernel
    def large(a: ti.types.ndarray(ti.f64, ndim=1)):
        for i in x:
            s = a[i] * x[i]
            for k in ti.static(range(150)):
                s += ti.sin(x[i] * k) * ti.exp(x[i] - k)
            loss[None] += s

    over = threading.Event()

    def count():
        # Another thread wants the lock all the time.
        while not over.is_set():
            sum(range(1000))

    if sys.argv[1] == "compiled":
        large.compile(given)
    thread = threading.Thread(target=count)
    thread.start()
    with ti.ad.Tape(loss):
        first(given)
        large(given)
        large(given)
    over.set()
    thread.join()
    print("loss", loss[None], x.grad[3])
"""


@pytest.mark.parametrize("when", ["compiled", "recorded"])
def test_a_tape_asks_what_a_large_adjoint_reads(when, tmp_path):
    """To record arrays, a tape waits for the plan of the adjoint."""
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(PLANNED))
    command = [sys.executable, program, when]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[:2000]
    # Sums of exp(-k), which sin(0 * k) multiplies: x is zero.
    assert run.stdout.split()[0] == "loss" and float(run.stdout.split()[1]) == 0
    expected = 3 + 2 * sum(k * np.exp(-float(k)) for k in range(150))
    assert float(run.stdout.split()[2]) == pytest.approx(expected, rel=1e-12)


INTERRUPTED = """
    import os
    import signal
    import threading

    import tai as ti

    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, shape=16)
    fields = [ti.field(ti.f64, shape=4) for _ in range(3)]
    for field in fields:
        field.fill(1.0)

    @ti.kernel
    def large(a: ti.f64):
        for i in x:
            s = a
            for k in ti.static(range(150)):
                s += ti.sin(x[i] * k) * ti.exp(x[i] - k)
            x[i] = s

    compiling, ending = threading.Event(), threading.Event()

    def compile_large():
        compiling.set()
        large.compile(1.0)

    def interrupt():
        ending.wait()
        os.kill(os.getpid(), signal.SIGINT)

    threads = [threading.Thread(target=compile_large), threading.Thread(target=interrupt)]
    for thread in threads:
        thread.start()
    compiling.wait()
    said = "nothing"
    try:
        ending.set()
        while fields:
            fields.pop()
        sum(range(1000))
        while True:
            pass
    except KeyboardInterrupt:
        said = "interrupted"
    for thread in threads:
        thread.join()
    fields.clear()
    x[3] = 2.0
    print(said, x[3])
"""


def test_ctrl_c_while_a_field_goes(tmp_path):
    """A destructor cannot raise: the interpreter does it afterwards."""
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(INTERRUPTED))
    command = [sys.executable, program]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[:2000]
    assert run.stdout == "interrupted 2.0\n" and run.stderr == ""


WAITING = """
    import sys
    import threading

    import numpy as np
    import tai as ti

    ti.init(arch=ti.cpu, offline_cache=False, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=16, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    Array = ti.types.ndarray(dtype=ti.f64, ndim=1)

    @ti.kernel
    def large(a: Array, b: Array):
        for i in a:
            s = 0.0
            for k in ti.static(range(800)):
                s += ti.sin(a[i] * x[i] * k) * ti.exp(a[i] - x[i] * k)
            loss[None] += s
            b[i] = s

    arrays = np.ones(16), np.ones(16)
    asked = 0
    core = large._specialize(large._get_signature().bind(arrays, {})).core
    begins, done = threading.Event(), threading.Event()
    ask = {
        "plan": lambda: core.reads_in_reverse(0),
        "flows": lambda: core.ends_gradients(0),
        "launch": lambda: large(*arrays),
    }[sys.argv[1]]

    def go_on():
        global asked
        begins.wait()
        sys.setswitchinterval(0.005)
        while not done.is_set():
            ask()
            asked += 1

    thread = threading.Thread(target=go_on)
    thread.start()
    # The other thread goes on when this one gives up the lock: within the call.
    sys.setswitchinterval(100)
    begins.set()
    large(*arrays) if sys.argv[1] == "launch" else core.reads_in_reverse(0)
    done.set()
    thread.join()
    print("asked", asked)
"""


@pytest.mark.parametrize("what", ["plan", "flows", "launch"])
def test_threads_that_want_one_kernel_while_it_is_made(what, tmp_path):
    """The main thread takes the lock back now and then; whoever waits for the kernel lets it."""
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(WAITING))
    command = [sys.executable, program, what]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[:2000]
    assert run.stdout.startswith("asked ")


def test_gradients_that_are_given_up_hide_no_error():
    """Adjoints are compiled side by side; if one is refused, its error is reported."""
    ti.init(offline_cache=False)
    n = 64
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    s = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def refused():
        for _ in range(1):
            ti.atomic_max(s[None], x[0])
            loss[None] += s[None]
            s[None] = s[None] * 0.8 + x[1]

    @ti.kernel
    def long():
        for i in x:
            b = x[i]
            for _ in ti.static(range(300)):
                b = ti.sin(b) * 1.0001 + 0.1
            loss[None] += b

    @ti.kernel
    def quick():
        loss[None] += x[3]

    for _ in range(3):
        # The sweep asks for them from the last to the first.
        with pytest.raises(ti.TaiCompilationError, match="at the same time"):
            with ti.ad.Tape(loss):
                refused()
                long()
                quick()
