"""Plots of run time against error, and docs/reports/accuracy.md, from the rows of the benchmark.

    .venv/bin/python benchmarks/error/page.py --rows error-h200.csv [--out FOLDER]

The page answers four questions in at most 150 lines; the figures and a plot of each scene are in
docs/reports/accuracy/. Each sentence with a figure is made of the rows. It is refused for rows of
several commits, of a tree with changes, or of several sessions at one place.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import statistics
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import gates
import modes
import rows

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "reports" / "accuracy.md"
# A page and a plot for each scene, beside the page itself.
FOLDER = "accuracy"
TARGETS = (1e-2, 1e-4, 1e-6, 1e-10)
# A value for errors of zero, which cannot be drawn on a logarithmic axis.
LEAST = 1e-17
# Errors beyond this are losses of range, and not of digits.
OVERFLOW = 1e3
# Losses that the page lists; all are on the pages of scenes.
MOST_LOSSES = 30
# Marks in a plot.
MOST_MARKS = 5
ORDER = [mode.name for mode in modes.TAI]
# Where several modes are as fast, the first one is taken.
SIMPLEST = ["f32", "f64", *(name for name in ORDER if name not in ("f32", "f64"))]
# The unit roundoff of numbers that are stored in fewer bits than they are computed in.
STORED = {"f16 storage": 2.0**-11, "bf16 storage": 2.0**-8}


def groups_of(found: list[dict]) -> dict[tuple, list[dict]]:
    """Measured rows by scene and by the place where they ran."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows.measured(found):
        groups.setdefault((row["scene"], place_of(row)), []).append(row)
    return groups


def place_of(row: dict) -> str:
    """The card, or the processor and its threads, in words."""
    if row["arch"] == "cuda":
        # Its name stands last: "processor, cores, card".
        return row["machine"].rsplit(", ", 1)[-1]
    family = re.search(r"EPYC|Xeon|Ryzen|Core|Neoverse", row["machine"])
    cores = re.search(r"(\d+) cores", row["machine"])
    name = family[0] if family else "CPU"
    if row["threads"] == "1":
        return f"{name}, one thread"
    return f"{name}, {cores[1] if cores else 'all'} threads"


def split(group: list[dict]) -> tuple[list[dict], list[dict]]:
    ours = [row for row in group if row["system"] == modes.OURS]
    return ours, [row for row in group if row["system"] != modes.OURS]


def unit_of(row: dict) -> float:
    """The unit roundoff of a row's mode."""
    bits = modes.find(row["system"], row["mode"]).bits
    return STORED.get(row["mode"], {32: 2.0**-24, 64: 2.0**-53}[bits])


# Words


def number(value: float | None, form: str = ".2g") -> str:
    return "–" if value is None or math.isnan(value) else f"{value:{form}}"


def table(group: list[dict]) -> list[str]:
    """All rows of a scene, tai's first."""
    ours, peers = split(group)
    ours.sort(key=lambda row: ORDER.index(row["mode"]))
    peers.sort(key=lambda row: (row["system"], row["mode"]))
    has_ulp = any(row["max_ulp"] is not None for row in group)
    head = ["system, mode", "ms", "quartiles", "error", "range", "error / κu", "loss", "gradient"]
    head += ["cosine", *(["worst ulp"] if has_ulp else [])]
    head += ["results", "launches", "after descent", "MiB"]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in [*ours, *peers]:
        cells = [f"{row['system']}, {row['mode']}", number(row["ms"], ".3g")]
        cells += [f"{row['q1']:.3g} – {row['q3']:.3g}", amount(row["error"])]
        cells += [f"{amount(row['error_low'])} – {amount(row['error_high'])}"]
        known = row["condition"] and row["error"] <= OVERFLOW
        cells += [number(row["error"] / row["condition"] / unit_of(row)) if known else "–"]
        cells += [amount(row["loss_rel"]), amount(row["grad_rel"])]
        short = row["grad_cos"] is not None and row["grad_cos"] < 1 - 1e-9
        cells += [f"1 - {1 - row['grad_cos']:.1g}" if short else number(row["grad_cos"], ".0f")]
        cells += [number(row["max_ulp"], ".3g")] if has_ulp else []
        cells += [f"{row['distinct']:.0f} of {row['runs']:.0f}", number(row["launches"], ".0f")]
        cells += [number(row["final_loss"], ".6g"), number(row["peak_mb"], ".0f")]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def amount(error: float | None) -> str:
    """An error; one of range has a word."""
    return "overflow" if error is not None and not error <= OVERFLOW else number(error)


def best_against(peer: dict, ours: list[dict]) -> dict | None:
    """The fastest mode of tai that is as exact as a row of a peer, but for the spread."""
    good = [row for row in ours if rows.is_as_exact(row, peer)]
    return min(good, key=lambda row: row["ms"], default=None)


def standing(peer: dict, ours: list[dict]) -> str:
    """How tai stands at the error of a peer: "faster", "level" (within the spread) or "lost"."""
    best = best_against(peer, ours)
    if best is None or rows.is_faster(peer, best):
        return "lost"
    return "faster" if rows.is_faster(best, peer) else "level"


def counted(standings: Iterable[str]) -> str:
    """How many modes of peers some mode of tai dominates, in words."""
    counts = Counter(standings)
    total = sum(counts.values())
    return (
        f"{total - counts['lost']} of {total} modes of peers are dominated by some mode of tai, "
        f"{counts['faster']} by more than the spread of times"
    )


def verdict(group: list[dict]) -> str:
    """How many modes of peers some mode of tai dominates, and the others."""
    ours, peers = split(group)
    text = counted(standing(peer, ours) for peer in peers)
    lost = [row for row in peers if standing(row, ours) == "lost"]
    return f"{text}; not {', '.join(map(loss_of(ours), lost))}." if lost else f"{text}."


def loss_of(ours: list[dict]) -> Callable[[dict], str]:
    """A function that says by how much tai is slower than a row at its error."""

    def text(peer: dict) -> str:
        best = best_against(peer, ours)
        name = f"{peer['system']} {peer['mode']}"
        if best is None:
            return f"{name} (no mode of tai has an error of {peer['error']:.1e})"
        low, high = best["q1"] / peer["q3"], best["q3"] / peer["q1"]
        ratio = f"{best['ms'] / peer['ms']:.2f} ({low:.2f} to {high:.2f})"
        return f"{name} ({best['mode']} takes {ratio} times as long)"

    return text


def fastest(group: list[dict], target: float) -> dict | None:
    """The fastest mode within an error at all inputs; of those within its spread, the simplest."""
    ours = [row for row in split(group)[0] if row["mode"] != "f32 unguarded"]
    good = [row for row in ours if row["error_high"] <= target]
    best = min(good, key=lambda row: row["ms"], default=None)
    near = [row for row in good if not rows.is_faster(best, row)]
    return min(near, key=lambda row: SIMPLEST.index(row["mode"]), default=None)


def choice(group: list[dict]) -> list[str]:
    """The fastest mode for each greatest error."""
    cells = []
    for target in TARGETS:
        best = fastest(group, target)
        cells.append("–" if best is None else f"{best['mode']} ({best['ms']:.3g} ms)")
    return cells


def by_place(groups: dict[tuple, list[dict]]) -> dict[str, list[tuple[str, list[dict]]]]:
    """Scenes and their rows at each place."""
    places: dict[str, list[tuple[str, list[dict]]]] = {}
    for (scene, place), group in groups.items():
        places.setdefault(place, []).append((scene, group))
    return places


def choices(groups: dict[tuple, list[dict]]) -> list[str]:
    """How often each mode is the fastest within an error, at each place."""
    lines = [f"| where | {' | '.join(f'{t:.0e}' for t in TARGETS)} |"]
    lines += [f"|---|{'---|' * len(TARGETS)}"]
    for where, mine in by_place(groups).items():
        cells = []
        for target in TARGETS:
            found = [fastest(group, target) for _, group in mine]
            counts = Counter("none" if row is None else row["mode"] for row in found)
            cells.append(", ".join(f"{name} {count}" for name, count in counts.most_common(4)))
        lines.append(f"| {where} ({len(mine)} scenes) | {' | '.join(cells)} |")
    return lines


def losses(groups: dict[tuple, list[dict]]) -> list[str]:
    """For each place how many modes of peers are dominated, and the losses, the greatest first."""
    lines, lost = [], []
    for where, mine in by_place(groups).items():
        standings = []
        for scene, group in mine:
            ours, peers = split(group)
            for peer in peers:
                standings.append(standing(peer, ours))
                if standings[-1] == "lost":
                    best = best_against(peer, ours)
                    size = best["ms"] / peer["ms"] if best else math.inf
                    lost.append((size, f"- {scene}, {where}: {loss_of(ours)(peer)}"))
        if standings:
            lines.append(f"- **{where}**: {counted(standings)}.")
    lost.sort(key=lambda entry: -entry[0])
    lines += ["", "The losses, with the ratios that the quartiles allow:", ""] if lost else []
    lines += [text for _, text in lost[:MOST_LOSSES]]
    if len(lost) > MOST_LOSSES:
        lines.append(f"- and {len(lost) - MOST_LOSSES} more, on the pages of scenes")
    return lines or ["No peer was measured."]


def prices(groups: dict[tuple, list[dict]]) -> list[str]:
    """The cost and the gain of each mode next to f32, over all scenes and places."""
    lines = [
        "| mode | time next to f32 | slower, faster | error next to f32 | smaller | for what |",
        "|---|---|---|---|---|---|",
    ]
    for name in ORDER:
        slower, worse, overflows = [], [], 0
        counts: Counter = Counter()
        for group in groups.values():
            ours = {row["mode"]: row for row in split(group)[0]}
            if name not in ours or "f32" not in ours:
                continue
            mine, plain = ours[name], ours["f32"]
            slower.append(mine["ms"] / plain["ms"])
            counts["slower"] += rows.is_faster(plain, mine)
            counts["faster"] += rows.is_faster(mine, plain)
            if not mine["error"] <= OVERFLOW:
                overflows += 1
            elif plain["error"] <= OVERFLOW:
                worse.append(max(mine["error"], LEAST) / max(plain["error"], LEAST))
                counts["exact"] += rows.is_more_exact(mine, plain)
        if not slower:
            lines.append(f"| {name} | not measured | | | | {modes.ABOUT[name]} |")
            continue
        total = len(slower)
        about = f"{statistics.geometric_mean(slower):.2f} ({min(slower):.2g} to {max(slower):.2g})"
        about += f" | {counts['slower']}, {counts['faster']} of {total} | "
        if worse:
            error = statistics.geometric_mean(worse)
            about += f"{error:.2g} ({min(worse):.1g} to {max(worse):.1g})"
        about += f", overflow in {overflows}" if overflows else ""
        lines.append(f"| {name} | {about} | {counts['exact']} | {modes.ABOUT[name]} |")
    return lines


def trouble(found: list[dict]) -> list[str]:
    """Failures and missing peers, in one line for each reason."""
    reasons: dict[tuple, set[str]] = {}
    for row in found:
        if row["status"] != "ok":
            key = (row["system"], row["status"], row["reason"] or "no reason given")
            reasons.setdefault(key, set()).add(f"{row['scene']} ({row['mode']})")
    lines = []
    for (system, status, reason), where in sorted(reasons.items()):
        shown = ", ".join(sorted(where)[:6]) + (", …" if len(where) > 6 else "")
        lines.append(f"- {system}, {status}: {reason.replace('|', '/')}: {shown}")
    return lines


def bars(found: list[dict]) -> list[str]:
    """The bars, and how many figures keep each, at each place."""
    places: dict[str, list[dict]] = {}
    for row in found:
        places.setdefault(place_of(row), []).append(row)
    judged = {where: gates.judge(mine) for where, mine in places.items()}
    lines = [f"| bar, kept by (of) | {' | '.join(judged)} |", f"|---|{'---|' * len(judged)}"]
    for several in zip(*judged.values(), strict=True):
        cells = [
            f"{len(gate.found) - len(gate.broken)} ({len(gate.found)})" if gate.found else "–"
            for gate in several
        ]
        lines.append(f"| {several[0].name} | {' | '.join(cells)} |")
    return lines


def references_in_words(found: list[dict]) -> str:
    """The errors of the references, the greatest of them by name."""
    errors = {r["scene"]: r["reference_error"] for r in rows.measured(found)}
    known = {scene: error for scene, error in errors.items() if error is not None}
    if not known:
        return "The references have no error estimate."
    worst = max(known, key=lambda scene: known[scene])
    small = sum(error <= rows.FLOOR for error in known.values())
    return (
        f"Errors of the references: at most 1e-15 in {small} of {len(known)} scenes, the "
        f"greatest {known[worst]:.1e} ({worst})."
    )


def spreads_in_words(found: list[dict]) -> str:
    """How many inputs and rounds the rows have."""
    mine = rows.measured(found)
    inputs = Counter(int(row["inputs"]) for row in mine)
    rounds = Counter(int(row["rounds"]) for row in mine)
    few = sum(count for number, count in inputs.items() if number < max(inputs))
    less = sum(count for number, count in rounds.items() if number < max(rounds))
    text = f"{max(inputs)} inputs"
    text += f" ({few} of {len(mine)} rows: {min(inputs)} or more)" if few else ""
    text += f" and {max(rounds)} rounds"
    return text + (f" ({less} of {len(mine)} rows: {min(rounds)} or more)" if less else "")


INTRODUCTION = """
    How long an iteration takes (forward and backward) and how far its loss and its gradient are
    off, for each mode of numbers, on the examples at small sizes and on single kernels.
    `make bench-error` writes this page, the pages of scenes, and each sentence with a figure."""

METHOD = """
    One command, one commit, one session on each machine. The error is that of the loss or of the
    gradient (L2), whichever is greater: the median over the inputs of a scene and inputs whose
    numbers are each an ulp of f32 off, which all modes hold exactly. All modes of a scene are timed
    in turns; a time is the median over rounds, with quartiles. **A mode is faster only if the
    quartiles do not overlap, and more exact only if the ranges of errors do not.** Errors below
    1e-15 are equal. A greater error than 1000 is an overflow, and in no average. Kernels are
    compared with 80-bit floats in NumPy and sums that are rounded once; scenes with shadows of 80
    bits, four of which are compared with adjoints written by hand in NumPy in 80 bits, and all, at
    a tiny size, with 50 digits (`benchmarks/error/exact.py`). `make bench-error-gate` compares two
    commits."""

HINT = """
    Rows of a size other than full were measured in a hurry: their times are a hint, and so is all
    that rests on them."""

LEGEND = """
    *Error* is the median of the relative errors (L2) of the loss or of the gradient, whichever is
    greater, *range* the least and the greatest over inputs, *κu* the condition of the scene
    (the greatest change of loss or gradient when its inputs move by an ulp, in parts of theirs)
    times the unit roundoff of the mode: a mode cannot be much better than 1, and is bad for itself,
    not for the scene, far above it. *Loss* and *gradient* are medians, *cosine* is between the
    gradient and the true one, *results* how many different ones there were in how many runs,
    *after descent* the loss after some steps, *MiB* the most memory of the process, *ms* the median
    over rounds: the processor's time of one thread, or the clock's with all."""


def text_of(found: list[dict]) -> str:
    groups = groups_of(found)
    lines = ["# Run time against error", "", *_wrapped(INTRODUCTION), ""]
    lines += ["## Which mode for my error?", ""]
    lines += _wrapped(
        "In how many scenes each mode is the fastest of tai within an error (four modes at most; "
        "of modes within the spread, the simplest). [ti.solve_to](../guides/solve-to.md) chooses "
        "for a program and an error."
    )
    lines += ["", *choices(groups), "", "## The cost of a mode", ""]
    lines += _wrapped(
        "Geometric means with ranges; in how many cases a mode is slower and faster than f32, and "
        "its error smaller, by more than the spread."
    )
    lines += ["", *prices(groups), "", "## Where do we lose?", "", *losses(groups), ""]
    lines += ["### Bars", "", *bars(found), "", "## How was it measured?", "", *_wrapped(METHOD)]
    lines += ["", *_wrapped(f"{spreads_in_words(found)}. {references_in_words(found)}"), ""]
    for machine in dict.fromkeys(row["machine"] for row in found):
        mine = [row for row in found if row["machine"] == machine]
        systems = {f"{r['system']} {r['version']}" for r in mine if r["version"]}
        sizes = ", ".join(sorted({r["size"] for r in mine}))
        text = f"- {machine}; size {sizes}; tai at {mine[0]['git']}; {', '.join(sorted(systems))}"
        lines += textwrap.wrap(text, 110, subsequent_indent="  ")
    if any(row["size"] != "full" for row in found):
        lines += ["", *_wrapped(HINT)]
    scenes = list(dict.fromkeys(scene for scene, _ in groups))
    text = ", ".join(f"[{scene}]({FOLDER}/{scene}.md)" for scene in scenes)
    lines += ["", *_wrapped(f"Figures and a plot of each scene: {text}.")]
    failures = trouble(found)
    if failures:
        lines += ["", "Not measured:", "", *failures[:8]]
    assert len(lines) <= 150, f"the page has {len(lines)} lines"
    return "\n".join(lines) + "\n"


def scene_text(scene: str, groups: dict[tuple, list[dict]], has_picture: bool) -> str:
    """The page of a scene: its fastest modes, peers, and all figures."""
    lines = [f"# Run time against error: {scene}", "", *_wrapped(LEGEND), ""]
    mine = {place: group for (name, place), group in groups.items() if name == scene}
    known = next(iter(mine.values()))[0]
    own = number(known["reference_error"], ".1e")
    lines += [f"Condition {number(known['condition'])}; error of the reference {own}.", ""]
    lines += [f"![{scene}]({scene}.png)", ""] if has_picture else []
    lines += [f"| where | {' | '.join(f'{t:.0e}' for t in TARGETS)} |"]
    lines += [f"|---|{'---|' * len(TARGETS)}"]
    for place, group in mine.items():
        lines.append(f"| {place} | {' | '.join(choice(group))} |")
    for place, group in mine.items():
        has_peers = bool(split(group)[1])
        said = f"{place}: {verdict(group)}" if has_peers else "No peer was measured."
        lines += ["", f"## {place}", "", *_wrapped(said), "", *table(group)]
    fast = speed_and_digits(mine)
    if fast:
        lines += ["", "## Fast maths, and the digits that it loses", "", *fast]
    return "\n".join(lines) + "\n"


def speed_and_digits(mine: dict[str, list[dict]]) -> list[str]:
    lines = []
    for place, group in mine.items():
        ours = {row["mode"]: row for row in split(group)[0]}
        if not {"f32", "f32 fast"} <= set(ours):
            continue
        plain, fast = ours["f32"], ours["f32 fast"]
        lost = f"{plain['error']:.1e} | {fast['error']:.1e}"
        ulp = f"{number(plain['max_ulp'], '.3g')} | {number(fast['max_ulp'], '.3g')}"
        faster = plain["ms"] / fast["ms"]
        lines.append(f"| {place} | {faster:.2f} | {lost} | {ulp} |")
    head = "| where | times faster | error of f32 | of f32 fast | ulp of f32 | of f32 fast |"
    return [head, "|---|---|---|---|---|---|", *lines] if lines else []


def _wrapped(text: str) -> list[str]:
    # A link that is broken at a hyphen leads nowhere.
    return textwrap.wrap(" ".join(text.split()), 110, break_on_hyphens=False)


# Pictures


def marked(group: list[dict]) -> list[dict]:
    """The rows that a plot shows: f32 and f64 of tai, the most exact mode, and the best peers."""
    ours, peers = split(group)
    own = {row["mode"]: row for row in ours if row["error"] <= OVERFLOW}
    chosen = [own[name] for name in ("f32", "f64") if name in own]
    rest = [row for row in own.values() if row not in chosen]
    chosen += sorted(rest, key=lambda row: (max(row["error"], rows.FLOOR), row["ms"]))[:1]
    for bits in (32, 64):
        same = [r for r in peers if modes.find(r["system"], r["mode"]).bits == bits]
        chosen += sorted(same, key=lambda row: row["ms"])[:1]
    return chosen[:MOST_MARKS]


def draw(groups: dict[tuple, list[dict]], folder: Path) -> set[str]:
    """A plot for each scene, with a panel for each place; returns the scenes that have one."""
    try:
        import matplotlib
    except ImportError:
        return set()
    matplotlib.use("Agg")
    from matplotlib import pyplot

    from studio.pictures import save_figure

    colours = _palette()
    paper, ink, soft = colours["PAPER"], colours["INK"], colours["SOFT"]
    look = {
        "axes.edgecolor": soft, "axes.facecolor": paper, "axes.labelcolor": ink,
        "axes.spines.right": False, "axes.spines.top": False, "axes.titlecolor": ink,
        "figure.facecolor": paper, "font.size": 10, "legend.frameon": False, "text.color": ink,
        "xtick.color": ink, "ytick.color": ink,
    }  # fmt: skip
    written = set()
    for scene in dict.fromkeys(scene for scene, _ in groups):
        mine = {place: group for (name, place), group in groups.items() if name == scene}
        with matplotlib.rc_context(look):
            figure, axes = pyplot.subplots(
                1, len(mine), figsize=(4.6 * len(mine), 4), squeeze=False, layout="constrained"
            )
            for axis, (place, group) in zip(axes.flat, mine.items(), strict=True):
                _draw_place(axis, marked(group), colours)
                axis.set(title=f"{scene}, {place}", xlabel="ms", ylabel="relative error")
            save_figure(figure, folder / f"{scene}.png", dpi=80)
            pyplot.close(figure)
        written.add(scene)
    return written


def _draw_place(axis, shown: list[dict], colours: dict[str, str]) -> None:
    """Marks with quartiles of time and ranges of error, on logarithmic axes with labelled ticks."""
    from matplotlib import ticker

    series = [colours[name] for name in ("BLUE", "RED", "GOLD", "GREEN", "PLUM")]
    for k, row in enumerate(shown):
        error, low, high = (max(row[key], LEAST) for key in ("error", "error_low", "error_high"))
        is_ours = row["system"] == modes.OURS
        axis.errorbar(
            row["ms"], error, xerr=[[row["ms"] - row["q1"]], [row["q3"] - row["ms"]]],
            yerr=[[error - low], [high - error]], marker="osD^v"[k], markersize=8, linestyle="none",
            color=series[k], markerfacecolor=series[k] if is_ours else "none",
            label=f"{row['system']}, {row['mode']}", capsize=2,
        )  # fmt: skip
    axis.set(xscale="log", yscale="log")
    # At least one decade of each, so that both axes have labelled ticks.
    for low, high, bound in ((*axis.get_xlim(), axis.set_xlim), (*axis.get_ylim(), axis.set_ylim)):
        bound(10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high)))
    axis.xaxis.set_major_locator(ticker.LogLocator(10, (1, 2, 5)))
    axis.xaxis.set_major_formatter(ticker.ScalarFormatter())
    axis.yaxis.set_major_formatter(ticker.LogFormatterSciNotation())
    axis.xaxis.set_minor_formatter(ticker.NullFormatter())
    axis.grid(True, which="major", color=colours["SOFT"], alpha=0.3)
    axis.legend(fontsize=8)


def _palette() -> dict[str, str]:
    """The colours of the simulators' pictures."""
    from studio import pictures

    names = ("PAPER", "INK", "SOFT", "BLUE", "RED", "GOLD", "GREEN", "PLUM", "TEAL")
    return {name: pictures.css(getattr(pictures, name)) for name in names}


def make(files: list[Path], out: Path | None = None) -> str:
    """Writes the page with the pages and plots of scenes; returns a line about that.

    Args:
        files: rows; those in another folder are copied to the results.
        out: a folder for the page, in the place of docs/reports.
    """
    found = [row for path in files for row in rows.read(path)]
    if not rows.measured(found):
        return "no page: nothing was measured"
    reason = rows.why_not_one_session(found)
    if reason:
        return f"no page: {reason}"
    groups = groups_of(found)
    path = out / PAGE.name if out else PAGE
    pages = path.parent / FOLDER
    if out is None:
        # Figures that no page shows are of other commits.
        kept = [RESULTS / file.name for file in files]
        for file, target in zip(files, kept, strict=True):
            if file.resolve() != target:
                shutil.copyfile(file, target)
        for old in RESULTS.glob("error-*.csv"):
            if old not in kept:
                old.unlink()
        for old in [*pages.glob("*.md"), *pages.glob("*.png")]:
            old.unlink()
    pages.mkdir(parents=True, exist_ok=True)
    drawn = draw(groups, pages)
    path.write_text(text_of(found))
    for scene in dict.fromkeys(scene for scene, _ in groups):
        (pages / f"{scene}.md").write_text(scene_text(scene, groups, scene in drawn))
    return f"{path}, {len(drawn)} plots{'' if drawn else ': no matplotlib'}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", type=Path, required=True, metavar="FILE")
    parser.add_argument("--out", type=Path, help="a folder, in the place of docs/reports")
    given = parser.parse_args(arguments)
    try:
        said = make(given.rows, given.out)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print(said)
    return int(said.startswith("no page"))


if __name__ == "__main__":
    sys.exit(main())
