"""R1: mutants of the .mlir files of the tests, through tai-opt.

Each mutant is parsed and goes through whole pipelines, and through the passes of the file that
it comes from. Errors are what is expected; signals and hangs are not. Many mutants go through one
process; where that dies or hangs, the mutant that did it is found by halves and kept.
"""

from __future__ import annotations

import os
import random
import re
import resource
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bars import ROOT, Bar
from mutations import Mutator, read_sources

SECONDS = 10  # for one mutant; more is a hang
BATCH = 40
PIPELINES = [
    "--tai-to-llvm",
    "--tai-autodiff --tai-to-llvm",
    "--tai-to-nvvm",
    "--tai-autodiff --tai-to-nvvm",
    "--tai-forward-diff --tai-to-llvm",
    "--tai-autodiff",
]
# Crashes inside MLIR that no hook of ours can keep away: the frame they end in, and why.
KNOWN_UPSTREAM: dict[str, str] = {}
FRAME = re.compile(
    r"^\d+\s+(?P<library>\S+)\s+0x[0-9a-f]+(?: (?P<name>.*?)(?: \+ \d+)?)?$", re.MULTILINE
)


@dataclass
class Outcome:
    """How one process ended: 'ok', 'hang', or a signal with the frames it came from."""

    kind: str
    frames: list[str] = field(default_factory=list)

    @property
    def place(self) -> str:
        """The first frames, as one line."""
        return f"{self.kind} in {' < '.join(self.frames[:3]) or 'unknown'}"


def limit_memory() -> None:
    """What a child may take: a mutant that wants all memory dies instead of the machine."""
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
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
    command = [tool, "--split-input-file", "--mlir-disable-threading", *options.split(), path]
    try:
        result = subprocess.run(
            [*command, "-o", "/dev/null"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "LLVM_DISABLE_SYMBOLIZATION": "1"},
            preexec_fn=limit_memory,
            timeout=SECONDS + len(texts) - 1,
        )
    except subprocess.TimeoutExpired:
        return Outcome("hang")
    if b"Unknown command line argument" in result.stderr:
        raise ValueError(result.stderr.decode())
    if result.returncode >= 0:
        return Outcome("ok")
    return Outcome(f"signal {-result.returncode}", frames_of(result.stderr.decode("latin-1")))


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


def known(outcome: Outcome) -> bool:
    return any(name in frame for name in KNOWN_UPSTREAM for frame in outcome.frames[:8])


def main() -> None:
    bar = Bar("R1", "mutants of .mlir text", full=100_000, short=800)
    bar.parser.add_argument("--keep", type=Path, help="folder for the mutants that fail")
    args = bar.parse()
    sources = read_sources(ROOT / "test")
    mutator = Mutator(sources, args.seed)
    choose = random.Random(args.seed)
    done = 0
    counts: Counter[str] = Counter()
    places: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        while done < args.count:
            source = choose.choices(sources, [1 if piece.invalid else 6 for piece in sources])[0]
            options = choose.choice([*PIPELINES, *source.options * 2])
            pieces = [other for other in sources if other.path == source.path]
            size = min(BATCH, args.count - done)
            texts = [mutator.mutate(choose.choice(pieces).text) for _ in range(size)]
            tool = args.build / "bin/tai-opt"
            for text, outcome in find_failures(tool, options, texts, Path(folder)):
                kind = "known" if known(outcome) else outcome.kind.split()[0]
                counts[kind] += 1
                place = f"{outcome.place} ({options})"
                places[outcome.place] += 1
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
        f"{done} run, {counts['signal']} signals, {counts['hang']} hangs, "
        f"{counts['known']} known crashes of MLIR's own",
        met=not counts["signal"] and not counts["hang"],
    )


if __name__ == "__main__":
    main()
