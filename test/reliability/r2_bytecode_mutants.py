"""R2: damaged bytecode through the library's loader, and through MLIR's own reader beside it.

The loader takes bytecode only behind its checksum, and must refuse all that is damaged. MLIR's
reader is given the same damage without the checksum, and its crashes are counted for comparison.
"""

from __future__ import annotations

import ctypes
import os
import random
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from bars import ROOT, Bar
from mutations import read_sources

HEADER = 24
SECONDS = 10  # of computing, for one file; more is a hang
BATCH = 500


class StringRef(ctypes.Structure):
    _fields_ = [("data", ctypes.c_char_p), ("size", ctypes.c_size_t)]


class Error(ctypes.Structure):
    """TaiError of the C API."""

    _fields_ = [
        ("status", ctypes.c_int),
        ("message", ctypes.c_char_p),
        ("file", ctypes.c_char_p),
        ("line", ctypes.c_int),
        ("column", ctypes.c_int),
        ("diagnostics", ctypes.c_char_p),
    ]


class Library:
    """libtai through its C API."""

    def __init__(self, build: Path):
        self.api = ctypes.CDLL(str(build / "lib/libtai.so"))
        for name in ("taiContextCreate", "taiContextGetMlirContext", "mlirModuleCreateParse"):
            getattr(self.api, name).restype = ctypes.c_void_p
        self.api.taiContextLastError.restype = Error
        self.api.mlirModuleCreateParse.argtypes = [ctypes.c_void_p, StringRef]
        self.context = ctypes.c_void_p(self.api.taiContextCreate())
        self.mlir = ctypes.c_void_p(self.api.taiContextGetMlirContext(self.context))

    def load(self, data: bytes) -> str:
        """Loads a file as programs do; says how that ended."""
        kernel = ctypes.c_void_p()
        # No kernel has this name, so that a module that is read goes no further.
        status = self.api.taiKernelLoad(
            self.context, data, ctypes.c_size_t(len(data)), b"file", b"", ctypes.byref(kernel)
        )
        message = self.api.taiContextLastError(self.context).message.decode("latin-1")
        if status == 0 or "holds no kernel" in message:
            return "accepted"
        return "refused"

    def read_raw(self, data: bytes) -> str:
        """Reads bytecode by MLIR's reader alone."""
        module = self.api.mlirModuleCreateParse(self.mlir, StringRef(data, len(data)))
        return "accepted" if module else "refused"


def make_files(build: Path, count: int) -> list[bytes]:
    """Modules of the tests as bytecode with a checksum."""
    files = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "module.mlir"
        for source in read_sources(ROOT / "test"):
            if source.invalid or "tai.kernel" not in source.text:
                continue
            path.write_text(source.text)
            command = [build / "bin/tai-translate", "--tai-to-bytecode", path]
            result = subprocess.run(command, capture_output=True)
            if result.returncode == 0:
                files.append(result.stdout)
            if len(files) == count:
                break
    return files


def damage(choose: random.Random, files: list[bytes], start: int) -> bytes:
    """A file with one to three kinds of damage from byte `start` on.

    Never a file as it was, and never blank: that is the text of an empty module.
    """
    original = choose.choice(files)
    data = bytearray()
    while not data.strip() or bytes(data) in files:
        data = bytearray(original)
        for _ in range(choose.choice((1, 1, 2, 3))):
            at = choose.randrange(start, max(len(data), start + 1))
            to = min(max(len(data), at), at + choose.choice((1, 2, 8, 64, 512)))
            other = choose.choice(files)
            kind = choose.randrange(8)
            if kind < 3:
                for _ in range(choose.choice((1, 1, 1, 4))):
                    if len(data) > start:
                        data[choose.randrange(start, len(data))] ^= 1 << choose.randrange(8)
            elif kind == 3:
                del data[at:]
            elif kind == 4:
                del data[at:to]
            elif kind == 5:
                data[at:to] = bytes(to - at)
            elif kind == 6:
                data[at:at] = choose.randbytes(to - at)
            else:
                data[at:to] = other[at:to]
    return bytes(data)


def run_batch(step: Callable[[bytes], str], batch: list[bytes]) -> Iterator[str]:
    """How the step ends on each file. A process that dies is followed by another."""
    done = 0
    while done < len(batch):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            for data in batch[done:]:
                signal.setitimer(signal.ITIMER_PROF, SECONDS)
                os.write(write, step(data)[:1].encode())
            os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            answers = pipe.read().decode()
        _, status = os.waitpid(child, 0)
        yield from ({"a": "accepted", "r": "refused"}[answer] for answer in answers)
        done += len(answers)
        if os.WIFSIGNALED(status):
            yield "hang" if os.WTERMSIG(status) == signal.SIGPROF else "signal"
            done += 1


def run(bar: Bar, step: Callable[[bytes], str], make: Callable[[], bytes], count: int):
    """How the step ended on so many files, counted."""
    results: Counter[str] = Counter()
    for begun in range(0, count, BATCH):
        if bar.left() <= 0:
            break
        batch = [make() for _ in range(min(BATCH, count - begun))]
        results.update(run_batch(step, batch))
    return results


def main() -> None:
    bar = Bar(
        "R2", "mutants of bytecode", full=100_000, short=2_000, adds=True,
        target="100,000 through the library's loader: all refused, no signal",
        miss="a damaged file that is taken, or that ends the process",
    )  # fmt: skip
    bar.parser.add_argument("--raw", type=int, help="files for MLIR's reader; a tenth without it")
    args = bar.parse()
    files = make_files(args.build, 20 if args.short else 100)
    library = Library(args.build)
    if any(library.load(data) != "accepted" for data in files):
        sys.exit("a file that is not damaged was refused")
    choose = random.Random(args.seed)
    checked = run(bar, library.load, lambda: damage(choose, files, 0), args.count)
    # Only the reader sees bytes behind the checksum.
    raw = run(
        bar,
        library.read_raw,
        lambda: damage(choose, files, HEADER)[HEADER:],
        args.count // 10 if args.raw is None else args.raw,
    )
    rate = 100 * (raw["signal"] + raw["hang"]) / max(raw.total(), 1)
    bar.report(
        f"{checked.total()} mutants",
        f"{checked['signal']} signals, {checked['hang']} hangs, "
        f"{checked['accepted']} accepted; MLIR's own reader: {raw.total()} run, "
        f"{raw['signal'] + raw['hang']} crashes and hangs, {rate:.2f} %",
        met=checked["refused"] == checked.total() > 0,
    )


if __name__ == "__main__":
    main()
