"""R5: kernels that are wrong get an error that teaches.

The kernels are those of the files bad_*.py of test/python. Each error must name the file and the
line, show it with a caret under the part that is wrong, say why in words of Python and of the
package, and what to do. A process of its own runs each file, so that one that dies is counted, too.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import json
import re
import signal
import subprocess
import sys
import traceback

from bars import ROOT, Bar

FILES = sorted((ROOT / "test/python").rglob("bad_*.py"))
LEAST = 150
# Words that only authors of the compiler know.
INTERNAL = re.compile(
    r"memref|\btai\.|NoneType|mlir|llvm\.|arith\.|scf\.|\bcf\.|\bSSA\b|'@\w|<class|object at 0x|"
    r"Traceback|[A-Z]\w+(Value|Argument|Place|Node)\b|assert(ion)? failed in",
    re.IGNORECASE,
)
SECONDS = 60  # for one kernel; more is a hang


def judge(function, kind: type[Exception]) -> list[str]:
    """The parts that the error of one kernel lacks."""
    import tai as ti

    ti.init(arch=ti.cpu, offline_cache=False)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            function()
    except ti.TaiError as caught:
        error = caught
    except Exception as caught:
        return [f"a raw {type(caught).__name__}: {caught}"]
    else:
        return ["accepted"]
    lines, start = inspect.getsourcelines(function)
    if function.__name__ == "recursion":  # the mistake is in a function beside it
        lines, start = inspect.getsourcelines(sys.modules[function.__module__])
        marked = [start + i for i, line in enumerate(lines, 1) if "# BAD-RECURSION" in line]
    else:
        marked = [start + i for i, line in enumerate(lines) if "# BAD" in line]
    text = str(error)
    # The program's own text, and the path of its file, may hold any word.
    shown = text.splitlines()
    words = [line for line in shown if not re.match(r"\s*(-->|\d+ \||\| )", line)]
    lacks = []
    if not isinstance(error, kind):
        lacks.append(f"a {type(error).__name__}, not a {kind.__name__}")
    if error.filename != function.__code__.co_filename or error.lineno not in marked:
        lacks.append(f"at {error.filename}:{error.lineno}, not at line {marked}")
    if not any(re.fullmatch(r"\s*\|\s*\^+", line) for line in shown):
        lacks.append("no caret")
    if not error.hint and "note: " not in text:
        lacks.append("no hint")
    if found := INTERNAL.search("\n".join(words)):
        lacks.append(f"speaks of '{found[0]}'")
    return [f"{lack}\n{text}" for lack in lacks]


def work(name: str) -> None:
    """Judges the kernels of a file; the number first, then one line for each."""
    sys.path.insert(0, str(FILES[0].parent))
    importlib.import_module(name)
    import bad_register

    print(json.dumps(len(bad_register.CASES)), flush=True)
    for function, kind, *_ in bad_register.CASES:
        # Its default action ends the process.
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            lacks = judge(function, kind)
        except BaseException:
            lacks = [f"in the script: {traceback.format_exc()}"]
        print(json.dumps([function.__name__, lacks]), flush=True)


def main() -> None:
    bar = Bar(
        "R5", "bad Python kernels", full=LEAST, short=LEAST,
        target=f"{LEAST} kernels and more: each error with file, line, caret, reason and hint",
        miss="a kernel that is accepted, aborts or hangs, or whose error lacks one of these or "
        "speaks of the compiler's insides",
    )  # fmt: skip
    bar.parser.add_argument("--work")
    args = bar.parse()
    if args.work:
        work(args.work)
        return
    total = done = wrong = aborts = 0
    for path in FILES:
        if path.stem == "bad_register":
            continue
        command = [sys.executable, __file__, "--work", path.stem]
        run = subprocess.run(command, capture_output=True, text=True)
        lines = run.stdout.splitlines()
        total += int(lines[0]) if lines else 0
        done += len(lines[1:])
        for name, lacks in map(json.loads, lines[1:]):
            wrong += bool(lacks)
            for lack in lacks:
                print(f"{path.name}: {name}: {lack}", flush=True)
        if run.returncode != 0:
            aborts += 1
            print(f"{path.name}: ended with {run.returncode}\n{run.stderr[-2000:]}", flush=True)
    bar.report(
        f"{done} kernels", f"{wrong} errors that lack something, {aborts} aborts or hangs",
        met=not wrong and not aborts and done == total >= LEAST,
    )  # fmt: skip


if __name__ == "__main__":
    main()
