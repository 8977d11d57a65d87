"""Table and plot of a benchmark's records (dicts with peer, scene, phase, ms, ...)."""

from __future__ import annotations

import statistics
from pathlib import Path

TIMES = [
    "forward",
    "backward",
    "both",
    "replay",
    "compile_cold",
    "compile_warm",
    "launch",
    "import",
]


def time_of(records: list[dict], peer: str, scene: str, phase: str) -> float | None:
    """Median over the rounds in milliseconds; `both` is forward and backward together."""
    if phase == "both":
        parts = [time_of(records, peer, scene, p) for p in ("forward", "backward")]
        return None if None in parts else sum(parts)
    found = [
        r["ms"]
        for r in records
        if (r["peer"], r["scene"], r["phase"]) == (peer, scene, phase) and "ms" in r
    ]
    return statistics.median(found) if found else None


def error_of(records: list[dict], peer: str, scene: str) -> float | None:
    """Largest relative error of the gradient over the rounds."""
    found = [
        r["grad_rel_err"]
        for r in records
        if (r["peer"], r["scene"]) == (peer, scene) and r.get("grad_rel_err") is not None
    ]
    return max(found) if found else None


def trouble_of(records: list[dict], peer: str, scene: str) -> str | None:
    """`missing` or `failed` where that is what happened."""
    for phase in ("failed", "missing"):
        if any((r["peer"], r["scene"], r["phase"]) == (peer, scene, phase) for r in records):
            return phase
    return None


def _time_text(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _row(records: list[dict], scene: str, phase: str, peers: list[str], ours: str) -> list[str]:
    base = time_of(records, ours, scene, phase)
    cells = []
    for peer in peers:
        value = time_of(records, peer, scene, phase)
        if value is None:
            cells.append(trouble_of(records, peer, scene) or "-")
        elif base and peer != ours:
            cells.append(f"{_time_text(value)} ({value / base:.2g}x)")
        else:
            cells.append(_time_text(value))
    return [scene, phase.replace("_", " "), *cells]


def table(records: list[dict], scenes: list[str], peers: list[str], ours: str) -> str:
    """A Markdown table, one row per scene and phase, one column per peer."""
    rows = [["scene", "phase", *peers]]
    for scene in scenes:
        rows_of_scene = []
        for phase in TIMES:
            if any(time_of(records, peer, scene, phase) is not None for peer in peers):
                rows_of_scene.append(_row(records, scene, phase, peers, ours))
        if not rows_of_scene:
            cells = [trouble_of(records, peer, scene) or "-" for peer in peers]
            rows_of_scene.append([scene, "-", *cells])
        errors = [error_of(records, peer, scene) for peer in peers]
        if any(error is not None for error in errors):
            cells = ["-" if error is None else f"{error:.1e}" for error in errors]
            rows_of_scene.append([scene, "gradient error", *cells])
        rows += rows_of_scene
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    lines = [
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |"
        for row in rows
    ]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    reasons = {
        f"{r['peer']}, {r['scene']}: {r['phase']}: {r['reason']}"
        for r in records
        if r.get("reason")
    }
    return "\n".join([*lines, *([""] if reasons else []), *sorted(reasons)])


def plot(
    records: list[dict], scenes: list[str], peers: list[str], title: str, path: Path
) -> Path | None:
    """Bars of the times, and time against error of the gradient; None without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    timed = [s for s in scenes if s != "first_kernel"]
    shown = [s for s in timed if any(time_of(records, p, s, "forward") for p in peers)]
    if not shown:
        return None
    figure, axes = pyplot.subplots(
        2, len(shown), figsize=(3.6 * len(shown), 6.4), squeeze=False, layout="constrained"
    )
    colours = {peer: f"C{k}" for k, peer in enumerate(peers)}
    for column, scene in enumerate(shown):
        present = [p for p in peers if time_of(records, p, scene, "forward") is not None]
        _bars(axes[0][column], records, scene, present, colours)
        _front(axes[1][column], records, scene, present, colours)
    figure.suptitle(title, fontsize=9)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
    return path


def _bars(axis, records, scene, present, colours) -> None:
    forward = [time_of(records, p, scene, "forward") for p in present]
    backward = [time_of(records, p, scene, "backward") or 0.0 for p in present]
    place = range(len(present))
    own = [colours[p] for p in present]
    axis.barh(place, forward, color=own)
    axis.barh(place, backward, left=forward, color=own, alpha=0.5)
    axis.set_yticks(place, present)
    axis.invert_yaxis()
    axis.set_title(scene)
    axis.set_xlabel("ms, forward and (light) backward")


def _front(axis, records, scene, present, colours) -> None:
    for peer in present:
        time = time_of(records, peer, scene, "both")
        error = error_of(records, peer, scene)
        if time and error:
            # The first of the list is the project itself: filled, its peers hollow.
            face = colours[peer] if peer == "tai" else "none"
            axis.plot(time, error, "o", color=colours[peer], markerfacecolor=face, label=peer)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("ms of an iteration")
    axis.set_ylabel("relative error of the gradient")
    low, high = axis.get_ylim()
    # Errors of one size should look like it, whatever their digits.
    axis.set_ylim(low / 3.0, high * 3.0)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=7)
