"""R1: mutants of the .mlir files of the tests, through tai-opt.

Each mutant is parsed and goes through whole pipelines, and through the passes of the file that
it comes from. Errors are expected; signals and hangs are misses. Many mutants go through one
process, which may compute for no longer than one of them may; where it dies or hangs, the mutant
that did it is found by halves and kept. A process that still computes when the time of the run is
up is ended and named; its mutants do not count as tried.
"""

from __future__ import annotations

import os
import random
import re
import resource
import signal
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bars import ROOT, Bar
from mutations import SPLIT, Mutator, Source, read_sources

SECONDS = 10  # of computing, for one mutant; more is a hang
# Mutants of one process, and of one that runs the passes of a test file. To start a process takes
# as long as ten mutants.
BATCH, BATCH_OF_FILE = 200, 80
PIPELINES = [
    "--tai-to-llvm",
    "--tai-autodiff --tai-to-llvm",
    "--tai-to-nvvm",
    "--tai-autodiff --tai-to-nvvm",
    "--tai-forward-diff --tai-to-llvm",
    "--tai-autodiff",
]


@dataclass(frozen=True)
class Upstream:
    """A crash of MLIR 22 before any code of ours sees the module.

    It is known by the construct that a text needs for it, because a stripped or static build names
    no function: the text crashes without any pass, and the same text with something harmless in
    place of the construct gets through all passes.
    """

    reason: str
    construct: re.Pattern
    harmless: Callable[[re.Match], str]
    report: str = ""  # a part of the process's output


COMPOSITE = r"\b(?:(?:tensor|memref|tuple|complex)<[^<>\n]*>|none\b|index\b)"
KNOWN_UPSTREAM = [
    Upstream("%j = affine.apply (...)(%j): the verifier follows the operand without end",
             re.compile(r"(?P<own>%\w+) = affine\.apply [^\n]*(?P=own)\b[^\n]*"),
             lambda match: f"{match['own']} = arith.constant 0 : index"),
    Upstream("array<index: ...>: an index type is asked for its bits",
             re.compile(r"(array<\s*)index"), lambda match: f"{match[1]}i64"),
    Upstream("llvm.atomicrmw of a type that is neither a scalar nor a vector",
             re.compile(rf".*\batomicrmw\b.*{COMPOSITE}.*"),
             lambda match: re.sub(COMPOSITE, "f32", match[0])),
    Upstream("llvm.extractvalue [4294967296]: a position of a struct is compared in 32 bits",
             re.compile(r".*\b(?:extract|insert)value\b.*\d{10}.*"),
             lambda match: re.sub(r"\d{10,}", "0", match[0])),
    Upstream("%r#2147483647: room for as many", re.compile(r"#\d{8,}"), lambda _: "#0",
             "LLVM ERROR: out of memory"),
]  # fmt: skip
# A text that may crash so goes through a process of its own, and takes no others with it.
RISKY = re.compile("|".join(f"(?:{crash.construct.pattern})" for crash in KNOWN_UPSTREAM))
# A frame as the loader names it, which knows the exported functions, and by a symbolizer.
FRAME = re.compile(
    r"^(?:\d+\s+(?P<library>\S+)\s+0x[0-9a-f]+(?: (?P<name>.*?)(?: \+ \d+)?)?"
    r"| *#\d+ 0x[0-9a-f]+ (?P<symbol>\S.*) \S+)$",
    re.MULTILINE,
)


@dataclass
class Outcome:
    """How one process ended: 'ok', 'hang', 'late', or a signal with the frames it came from."""

    kind: str
    frames: list[str] = field(default_factory=list)
    report: str = ""
    # Why MLIR itself dies of this, or nothing.
    known: str = ""

    @property
    def place(self) -> str:
        """The first frames, as one line."""
        return f"{self.kind} in {' < '.join(self.frames[:3]) or 'unknown'}"


def limit(seconds: int) -> None:
    """The limits of a child: a mutant that wants all memory dies instead of the machine."""
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def frames_of(trace: str) -> list[str]:
    """The functions of a stack trace below the signal handler, or their libraries."""
    frames = []
    for match in FRAME.finditer(trace):
        name = (match["symbol"] or match["name"] or "").replace("(anonymous namespace)::", "")
        frames.append(re.sub(r"\(.*", "", name) or match["library"])
    skipped = re.compile(
        r"^llvm::(sys::|report_)|^libc|^libLLVM|^(SignalHandler|__pthread_kill.*|abort|raise)$"
    )
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
        How it ended ('ok', 'hang' or 'late'), its status, and its output.
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


def call(
    tool: Path, options: str, texts: list[str], folder: Path, left: float, *, names: bool = False
) -> Outcome:
    """Runs tai-opt on the texts as one file, for at most the time that is left.

    Args:
        names: whether a symbolizer may name the functions of a crash, which takes seconds.
    """
    path = folder / "batch.mlir"
    path.write_text("\n// -----\n".join(texts), encoding="utf-8", errors="surrogateescape")
    command = [tool, "--split-input-file", "--mlir-disable-threading", *options.split(), path]
    kind, status, _, error = run_limited(
        [*command, "-o", "/dev/null"], SECONDS, left, stdout=subprocess.DEVNULL,
        env=os.environ | ({} if names else {"LLVM_DISABLE_SYMBOLIZATION": "1"}),
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


def explain(
    tool: Path, options: str, text: str, outcome: Outcome, folder: Path, left: Callable[[], float]
) -> Outcome:
    """The outcome of a text that crashes, with the reason why it is known or better names."""
    reasons, harmless = [], text
    for crash in KNOWN_UPSTREAM:
        if crash.report in outcome.report and crash.construct.search(text):
            reasons.append(crash.reason)
            harmless = crash.construct.sub(crash.harmless, harmless)
    if (
        reasons
        and call(tool, "", [text], folder, left()).kind == outcome.kind
        and call(tool, options, [harmless], folder, left()).kind == "ok"
    ):
        return replace(outcome, known=", ".join(reasons))
    named = call(tool, options, [text], folder, left(), names=True)
    return named if named.kind == outcome.kind and named.frames else outcome


def find_failures(
    tool: Path, options: str, texts: list[str], folder: Path, left: Callable[[], float]
) -> Iterator[tuple[str, Outcome]]:
    """The texts of a batch that end their process, by halves.

    Args:
        left: the seconds that are left of the run. Texts that are not tried when they are over come
            as one text that is 'late'.
    """
    outcome = call(tool, options, texts, folder, left())
    if outcome.kind == "ok":
        return
    if len(texts) == 1 or outcome.kind == "late":
        if outcome.kind.startswith("signal"):
            outcome = explain(tool, options, texts[0], outcome, folder, left)
        yield "\n// -----\n".join(texts), outcome
        return
    middle = len(texts) // 2
    yield from find_failures(tool, options, texts[:middle], folder, left)
    yield from find_failures(tool, options, texts[middle:], folder, left)


def generic_forms(tool: Path, texts: list[str]) -> list[str]:
    """The texts as MLIR prints any op, in which regions may be what no parser of an op lets by.

    A text that cannot be parsed stays as it is.
    """
    with tempfile.TemporaryFile() as given:
        given.write("\n// -----\n".join(texts).encode(errors="replace"))
        given.seek(0)
        command = [tool, "--split-input-file", "--mlir-disable-threading",
                   "--mlir-print-op-generic", "--mlir-print-local-scope"]  # fmt: skip
        limit = 20 * SECONDS
        kind, _, out, _ = run_limited(command, limit, 20 * limit, stdin=given,
                                      stdout=subprocess.PIPE)  # fmt: skip
    forms = SPLIT.split(out.decode(errors="replace"))
    if kind != "ok" or len(forms) != len(texts):
        raise RuntimeError(f"{len(texts)} texts, {len(forms)} forms: {kind}")
    return [form if form.strip() else text for form, text in zip(forms, texts, strict=True)]


class Choices:
    """Draws the mutants of one process after another, and the passes they go through."""

    def __init__(self, sources: list[Source], seed: int, tool: Path):
        self.sources = sources
        self.weights = [1 if piece.invalid else 6 for piece in sources]
        self.mutator = Mutator(sources, seed)
        self.random = random.Random(seed)
        texts = [source.text for source in sources]
        self.forms = dict(zip(texts, generic_forms(tool, texts), strict=True))

    def batch(self, most: int) -> tuple[str, list[str]]:
        """Options of tai-opt, and mutants: of any files, or of the one whose passes these are."""
        source = self.random.choices(self.sources, self.weights)[0]
        options = self.random.choice([*PIPELINES, *source.options * 2])
        if options in PIPELINES:
            pieces = self.random.choices(self.sources, self.weights, k=min(BATCH, most))
        else:
            pieces = [other for other in self.sources if other.path == source.path]
            pieces = self.random.choices(pieces, k=min(BATCH_OF_FILE, most))
        texts = [self.forms[piece.text] if self.random.random() < 0.3 else piece.text
                 for piece in pieces]  # fmt: skip
        return options, [self.mutator.mutate(text) for text in texts]


def judge_batch(
    tool: Path, options: str, texts: list[str], folder: Path, left: Callable[[], float]
) -> Iterator[tuple[str, Outcome]]:
    """The texts that end their process; see `find_failures`."""
    risky = [text for text in texts if RISKY.search(text)]
    for text in risky:
        yield from find_failures(tool, options, [text], folder, left)
    if others := [text for text in texts if not RISKY.search(text)]:
        yield from find_failures(tool, options, others, folder, left)


def main() -> None:
    bar = Bar(
        "R1", "mutants of .mlir text", full=100_000, short=1200, adds=True,
        target="100,000 mutants through tai-opt and whole pipelines: no signal, no hang",
        miss="a mutant that ends tai-opt by a signal or computes for more than 10 s",
    )  # fmt: skip
    bar.parser.add_argument("--keep", type=Path, help="folder for the mutants that fail")
    args = bar.parse()
    tool = args.build / "bin/tai-opt"
    choices = Choices(read_sources(ROOT / "test"), args.seed, tool)
    done = late = 0
    counts: Counter[str] = Counter()
    places: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        while done < args.count and bar.left() > 0:
            options, texts = choices.batch(args.count - done)
            late = 0
            for text, outcome in judge_batch(tool, options, texts, Path(folder), bar.left):
                late += len(SPLIT.split(text)) if outcome.kind == "late" else 0
                kind = "known" if outcome.known else outcome.kind.split()[0]
                counts[kind] += 1
                place = f"{outcome.place} ({options})"
                places[outcome.known or outcome.place] += 1
                if kind != "known":
                    print(place, flush=True)
                if args.keep:
                    args.keep.mkdir(parents=True, exist_ok=True)
                    (args.keep / f"{kind}-{sum(counts.values())}.mlir").write_text(
                        f"// {place}\n{text}", errors="surrogateescape"
                    )
            done += len(texts) - late
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
