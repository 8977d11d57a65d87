"""A program whose ranks exchange rows of an emulated GPU as those of GPUs, on gloo.

It prints the largest difference to one process for each scene, and in deterministic mode whether
the bits are equal. With `--fail`, a loop of rank 1 fails.
"""

import contextlib
import ctypes
import os
import sys
import types
from pathlib import Path

os.environ["TI_ARCH"], os.environ["TAI_CUDA_EMULATION"] = "cuda", "1"
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
import tai as ti  # noqa: E402
import torch  # noqa: E402
from tai._impl.base import exchanged, mesh, torch_ranks  # noqa: E402

import rank_particles  # noqa: E402
import rank_scenes  # noqa: E402


class Event:
    """An event of a GPU that has done all its work."""

    def record(self):
        """The work is done."""

    def query(self):
        return True


def say(line):
    """Prints a line at once, as the other ranks do."""
    os.write(1, f"{line}\n".encode())


def use_host_as_gpu():
    """Lets the module for GPUs work on memory of the host."""
    torch.cuda.Event = Event
    stream = types.SimpleNamespace(cuda_stream=0)
    torch.cuda.current_stream = torch.cuda.default_stream = lambda: stream
    torch.cuda.stream = lambda _: contextlib.nullcontext()

    def on_host(make):
        def made(*given, **options):
            options.pop("device", None), options.pop("pin_memory", None)
            return make(*given, **options)

        return made

    torch.zeros, torch.full = on_host(torch.zeros), on_host(torch.full)
    from tai._impl.base import exchanged_cuda

    def view(address, code, extents, strides):
        dtype = np.dtype(code)
        size = dtype.itemsize + sum((n - 1) * s for n, s in zip(extents, strides, strict=True))
        memory = (ctypes.c_char * size).from_address(address)
        return torch.from_numpy(np.ndarray(extents, dtype, memory, 0, strides))

    exchanged_cuda._view = view
    device = exchanged_cuda.DeviceMemory(exchanged._TYPES)
    torch_ranks.name_of_gpu = lambda: os.environ["RANK"]
    mesh.memory_of = lambda on_device: device if on_device else exchanged.HostMemory()


use_host_as_gpu()
size = int(os.environ["WORLD_SIZE"])
transport = torch_ranks.connect("x", size, 30, False)
transport.has_nccl = True


def fail():
    """A loop of rank 1 stops at an assertion, and the other ranks wait for its rows."""
    ti.init(arch=ti.cuda, debug=True, mesh=ti.mesh("x", size, transport))
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    ti.root.shard(ti.i).dense(ti.i, 12).place(x, y)

    @ti.kernel
    def check():
        for i in range(12):
            assert i < 9, "row nine"
            x[i] = i

    @ti.kernel
    def blur():
        for i in range(1, 11):
            y[i] = x[i - 1] + x[i + 1]

    check()
    blur()
    print("no error", y.to_numpy())


def large(together):
    """Fields that are larger than the memory of a device; their rows on a rank are not."""
    n, m = 1024, 1024
    given = ti.mesh("x", size, transport) if together else None
    ti.init(arch=ti.cuda, offline_cache=False, device_memory_limit=12 << 20, mesh=given)
    x, y, loss = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.f32)
    rows = ti.root.shard(ti.i) if together else ti.root
    rows.dense(ti.ij, (n, m)).place(x, y)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def move():
        for i, j in ti.ndrange((1, n), m):
            y[i, j] = 2 * x[i - 1, j]

    @ti.kernel
    def square():
        for i, j in x:
            x[i, j] = y[i, j] * y[i, j]

    @ti.kernel
    def total():
        for i, j in x:
            loss[None] += x[i, j]

    start = (np.arange(n * m, dtype=np.float32) % 97).reshape(n, m)
    x.from_numpy(start)
    x[n - 1, 0] = 1
    with ti.ad.Tape(loss):
        move()
        square()
        total()
    gradient = 8 * start
    gradient[n - 1] = 0
    moved = np.zeros((n, m), np.float32)
    moved[1:] = 2 * start[:-1]
    return (np.array_equal(x.grad.to_numpy(), gradient) and np.array_equal(y.to_numpy(), moved)
            and np.array_equal(x.to_numpy(), moved * moved))  # fmt: skip


if "--fail" in sys.argv:
    fail()
    sys.exit()
scenes = [(rank_scenes, name) for name in ("wave", "heat", "scatter", "peak", "host")]
for module, name in [*scenes, (rank_particles, "mpm"), (rank_particles, "everywhere")]:
    whole = module.run(None, name, "f64")
    found = module.run(transport, name, "f64")
    error = 0.0
    for key, value in whole.items():
        if key != "moves":
            error = max(error, float(np.abs(np.asarray(found[key]) - value).max()))
    say(f"rank {transport.rank} {name} {error <= 1e-11} {error:.2g}")
for deterministic in (False, True):
    whole = rank_scenes.stencil(None, 24, 1, deterministic)
    found = rank_scenes.stencil(transport, 24, 1, deterministic)
    made = found.pop("made")
    # The ranks add up the loss in another order, but in deterministic mode.
    bound = 0 if deterministic else 1e-6
    equal = all(np.allclose(found[key], whole[key], bound, bound) for key in found)
    say(f"rank {transport.rank} stencil {equal} {made}")
try:
    fits = large(False)
except ti.TaiError as error:
    fits = "out of memory on the device" not in str(error)
say(f"rank {transport.rank} large {not fits and large(True)}")
torch_ranks.dist.barrier()
