"""Plots of run time against error, and docs/reports/accuracy.md, from the rows of the benchmark.

The page answers four questions in at most 150 lines; all figures of a scene are in
docs/reports/accuracy/. Each sentence with a figure is made of the rows.
"""

from __future__ import annotations

import math
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
PAGE = ROOT / "docs" / "reports" / "accuracy.md"
PICTURES = PAGE.parent / "pictures"
# A page for each scene, beside the page itself.
FOLDER = "accuracy"
TARGETS = (1e-2, 1e-4, 1e-6, 1e-10)
# A value for errors of zero, which cannot be drawn on a logarithmic axis.
LEAST = 1e-17
# Errors count as equal below the first, and where they differ by less than the second: noise.
FLOOR, ERROR_NOISE = 1e-15, 1.05
# Errors beyond this are losses of range, and not of digits.
OVERFLOW = 1e3
# Losses that the page lists; all are on the pages of scenes.
MOST_LOSSES = 40
ORDER = [mode.name for mode in modes.TAI]
# Where several modes are as fast, the first one is taken.
SIMPLEST = ["f32", "f64", *(name for name in ORDER if name not in ("f32", "f64"))]


def groups_of(found: list[dict]) -> dict[tuple, list[dict]]:
    """Measured rows by scene, size, arch and threads, on one machine."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows.measured(found):
        place = (row["machine"], row["size"], row["arch"], row["threads"])
        groups.setdefault((row["scene"], *place), []).append(row)
    return groups


def merged(groups: dict[tuple, list[dict]]) -> dict[tuple, list[dict]]:
    """The same with one group for each card, whatever machine it is in.

    If two machines have the same rows, those of the machine with more of the scene are kept.
    """
    cards: dict[tuple, list[dict]] = {}
    for key in sorted(groups, key=lambda key: -len(groups[key])):
        scene, machine, size, arch, threads = key
        where = (scene, place_of(machine, arch), size, arch, threads)
        group = cards.setdefault(where, [])
        known = {(row["system"], row["mode"]) for row in group}
        group += [row for row in groups[key] if (row["system"], row["mode"]) not in known]
    scenes = list(dict.fromkeys(key[0] for key in groups))
    return dict(
        sorted(cards.items(), key=lambda item: (item[0][3:], item[0][1], scenes.index(item[0][0])))
    )


def place_of(machine: str, arch: str) -> str:
    """The machine, or the card of one: its name stands last, "processor, cores, card"."""
    return machine.rsplit(", ", 1)[-1] if arch == "cuda" else machine


def split(group: list[dict]) -> tuple[list[dict], list[dict]]:
    ours = [row for row in group if row["system"] == modes.OURS]
    return ours, [row for row in group if row["system"] != modes.OURS]


def marks(row: dict, peers: list[dict]) -> str:
    """How a row of tai stands against those of its peers."""
    if row["system"] != modes.OURS or not peers:
        return ""
    if rows.beats_all(row, peers):
        return "★"
    bits = modes.find(modes.OURS, row["mode"]).bits
    same = [r for r in peers if modes.find(r["system"], r["mode"]).bits == bits]
    return "+" if rows.beats_all(row, same) else ""


# Words


def number(value: float | None, form: str = ".2g") -> str:
    return "–" if value is None or math.isnan(value) else f"{value:{form}}"


def table(group: list[dict]) -> list[str]:
    """All rows of a scene, tai's first."""
    ours, peers = split(group)
    ours.sort(key=lambda row: ORDER.index(row["mode"]))
    peers.sort(key=lambda row: (row["system"], row["mode"]))
    has_ulp = any(row["max_ulp"] is not None for row in group)
    head = ["", "system, mode", "ms", "p10 – p90", "loss", "gradient", "cosine"]
    head += ["worst ulp"] if has_ulp else []
    head += ["results", "launches", "after descent", "MiB"]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in [*ours, *peers]:
        cells = [marks(row, peers), f"{row['system']}, {row['mode']}", number(row["ms"], ".3g")]
        cells += [f"{row['p10']:.3g} – {row['p90']:.3g}", number(row["loss_rel"])]
        cells += [number(row["grad_rel"])]
        short = row["grad_cos"] is not None and row["grad_cos"] < 1 - 1e-9
        cells += [f"1 - {1 - row['grad_cos']:.1g}" if short else number(row["grad_cos"], ".0f")]
        cells += [number(row["max_ulp"], ".3g")] if has_ulp else []
        cells += [f"{row['distinct']:.0f} of {row['runs']:.0f}", number(row["launches"], ".0f")]
        cells += [number(row["final_loss"], ".6g"), number(row["peak_mb"], ".0f")]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def is_matched(peer: dict, ours: list[dict]) -> bool:
    """Whether a mode of tai is at least as fast as a row of a peer, and as exact but for noise."""
    bar = ERROR_NOISE * max(rows.error_of(peer), FLOOR)
    return any(row["ms"] <= peer["ms"] and rows.error_of(row) <= bar for row in ours)


def is_within_spread(row: dict, other: dict) -> bool:
    """Whether the times of two rows overlap, so that none of them is the faster."""
    return row["p10"] <= other["p90"] and other["p10"] <= row["p90"]


def verdict(group: list[dict]) -> str:
    """How many modes of peers some mode of tai dominates, and the others."""
    ours, peers = split(group)
    lost = [row for row in peers if not is_matched(row, ours)]
    text = f"{len(peers) - len(lost)} of {len(peers)} modes of peers are dominated by one of tai"
    return f"{text}; not {', '.join(map(loss_of(ours), lost))}." if lost else f"{text}."


def loss_of(ours: list[dict]) -> Callable[[dict], str]:
    """A function that says by how much tai is slower than a row at its error."""

    def text(peer: dict) -> str:
        bar = ERROR_NOISE * max(rows.error_of(peer), FLOOR)
        good = [row for row in ours if rows.error_of(row) <= bar]
        name = f"{peer['system']} {peer['mode']}"
        if not good:
            return f"{name} (no mode of tai has an error of {rows.error_of(peer):.1e})"
        best = min(good, key=lambda row: row["ms"])
        over = ", within the spread" if is_within_spread(best, peer) else ""
        return f"{name} ({best['mode']} takes {best['ms'] / peer['ms']:.2f} times as long{over})"

    return text


def fastest(group: list[dict], target: float) -> dict | None:
    """The fastest mode within an error; of those within its spread, the simplest."""
    ours = [row for row in split(group)[0] if row["mode"] != "f32 unguarded"]
    good = [row for row in ours if rows.error_of(row) <= target]
    best = min(good, key=lambda row: row["ms"], default=None)
    near = [row for row in good if row is best or is_within_spread(row, best)]
    return min(near, key=lambda row: SIMPLEST.index(row["mode"]), default=None)


def choice(group: list[dict]) -> list[str]:
    """The fastest mode for each greatest error."""
    cells = []
    for target in TARGETS:
        best = fastest(group, target)
        cells.append("–" if best is None else f"{best['mode']} ({best['ms']:.3g} ms)")
    return cells


def choices(groups: dict[tuple, list[dict]]) -> list[str]:
    """How often each mode is the fastest within an error, at each place."""
    places: dict[str, list[list[dict]]] = {}
    for (_, *place), group in groups.items():
        places.setdefault(_place(place), []).append(group)
    lines = [f"| where | {' | '.join(f'{t:.0e}' for t in TARGETS)} |"]
    lines += [f"|---|{'---|' * len(TARGETS)}"]
    for where, mine in places.items():
        cells = []
        for target in TARGETS:
            found = [fastest(group, target) for group in mine]
            counts = Counter("none" if row is None else row["mode"] for row in found)
            cells.append(", ".join(f"{name} {count}" for name, count in counts.most_common(4)))
        lines.append(f"| {where} ({len(mine)} scenes) | {' | '.join(cells)} |")
    return lines


def losses(groups: dict[tuple, list[dict]]) -> list[str]:
    """For each place how many modes of peers are dominated, and the losses, the greatest first."""
    counts: dict[str, list[int]] = {}
    lost = []
    for (scene, *place), group in groups.items():
        ours, peers = split(group)
        for peer in peers:
            is_won = is_matched(peer, ours)
            won, all_ = counts.setdefault(_place(place), [0, 0])
            counts[_place(place)] = [won + is_won, all_ + 1]
            if not is_won:
                bar = ERROR_NOISE * max(rows.error_of(peer), FLOOR)
                good = [row["ms"] for row in ours if rows.error_of(row) <= bar]
                size = min(good, default=math.inf) / peer["ms"]
                lost.append((size, f"- {scene}, {_place(place)}: {loss_of(ours)(peer)}"))
    lines = [
        f"- **{where}: {won} of {total}** modes of peers are dominated by some mode of tai: at "
        "least as fast, and as exact."
        for where, (won, total) in counts.items()
    ]
    lost.sort(key=lambda entry: -entry[0])
    lines += ["", "The losses:", ""] if lost else []
    lines += [text for _, text in lost[:MOST_LOSSES]]
    if len(lost) > MOST_LOSSES:
        lines.append(f"- and {len(lost) - MOST_LOSSES} more, on the pages of scenes")
    return lines or ["No peer was measured."]


def prices(groups: dict[tuple, list[dict]]) -> list[str]:
    """The cost and the gain of each mode next to f32, over all scenes."""
    lines = ["| mode | time next to f32 | error next to f32 | for what |", "|---|---|---|---|"]
    for name in ORDER:
        slower, worse, overflows = [], [], 0
        for group in groups.values():
            ours = {row["mode"]: row for row in split(group)[0]}
            if name in ours and "f32" in ours:
                slower.append(ours[name]["ms"] / ours["f32"]["ms"])
                pair = [rows.error_of(ours[key]) for key in (name, "f32")]
                if not pair[0] <= OVERFLOW:
                    overflows += 1
                elif pair[1] <= OVERFLOW:
                    worse.append(max(pair[0], LEAST) / max(pair[1], LEAST))
        if slower:
            time, error = (statistics.geometric_mean(x) for x in (slower, worse or [1.0]))
            spread = f"{min(slower):.2g} to {max(slower):.2g}"
            about = f"{time:.2f} ({spread}) | {error:.2g}"
            about += f" ({min(worse):.1g} to {max(worse):.1g})" if worse else ""
            about += f", overflow in {overflows}" if overflows else ""
            lines.append(f"| {name} | {about} | {modes.ABOUT[name]} |")
        else:
            lines.append(f"| {name} | not measured | | {modes.ABOUT[name]} |")
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
    """The bars, and how many figures keep each, on CPUs and on each card."""
    places: dict[str, list[dict]] = {}
    for row in found:
        where = place_of(row["machine"], row["arch"])
        places.setdefault(where, []).append(row)
    judged = {where: gates.judge(mine) for where, mine in places.items()}
    lines = [f"| bar, kept by (of) | {' | '.join(judged)} |", f"|---|{'---|' * len(judged)}"]
    for several in zip(*judged.values(), strict=True):
        cells = [
            f"{len(gate.found) - len(gate.broken)} ({len(gate.found)})" if gate.found else "–"
            for gate in several
        ]
        lines.append(f"| {several[0].name} | {' | '.join(cells)} |")
    return lines


INTRODUCTION = """
    How long an iteration takes (forward and backward) and how far its loss and its gradient are
    off, for each mode of numbers, on the examples at small sizes and on single kernels.
    `make bench-error` writes this page, the pages of scenes, and each sentence with a figure."""

METHOD = """
    Each row is a process of its own. The initial values of fields are numbers of f32 in all modes:
    the error is that of computing, of the loss or the gradient (L2), whichever is greater. Kernels
    are compared with sums that are rounded once and with 80-bit floats; scenes with tai in f64
    and deterministic sums, which at a tiny size agrees with numbers of 50 digits within 1e-11
    (`benchmarks/error/exact.py`), so an error below that says nothing of a scene. Times are medians
    with the 10th and the 90th percentile; of modes whose times overlap, the simplest counts as the
    fastest. Errors below 1e-15 are equal, and so are those that differ by less than 5 %. A greater
    error than 1000 is an overflow, and in no average. `make bench-error-gate` compares two
    commits."""

HINT = """
    Rows of a size other than full were measured in a hurry, several at a time: their errors hold,
    their times are a hint, and so is all that rests on them."""

MIXED = """
    **These rows are of several commits**: next to a row of another commit, a time is a hint."""

CARDS = """
    Rows of one card may be of several machines that have it; the cost of
    a mode next to another is compared on one machine alone."""

LEGEND = """
    *Loss* and *gradient* are relative errors (L2), *cosine* is between the gradient and the true
    one, *results* how many different ones there were in how many runs, *after descent* the loss
    after some steps, *MiB* the most memory of the process, *ms* the median over the runs: the
    processor's time of one thread, or the clock's with all. ★ marks a row of tai that is
    faster and at least as exact as every mode of every peer that was measured; + one that is so
    among rows of the same width. The script that ran them sets the marks."""


def text_of(found: list[dict], pictures: Iterable[Path]) -> str:
    apart = groups_of(found)
    groups = merged(apart)
    lines = ["# Run time against error", "", *_wrapped(INTRODUCTION), ""]
    lines += ["## Which mode for my error?", ""]
    lines += _wrapped(
        "In how many scenes each mode is the fastest of tai within an error (four modes at most). "
        "[ti.solve_to](../guides/solve-to.md) chooses for a program and an error."
    )
    lines += ["", *choices(groups), "", "## The cost of a mode", "", *prices(apart), ""]
    lines += ["## Where do we lose?", "", *losses(groups), "", "### Bars", "", *bars(found), ""]
    lines += ["## How was it measured?", "", *_wrapped(METHOD), ""]
    for machine in dict.fromkeys(row["machine"] for row in found):
        mine = [row for row in found if row["machine"] == machine]
        systems = {f"{r['system']} {r['version']}" for r in mine if r["version"]}
        gits = ", ".join(sorted({r["git"] for r in mine}))
        sizes = ", ".join(sorted({r["size"] for r in mine}))
        text = f"- {machine}; size {sizes}; tai at {gits}; {', '.join(sorted(systems))}"
        lines += textwrap.wrap(text, 110, subsequent_indent="  ")
    if len({row["git"] for row in found if row["system"] == modes.OURS}) > 1:
        lines += ["", *_wrapped(MIXED)]
    if any(row["size"] != "full" for row in found):
        lines += ["", *_wrapped(HINT)]
    if any(row["arch"] == "cuda" for row in found):
        lines += ["", *_wrapped(CARDS)]
    scenes = list(dict.fromkeys(key[0] for key in groups))
    text = ", ".join(f"[{scene}]({FOLDER}/{scene}.md)" for scene in scenes)
    lines += ["", *_wrapped(f"Figures of each scene: {text}.")]
    drawn = ", ".join(f"[{path.stem}](pictures/{path.name})" for path in pictures)
    if drawn:
        lines += ["", *_wrapped(f"Pictures of all scenes: {drawn}.")]
    failures = trouble(found)
    if failures:
        lines += ["", "Not measured:", "", *failures[:8]]
    assert len(lines) <= 150, f"the page has {len(lines)} lines"
    return "\n".join(lines) + "\n"


def scene_text(scene: str, groups: dict[tuple, list[dict]]) -> str:
    """The page of a scene: its fastest modes, peers, and all figures."""
    lines = [f"# Run time against error: {scene}", "", *_wrapped(LEGEND), ""]
    lines += [f"| where | {' | '.join(f'{t:.0e}' for t in TARGETS)} |"]
    lines += [f"|---|{'---|' * len(TARGETS)}"]
    mine = {tuple(place): group for (name, *place), group in groups.items() if name == scene}
    for place, group in mine.items():
        lines.append(f"| {_place(place)} | {' | '.join(choice(group))} |")
    for place, group in mine.items():
        has_peers = bool(split(group)[1])
        said = verdict(group) if has_peers else "No peer was measured."
        lines += ["", f"## {_place(place)}", "", *_wrapped(said), "", *table(group)]
    fast = speed_and_digits({key: group for key, group in groups.items() if key[0] == scene})
    if fast:
        lines += ["", "## Fast maths, and the digits that it loses", "", *fast]
    return "\n".join(lines) + "\n"


def speed_and_digits(groups: dict[tuple, list[dict]]) -> list[str]:
    lines = []
    for (scene, *place), group in groups.items():
        ours = {row["mode"]: row for row in split(group)[0]}
        if not {"f32", "f32 fast"} <= set(ours):
            continue
        plain, fast = ours["f32"], ours["f32 fast"]
        lost = f"{rows.error_of(plain):.1e} | {rows.error_of(fast):.1e}"
        ulp = f"{number(plain['max_ulp'], '.3g')} | {number(fast['max_ulp'], '.3g')}"
        faster = plain["ms"] / fast["ms"]
        lines.append(f"| {scene} ({_place(place)}) | {faster:.2f} | {lost} | {ulp} |")
    head = "| scene | times faster | error of f32 | of f32 fast | ulp of f32 | of f32 fast |"
    return [head, "|---|---|---|---|---|---|", *lines] if lines else []


def _place(place: Iterable[str]) -> str:
    machine, _, arch, threads = place
    if arch == "cuda":
        return machine
    return "one thread" if threads == "1" else "all threads"


def _wrapped(text: str) -> list[str]:
    # A link that is broken at a hyphen leads nowhere.
    return textwrap.wrap(" ".join(text.split()), 110, break_on_hyphens=False)


# Pictures


def draw(found: list[dict], folder: Path) -> list[Path]:
    """A panel for each scene, at each place a picture; none without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return []
    matplotlib.use("Agg")
    places: dict[tuple, dict[str, list[dict]]] = {}
    for (scene, *place), group in merged(groups_of(found)).items():
        places.setdefault(tuple(place), {})[scene] = group
    written = []
    for (machine, size, arch, threads), scenes in places.items():
        where = machine.lower() if arch == "cuda" else f"cpu-{threads}"
        path = folder / f"accuracy-{where}{'' if size == 'full' else '-' + size}.png"
        _draw_place(scenes, path, f"{machine}; size {size}; threads {threads}")
        written.append(path)
    return written


def _draw_place(scenes: dict[str, list[dict]], path: Path, title: str) -> None:
    import matplotlib
    from matplotlib import pyplot

    from studio.pictures import save_figure

    colours = _palette()
    paper, ink, soft = colours["PAPER"], colours["INK"], colours["SOFT"]
    series = [colours[name] for name in ("BLUE", "RED", "GOLD", "GREEN", "PLUM", "TEAL")]
    look = {
        "axes.edgecolor": soft, "axes.facecolor": paper, "axes.labelcolor": ink,
        "axes.spines.right": False, "axes.spines.top": False, "axes.titlecolor": ink,
        "figure.facecolor": paper, "font.size": 8, "legend.frameon": False, "text.color": ink,
        "xtick.color": ink, "ytick.color": ink,
    }  # fmt: skip
    columns = 4
    height = math.ceil((len(scenes) + 1) / columns)
    shapes = "osD^vP*XhdHp<>8"
    peers = [name for name in modes.MODES if name != modes.OURS]
    with matplotlib.rc_context(look):
        figure, axes = pyplot.subplots(
            height, columns, figsize=(3.1 * columns, 2.7 * height), squeeze=False,
            layout="constrained",
        )  # fmt: skip
        handles: dict[str, object] = {}
        for axis, (scene, group) in zip(axes.flat, scenes.items(), strict=False):
            ours, others = split(group)
            line = rows.front(ours)
            axis.plot([r["ms"] for r in line], [_shown(r) for r in line], color=soft, zorder=1)
            for row in ours:
                k = ORDER.index(row["mode"])
                handles[row["mode"]] = axis.plot(
                    row["ms"], _shown(row), shapes[k % len(shapes)], markersize=5,
                    color=series[k % len(series)], linestyle="none",
                )[0]  # fmt: skip
            for row in others:
                k = peers.index(row["system"])
                handles[f"{row['system']}"] = axis.plot(
                    row["ms"], _shown(row), shapes[k], markersize=6, markerfacecolor="none",
                    markeredgecolor=series[k % len(series)], linestyle="none",
                )[0]  # fmt: skip
            axis.set(title=scene, xscale="log", yscale="log", xlabel="ms", ylabel="relative error")
            axis.minorticks_off()
        for axis in axes.flat[len(scenes) :]:
            axis.set_axis_off()
        last = axes.flat[len(scenes)]
        last.legend(handles.values(), handles.keys(), loc="center", ncols=2, fontsize=7)
        figure.suptitle(title, fontsize=9)
        path.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure, path, dpi=100)
        pyplot.close(figure)


def _shown(row: dict) -> float:
    error = rows.error_of(row)
    return min(max(error, LEAST), 1e3)


def _palette() -> dict[str, str]:
    """The colours of the simulators' pictures."""
    from studio import pictures

    names = ("PAPER", "INK", "SOFT", "BLUE", "RED", "GOLD", "GREEN", "PLUM", "TEAL")
    return {name: pictures.css(getattr(pictures, name)) for name in names}


def write(files: list[Path], kept: bool, work: Path) -> str:
    """Writes the page and its pictures; where results are not kept, into the folder of the run."""
    found = [row for path in files for row in rows.read(path)]
    if not rows.measured(found):
        return "nothing was measured, so there is no page"
    folder = PICTURES if kept else work
    pictures = draw(found, folder)
    path = PAGE if kept else work / "accuracy.md"
    path.write_text(text_of(found, pictures))
    groups = merged(groups_of(found))
    pages = path.parent / FOLDER
    pages.mkdir(exist_ok=True)
    for scene in dict.fromkeys(key[0] for key in groups):
        (pages / f"{scene}.md").write_text(scene_text(scene, groups))
    return f"{path}, {', '.join(p.name for p in pictures) or 'no pictures: no matplotlib'}"
