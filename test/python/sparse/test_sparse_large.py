"""Sparse boxes far larger than the memory of a device: cells have memory where they are active."""

import subprocess
import sys

import numpy as np
import pytest
import tai as ti

# Blocks of 128 KiB, with their adjoints twice that: a box of 4 TiB.
BLOCKS, BLOCK = 256, 32
SIZE = BLOCKS * BLOCK


@pytest.fixture(autouse=True)
def on_device(request, monkeypatch):
    """A GPU if the options ask for it, else the emulated one."""
    if request.config.getoption("--arch") != "cuda":
        monkeypatch.setenv("TI_ARCH", "cuda")
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)


@pytest.fixture
def box():
    x = ti.field(ti.f32, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    blocks = ti.root.pointer(ti.ijk, BLOCKS)
    blocks.dense(ti.ijk, BLOCK).place(x, x.grad)
    return x, loss, blocks


def corners(count):
    """Corners of blocks all over the box."""
    k = np.arange(count)
    return np.stack([k * 37 % BLOCKS, k * 91 % BLOCKS, k * 211 % BLOCKS], axis=1) * BLOCK


def make_scatter(x, count):
    @ti.kernel
    def scatter():
        for k in range(count):
            x[k * 37 % BLOCKS * BLOCK, k * 91 % BLOCKS * BLOCK, k * 211 % BLOCKS * BLOCK] = k + 1.0

    return scatter


def test_kernels_and_gradients(box):
    x, loss, blocks = box
    scatter = make_scatter(x, 50)

    @ti.kernel
    def square():
        for i, j, k in x:
            loss[None] += x[i, j, k] ** 2

    @ti.kernel
    def spread():
        for i, j, k in x:
            # The right neighbour lies in the same block.
            if i % BLOCK == 1:
                x[i, j, k] = 2 * x[i - 1, j, k]

    scatter()
    with ti.ad.Tape(loss):
        spread()
        square()
    value = np.arange(1.0, 51.0)
    assert loss[None] == pytest.approx(5 * (value**2).sum())
    for at, v in zip(corners(50).tolist(), value, strict=True):
        assert x[at] == v
        assert x[at[0] + 1, at[1], at[2]] == 2 * v
        assert x.grad[at] == pytest.approx(10 * v)
    assert blocks.num_active == 50
    assert x[SIZE - 1, SIZE - 1, 5] == 0


def test_fills_go_by_active_cells(box):
    x, loss, blocks = box
    make_scatter(x, 20)()

    @ti.kernel
    def add():
        for i, j, k in x:
            loss[None] += x[i, j, k]

    x.fill(0.5)
    add()
    assert loss[None] == 0.5 * 20 * BLOCK**3
    x.grad.fill(3)
    assert x.grad[(corners(20)[7] + 3).tolist()] == 3
    assert x.grad[9, 9, 9 + 5 * BLOCK] == 0


def test_deactivation_leaves_zeros(box):
    x, loss, blocks = box
    scatter = make_scatter(x, 60)

    @ti.kernel
    def drop():
        for i, j, k in blocks:
            if i % 2 == 0:
                ti.deactivate(blocks, [i, j, k])

    @ti.kernel
    def touch():
        for k in range(60):
            at = ti.Vector([k * 37 % BLOCKS, k * 91 % BLOCKS, k * 211 % BLOCKS]) * BLOCK
            x[at[0] + 1, at[1], at[2]] = 1

    scatter()
    x.fill(2)
    drop()
    places = corners(60)
    kept = places[:, 0] // BLOCK % 2 == 1
    assert blocks.num_active == kept.sum()
    touch()
    for at, stays in zip((places + 2).tolist(), kept, strict=True):
        assert x[at] == (2 if stays else 0)
    blocks.deactivate_all()
    assert blocks.num_active == 0
    touch()
    assert x[(places[5] + 2).tolist()] == 0
    assert x[places[5][0] + 1, places[5][1], places[5][2]] == 1


def test_the_host_makes_cells_active(box):
    x, _, blocks = box
    places = corners(30).tolist()
    for k, at in enumerate(places):
        x[at] = k

    @ti.kernel
    def double():
        for i, j, k in x:
            x[i, j, k] *= 2

    double()
    x[1, 2, 3] = 5
    double()
    assert [x[at] for at in places] == [4.0 * k for k in range(30)]
    assert x[1, 2, 3] == 10
    assert len(blocks.active_cells()) == len({*map(tuple, places), (0, 0, 0)})


def test_levels_of_cells_alone():
    """A large cell is zeroed by way of the small ones in it that are active."""
    x, y = ti.field(ti.i32), ti.field(ti.i32)
    top = ti.root.pointer(ti.ij, 64)
    inner = top.bitmasked(ti.ij, 128)
    inner.dense(ti.ij, 16).place(x)
    # The cells of `top` hold lists, too.
    lists = top.dynamic(ti.k, 1024)
    lists.place(y)
    far = 64 * 128 * 16

    @ti.kernel
    def fill():
        for k in range(200):
            x[k * 4099 % far, k * 7001 % far] = k + 1
        for t in range(64):
            for k in range(5 + t):
                y[t, t].append(k + 1)

    @ti.kernel
    def drop():
        for i, j in top:
            if (i + j) % 3 != 0:
                ti.deactivate(top, [i, j])

    fill()
    k = np.arange(200)
    a, b = k * 4099 % far, k * 7001 % far
    gone = (a // 2048 + b // 2048) % 3 != 0
    drop()
    assert [x[i, j] for i, j in zip(a.tolist(), b.tolist(), strict=True)] == np.where(
        gone, 0, k + 1
    ).tolist()
    t = np.arange(64)
    assert lists.num_active == (5 + t)[2 * t % 3 == 0].sum()
    assert [y[1, 1, i] for i in range(6)] == [0] * 6
    assert [y[3, 3, i] for i in range(8)] == list(range(1, 9))
    top.deactivate_all()
    assert inner.num_active == lists.num_active == 0
    assert x[int(a[0]), int(b[0])] == 0 and y[3, 3, 2] == 0


LIMIT = 256 << 20
# Blocks of 16 KiB, 1024 in a row; those of each column are 16 MiB apart.
FULL = f"""
import tai as ti

ti.init(device_memory_limit={LIMIT})
x = ti.field(ti.f32)
blocks = ti.root.pointer(ti.ij, 1024)
blocks.dense(ti.ij, 64).place(x)

@ti.kernel
def scatter(first: ti.i32, end: ti.i32):
    for i in range(first, end):
        for j in range(8):
            x[i * 64, j * 128 * 64] = i + 1.0

@ti.kernel
def total() -> ti.f32:
    s = 0.0
    for i, j in x:
        s += x[i, j]
    return s

scatter(0, 10)
print(total(), blocks.num_active)
try:
    scatter(10, 1024)
    ti.sync()
except ti.TaiMemoryError as error:
    print(str(error).replace(chr(10), " "))
some = blocks.num_active
print(80 < some < 8192)
# The existing cells can be used, and emptied for others.
print(total() >= 440)
blocks.deactivate_all()
scatter(0, 3)
print(total())
"""


def test_running_out_of_memory(tmp_path):
    path = tmp_path / "full.py"
    path.write_text(FULL)
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "440.0 80"
    assert "out of memory on the device: one more cell of the 'pointer' level" in lines[1]
    assert "full.py" in lines[1] and "lie in pieces of" in lines[1]
    assert lines[2:] == ["True", "True", "48.0"]
