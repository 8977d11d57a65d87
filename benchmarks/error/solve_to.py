"""Measures `ti.solve_to`: asked error against true error, time and iterations, on scenes.

    .venv/bin/python benchmarks/error/solve_to.py                   # all, small
    .venv/bin/python benchmarks/error/solve_to.py --scenes wave,heat --errors 1e-4
    .venv/bin/python benchmarks/error/solve_to.py --write           # docs/reports/solve-to.md

The 19 scenes of the benchmark of errors, and programs that have steps or a tolerance to choose
(`programs.py`). The true error is that against 80-bit floats (kernels), adjoints in NumPy (scenes
of `test/python/reference`), closed forms or 60 digits (programs); other scenes are compared with
shadows of 80 bits (`references.py`). Each choice is made in a process of its own. Then all modes
run in turns, with the chosen steps or tolerance, and the fastest whose true error is within the one
that was asked for is the best.

Exits with 1 if a true error is above the one that was asked for, if a choice took more than 20
iterations or is slower than 1.2 times the best by more than the quartiles, or if a true error is
below 0.05 times the one that was asked for although steps or a tolerance could have filled the
room.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
import types
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "reports" / "solve-to.md"
TABLE = ROOT / "benchmarks" / "results" / "solve-to.json"
PICTURE = PAGE.parent / "pictures" / "solve-to.png"
ERRORS = [1e-2, 1e-5, 1e-9]
MOST_ITERATIONS, MOST_TIME, LEAST_ERROR = 20, 1.2, 0.05
# Rounds in which all modes are timed in turns; a time is the median, with quartiles.
ROUNDS = 9


def distances(found: tuple, exact: tuple) -> float:
    """The relative error of loss or gradient (L2), whichever is greater."""
    loss = abs(found[0] - exact[0]) / abs(exact[0])
    gradient = np.linalg.norm(found[1] - exact[1]) / np.linalg.norm(exact[1])
    return float(max(loss, gradient))


def prepare(name: str, size: str, reference: str):
    """The program (run, loss, unknowns), how to make its gradient flat, and the exact result."""
    import cases
    import programs

    if name in programs.PROGRAMS:
        case = programs.PROGRAMS[name]()
        picks = [lambda array: array] * len(case.wrt)
        return case.run, case.loss, case.wrt, picks, case.exact
    program = cases.make(name, "tai", size)
    if name in cases.micro.NAMES:
        data = cases.micro.data_of(name, size)
        found = data.exact()
        gradient = data.expand(np.asarray(found["gradient"], float))
        exact = float(found["loss"]), gradient
    elif name in cases.SHARED:
        exact = cases.problem_of(name, size).reference()
    else:
        with np.load(reference) as file:
            exact = float(file["loss"]), file["gradient"]
    if hasattr(program, "module"):
        picks = [lambda array: array] * len(program.unknowns)
        return program.forward, program.module.loss, program.unknowns, picks, exact

    def run() -> None:
        program._prepare()
        program._forward()

    unknowns, picks = zip(*program._unknowns, strict=True)
    return run, program._loss, list(unknowns), picks, exact


def measure(
    name: str, size: str, asked: float, kind: str, reference: str, cache: str, clock: str
) -> dict:
    """The choice for an error, and all modes beside it."""
    import tai as ti

    options = {"offline_cache": True, "offline_cache_file_path": cache}
    options["default_fp"] = getattr(ti, kind)
    if clock == "processor":
        from tai._impl.ad import solve

        # Other programs do not lengthen the processor's time much.
        solve.time = types.SimpleNamespace(perf_counter=time.process_time)
        options["cpu_max_num_threads"] = 1
    started = ti.init
    started(**options)
    ti.init = lambda *_, **__: started(**options)
    run, loss, wrt, picks, exact = prepare(name, size, reference)
    row: dict = {"scene": name, "asked": asked, "types": kind, "clock": clock}
    warnings.simplefilter("ignore")
    begin = time.perf_counter()
    try:
        found = ti.solve_to(run, loss=loss, wrt=wrt, error=asked)
    except ti.TaiError as failure:
        return row | {"refused": failure.message}
    row["seconds"] = time.perf_counter() - begin

    def flat(gradients) -> np.ndarray:
        parts = [pick(np.asarray(g)).ravel() for pick, g in zip(picks, gradients, strict=True)]
        return np.concatenate(parts)

    row["true"] = distances((found.loss, flat(found.gradients)), exact)
    row |= {"expected": found.error, "iterations": found.iterations, "modes": found.modes,
            "room": found.room,
            "parts": {part.name: part.error for part in found.parts}}  # fmt: skip
    return row | compare(run, loss, wrt, flat, exact, found, asked)


def compare(run, loss, wrt, flat, exact, found, asked: float) -> dict:
    """The time of the choice next to that of the best of all modes, in turns."""
    from tai._impl.ad import solve

    search = solve._Search(run, loss, wrt, None, asked)
    search._options = {key: found.modes[key] for key in ("steps", "tol") if key in found.modes}
    solve.MOST_ITERATIONS = math.inf
    try:
        search._discover()
        reference, _ = search._reference()
        choices = search._choices(search._estimate(reference))
        candidates = []
        for choice in choices:
            choice.version = search._version(
                choice.modes, search._types(choice.base, choice.narrow)
            )
            loss_there, gradient, _, _ = search._measure(choice.version)
            arrays = search._by_field(gradient)
            choice.errors = (distances((loss_there, flat(arrays)), exact),)
            if choice.errors[0] <= asked or is_chosen(choice, found):
                candidates.append(choice)
        chosen = next((c for c in candidates if is_chosen(c, found)), None)
        taken: dict[str, list[float]] = {choice.name: [] for choice in candidates}
        for _ in range(ROUNDS):
            for choice in candidates:
                choice.version.seconds = math.inf
                search._measure(choice.version)
                taken[choice.name].append(choice.version.seconds)
        times = {name: statistics.quantiles(found, n=4) for name, found in taken.items()}
        within = [c for c in candidates if c.errors[0] <= asked]
        best = min(within, key=lambda c: times[c.name][1], default=None)
        if chosen is None or best is None:
            return {"best": None, "ratio": None}
        return {
            "best": best.name, "best_error": best.errors[0], "chosen": chosen.name,
            "ms": 1e3 * times[chosen.name][1],
            "ratio": times[chosen.name][1] / times[best.name][1],
            # The least ratio that the quartiles allow.
            "least_ratio": times[chosen.name][0] / times[best.name][2],
            "wider": max((c.errors[0] for c in within), default=None),
        }  # fmt: skip
    finally:
        search._start.restore()


def is_chosen(choice, found) -> bool:
    """Whether a choice has the modes of the result."""
    modes = found.modes
    has_narrow = any(kind in ("f16", "bf16") for kind in modes["types"].values())
    return (
        choice.modes["precision"] == modes["precision"]
        and choice.modes.get("sums", "default") == modes["sums"]
        and choice.modes.get("math", "default") == modes["math"]
        and bool(choice.narrow) == has_narrow
    )


def verdict(row: dict) -> str:
    """In a word, whether the bars are kept."""
    if "refused" in row:
        return "refused"
    share = row["true"] / row["asked"]
    if share > 1:
        return "FAILS: more error than asked"
    if row["iterations"] > MOST_ITERATIONS:
        return "FAILS: iterations"
    if row["ratio"] is None:
        return "FAILS: slower than the best"
    if min(row["ratio"], row.get("least_ratio", row["ratio"])) > MOST_TIME:
        return "FAILS: slower than the best"
    if share >= LEAST_ERROR:
        return "in the band"
    if "steps" in row["modes"] or "tol" in row["modes"]:
        return "FAILS: room is left"
    return "no cheaper mode"


HEAD = (
    "| scene | asked | true | true / asked | expected | time / best | best of all | chosen | "
    "iterations | outcome |\n|---|---|---|---|---|---|---|---|---|---|"
)


def shown(row: dict) -> str:
    """A line of the table."""
    start = f"| {row['scene']} | {row['asked']:.0e} |"
    if "refused" in row:
        text = row["refused"].replace("|", "/")
        return f"{start} | | | | | | | refused: {text[:160]} |"
    modes = row["modes"]
    words = [row.get("chosen") or modes["precision"]]
    words += [f"{key}={modes[key]:.3g}" for key in ("steps", "tol") if key in modes]
    ratio = "–" if row["ratio"] is None else f"{row['ratio']:.2f}"
    return (
        f"{start} {row['true']:.1e} | {row['true'] / row['asked']:.2g} | {row['expected']:.1e} | "
        f"{ratio} | {row['best'] or '–'} | {', '.join(words)} | {row['iterations']} | "
        f"{verdict(row)} |"
    )


def page_of(rows: list[dict], size: str, has_picture: bool) -> str:
    """The page: each sentence with a figure is made of the rows."""
    done = [row for row in rows if "refused" not in row]
    above = [row for row in done if row["true"] > row["asked"]]
    knobs = [row for row in done if {"steps", "tol"} & set(row["modes"])]
    inside = [row for row in done if LEAST_ERROR <= row["true"] / row["asked"] <= 1]
    alone = [row for row in done if verdict(row) == "no cheaper mode"]
    outside = [row for row in done if row not in inside and row not in alone]
    inside_knobs = [row for row in knobs if row in inside]
    ratios = sorted(row["ratio"] for row in done if row["ratio"] is not None)
    quick = [row for row in done if "slower" not in verdict(row)]
    most = max((row["iterations"] for row in done), default=0)
    counts = Counter(row["machine"] for row in rows)
    machines = "; ".join(f"{name} ({count} calls)" for name, count in counts.items())
    lines = [
        "# An error that is asked for, and the true one",
        "",
        "Written by `python benchmarks/error/solve_to.py --write`, which describes references and",
        f"rules; {machines}, size {size}. Machines were shared with other work: ratios of times "
        "are of",
        f"medians over {ROUNDS} rounds in turns, and still a hint: a choice counts as slower than",
        "1.2 times the best only if the quartiles say so.",
        "",
        f"- {len(rows)} calls, {len(rows) - len(done)} refused, **{len(above)} with more error "
        "than asked**; at most "
        f"{most} iterations.",
        "- The true error is within 0.05 and 1 of the one asked for wherever a cheaper mode, steps "
        "or a tolerance can fill the",
        f"  room: **{len(inside)} of {len(inside) + len(outside)}** (of {len(knobs)} calls with "
        f"steps or a tolerance, {len(inside_knobs)}).",
        f"- In the other {len(alone)} calls the cheapest mode has less error than that: between 16 "
        "bits, f32 and f64 there is",
        "  nothing to choose from, and no mode that keeps the error is faster by more than 1.2 "
        "times. `result.room` says so.",
        "- The choice takes at most 1.2 times the best mode, but for the spread, in "
        f"{len(quick)} of {len(done)}"
        + (
            f" (median {ratios[len(ratios) // 2]:.2f}, at most {ratios[-1]:.2f})."
            if ratios
            else "."
        ),
        "",
        *([f"![asked and true errors](pictures/{PICTURE.name})", ""] if has_picture else []),
        "## Where there is room",
        "",
        HEAD,
        *(shown(row) for row in rows if row not in alone),
        "",
        "## Where the cheapest mode has less error than was asked for",
        "",
        HEAD,
        *map(shown, alone),
    ]
    return "\n".join(lines) + "\n"


def draw(rows: list[dict], path: Path) -> bool:
    """A panel for each scene: the asked error against the true one, and its time.

    Returns whether there is a picture: none without matplotlib.
    """
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(row["scene"] for row in rows if "refused" not in row))
    columns = 6
    height = math.ceil(len(names) / columns)
    figure, axes = pyplot.subplots(
        height, columns, figsize=(2.2 * columns, 1.9 * height), squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes.flat, names, strict=False):
        mine = [row for row in rows if row["scene"] == name and "refused" not in row]
        asked = [row["asked"] for row in mine]
        axis.plot([1e-13, 1], [1e-13, 1], color="0.8", linewidth=0.8)
        axis.plot(asked, [max(row["true"], 1e-17) for row in mine], "o-", markersize=3)
        axis.set(xscale="log", yscale="log", title=name, xlim=(1e-13, 1), ylim=(1e-17, 1))
        axis.tick_params(labelsize=6)
        axis.title.set_fontsize(8)
        times = axis.twinx()
        known = [(row["asked"], row["ms"]) for row in mine if row.get("ms")]
        if known:
            times.plot(*zip(*known, strict=True), "s:", color="tab:red", markersize=2.5)
            times.set_yscale("log")
        times.tick_params(labelsize=5, colors="tab:red", which="both")
    for axis in axes.flat[len(names) :]:
        axis.set_axis_off()
    figure.suptitle("asked error (x), true error (blue, left), ms of an iteration (red, right)",
                    fontsize=9)  # fmt: skip
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
    return True


def main() -> int:
    import cases
    import harness
    import programs

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [*cases.NAMES, *programs.PROGRAMS]
    parser.add_argument("--scenes", default=",".join(names))
    parser.add_argument("--size", default="tiny", choices=["tiny", "quick", "full"])
    parser.add_argument("--errors", default=",".join(map(str, ERRORS)))
    parser.add_argument("--types", default="f32", choices=["f32", "f64"])
    parser.add_argument("--clock", default="wall", choices=["wall", "processor"],
                        help="the processor's is of one thread")  # fmt: skip
    parser.add_argument("--timeout", type=float, default=120, help="seconds of a call")
    parser.add_argument("--budget", type=float, default=math.inf, help="seconds of all calls")
    parser.add_argument("--write", action="store_true", help="the page and its picture")
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    errors = [float(text) for text in args.errors.split(",")]
    if args.one:
        stream = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)
        reference, cache = args.one.split(",")
        row = measure(args.scenes, args.size, errors[0], args.types, reference, cache, args.clock)
        print(json.dumps(row), file=stream, flush=True)
        return 0
    scenes = args.scenes.split(",")
    for scene in scenes:
        if scene not in names:
            parser.error(f"unknown scene '{scene}', known are {', '.join(names)}")
    rows = json.loads(TABLE.read_text())["rows"] if args.resume and TABLE.is_file() else []
    known = {(row["scene"], row["asked"]) for row in rows}
    print(HEAD)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as work:
        for scene in scenes:
            wanted = [error for error in errors if (scene, error) not in known]
            if not wanted or time.monotonic() - begin > args.budget:
                continue
            reference = Path(work) / scene / "0.npz"
            if scene in cases.EXAMPLES:
                try:
                    keep(scene, args.size, reference, work, args.timeout)
                except subprocess.TimeoutExpired:
                    print(f"{scene}: no reference in {args.timeout:.0f} s", file=sys.stderr)
                    continue
            for error in wanted:
                row = call(scene, error, args, reference, work)
                if row is not None:
                    rows.append(row | {"machine": harness.machine()})
                    print(shown(row), flush=True)
                    if args.write:
                        text = json.dumps({"size": args.size, "rows": rows}, indent=1)
                        TABLE.write_text(text + "\n")
    if args.write:
        # Rows that were kept keep their machine.
        rows.sort(key=lambda row: (names.index(row["scene"]), -row["asked"]))
        has_picture = draw(rows, PICTURE)
        PAGE.write_text(page_of(rows, args.size, has_picture))
    failed = [row for row in rows if verdict(row).startswith("FAILS")]
    for row in failed:
        print(f"{row['scene']} {row['asked']:.0e}: {verdict(row)}", file=sys.stderr)
    return int(bool(failed))


def keep(scene: str, size: str, path: Path, cache: str, timeout: float) -> None:
    """Writes loss and gradient from shadows of 80 bits."""
    command = [sys.executable, str(HERE / "references.py"), "--scene", scene, "--size", size]
    command += ["--count", "1", "--out", str(path.parent), "--cache", cache]
    subprocess.run(command, capture_output=True, check=False, timeout=timeout)


def call(scene: str, error: float, args, reference: Path, cache: str) -> dict | None:
    """The row of a call, in a process of its own; None if it could not be measured."""
    command = [sys.executable, __file__, "--scenes", scene, "--size", args.size]
    command += ["--errors", str(error), "--types", args.types, "--clock", args.clock]
    command += ["--one", f"{reference},{cache}"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=HERE, check=False, timeout=args.timeout
        )
    except subprocess.TimeoutExpired:
        print(f"{scene} {error:.0e}: longer than {args.timeout:.0f} s", file=sys.stderr)
        return None
    if done.returncode:
        print(f"{scene} {error:.0e}: failed\n{done.stderr[-1500:]}", file=sys.stderr)
        return None
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    sys.exit(main())
