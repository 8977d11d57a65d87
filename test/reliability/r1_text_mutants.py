"""R1: mutants of the .mlir files of the tests, through tai-opt.

Each mutant is parsed and goes through whole pipelines, and through the passes of the file that
it comes from. Errors are what is expected; signals and hangs are not. Many mutants go through one
process; where that dies or hangs, the mutant that did it is found by halves and kept.
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
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bars import ROOT, Bar
from mutations import Mutator, read_sources

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
    """How one process ended: 'ok', 'hang', or a signal with the frames it came from."""

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


def call(tool: Path, options: str, texts: list[str], folder: Path) -> Outcome:
    """Runs tai-opt on the texts as one file."""
    path = folder / "batch.mlir"
    path.write_text("\n// -----\n".join(texts), encoding="utf-8", errors="surrogateescape")
    seconds = SECONDS + len(texts) - 1
    command = [tool, "--split-input-file", "--mlir-disable-threading", *options.split(), path]
    try:
        result = subprocess.run(
            [*command, "-o", "/dev/null"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "LLVM_DISABLE_SYMBOLIZATION": "1"},
            preexec_fn=lambda: limit(seconds),
            timeout=20 * seconds,
        )
    except subprocess.TimeoutExpired:
        return Outcome("hang")
    if result.returncode > 1 or b"Unknown command line argument" in result.stderr:
        raise RuntimeError(result.stderr.decode())
    if result.returncode >= 0:
        return Outcome("ok")
    report = result.stderr.decode("latin-1")
    hangs = -result.returncode in (signal.SIGXCPU, signal.SIGKILL)
    kind = "hang" if hangs else f"signal {-result.returncode}"
    return Outcome(kind, frames_of(report), report)


def find_failures(
    tool: Path, options: str, texts: list[str], folder: Path
) -> Iterator[tuple[str, Outcome]]:
    """The texts of a batch that end their process, by halves."""
    outcome = call(tool, options, texts, folder)
    if outcome.kind == "ok":
        return
    if len(texts) == 1:
        yield texts[0], outcome
        return
    middle = len(texts) // 2
    yield from find_failures(tool, options, texts[:middle], folder)
    yield from find_failures(tool, options, texts[middle:], folder)


@functools.cache
def generic_form(tool: Path, text: str) -> str:
    """The text as MLIR prints any op, in which regions may be what no parser of an op lets by."""
    command = [tool, "--mlir-print-op-generic", "--mlir-print-local-scope"]
    result = subprocess.run(command, input=text, capture_output=True, text=True, errors="replace")
    return result.stdout if result.returncode == 0 else text


def main() -> None:
    bar = Bar(
        "R1", "mutants of .mlir text", full=100_000, short=800,
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
            for text, outcome in find_failures(tool, options, texts, Path(folder)):
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
            done += size
    for place, number in places.most_common():
        print(f"{number:6} {place}")
    bar.report(
        f"{done} mutants",
        f"{counts['signal']} signals, {counts['hang']} hangs, "
        f"{counts['known']} known crashes of MLIR's own",
        met=not counts["signal"] and not counts["hang"],
    )


if __name__ == "__main__":
    main()
