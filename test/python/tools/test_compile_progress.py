"""The line that names the kernel in the compiler: on terminals only, and gone at the end."""

import io
import os
import pty
import subprocess
import sys
import threading

import pytest
import tai as ti
from tai._impl.base import compiling, state

# The clock stands still, and a kernel stays in the compiler until a line with its name was written:
# then a small kernel does, however busy the machine is.
PROGRAM = """import threading
import time
import types
import tai as ti
from tai._impl.base import compiling

compiling.PATIENCE = -1.0
compiling.time = types.SimpleNamespace(monotonic=lambda: 7.0, sleep=time.sleep)
write, end = compiling.Watcher._write, compiling.Watcher.end
written, changed = [], threading.Condition()

def note(text):
    write(text)
    with changed:
        written.append(text)
        changed.notify_all()

def end_when_shown(watcher, compilation):
    line = f"compiling kernel '{{compilation.name}}'"
    with changed:
        assert changed.wait_for(lambda: any(line in text for text in written), 60)
    end(watcher, compilation)

compiling.Watcher._write, compiling.Watcher.end = staticmethod(note), end_when_shown

ti.init(offline_cache=False, {options})
x = ti.field(ti.f32, 64, needs_grad=True)
loss = ti.field(ti.f32, (), needs_grad=True)

@ti.kernel
def waves():
    for i in x:
        loss[None] += ti.sin(x[i])

with ti.ad.Tape(loss):
    waves()
print("done")
"""


def on_terminal(tmp_path, options=""):
    """The output of a program to a terminal as its standard error."""
    file = tmp_path / "program.py"
    file.write_text(PROGRAM.format(options=options))
    reader, writer = pty.openpty()
    process = subprocess.Popen([sys.executable, file], stderr=writer, stdout=subprocess.PIPE)
    os.close(writer)
    text = b""
    while True:
        try:
            part = os.read(reader, 4096)
        except OSError:  # nobody writes any more
            break
        if not part:
            break
        text += part
    os.close(reader)
    assert process.communicate()[0] == b"done\n" and process.returncode == 0, text
    return text.decode()


def test_on_a_terminal(tmp_path):
    text = on_terminal(tmp_path)
    assert "compiling kernel 'waves', 0 s" in text
    assert "compiling kernel 'waves.grad', 1 done, 0 s" in text
    # Nothing stays.
    assert text.endswith("\r\x1b[K") and "\n" not in text


def test_it_can_be_turned_off(tmp_path):
    assert on_terminal(tmp_path, "compile_progress=False") == ""


def test_not_where_no_terminal_is(tmp_path):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM.format(options=""))
    done = subprocess.run([sys.executable, file], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("done\n", "")


class Stream(io.StringIO):
    """Says when something was written."""

    def __init__(self):
        super().__init__()
        self.wrote = threading.Event()

    def isatty(self):
        return True

    def write(self, text):
        super().write(text)
        self.wrote.set()


@pytest.fixture
def watcher(monkeypatch):
    monkeypatch.setattr(compiling, "PATIENCE", 0.0)
    return compiling.Watcher()


def test_above_a_progress_bar(watcher, monkeypatch):
    stream = Stream()
    monkeypatch.setattr(sys, "stderr", stream)
    for name in ("a", "b"):
        stream.wrote.clear()
        with watcher.compiling(name):
            assert stream.wrote.wait(60)
    # Whole lines: rich puts them above its bar.
    lines = stream.getvalue().splitlines()
    assert lines[0] == "compiling kernel 'a' …" and lines[1].startswith("compiling kernel 'b'")


def test_what_is_fast_is_not_shown(monkeypatch):
    stream = Stream()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(compiling, "PATIENCE", 1e9)
    watcher = compiling.Watcher()
    for _ in range(3):
        with watcher.compiling("a"):
            pass
    assert stream.getvalue() == ""


def test_errors_pass(watcher, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Stream())
    with pytest.raises(KeyboardInterrupt), watcher.compiling("a"):
        raise KeyboardInterrupt
    assert watcher._compilations == []


@pytest.mark.parametrize("stream", [None, object()])
def test_without_standard_error(monkeypatch, stream):
    ti.init()
    monkeypatch.setattr(sys, "stderr", stream)
    assert not compiling.is_shown()
    monkeypatch.setattr(sys, "stderr", Stream())
    assert compiling.is_shown()
    monkeypatch.setattr(state.options, "compile_progress", False)
    assert not compiling.is_shown()


def test_what_has_no_gradient_is_said_where_it_is_needed(monkeypatch):
    ti.init()
    monkeypatch.setattr(sys, "stderr", Stream())
    x = ti.field(ti.f32, 4, needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def fill():
        for i in x:
            x[i] = 3.0

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] ** 2

    fill()
    with ti.ad.Tape(loss):
        total()
    assert x.grad.to_numpy().tolist() == [6.0] * 4
