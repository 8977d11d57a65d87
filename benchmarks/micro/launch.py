"""The host overhead of a GPU launch without the driver's, measured without a GPU: nanoseconds per
call of a compiled kernel from Python, and driver calls per launch.

    launch.py [--package PATH] [--compiler clang-22]

The driver is ColdDriver.c. It measures its own time, which is subtracted, and touches some memory
and code at each launch, as a real driver does, to evict the caller from the caches: the first
column is the amount. To compare two builds, run them interleaved.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPETITIONS, BATCH = 400, 200


def build_driver(compiler: str, folder: str) -> str:
    """Compiles the driver.

    Raises:
        CalledProcessError: the compiler fails.
    """
    library = str(Path(folder) / "cold-driver.so")
    command = [compiler, "-O2", "-fPIC", "-shared", "-finstrument-functions", "-o", library]
    subprocess.run([*command, str(HERE / "ColdDriver.c")], check=True)
    return library


def measure(run, inside: ctypes.c_longlong) -> float:
    """Nanoseconds of one of the calls that `run` makes BATCH of, without those in the driver:
    of ten batches, one is quicker."""
    times = []
    for _ in range(REPETITIONS):
        inside.value = 0
        start = time.perf_counter_ns()
        run()
        times.append((time.perf_counter_ns() - start - inside.value) / BATCH)
    return sorted(times)[REPETITIONS // 10]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--package", default=str(HERE.parent.parent / "python"))
    parser.add_argument("--compiler", default="clang-22")
    options = parser.parse_args()
    sys.path.insert(0, options.package)
    with tempfile.TemporaryDirectory() as folder:
        library = build_driver(options.compiler, folder)
        os.environ.update(TAI_CUDA_DRIVER=library, TAI_FAKE_CUDA="any-function")
        driver = ctypes.CDLL(library)

    import tai as ti

    calls, inside, launches, cold = (
        ctypes.c_longlong.in_dll(driver, name)
        for name in ("tai_fake_cuda_calls", "tai_cold_ns", "tai_cold_launches", "tai_cold_bytes")
    )
    ti.init(arch=ti.cuda)
    value = ti.field(dtype=ti.f32, shape=())
    fields = [ti.field(dtype=ti.f32, shape=64) for _ in range(8)]

    @ti.kernel
    def bump(t: ti.i32):
        value[None] += t

    @ti.kernel
    def mix(t: ti.i32, a: ti.f32, b: ti.f32):
        for i in range(64):
            fields[0][i] = fields[1][i] + a * fields[2][i] + b * fields[3][i]
            fields[4][i] = fields[5][i] + a * fields[6][i] + t * fields[7][i]

    @ti.data_oriented
    class Scene:
        @ti.kernel
        def bump(self, t: ti.i32):
            value[None] += t

    scene = Scene()

    def nothing():
        for _ in range(BATCH):
            abs(1)

    def plain():
        for _ in range(BATCH):
            bump(1)

    def large():
        for _ in range(BATCH):
            mix(1, 0.5, 0.25)

    def method():
        for _ in range(BATCH):
            scene.bump(1)

    cases = {
        "abs(1)": nothing,
        "bump(1)": plain,
        "mix(1, 0.5, 0.25)": large,
        "scene.bump(1)": method,
    }
    for run in cases.values():
        run()
    print("ns per call".ljust(20), *(f"{name:>20}" for name in cases))
    for kib in (0, 16, 32, 64, 128, 256):
        cold.value = kib << 10
        row = [f"{measure(run, inside):20.0f}" for run in cases.values()]
        print(f"{kib} KiB".ljust(20), *row)
    cold.value = 0
    row = []
    for run in cases.values():
        before, queued = calls.value, launches.value
        run()
        queued = launches.value - queued
        row.append(f"{(calls.value - before) / queued if queued else 0:20.2f}")
    print("driver calls".ljust(20), *row)


if __name__ == "__main__":
    main()
