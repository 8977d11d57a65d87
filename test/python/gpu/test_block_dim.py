"""Loops that say how large their blocks are on a GPU, and sizes that stay for the next process."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import tai as ti

from fake_driver import fake_driver

COUNT = 1000


@pytest.fixture
def emulated(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")


@pytest.mark.parametrize("size", [32, 8, 96, 1024])
@pytest.mark.parametrize("deterministic", [False, True])
def test_results_are_the_same(emulated, size, deterministic):
    ti.init(deterministic=deterministic, offline_cache=False)
    x = ti.field(ti.f32, COUNT, needs_grad=True)
    y = ti.field(ti.f32, COUNT, needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def step():
        ti.loop_config(block_dim=size)
        for i in x:
            y[i] = x[i] * x[(i + 1) % COUNT]
        ti.loop_config(block_dim=2 * size if size < 1024 else 64)
        for i in range(COUNT):
            loss[None] += y[i]

    values = np.random.default_rng(3).random(COUNT).astype(np.float32)
    x.from_numpy(values)
    with ti.ad.Tape(loss=loss) as tape:
        step()
    expected = np.roll(values, 1) + np.roll(values, -1)
    for _ in range(3):
        np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=1e-6)
        assert loss[None] == pytest.approx((values * np.roll(values, -1)).sum(), rel=1e-5)
        tape.replay()
        tape.grad()


def sized(size):
    x = ti.field(ti.f32, 8)

    @ti.kernel
    def fill():
        ti.loop_config(block_dim=size)
        for i in x:
            x[i] = 1

    return fill


@pytest.mark.parametrize("size", [48, 3, 1056, 2048])
def test_sizes_that_no_gpu_has(emulated, size):
    ti.init(offline_cache=False)
    with pytest.raises(ti.TaiTypeError, match=f"no blocks of block_dim={size} threads") as caught:
        sized(size)()
    assert "ti.loop_config(block_dim=size)" in str(caught.value)
    assert "a multiple of 32 or a power of two, 1024 at most" in str(caught.value)


def test_the_cpu_takes_any_number(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cpu")
    ti.init(offline_cache=False)
    for size in (0, 48, 2048, np.int32(64), None):
        sized(size)()
    for size in (-1, "many", 2.5, True):
        with pytest.raises(ti.TaiTypeError, match="block_dim is a number of threads, but got"):
            sized(size)()


def test_the_limit_is_a_number_of_warps(emulated):
    with pytest.raises(ti.TaiRuntimeError, match="max_block_dim.*a multiple of 32"):
        ti.init(max_block_dim=100)
        sized(64)()


# On a driver that has no GPU, and does nothing.


def run(folder, text, likes_512=False):
    """The data that a program passes to `say`; the program runs above that driver."""
    program = folder / "program.py"
    program.write_text(
        "import json\n"
        "import tai as ti\n"
        "def say(what):\n"
        "    print('said', json.dumps(what))\n"
        "def threads():\n"
        "    return {row.name: row.threads for row in ti.profiler.get_stats()\n"
        "            if row.kind == 'device'}\n" + text
    )
    environment = {
        **os.environ, "TI_ARCH": "cuda", "TAI_CUDA_EMULATION": "",
        "TAI_CUDA_DRIVER": str(fake_driver()),
        "TAI_FAKE_CUDA": "any-function" + (" likes-512" if likes_512 else ""),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, str(program)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line[5:]) for line in done.stdout.splitlines() if line[:5] == "said "]


LOOPS = """
n = 100000
x, y = ti.field(ti.f32, n, needs_grad=True), ti.field(ti.f32, n, needs_grad=True)
z = ti.field(ti.f32)
ti.root.pointer(ti.i, 64).dense(ti.i, 64).place(z)
loss = ti.field(ti.f32, (), needs_grad=True)
z[100] = 1
@ti.kernel
def several():
    ti.loop_config(block_dim=64)
    for i in range(n):
        y[i] = x[i] * x[i]
    for i in x:
        y[i] += 2 * x[i]
    ti.loop_config(block_dim=512)
    for i in range(n):
        loss[None] += y[i]
@ti.kernel
def cells():
    ti.loop_config(block_dim=96)
    for i in z:
        z[i] = 1
@ti.kernel
def steady():
    ti.loop_config(block_dim_adaptive=False)
    for i in range(70):
        y[i] = 1
"""


def test_each_loop_is_launched_with_its_own(tmp_path):
    said, alone = run(
        tmp_path,
        "ti.init(kernel_profiler=True, offline_cache=False)\n" + LOOPS + "several()\n"
        "cells()\n"
        "steady()\n"
        "say(threads())\n"
        "ti.profiler.clear_kernel_profiler_info()\n"
        "several.grad()\n"
        "say(threads())\n",
    )
    assert said["several_0"] == 64
    assert said["several_1"] == 256
    assert said["several_2"] == 512
    assert said["cells_0"] == 96, said
    assert said["steady_0"] == 256
    # The loops of the gradient, from the last to the first.
    sizes = [alone[name] for name in sorted(alone) if name.startswith("several")]
    assert {64, 512} <= set(sizes)


def test_a_loop_comes_before_the_option(tmp_path):
    [said] = run(
        tmp_path,
        "ti.init(kernel_profiler=True, offline_cache=False, default_gpu_block_dim=128)\n"
        + LOOPS
        + "several()\n"
        "steady()\n"
        "say(threads())\n",
    )
    assert said["several_0"] == 64
    assert said["several_1"] == 128
    assert said["several_2"] == 512
    assert said["steady_0"] == 128


def test_no_block_is_above_the_limit(tmp_path):
    [said] = run(
        tmp_path,
        "ti.init(kernel_profiler=True, offline_cache=False, max_block_dim=128)\n" + LOOPS + ""
        "several()\n"
        "say(threads())\n",
    )
    assert said["several_0"] == 64
    assert said["several_1"] == 128
    assert said["several_2"] == 128


TRIALS = """
x = ti.field(ti.f32, 1 << 20)
@ti.kernel
def step():
    for i in x:
        x[i] += 1
for _ in range(40):
    ti.profiler.clear_kernel_profiler_info()
    step()
    say(threads()["step_0"])
"""


def test_what_trials_find_stays_for_the_next_process(tmp_path):
    def sizes(options):
        return run(tmp_path, f"ti.init(kernel_profiler=True, {options})\n" + TRIALS, True)

    cache = tmp_path / "cache"
    cached = f"offline_cache_file_path={str(cache)!r}"
    tried = [256, 256, 64, 128, 512]
    assert sizes(f"deterministic=True, {cached}") == [256] * 40
    for _ in range(2):
        found = sizes("offline_cache=False")
        assert found[:5] == tried and found[-1] == 512
    before = set(cache.iterdir())
    found = sizes(cached)
    assert found[:5] == tried and found[-1] == 512
    # The kernel and the size.
    assert len(set(cache.iterdir()) - before) == 2
    assert sizes(cached) == [512] * 40
    # A damaged entry is found again.
    for entry in cache.iterdir():
        entry.write_bytes(entry.read_bytes()[:50])
    found = sizes(cached)
    assert found[:5] == tried and found[-1] == 512
    assert sizes(cached) == [512] * 40
