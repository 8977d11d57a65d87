"""A host without Python gets the gradients of a tape from a saved program."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
BUILD = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build"))

# A host without the package: the C API by ctypes. Prints the gradient twice, and the loss.
HOST = """
import ctypes, json, sys
tai, path, names = ctypes.CDLL(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3])
pointer = ctypes.c_void_p
class Error(ctypes.Structure):
    _fields_ = [("status", ctypes.c_int), ("message", ctypes.c_char_p), ("file", ctypes.c_char_p),
                ("line", ctypes.c_int), ("column", ctypes.c_int), ("diagnostics", ctypes.c_char_p)]
tai.taiContextCreate.restype = pointer
tai.taiContextLastError.restype, tai.taiContextLastError.argtypes = Error, [pointer]
tai.taiProgramGetSymbol.restype = ctypes.c_char_p
tai.taiProgramGetSymbol.argtypes = [pointer, ctypes.c_int, ctypes.c_int64]
tai.taiContextDestroy.argtypes = [pointer]
context = pointer(tai.taiContextCreate())
def call(name, *args):
    if getattr(tai, name)(*args):
        sys.exit(tai.taiContextLastError(context).diagnostics.decode())
def field(name):
    handle = pointer()
    call("taiContextFindField", context, name, ctypes.byref(handle))
    return handle
def read(handle, count):
    array = (ctypes.c_double * count)()
    call("taiFieldCopyToHost", handle, array)
    return list(array)
program = pointer()
call("taiProgramLoadFile", context, path.encode(), ctypes.byref(program))
loss = field(tai.taiProgramGetSymbol(program, 4, 0))
results = []
for _ in range(2):
    gradients = []
    call("taiProgramRun", program, b"gradient")
    for number, count in enumerate(names):
        adjoint = pointer()
        call("taiFieldGetAdjoint", field(tai.taiProgramGetSymbol(program, 5, number)),
             ctypes.byref(adjoint))
        gradients.append(read(adjoint, count))
    results.append([read(loss, 1)[0], gradients])
assert tai.taiProgramGetSymbol(program, 5, len(names)) is None
print(json.dumps(results))
tai.taiContextDestroy(context)
"""


def load(path, *counts):
    """The loss and the gradients, as a host without Python's package finds them, twice."""
    done = subprocess.run(
        [sys.executable, "-c", HOST, str(BUILD / "lib/libtai.so"), str(path), json.dumps(counts)],
        capture_output=True, text=True, env={**os.environ, "TAI_CACHE_DIR": ""},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


pytestmark = pytest.mark.skipif(
    not (BUILD / "lib/libtai.so").exists(), reason="this machine has no libtai of C"
)


def rope(n, steps, layout):
    """A rope in place; the kernels take an index, a number and a vector."""
    x, v = ti.Vector.field(2, ti.f64), ti.Vector.field(2, ti.f64)
    k = ti.field(ti.f64)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    if layout == "aos":
        ti.root.dense(ti.i, n).place(x, v, k)
    else:
        for f in (x, v, k):
            ti.root.dense(ti.i, n).place(f)
    ti.root.lazy_grad()

    @ti.kernel
    def pull(dt: ti.f64, g: ti.types.vector(2, ti.f64)):
        for i in range(n - 1):
            d = x[i + 1] - x[i]
            v[i + 1] += dt * (g - k[i] * d)

    @ti.kernel
    def move(dt: ti.f64, t: ti.i32):
        for i in x:
            x[i] += dt * v[i] * (1.0 + 0.01 * t)

    @ti.kernel
    def far():
        for i in x:
            loss[None] += x[i].norm_sqr()

    def run():
        for t in range(steps):
            pull(0.01, ti.Vector([0.0, -9.8]))
            move(0.01, t)
        far()

    x.from_numpy(np.stack([np.arange(n) * 0.1, np.zeros(n)], axis=1))
    k.from_numpy(20.0 + np.arange(n))
    return run, loss, x, v, k


@pytest.mark.parametrize("layout", ["soa", "aos"])
@pytest.mark.parametrize("threads", [1, 2])
def test_the_gradient_is_that_of_a_tape(tmp_path, layout, threads):
    ti.init(arch=ti.cpu, cpu_max_num_threads=threads)
    run, loss, x, v, k = rope(17, 5, layout)
    loss[None] = 3.0
    start = x.to_numpy()
    ti.export(run, loss, [k, x], tmp_path / "rope.tai")
    assert (x.to_numpy() == start).all() and loss[None] == 3.0

    with ti.ad.Tape(loss):
        run()
    for found, gradients in load(tmp_path / "rope.tai", 17, 34):
        assert found == pytest.approx(loss[None], rel=1e-13)
        np.testing.assert_allclose(gradients[0], k.grad.to_numpy(), rtol=1e-11)
        np.testing.assert_allclose(gradients[1], x.grad.to_numpy().ravel(), rtol=1e-11)
        # The second run begins where the first one has ended.
        with ti.ad.Tape(loss):
            run()


def test_tai_run_runs_the_gradient(tmp_path):
    ti.init(arch=ti.cpu)
    a = ti.field(ti.f64, shape=3, needs_grad=True, name="a")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")

    @ti.func
    def cube(z):
        return z * z * z

    @ti.kernel
    def f(s: ti.f64):
        for i in a:
            loss[None] += s * cube(a[i])

    a.from_numpy(np.array([1.0, 2.0, 3.0]))

    def run():
        f(1.0)
        f(0.5)

    ti.export(run, loss, a, tmp_path / "cubes.tai")
    done = subprocess.run(
        [BUILD / "bin/tai-run", tmp_path / "cubes.tai", "--print-field=@a_grad,@loss"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "@a_grad : 3xf64 = [4.5, 18, 40.5]\n@loss : f64 = 54\n"


def small():
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    return x, loss, total


def refuse(match, run, loss, wrt, path):
    with pytest.raises(ti.TaiRuntimeError, match=match):
        ti.export(run, loss, wrt, path)
    assert not path.exists()


def test_more_than_launches_is_refused(tmp_path):
    x, loss, total = small()
    path = tmp_path / "none.tai"

    def writes():
        total()
        x[0] = 2.0

    @ti.kernel
    def add(a: ti.types.ndarray(ti.f64, 1)):
        for i in a:
            loss[None] += a[i]

    refuse("record 1 is no launch", writes, loss, x, path)
    refuse("takes an array of the caller", lambda: add(np.ones(3)), loss, x, path)
    refuse("recorded no launch", lambda: None, loss, x, path)
    flat = ti.field(ti.f64, shape=2)
    flat.fill(0)
    refuse("has no gradient", total, loss, flat, path)
    with pytest.raises(ti.TaiRuntimeTypeError, match="one number"):
        ti.export(total, x, x, path)
    with pytest.raises(ti.TaiRuntimeTypeError, match="is no field"):
        ti.export(total, loss, [x, 3], path)
    with pytest.raises(ti.TaiRuntimeError, match="cannot write"):
        ti.export(total, loss, x, tmp_path / "no/such/folder.tai")
    # An error of the function itself passes through, and fields are as before.
    x.fill(7)

    def fails():
        x.fill(1)
        raise KeyError("mine")

    with pytest.raises(KeyError):
        ti.export(fails, loss, x, path)
    assert (x.to_numpy() == 7).all()


def test_sparse_fields_are_refused(tmp_path):
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f64, needs_grad=True)
    ti.root.pointer(ti.i, 4).dense(ti.i, 4).place(x, x.grad)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x[3] = 2.0

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    refuse("has sparse levels", total, loss, x, tmp_path / "none.tai")


def test_kernels_and_helpers_of_one_name_stand_beside_each_other(tmp_path):
    x, loss, total = small()
    x.fill(2)

    def make(power):
        @ti.kernel
        def f(n: ti.template()):
            for i in x:
                loss[None] += x[i] ** power * n

        return f

    first, second = make(2), make(3)

    def run():
        first(1)
        second(1)
        first(2)
        total()

    ti.export(run, loss, x, tmp_path / "names.tai")
    (found, (slopes,)), _ = load(tmp_path / "names.tai", 4)
    assert found == pytest.approx(4 * (4 + 8 + 8 + 2))
    assert slopes == pytest.approx([4 + 12 + 8 + 1] * 4)


def test_another_version_and_damage_are_refused(tmp_path):
    x, loss, total = small()
    ti.export(total, loss, x, tmp_path / "a.tai")
    good = (tmp_path / "a.tai").read_bytes()
    (tmp_path / "b.tai").write_bytes(good[:-7])
    run = [BUILD / "bin/tai-run", tmp_path / "b.tai"]
    done = subprocess.run(run, capture_output=True, text=True, errors="replace")
    assert done.returncode == 1 and "cut off or damaged" in done.stderr
    (tmp_path / "b.tai").write_text("module attributes {tai.saved = {version = 2 : i64}} {}")
    done = subprocess.run(run, capture_output=True, text=True, errors="replace")
    assert "of version 2, and this tai reads version 1; save it again" in done.stderr
