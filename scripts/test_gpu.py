"""Test and time the project on a machine with a GPU, from the portable bundle.

    scripts/test_gpu.py [--tests] [--bench] [--sanitize] [--minutes 9] [-k expression]

Unpacks the bundle (dist/tai-portable-*.tar.xz, or --bundle), compiles the Python module for
the interpreter that runs this script, copies the tests beside it, and runs the chosen steps:

    tests     the Python tests with --arch=cuda, whole programs in IR among them, in parallel
    bench     benchmarks/gpu/run.py: tai, hand-written CUDA, and other systems
    errors    benchmarks/error/run.py: run time against error on the GPU; with --arch cpu, on
              one thread of the CPU
    functions all arguments of functions of one f32 (scripts/exhaustive.py), on the GPU or the CPU;
              what --out holds from an earlier run is not done again
    fuzz      random kernels on the GPU, of up to two million elements; see test/fuzz/run.py
    ensemble  examples/ensemble.py on 1, 2 and 4 GPUs, as many as there are
    bars      the bars of test/reliability that can run on a GPU, from seeds of their own
    sanitize  some of the tests under compute-sanitizer, where there is one, on all GPUs;
              -k test_ takes all of them

Without a choice, tests, bench and fuzz. Needs Python 3.11 or newer with NumPy, pytest and pybind11,
and a C++ compiler; no LLVM. The results of each step go into one report and one log in --out, also
when the time is up or a step dies. `--arch emulated` and `--arch cpu` do the same without a GPU;
`--build build` takes a build of this checkout instead of the bundle.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tarfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks" / "gpu"))

# Files that tests read besides the package.
TREE = [
    "test",
    "benchmarks",
    "docs",
    "editors",
    "examples",
    "scripts",
    "README.md",
    "pyproject.toml",
]
# How the time is shared among the steps.
SHARES = {
    "tests": 4,
    "bench": 5,
    "errors": 5,
    "functions": 8,
    "fuzz": 1,
    "ensemble": 2,
    "bars": 3,
    "sanitize": 4,
}
# Tests that run under compute-sanitizer: each kind of access once, it is slow.
SANITIZED = (
    "test_fields or test_gradients or test_atomic_gradients or test_loop_gradients or "
    "test_sparse_gradients or test_benchmark_scenes"
)
TOOLS = ["memcheck", "racecheck", "initcheck", "synccheck"]


@dataclass
class Step:
    """The result of a step, for the report."""

    name: str
    seconds: float = 0.0
    summary: str = "did not run"
    failed: bool = True
    details: list[str] = field(default_factory=list)


class Log:
    """The one log: every command, and its output."""

    def __init__(self, path: Path):
        self.stream = path.open("w")

    def __call__(self, text: str) -> None:
        self.stream.write(text.rstrip("\n") + "\n")
        self.stream.flush()

    def say(self, text: str) -> None:
        print(f"test-gpu: {text}", flush=True)
        self(text)


class Machine:
    """Runs commands within a time, with all they print in the log."""

    def __init__(self, log: Log, minutes: float):
        self.log = log
        self.deadline = time.monotonic() + 60.0 * minutes

    def left(self) -> float:
        return self.deadline - time.monotonic()

    def run(
        self, command: list[object], seconds: float, cwd: Path, environment: dict[str, str]
    ) -> tuple[int | None, str]:
        """Exit status, or None where the time was up, and the output."""
        words = [str(word) for word in command]
        self.log(f"$ {' '.join(words)}")
        process = subprocess.Popen(
            words, cwd=cwd, env=os.environ | environment, text=True, errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            output, _ = process.communicate(timeout=max(seconds, 1.0))
            status = process.returncode
        except subprocess.TimeoutExpired:
            # An interrupted test runner still reports its results.
            os.killpg(process.pid, signal.SIGINT)
            try:
                output, _ = process.communicate(timeout=10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                output, _ = process.communicate()
            status = None
        self.log(output)
        return status, output


def newest_bundle() -> Path | None:
    found = sorted((ROOT / "dist").glob("tai-portable-*.tar.xz"), key=lambda p: p.stat().st_mtime)
    return found[-1] if found else None


class Stage:
    """The bundle with its module and the tests, in a folder of its own."""

    def __init__(self, options: argparse.Namespace, machine: Machine):
        self.options = options
        self.machine = machine
        self.root = options.work / "tai"
        self.environment = {
            "PYTHONPATH": str(self.root / "python"),
            "TAI_BUILD_DIR": str(self.root),
            "TAI_COMMIT": os.environ.get("TAI_COMMIT") or self.commit(),
        }

    @staticmethod
    def commit() -> str:
        command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError:
            return ""
        return done.stdout.strip()

    def prepare(self) -> str:
        """Makes the folder; returns a description of its contents."""
        origin = self._unpack()
        if self.options.tree_python:
            ignored = shutil.ignore_patterns("__pycache__", "*.so")
            target = self.root / "python/tai"
            shutil.copytree(ROOT / "python/tai", target, dirs_exist_ok=True, ignore=ignored)
            origin += ", Python from the checkout"
        for name in TREE:
            source, target = ROOT / name, self.root / name
            if source.is_dir():
                shutil.rmtree(target, ignore_errors=True)
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(source, target)
        self._compile()
        return origin

    def _unpack(self) -> str:
        shutil.rmtree(self.root, ignore_errors=True)
        if self.options.build:
            build = self.options.build.resolve()
            command = ["cmake", "--install", build, "--prefix", self.root]
            self._must(command, "the build cannot be installed")
            return f"the build in {self.options.build}"
        bundle = self.options.bundle or newest_bundle()
        if not bundle or not bundle.exists():
            raise SystemExit("test-gpu: no bundle in dist/: make portable, or give --bundle")
        unpacked = self.options.work / "unpacked"
        shutil.rmtree(unpacked, ignore_errors=True)
        with tarfile.open(bundle) as archive:
            archive.extractall(unpacked, filter="data")
        (inner,) = unpacked.iterdir()
        inner.rename(self.root)
        digest = hashlib.sha256(bundle.read_bytes()).hexdigest()[:12]
        return f"{bundle.name}, sha256 {digest}…, {bundle.stat().st_size / 1e6:.1f} MB"

    def _compile(self) -> None:
        """Compiles the module for this interpreter; an earlier one for it is replaced."""
        compiler = next(filter(shutil.which, ("c++", "g++", "clang++", "clang++-22")), None)
        if not compiler:
            raise SystemExit("test-gpu: there is no C++ compiler")
        includes = ["-I", self.root / "include", "-I", ROOT / "include", *self._upstream()]
        asked = [sys.executable, "-m", "pybind11", "--includes"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit("test-gpu: this Python has no pybind11")
        flags = ["-std=c++17", "-O2", "-fPIC", "-fvisibility=hidden", *done.stdout.split()]
        source, objects, running = ROOT / "python/src", [], []
        for file in sorted(source.glob("*.cpp")):
            objects.append(self.options.work / f"{file.stem}.o")
            command = [compiler, *flags, *includes, "-c", file, "-o", objects[-1]]
            self.machine.log(f"$ {' '.join(map(str, command))}")
            pipe = subprocess.PIPE
            running.append(subprocess.Popen(list(map(str, command)), stderr=pipe, text=True))
        for process in running:
            _, errors = process.communicate()
            self.machine.log(errors)
            if process.returncode != 0:
                raise SystemExit(f"test-gpu: the Python module does not compile:\n{errors[-2000:]}")
        for old in (self.root / "python/tai").glob("_core*.so"):
            old.unlink()
        module = self.root / f"python/tai/_core{sysconfig.get_config_var('EXT_SUFFIX')}"
        link = [compiler, "-shared", *objects, "-L", self.root / "lib", "-ltai"]
        self._must(
            [*link, "-Wl,-rpath,$ORIGIN/../../lib", "-o", module],
            "the Python module cannot be linked",
        )
        # As what installs packages does.
        code = [sys.executable, "-m", "compileall", "-q", self.root / "python" / "tai"]
        self._must(code, "the package cannot be compiled")
        self._must([sys.executable, "-c", "import tai"], "the package cannot be imported")

    def _upstream(self) -> list[object]:
        """Where the headers of MLIR's C API are; the bundle has them itself."""
        if not self.options.build:
            return []
        cache = (self.options.build / "CMakeCache.txt").read_text()
        folder = re.search(r"^MLIR_DIR:\w+=(.*)$", cache, re.MULTILINE)
        return ["-I", Path(folder.group(1)).parents[2] / "include"] if folder else []

    def _must(self, command: list[object], complaint: str) -> None:
        status, output = self.machine.run(command, 300, self.options.work, self.environment)
        if status != 0:
            raise SystemExit(f"test-gpu: {complaint}:\n{output[-2000:]}")


def pytest_command(
    options: argparse.Namespace, expression: str | None, timeout: int = 120
) -> list[object]:
    command = [sys.executable, "-m", "pytest", "-v", "--tb=short", f"--arch={options.arch}"]
    command += ["-p", "no:cacheprovider"]
    if find_spec("pytest_timeout"):
        command += ["--timeout", timeout]
    if expression:
        command += ["-k", expression]
    return [*command, "test/python"]


def cases(junit: Path, output: str) -> tuple[Counter, list[str], Counter]:
    """Counts of outcomes, the names of failures, and how often each reason skipped a test.

    From the XML or, where there is none, from the output.
    """
    counts: Counter = Counter()
    reasons: Counter = Counter()
    failures = []
    if junit.exists() and junit.stat().st_size:
        for case in ElementTree.parse(junit).getroot().iter("testcase"):
            name = f"{case.get('classname', '')}::{case.get('name', '')}"
            bad = case.find("failure") if case.find("failure") is not None else case.find("error")
            skip = case.find("skipped")
            if bad is not None:
                counts["failed"] += 1
                lines = [line for line in (bad.get("message") or "").splitlines() if line.strip()]
                failures.append(f"`{name}`: {lines[0][:200] if lines else 'no message'}")
            elif skip is not None:
                counts["skipped"] += 1
                reasons[(skip.get("message") or "no reason")[:200]] += 1
            else:
                counts["passed"] += 1
        return counts, failures, reasons
    words = {"PASSED": "passed", "FAILED": "failed", "ERROR": "failed", "SKIPPED": "skipped"}
    outcome = "|".join(words)
    for line in output.splitlines():
        # With many processes the outcome comes first, with one it comes last.
        many = re.match(rf"\[gw\d+\].*\b({outcome}) (test/\S+::.+?)\s*$", line)
        one = re.match(rf"(test/\S+::.+?) ({outcome})\b", line)
        if many or one:
            word, name = (many[1], many[2]) if many else (one[2], one[1])
            counts[words[word]] += 1
            if words[word] == "failed":
                failures.append(f"`{name}`")
    return counts, failures, reasons


def run_tests(stage: Stage, seconds: float) -> Step:
    step, options = Step("tests"), stage.options
    junit = options.work / "tests.xml"
    junit.unlink(missing_ok=True)
    command = [*pytest_command(options, options.k), f"--junitxml={junit}"]
    if find_spec("xdist") and options.jobs > 1:
        command += ["-n", options.jobs]
    # JAX would take three quarters of the memory in the first process that imports it.
    environment = stage.environment | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    counts, failures, reasons = cases(junit, output)
    step.summary = ", ".join(f"{counts[w]} {w}" for w in ("passed", "failed", "skipped"))
    if status is None:
        step.summary += f"; stopped after {seconds:.0f} s"
    elif status != 0 and not failures:
        step.summary += f"; pytest ended with status {status}"
    step.failed = status != 0 or not counts["passed"]
    step.details = [f"failed: {failure}" for failure in failures]
    step.details += [f"skipped {n} times: {reason}" for reason, n in reasons.most_common()]
    return step


def run_bench(stage: Stage, seconds: float) -> Step:
    step, options = Step("bench"), stage.options
    arch = "cpu" if options.arch == "cpu" else "cuda"
    command = [sys.executable, "benchmarks/gpu/run.py", "--arch", arch, "--out", options.out]
    command += ["--work", options.work / "bench", "--minutes", f"{(seconds - 20) / 60:.2f}"]
    command += ["--name", options.name, *(["--only", options.only] if options.only else [])]
    if options.quick:
        command.append("--quick")
    if options.arch != "cuda":
        command += ["--small", "--no-floors", "--peers", ""]
    environment = stage.environment | {"TI_ARCH": ""}
    if options.arch == "emulated":
        environment["TAI_CUDA_EMULATION"] = "1"
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    report = options.out / f"gpu-{options.name}.md"
    lines = report.read_text().splitlines() if report.exists() else []
    if "## Figures and bars" in lines:
        begin, end = lines.index("## Figures and bars") + 1, lines.index("## Agreement")
        step.details = lines[begin:end]
    judged = [line.split("|")[-2].strip() for line in step.details if line.startswith("|")]
    step.summary = f"{judged.count('met')} bars met, {judged.count('**missed**')} missed, "
    step.summary += f"{judged.count('not measured')} not measured; see {report.name}"
    if status is None:
        step.summary += f"; stopped after {seconds:.0f} s"
    elif status != 0:
        step.summary += "; some programs did not run or were wrong"
    step.failed = status != 0
    return step


def run_errors(stage: Stage, seconds: float) -> Step:
    """Run time against error; benchmarks/error/page.py makes the page from the rows, anywhere."""
    step, options = Step("errors"), stage.options
    arch = "cpu" if options.arch == "cpu" else "cuda"
    command = [sys.executable, "benchmarks/error/run.py", "--arch", arch, "--threads", "1"]
    command += ["--minutes", f"{(seconds - 25) / 60:.2f}", "--out", options.out, "--no-page"]
    command += ["--work", options.work / "errors", "--systems", "tai,jax,torch"]
    command += ["--machine", options.name, *(["--quick"] if options.quick else [])]
    environment = stage.environment | {"TI_ARCH": ""}
    if options.arch == "emulated":
        environment["TAI_CUDA_EMULATION"] = "1"
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    lines = output.splitlines()
    step.details = [line for line in lines if re.match(r"(keeps|FAILS|not judged) ", line)]
    kept = sum(line.startswith("keeps") for line in step.details)
    counted = [line for line in lines if " rows in " in line]
    step.summary = f"{kept} of {len(step.details)} bars kept; {counted[-1] if counted else 'cut'}"
    if status is None:
        step.summary += f"; stopped after {seconds:.0f} s"
    step.failed = status != 0
    # The log has the reasons of rows that failed.
    log = options.work / "errors" / "log.txt"
    if log.exists():
        shutil.copy2(log, options.out / "errors.log")
    return step


def run_functions(stage: Stage, seconds: float) -> Step:
    """All arguments of functions of one f32; scripts/exhaustive.py makes the page, anywhere."""
    step, options = Step("functions"), stage.options
    arch = "cpu" if options.arch == "cpu" else "cuda"
    path = options.out / f"functions-{options.name}-{arch}.json"
    command = [sys.executable, "scripts/exhaustive.py", "--arch", arch, "--out", path]
    command += ["--minutes", f"{(seconds - 20) / 60:.2f}", "--jobs", options.jobs]
    command += ["--stride", 4096] if options.quick else []
    environment = stage.environment | {"TI_ARCH": ""}
    if options.arch == "emulated":
        environment["TAI_CUDA_EMULATION"] = "1"
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    step.details = list(dict.fromkeys(re.findall(r"^\| `.*", output, re.MULTILINE)))
    done = sum(line.rstrip(" |").endswith("| all") for line in step.details)
    step.summary = f"{len(step.details)} functions, {done} of them at all arguments; {path.name}"
    if status is None:
        step.summary += f"; stopped after {seconds:.0f} s"
    step.failed = status != 0
    return step


def run_fuzz(stage: Stage, seconds: float) -> Step:
    step, options = Step("fuzz"), stage.options
    log = options.out / "fuzz.jsonl"
    log.unlink(missing_ok=True)
    # Other seeds each day: what fails is run again by the command that it prints.
    first = 1000 * (int(time.time()) // 86400)
    command = [sys.executable, "test/fuzz/run.py", "--targets", options.arch, "--first", first]
    command += ["--jobs", options.jobs, "--log", log, "--minutes", f"{(seconds - 15) / 60:.2f}"]
    environment = stage.environment | {"TAI_VERIFY_EACH": "1"}
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    counted = [line for line in output.splitlines() if " programs: " in line]
    step.summary = counted[-1] if counted else f"ended with status {status}"
    step.details = [line for line in output.splitlines() if line.startswith(("seed", "  run.py"))]
    step.failed = status != 0 or not counted or counted[-1].startswith("0 ")
    return step


def devices(options: argparse.Namespace) -> int:
    """How many processes of an ensemble have a processor of their own."""
    if options.arch != "cuda":
        return 2
    listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, check=False)
    return sum(line.startswith("GPU ") for line in listing.stdout.splitlines())


def run_ensemble(stage: Stage, seconds: float) -> Step:
    step, options = Step("ensemble"), stage.options
    step.failed = False
    if not find_spec("torch"):
        step.summary = "this Python has no torch"
        return step
    arch, scenes = ("cuda", 262144) if options.arch == "cuda" else ("cpu", 256)
    environment = stage.environment | {"TI_ARCH": ""}
    if options.arch == "emulated":
        # Only tai's: to torch there is no GPU.
        environment |= {"TI_ARCH": "cuda", "TAI_CUDA_EMULATION": "1"}
    numbers = [n for n in (1, 2, 4, 8) if n <= devices(options)]
    for number in numbers:
        command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
        command += ["--nproc-per-node", number, "examples/ensemble.py", "--arch", arch]
        command += ["--scenes", scenes, "--iterations", 30]
        share = seconds / len(numbers)
        status, output = stage.machine.run(command, share, stage.root, environment)
        line = next((line for line in output.splitlines() if "scaling" in line), None)
        if status == 0 and line:
            step.details.append(f"- {line}")
        else:
            step.failed = True
            step.details.append(f"- {number} processes: failed with status {status}, see the log")
    step.summary = step.details[-1].removeprefix("- ") if step.details else "there is no GPU"
    step.failed = step.failed or not step.details
    return step


def run_bars(stage: Stage, seconds: float) -> Step:
    """Their results go into a table, which docs/reliability.md shows."""
    step, options = Step("bars"), stage.options
    arch = "cpu" if options.arch == "cpu" else "cuda"
    results = stage.root / f"benchmarks/results/reliability-{'cpu' if arch == 'cpu' else 'gpu'}.csv"
    results.unlink(missing_ok=True)
    command = [sys.executable, "test/reliability/soak.py", "--arch", arch]
    command += ["--all-seconds", f"{seconds - 15:.0f}"]
    environment = stage.environment | {"TAI_VERIFY_EACH": "1"}
    if options.arch == "emulated":
        environment["TAI_CUDA_EMULATION"] = "1"
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    step.details = [line for line in output.splitlines() if re.match(r"R\d+ .*\(bar .*\)$", line)]
    step.summary = f"{len(step.details)} bars, {'all met' if status == 0 else 'some missed'}"
    step.failed = status != 0 or not step.details
    if results.exists():
        shutil.copy2(results, options.out)
    return step


def run_sanitizers(stage: Stage, seconds: float) -> Step:
    step, options = Step("sanitize"), stage.options
    program = shutil.which("compute-sanitizer") or "/usr/local/cuda/bin/compute-sanitizer"
    if options.arch != "cuda" or not Path(program).exists():
        step.summary, step.failed = "there is no compute-sanitizer here, or no GPU", False
        return step
    # Each spends its time in one thread, so they run side by side, with parts of the tests.
    parts = max(options.jobs // len(TOOLS), 1)
    work = [(tool, part) for tool in TOOLS for part in range(parts)]
    gpus = max(devices(options), 1)
    with ThreadPoolExecutor(len(work)) as pool:
        running = [
            pool.submit(sanitize, stage, program, tool, f"{part}/{parts}", part % gpus, seconds)
            for tool, part in work
        ]
        found = [one.result() for one in running]
    for tool in TOOLS:
        ours = [part for (name, _), part in zip(work, found, strict=True) if name == tool]
        step.details += report_tool(options, tool, ours)
        step.failed = step.failed or any(part.found for part in ours)
    unfinished = sum(not part.summaries for part in found)
    step.summary = "not clean" if step.failed else "clean"
    if unfinished:
        step.summary += f", as far as it went: {unfinished} processes were stopped"
        step.failed = True
    return step


@dataclass
class Sanitized:
    """The findings of a tool in a part of the tests."""

    text: str
    summaries: list[int]
    found_before: list[str]
    tests: int
    counts: Counter
    failures: list[str]
    is_late: bool

    @property
    def found(self) -> int:
        return sum(self.summaries) + len(self.found_before) + len(self.failures)


def sanitize(
    stage: Stage, program: str, tool: str, part: str, gpu: int, seconds: float
) -> Sanitized:
    options = stage.options
    # A log for each process: a test may start others.
    name = f"{tool}-{part.replace('/', '-of-')}"
    logs = options.work / "sanitizer" / name
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir(parents=True)
    junit = options.work / f"{name}.xml"
    junit.unlink(missing_ok=True)
    command = [program, "--tool", tool, "--target-processes", "all", "--log-file", logs / "%p.log"]
    if tool == "memcheck":
        # The runtime asks whether an address is the device's: "no" comes as an error.
        command += ["--report-api-errors", "no"]
    command += pytest_command(options, options.k or SANITIZED, 600)
    # The summary comes from processes that end by themselves.
    command += [f"--junitxml={junit}", f"--part={part}", f"--stop-after={0.8 * seconds - 10:.0f}"]
    environment = stage.environment | {"CUDA_VISIBLE_DEVICES": str(gpu)}
    status, output = stage.machine.run(command, seconds, stage.root, environment)
    counts, failures, _ = cases(junit, output)
    texts = [log.read_text(errors="replace") for log in sorted(logs.iterdir())]
    text = "".join(texts)
    summaries = re.findall(r"(?:ERROR|RACECHECK) SUMMARY: (\d+)", text)
    # Stopped processes have reported their findings until then.
    stopped = "".join(text for text in texts if " SUMMARY: " not in text)
    found = re.findall(r"^========= (?!COMPUTE-SANITIZER|Target application)(\S.*)", stopped, re.M)
    chosen = re.search(r"^(\d+) tests chosen$", output, re.MULTILINE)
    tests = int(chosen[1]) if chosen else 0
    numbers = [int(n) for n in summaries]
    return Sanitized(text, numbers, found, tests, counts, failures, status is None)


def report_tool(options: argparse.Namespace, tool: str, parts: list[Sanitized]) -> list[str]:
    (options.out / f"sanitizer-{tool}.log").write_text("".join(part.text for part in parts))
    ended = [part for part in parts if part.summaries]
    errors = sum(sum(part.summaries) for part in ended)
    passed = sum(part.counts["passed"] for part in parts)
    failures = [failure for part in parts for failure in part.failures]
    line = (
        f"- {tool}: {errors} errors in {len(ended)} of {len(parts)} processes that have a summary"
    )
    line += f"; of {sum(part.tests for part in parts)} tests {passed} passed, "
    line += f"{len(failures)} failed, {sum(part.counts['skipped'] for part in parts)} skipped"
    late = sum(part.is_late for part in parts)
    before = [text for part in parts for text in part.found_before]
    line += f"; {late} stopped, {len(before)} errors before that" if late else ""
    return [line, *(f"  - {text}" for text in [*failures[:20], *before[:20]])]


STEPS = {
    "tests": run_tests,
    "bench": run_bench,
    "errors": run_errors,
    "functions": run_functions,
    "fuzz": run_fuzz,
    "ensemble": run_ensemble,
    "bars": run_bars,
    "sanitize": run_sanitizers,
}


def write_report(options: argparse.Namespace, origin: str, steps: list[Step]) -> Path:
    import run as benchmark

    path = options.out / f"test-gpu-{options.name}.md"
    machine = benchmark.machine("cpu" if options.arch == "cpu" else "cuda")
    if options.arch == "emulated":
        machine["device"] = "dry run without a GPU (emulated device)"
    lines = [f"# make test-gpu: {machine['device']}", ""]
    lines += [f"- {name}: {value}" for name, value in machine.items()]
    lines += [f"- tested: {origin}", "", "| step | result | seconds |", "| --- | --- | --- |"]
    lines += [f"| {s.name} | {s.summary} | {s.seconds:.0f} |" for s in steps]
    for step in steps:
        if step.details:
            bullets = step.name in ("tests", "fuzz", "bars")
            lines += ["", f"## {step.name}", ""]
            lines += [f"- {line}" if bullets else line for line in step.details]
    path.write_text("\n".join(lines) + "\n")
    return path


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in STEPS:
        parser.add_argument(f"--{name}", action="store_true", help=f"run the step {name}")
    parser.add_argument("--arch", default="cuda", choices=["cuda", "emulated", "cpu"])
    parser.add_argument("--bundle", type=Path, help="the archive; default: the newest in dist/")
    parser.add_argument("--build", type=Path, help="a build folder, instead of a bundle")
    parser.add_argument(
        "--tree-python", action="store_true", help="Python sources from here, not the bundle's"
    )
    parser.add_argument("-k", metavar="EXPRESSION", help="which tests, as pytest takes it")
    parser.add_argument("--jobs", type=int, default=8, help="tests at a time")
    parser.add_argument("--only", help="which groups of the benchmark, comma-separated")
    parser.add_argument("--quick", action="store_true", help="a shorter benchmark")
    parser.add_argument("--minutes", type=float, default=9.0, help="for all steps together")
    parser.add_argument("--name", help="of the machine, in the files' names")
    parser.add_argument("--out", type=Path, help="folder of report and logs")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "test-gpu" / "work")
    options = parser.parse_args()
    options.steps = [name for name in STEPS if getattr(options, name)] or ["tests", "bench", "fuzz"]
    options.out = (options.out or ROOT / "build" / "test-gpu").resolve()
    options.work = options.work.resolve()
    if options.bundle:
        options.bundle = options.bundle.resolve()
    for folder in (options.out, options.work):
        folder.mkdir(parents=True, exist_ok=True)
    if not options.name:
        import run as benchmark

        device = benchmark.machine(options.arch)["device"]
        options.name = "emulated" if options.arch == "emulated" else benchmark.name_of(device)
    return options


def main() -> int:
    options = parse_arguments()
    log = Log(options.out / "test-gpu.log")
    machine = Machine(log, options.minutes)
    steps = [Step(name) for name in options.steps]
    origin = "nothing: the bundle could not be prepared"
    try:
        begin = time.monotonic()
        stage = Stage(options, machine)
        origin = stage.prepare()
        log.say(f"{origin}; ready after {time.monotonic() - begin:.0f} s")
        for k, name in enumerate(options.steps):
            weight = SHARES[name] / sum(SHARES[other] for other in options.steps[k:])
            begin = time.monotonic()
            steps[k] = STEPS[name](stage, machine.left() * weight)
            steps[k].seconds = time.monotonic() - begin
            log.say(f"{name}: {steps[k].summary}")
            write_report(options, origin, steps)
    finally:
        print(f"test-gpu: the report is {write_report(options, origin, steps)}", flush=True)
    for step in steps:
        for line in step.details if step.name != "bench" else []:
            print(line)
    return 1 if any(step.failed for step in steps) else 0


if __name__ == "__main__":
    sys.exit(main())
