"""Ctrl-C at every step of the package: the program behaves correctly afterwards."""

import _weakrefset
import dis
import functools
import inspect
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from tai._impl.base import locks, state

HERE = Path(ti.__file__).parent / "_impl"


def calls_handlers(frame):
    """Whether the interpreter looks for signals at the end of the step that comes."""
    name = dis.opname[frame.f_code.co_code[frame.f_lasti]]
    return name.startswith("CALL") or "JUMP_BACKWARD" in name


@functools.cache
def entries(code):
    return dis.Bytecode(code).exception_entries


def catcher(code, offset):
    """Where an exception at an instruction is caught."""
    found = [entry for entry in entries(code) if entry.start <= offset < entry.end]
    return found[-1].target if found else None


# An interruption that Python has lost, so that the work was done.
LOST = KeyboardInterrupt()


class Steps:
    """Goes through the steps of some files at which Python may call a signal handler."""

    def __init__(self, files):
        self.files = {str((HERE / file).resolve()) for file in files}
        # Each once: where it is in the code, and where that was called.
        self.seen = set()
        self.wanted = None
        # Whether the interrupted step was one of a generator.
        self.is_in_generator = False

    def run(self, work, wanted):
        """Interrupts the step with that number, if there are so many; says whether it did."""
        self.seen.clear()
        self.wanted = wanted
        outer = sys.gettrace()
        sys.settrace(self._begin)
        try:
            work()
        except KeyboardInterrupt as error:
            # As in a notebook, which keeps the last one, and with it the variables of all frames.
            return error
        finally:
            sys.settrace(outer)
        # Python itself loses some exceptions, such as those raised in a `__del__`. It reports that
        # of a generator that it closes, and goes on.
        if wanted < len(self.seen) and self.is_in_generator:
            return LOST
        assert wanted >= len(self.seen)
        return None

    def _begin(self, frame, event, _):
        if frame.f_code.co_filename not in self.files:
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        # The instruction before, if handlers are called after it: at the start of a function, too.
        last = frame.f_lasti

        def follow(frame, event, _):
            nonlocal last
            if event != "opcode":
                return follow
            code, here = frame.f_code, frame.f_lasti
            # An exception raised here must be caught at the place where that of a handler is.
            looked = last is not None and catcher(code, last) == catcher(code, here)
            last = here if calls_handlers(frame) else None
            step = (code, here, frame.f_back.f_code, frame.f_back.f_lasti)
            if looked and step not in self.seen:
                self.seen.add(step)
                if len(self.seen) - 1 == self.wanted:
                    self.is_in_generator = bool(code.co_flags & inspect.CO_GENERATOR)
                    raise KeyboardInterrupt
            return follow

        return follow


class Program:
    """Fields and kernels, and their results."""

    def __init__(self):
        self.x = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=True)
        self.loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
        x, loss = self.x, self.loss

        @ti.kernel
        def total():
            for i in x:
                loss[None] += x[i] ** 2

        self.total = total

    def tape(self, **options):
        self.x.fill(2.0)
        with ti.ad.Tape(self.loss, **options):
            self.total()
        return self.x.grad.to_numpy()

    def forward(self):
        self.x.fill(2.0)
        self.loss[None] = 0.0
        with ti.ad.FwdMode(loss=self.loss, param=self.x, seed=[1.0, 0.0, 0.0]):
            self.total()
        return self.loss.dual[None]

    def check(self):
        assert self.tape().tolist() == [4.0, 4.0, 4.0]
        assert self.loss[None] == 12.0
        assert self.forward() == 4.0


def check_state(program):
    """Nothing is left over, neither on this thread nor for another one."""
    assert state.tape is state.emitter is state.fp is state.rounding is None
    assert not state.forward
    assert not [lock for lock in locks.snapshot(locks._all) if lock._is_owned()]
    program.check()
    failures = []

    def work():
        try:
            program.check()
        except BaseException as error:  # noqa: BLE001
            failures.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(60)
    assert not thread.is_alive() and not failures


def interrupt_everywhere(files, make, program, after=lambda: None):
    """Interrupts work at each of its steps in the files, and does it again.

    Args:
        make: gives new work, and a check of its result.
        after: looks at the state after an interruption.
    """
    steps, number, limit = Steps(files), 0, sys.getrecursionlimit()
    # Since Python 3.12, the steps of a function are seen from the second run on that is traced,
    # and since 3.13 only if all runs between them were.
    steps.run(make()[0], sys.maxsize)
    while True:
        if sys.version_info >= (3, 13):
            steps.run(make()[0], sys.maxsize)
        work, check = make()
        error = steps.run(work, number)
        if error is None:
            break
        after()
        assert sys.getrecursionlimit() == limit
        check_state(program)
        if error is not LOST:
            work()
        check()
        number += 1
    assert number > 10
    check()


@pytest.fixture
def program():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    made = Program()
    made.check()
    return made


@pytest.mark.parametrize(
    "options",
    [{}, {"checkpoint": 2}, {"validation": True}, {"health": True}],
    ids=str,
)
def test_a_tape(options, program):
    def make():
        def work():
            program.tape(**options)

        return work, program.check

    files = ["ad/tape.py", "tracking/tracked.py", "tracking/tape_arrays.py", "ad/snapshot.py"]
    interrupt_everywhere(files, make, program)


def test_forward_mode(program):
    def make():
        return program.forward, program.check

    interrupt_everywhere(["ad/mode.py", "ad/forward.py", "history/origins.py"], make, program)


def test_a_mode_that_the_program_keeps(program):
    """Its object lives on, so that nothing ends the mode but its `with` block."""
    kept = []

    def make():
        def work():
            kept.append(ti.ad.FwdMode(loss=program.loss, param=program.x, seed=[1.0, 0.0, 0.0]))
            with kept[-1]:
                program.total()

        return work, program.check

    interrupt_everywhere(["ad/mode.py", "ad/forward.py"], make, program)


def test_a_function_with_a_gradient_of_its_own(program):
    @ti.ad.grad_replaced
    def outer():
        program.total()

    @ti.ad.grad_for(outer)
    def outer_gradient():
        program.total.grad()

    def make():
        def work():
            program.x.fill(2.0)
            with ti.ad.Tape(program.loss):
                outer()
            assert program.x.grad.to_numpy().tolist() == [4.0, 4.0, 4.0]

        return work, program.check

    interrupt_everywhere(["ad/tape.py"], make, program)


def test_a_compilation(program):
    def make():
        x, answers = program.x, []

        @ti.kernel(precision="f64")
        def first() -> ti.f64:
            return x[0]

        def work():
            x.fill(2.0)
            answers.append(first())

        def check():
            assert answers == [2.0]

        return work, check

    interrupt_everywhere(["base/state.py", "frontend/compiler.py"], make, program)


def test_fields_that_are_allocated(program):
    """Fields that were placed before still exist afterwards."""

    def make():
        x = ti.field(ti.f64, shape=3, needs_grad=True)
        y = ti.Vector.field(2, ti.f32, needs_grad=True)
        z = ti.Vector.field(2, ti.f32, needs_grad=True)
        ti.root.pointer(ti.i, 4).place(y)
        ti.root.dense(ti.i, 4).place(*z.components)

        def work():
            x.fill(2.0)
            y[1] = [3.0, 4.0]
            z[1] = [3.0, 4.0]

        def check():
            assert x.to_numpy().tolist() == [2.0, 2.0, 2.0]
            assert x.grad.to_numpy().tolist() == [0.0, 0.0, 0.0]
            for field in (y, z):
                assert field.to_numpy().tolist() == [[0, 0], [3, 4], [0, 0], [0, 0]]
                assert not field.grad.to_numpy().any()

        return work, check

    files = ["fields/matrix_field.py", "fields/root.py", "fields/scalar.py", "fields/snode.py"]
    interrupt_everywhere(files, make, program)


def test_a_tree_that_is_freed(program):
    """It is gone, or can be freed by another call."""

    def make():
        x = ti.field(ti.f64)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, 3).place(x)
        tree = builder.finalize()

        @ti.kernel
        def fill():
            for i in x:
                x[i] = 1.0

        fill()

        def work():
            if not tree._root.is_destroyed:
                tree.destroy()

        def check():
            with pytest.raises(ti.TaiRuntimeError, match="freed already"):
                tree.destroy()
            with pytest.raises(ti.TaiRuntimeError, match="destroyed"):
                x.to_numpy()

        return work, check

    interrupt_everywhere(["fields/snode.py", "launch/specialization.py"], make, program)


def test_a_kernel_of_a_program_that_is_over(program):
    """Whatever interrupted its first launch, the next program does not find its code."""

    def make():
        array = np.zeros(1)

        @ti.kernel
        def third(a: ti.types.ndarray(dtype=ti.f64, ndim=1)):
            s = 1.0
            for _ in range(1):
                s /= 3.0
            a[0] = s

        def work():
            third(array)

        def check():
            third(array)
            assert array[0] == 1.0 / 3.0
            ti.init(arch=ti.cpu, default_fp=ti.f32)
            third(array)
            assert array[0] == np.float32(1.0) / np.float32(3.0)
            ti.init(arch=ti.cpu, default_fp=ti.f64)
            program.__init__()

        return work, check

    files = ["launch/kernels.py", "launch/launch.py", _weakrefset.__file__]
    interrupt_everywhere(files, make, program)


LOADING = """
import os, signal, threading
import tai as ti

def interrupted():
    raise KeyboardInterrupt

main_thread, threading.main_thread = threading.main_thread, interrupted
try:
    from tai import _core
except KeyboardInterrupt:
    pass
threading.main_thread = main_thread
ti.init(arch=ti.cpu)
x = ti.field(ti.f64, shape=())

@ti.kernel
def endless():
    while x[None] < 1.0:
        x[None] += 0.0

timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
try:
    timer.start()
    endless()
except KeyboardInterrupt:
    print("ended")
timer.join()
"""


def test_the_extension_module_is_loaded(tmp_path):
    """Interrupted where it asks which thread is Python's own, it would never look for signals."""
    file = tmp_path / "loading.py"
    file.write_text(LOADING)
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=280)
    assert done.stdout == "ended\n", done.stderr


def test_checks_of_gradients(program):
    """They put back what fields held, and leave those alone that they do not use."""
    held = np.array([1.0, 2.0, 3.0])
    other = ti.field(ti.f64, shape=5)
    other.fill(1.0)

    def make():
        program.x.from_numpy(held)

        def work():
            program.x.from_numpy(held)
            program.loss[None] = 0.0
            assert ti.ad.check(program.total, loss=program.loss)
            after()

        return work, program.check

    def after():
        assert program.x.to_numpy().tolist() == held.tolist()
        assert other.to_numpy().tolist() == [1.0] * 5

    interrupt_everywhere(["ad/check.py", "ad/snapshot.py"], make, program, after)
