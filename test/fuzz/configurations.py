"""The configurations of random programs: target, threads, level of optimisation, number of
elements.

Each seed draws a configuration of its own, so that random programs, too, meet the compiler's
choices that depend on a size, on several threads, on a level or on a device. A configuration is one
word, such as `emulated-64t-O3-1031n`, by which a seed is run again:

    python test/fuzz/run.py --seed 17 --configuration emulated-64t-O3-1031n
"""

from __future__ import annotations

import contextlib
import os
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

# Elements: less than a vector, more than one, above the shortest loop that is split into interior
# and border, above a tile and a warp, above the sums that a block of a device makes of its own
# (1024), and where loops are long enough for chunks of several threads and private sums.
SIZES = (5, 5, 17, 33, 67, 260, 1031, 4099, 20011)
# On a GPU also where each thread takes several elements, and blocks of other sizes are tried.
GPU_SIZES = (5, 33, 260, 1031, 20011, 70001, 70001, (1 << 21) + 13)
THREADS = (1, 2, 3, 4)
# Threads of a block of the emulated device; above 32 there are several warps.
BLOCKS = (1, 32, 64, 96)


@dataclass(frozen=True)
class Configuration:
    """Where and how programs are compiled and run.

    Attributes:
        arch: `cpu`, `emulated`, `cuda`, or `python`, which is the interpreter.
        threads: of the CPU, or of a block of the emulated device.
        level: of optimisation.
        elements: of the fields.
        deterministic: whether sums do not depend on timing.
        compensated: whether sums have twice the digits, to tell rounding of sums from errors.
    """

    arch: str = "cpu"
    threads: int = 1
    level: int = 1
    elements: int = 5
    deterministic: bool = False
    compensated: bool = False

    def __str__(self) -> str:
        word = f"{self.arch}-{self.threads}t-O{self.level}-{self.elements}n"
        word += "-deterministic" if self.deterministic else ""
        return word + ("-compensated" if self.compensated else "")

    @contextlib.contextmanager
    def chosen(self) -> Iterator[None]:
        """Within, `init` is `ti.init` for it."""
        wanted = {
            "TI_ARCH": "cuda" if self.arch == "emulated" else self.arch,
            "TAI_CUDA_EMULATION": "1" if self.arch == "emulated" else "",
            "TAI_EMULATED_THREADS": str(self.threads),
        }
        before = {name: os.environ.get(name) for name in wanted}
        os.environ.update(wanted)
        try:
            yield
        finally:
            for name, value in before.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value

    @property
    def options(self) -> dict:
        """The arguments of `ti.init`."""
        return {
            "cpu_max_num_threads": self.threads if self.arch == "cpu" else 1,
            "opt_level": self.level, "deterministic": self.deterministic,
            "sums": "compensated" if self.compensated else "default",
        }  # fmt: skip

    def init(self, **options) -> None:
        import tai as ti

        ti.init(**self.options, **options)

    def plain(self) -> Configuration:
        """The one whose values all others must have."""
        return replace(self, arch="cpu", threads=1, level=0, deterministic=False)


def parse(word: str) -> Configuration:
    found = re.fullmatch(
        r"(cpu|emulated|cuda|python)-(\d+)t-O(\d)-(\d+)n(-deterministic)?(-compensated)?", word
    )
    if not found:
        raise ValueError(f"no configuration: {word!r}; one is {Configuration()}")
    arch, threads, level, elements, *sums = found.groups()
    return Configuration(arch, int(threads), int(level), int(elements), *map(bool, sums))


def default_targets() -> tuple[str, ...]:
    """Where tests run that do not say where."""
    if os.environ.get("TI_ARCH") == "cuda":
        return ("emulated",) if os.environ.get("TAI_CUDA_EMULATION") == "1" else ("cuda",)
    return ("cpu", "cpu", "emulated") if "TI_ARCH" not in os.environ else ("cpu",)


def draw(seed: int, targets: tuple[str, ...]) -> Configuration:
    """The configuration of a seed."""
    rng = random.Random(f"configuration {seed}")
    arch = rng.choice(targets)
    threads = rng.choice({"cpu": THREADS, "emulated": BLOCKS}.get(arch, (1,)))
    level = rng.choice((0, 1, 2, 3, 3))
    # One thread after another takes its time.
    sizes = SIZES[:-1] if arch == "emulated" and threads > 1 else SIZES
    if arch == "python":
        sizes = SIZES[:5]
    elements = rng.choice(GPU_SIZES if arch == "cuda" else sizes)
    return Configuration(arch, threads, level, elements, rng.random() < 0.2)
