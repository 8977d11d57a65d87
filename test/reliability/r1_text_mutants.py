"""R1: mutants of the .mlir files of the tests, through tai-opt.

Each mutant is parsed and goes through whole pipelines, and through the passes of the file that
it comes from. Errors are what is expected; signals and hangs are not. Many mutants go through one
process; where that dies or hangs, the mutant that did it is found by halves and kept. A process
that still computes when the time of the run is up is ended and named; what it was given does not
count as tried.
"""

from __future__ import annotations

import functools
import os
import random
import re
import resource
import signal
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bars import ROOT, Bar
from mutations import SPLIT, Mutator, read_sources

SECONDS = 10  # of computing, for one mutant; more is a hang
BATCH = 40
PIPELINES = [
    "--tai-to-llvm",
    "--tai-autodiff --tai-to-llvm",
    "--tai-to-nvvm",
    "--tai-autodiff --tai-to-nvvm",
    "--tai-forward-diff --tai-to-llvm",
    "--tai-autodiff",
]
# Crashes of MLIR 22 before any code of ours sees the module: what their report says, and why.
KNOWN_UPSTREAM = {
    r"Parser::parseDenseArrayAttr": "array<index: ...>: an index type is asked for its bits",
    r"LLVM::AtomicRMWOp::parse": "llvm.atomicrmw of a tensor",
    r"LLVM ERROR: out of memory(.|\n)*parseAsmSourceFile": "%r#2147483647: room for as many",
}
FRAME = re.compile(
    r"^\d+\s+(?P<library>\S+)\s+0x[0-9a-f]+(?: (?P<name>.*?)(?: \+ \d+)?)?$", re.MULTILINE
)


@dataclass
class Outcome:
    """How one process ended: 'ok', 'hang', 'late', or a signal with the frames it came from."""

    kind: str
    frames: list[str] = field(default_factory=list)
    report: str = ""

    @property
    def known(self) -> str:
        """Why MLIR itself dies of this, or nothing."""
        for pattern, reason in KNOWN_UPSTREAM.items():
            if re.search(pattern, self.report):
                return reason
        return ""

    @property
    def place(self) -> str:
        """The first frames, as one line."""
        return f"{self.kind} in {' < '.join(self.frames[:3]) or 'unknown'}"


def limit(seconds: int) -> None:
    """What a child may take: a mutant that wants all memory dies instead of the machine."""
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def frames_of(trace: str) -> list[str]:
    """The functions of a stack trace below the signal handler, or their libraries."""
    frames = [
        re.sub(r"\(.*", "", match["name"]) if match["name"] else match["library"]
        for match in FRAME.finditer(trace)
    ]
    skipped = re.compile(r"^llvm::sys::|^libc|^libLLVM|^abort$|^raise$")
    while frames and skipped.search(frames[0]):
        del frames[0]
    return frames


def is_asleep(process: subprocess.Popen) -> bool:
    """Whether a process waits for something, instead of computing or waiting for a processor."""
    state = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0]
    return state in "SDT"


def run_limited(
    command: list[object], seconds: int, left: float, **more: Any
) -> tuple[str, int, bytes, bytes]:
    """Runs a tool that may compute for `seconds`, and at most until the time that is left is up.

    On a busy machine the first takes many times as long by the clock.

    Returns:
        How it ended ('ok', 'hang' or 'late'), its status, and what it wrote.
    """
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, preexec_fn=lambda: limit(seconds), **more
    )
    try:
        out, error = process.communicate(timeout=max(1, min(20 * seconds, left)))
    except subprocess.TimeoutExpired:
        kind = "hang" if left > 20 * seconds or is_asleep(process) else "late"
        process.kill()
        process.communicate()
        return kind, 0, b"", b""
    return "ok", process.returncode, out or b"", error


def call(tool: Path, options: str, texts: list[str], folder: Path, left: float) -> Outcome:
    """Runs tai-opt on the texts as one file, for at most the time that is left."""
    path = folder / "batch.mlir"
    path.write_text("\n// -----\n".join(texts), encoding="utf-8", errors="surrogateescape")
    seconds = SECONDS + len(texts) - 1
    command = [tool, "--split-input-file", "--mlir-disable-threading", *options.split(), path]
    kind, status, _, error = run_limited(
        [*command, "-o", "/dev/null"], seconds, left, stdout=subprocess.DEVNULL,
        env={**os.environ, "LLVM_DISABLE_SYMBOLIZATION": "1"},
    )  # fmt: skip
    if kind != "ok":
        return Outcome(kind)
    if status > 1 or b"Unknown command line argument" in error:
        raise RuntimeError(error.decode())
    if status >= 0:
        return Outcome("ok")
    report = error.decode("latin-1")
    hangs = -status in (signal.SIGXCPU, signal.SIGKILL)
    kind = "hang" if hangs else f"signal {-status}"
    return Outcome(kind, frames_of(report), report)


def find_failures(
    tool: Path, options: str, texts: list[str], folder: Path, left: Callable[[], float]
) -> Iterator[tuple[str, Outcome]]:
    """The texts of a batch that end their process, by halves.

    Args:
        left: the seconds that are left of the run. What is not tried when they are over, comes as
            one text that is 'late'.
    """
    outcome = call(tool, options, texts, folder, left())
    if outcome.kind == "ok":
        return
    if len(texts) == 1 or outcome.kind == "late":
        yield "\n// -----\n".join(texts), outcome
        return
    middle = len(texts) // 2
    yield from find_failures(tool, options, texts[:middle], folder, left)
    yield from find_failures(tool, options, texts[middle:], folder, left)


@functools.cache
def generic_form(tool: Path, text: str) -> str:
    """The text as MLIR prints any op, in which regions may be what no parser of an op lets by."""
    with tempfile.TemporaryFile() as given:
        given.write(text.encode(errors="replace"))
        given.seek(0)
        kind, status, out, _ = run_limited(
            [tool, "--mlir-print-op-generic", "--mlir-print-local-scope"], SECONDS, 20 * SECONDS,
            stdin=given, stdout=subprocess.PIPE,
        )  # fmt: skip
    return out.decode(errors="replace") if kind == "ok" and status == 0 else text


def main() -> None:
    bar = Bar(
        "R1", "mutants of .mlir text", full=100_000, short=800, adds=True,
        target="100,000 mutants through tai-opt and whole pipelines: no signal, no hang",
        miss="a mutant that ends tai-opt by a signal or computes for more than 10 s",
    )  # fmt: skip
    bar.parser.add_argument("--keep", type=Path, help="folder for the mutants that fail")
    args = bar.parse()
    sources = read_sources(ROOT / "test")
    mutator = Mutator(sources, args.seed)
    choose = random.Random(args.seed)
    done = 0
    counts: Counter[str] = Counter()
    places: Counter[str] = Counter()
    late = 0
    with tempfile.TemporaryDirectory() as folder:
        while done < args.count and bar.left() > 0:
            source = choose.choices(sources, [1 if piece.invalid else 6 for piece in sources])[0]
            options = choose.choice([*PIPELINES, *source.options * 2])
            pieces = [other for other in sources if other.path == source.path]
            size = min(BATCH, args.count - done)
            tool = args.build / "bin/tai-opt"
            texts = [choose.choice(pieces).text for _ in range(size)]
            if choose.random() < 0.3:
                texts = [generic_form(tool, text) for text in texts]
            texts = [mutator.mutate(text) for text in texts]
            late = 0
            for text, outcome in find_failures(tool, options, texts, Path(folder), bar.left):
                late += len(SPLIT.split(text)) if outcome.kind == "late" else 0
                kind = "known" if outcome.known else outcome.kind.split()[0]
                counts[kind] += 1
                place = f"{outcome.place} ({options})"
                places[outcome.known or outcome.place] += 1
                if kind != "known":
                    print(f"{source.path.relative_to(ROOT)}: {place}", flush=True)
                if args.keep:
                    args.keep.mkdir(parents=True, exist_ok=True)
                    (args.keep / f"{kind}-{sum(counts.values())}.mlir").write_text(
                        f"// {place}\n{text}", errors="surrogateescape"
                    )
            done += size - late
            if late:
                break
    for place, number in places.most_common():
        print(f"{number:6} {place}")
    bar.report(
        f"{done} mutants",
        f"{counts['signal']} signals, {counts['hang']} hangs, "
        f"{counts['known']} known crashes of MLIR's own"
        + (f", {late} not done when the time was up" if late else ""),
        met=not counts["signal"] and not counts["hang"],
    )


if __name__ == "__main__":
    main()
