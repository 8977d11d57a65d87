"""Programs whose bits are compared between the CPU, with any number of threads, and the emulated
device, with blocks of any size, where `math="strict"` and `deterministic=True` are chosen.
"""

import contextlib

import numpy as np
import tai as ti
from tai._impl.base import native

TYPES = {"f32": ti.f32, "f64": ti.f64, "f16": ti.f16, "bf16": ti.bf16}

# Long enough for several partitions, chunks of sums and warps.
N = 20_011


def numbers(n, dtype, seed=0):
    """The numbers are f32 for types that NumPy lacks: fields round them."""
    kind = dtype.replace("f", "float") if dtype in ("f32", "f64") else "float32"
    return np.random.default_rng(seed).standard_normal(n).astype(kind)


def processors():
    """Older processors than this one, whose code it can run: without and with fused operations."""
    found = []
    for name in ("x86-64", "x86-64-v3"):
        with contextlib.suppress(ti.TaiRuntimeError):
            native.Context().set_option("target_cpu", name)
            found.append(name)
    return found


def runs(monkeypatch):
    """Contexts of each target: their names, when they have begun."""
    for threads in (1, 2, 3, 4):
        monkeypatch.setenv("TI_ARCH", "cpu")
        yield f"cpu {threads}", {"arch": ti.cpu, "cpu_max_num_threads": threads}
    for processor in processors():
        yield f"cpu {processor}", {"arch": ti.cpu, "target_cpu": processor}
    for threads in (1, 32, 96):
        monkeypatch.setenv("TI_ARCH", "cuda")
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
        monkeypatch.setenv("TAI_EMULATED_THREADS", str(threads))
        yield f"device {threads}", {"arch": ti.cuda}


def assert_same(program, dtype, monkeypatch):
    """`program(dtype)` gives arrays whose bits are those of one thread of the CPU."""
    first = None
    for name, options in runs(monkeypatch):
        ti.init(
            offline_cache=False, math="strict", deterministic=True,
            default_fp=ti.f64 if dtype == "f64" else ti.f32, **options,
        )  # fmt: skip
        found = [np.ascontiguousarray(a) for a in program(dtype)]
        first = first or found
        for i, (one, other) in enumerate(zip(first, found, strict=True)):
            different = np.flatnonzero(one.view(np.uint8) != other.view(np.uint8))
            assert different.size == 0, f"array {i} on {name}: {different.size} bytes differ"


def fields(dtype, count, shape=N, **kinds):
    kinds = kinds or {"needs_grad": True}
    return [ti.field(TYPES[dtype], shape=shape, **kinds) for _ in range(count)]
