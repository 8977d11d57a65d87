"""The report of a run on a GPU: figures against hand-written CUDA and the targets, in Markdown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

PEERS = ["jax", "torch", "warp", "quadrants", "taichi"]
# Tai's ways to run a scene, the quickest first: replays queued one behind the other, a replay and a
# wait, recording the tape and its gradient.
OURS = ["queued", "replay"]

# Times of peers on an H200, in milliseconds; used on that device beside the measured ones.
KNOWN_PEERS = {
    ("diffmpm", "warp in a graph"): 0.0248,
    ("smoke", "warp in a graph"): 4.0,
    ("mass_spring", "jax"): 66.8,
    ("mass_spring", "warp in a graph"): 81.7,
}


class Records:
    """Looks figures up in a list of records."""

    def __init__(self, records: list[dict], device: str):
        self.records = [r for r in records if not r.get("reason")]
        self.device = device

    def find(self, peer: str, scene: str, **wanted: str) -> dict | None:
        """The record with the least time."""
        found = [
            r
            for r in self.records
            if r["peer"] == peer
            and r["scene"] == scene
            and r.get("ms")
            and all(r.get(key, "") == value for key, value in wanted.items())
        ]
        return min(found, key=lambda r: r["ms"]) if found else None

    def ms(self, peer: str, scene: str, **wanted: str) -> float | None:
        record = self.find(peer, scene, **wanted)
        return record["ms"] if record else None

    def ours(self, scene: str) -> float | None:
        """Forward and backward of a scene on tai, by its quickest way."""
        times = [self.ms("tai", scene, phase=phase) for phase in OURS]
        return min((t for t in times if t), default=None)

    def floor(self, scene: str, *variants: str) -> float | None:
        times = [self.ms("floor", scene, variant=variant) for variant in variants]
        return min((t for t in times if t), default=None)

    def peer(self, peer: str, scene: str) -> float | None:
        """Forward and backward of a peer, by its quickest way."""
        whole = [self.ms(peer, scene, phase=phase) for phase in OURS]
        parts = [self.ms(peer, scene, phase=phase) for phase in ("forward", "backward")]
        if None not in parts:
            whole.append(sum(parts))
        return min((t for t in whole if t), default=None)

    def copy_speed(self) -> float | None:
        """GB/s of the quickest copy in this run."""
        speeds = [
            r["gb_per_s"]
            for r in self.records
            if r["scene"] == "bandwidth" and r.get("variant") in ("copy", "copy-engine")
            if r.get("gb_per_s")
        ]
        return max(speeds, default=None)

    def share_of_copy(self, peer: str, variant: str) -> float | None:
        record, copy = self.find(peer, "bandwidth", variant=variant), self.copy_speed()
        return record["gb_per_s"] / copy if record and copy else None


def ratio(above: float | None, below: float | None) -> float | None:
    return above / below if above and below else None


@dataclass(frozen=True)
class Figure:
    """A row of the report: a value, and the bar that it must keep, if there is one."""

    group: str
    what: str
    value: Callable[[Records], float | None]
    unit: str = ""
    at_most: float | None = None
    at_least: float | None = None

    def bar(self) -> str:
        if self.at_most is not None:
            return f"≤ {self.at_most:g} {self.unit}".strip()
        if self.at_least is not None:
            return f"≥ {self.at_least:g} {self.unit}".strip()
        return ""

    def verdict(self, value: float | None) -> str:
        if self.at_most is None and self.at_least is None:
            return ""
        if value is None:
            return "not measured"
        met = value <= self.at_most if self.at_most is not None else value >= self.at_least
        return "met" if met else "**missed**"


def _scene(scene: str, what: str, floor: tuple[str, ...], fused: tuple[str, ...]) -> list[Figure]:
    """Our time, the floor's, and both ratios."""
    figures = [Figure(scene, f"{what}, forward + backward", lambda r: r.ours(scene), "ms")]
    if floor:
        figures += [
            Figure(
                scene, "floor, one kernel per operation", lambda r: r.floor(scene, *floor), "ms"
            ),
            Figure(
                scene, "ours / that floor", lambda r: ratio(r.ours(scene), r.floor(scene, *floor)),
                "times", at_most=1.1,
            ),
        ]  # fmt: skip
    figures += [
        Figure(
            scene, "quickest floor (overlapped, fused or persistent)",
            lambda r: r.floor(scene, *fused), "ms",
        ),
        Figure(
            scene, "ours / that floor", lambda r: ratio(r.ours(scene), r.floor(scene, *fused)),
            "times",
        ),
    ]  # fmt: skip
    return figures


def _best_peer(scene: str) -> Callable[[Records], float | None]:
    """The quickest peer of this run, or of the times known from before."""

    def best(records: Records) -> float | None:
        here = [records.peer(peer, scene) for peer in PEERS]
        known = [ms for (where, _), ms in KNOWN_PEERS.items() if where == scene]
        if "H200" not in records.device:
            known = []
        return min((t for t in [*here, *known] if t), default=None)

    return best


def _compile(scene: str, phase: str) -> Callable[[Records], float | None]:
    return lambda r: ratio(r.ms("tai", scene, phase=phase), 1000.0)


def _micro(scene: str, phase: str) -> Callable[[Records], float | None]:
    return lambda r: ratio(r.ms("tai", scene, phase=phase), 1e-3)


def _sparse(variant: str) -> Callable[[Records], float | None]:
    return lambda r: ratio(
        r.ms("tai", "sparse", variant="dense"), r.ms("tai", "sparse", variant=variant)
    )


def _sparse_floor(variant: str) -> Callable[[Records], float | None]:
    return lambda r: ratio(
        r.ms("tai", "sparse", variant=variant), r.ms("floor", "sparse", variant=variant)
    )


def _percent(peer: str, variant: str) -> Callable[[Records], float | None]:
    def share(records: Records) -> float | None:
        found = records.share_of_copy(peer, variant)
        return 100.0 * found if found else None

    return share


FIGURES: list[Figure] = [
    *_scene(
        "diffmpm", "6.4 K particles, per step", ("graph", "graph-scalar"),
        ("graph-overlapped", "fused-graph", "fused-overlapped", "persistent"),
    ),
    *_scene(
        "diffmpm_large", "1 M particles, per step", ("graph-large", "shared-large"),
        ("fused-large",),
    ),
    *_scene(
        "smoke", "110², 99 steps", ("graph",),
        (
            *("graph-overlapped", "persistent"),
            *("tiled-graph", "tiled-overlapped", "tiled-persistent"),
        ),
    ),
    Figure("smoke", "the same", lambda r: r.ours("smoke"), "ms", at_most=1.6),
    Figure(
        "smoke", "best peer / ours", lambda r: ratio(_best_peer("smoke")(r), r.ours("smoke")),
        "times", at_least=1.4,
    ),
    Figure("smoke", "compile, cold", _compile("smoke", "compile_cold"), "s", at_most=1.0),
    Figure("smoke", "compile, warm", _compile("smoke", "compile_warm"), "s", at_most=0.15),
    *_scene("mass_spring", "2047 steps", (), ("persistent",)),
    Figure(
        "mass_spring", "best peer / ours",
        lambda r: ratio(_best_peer("mass_spring")(r), r.ours("mass_spring")), "times",
        at_least=4.0,
    ),
    Figure("wave", "128², 254 updates, forward + backward", lambda r: r.ours("wave"), "ms"),
    Figure("launch", "a launch, enqueue only", _micro("launch", "enqueue"), "µs", at_most=3.0),
    Figure("launch", "a launch and a wait for it", _micro("launch", "round_trip"), "µs"),
    Figure("chain", "a replayed tape, per launch", _micro("chain", "replay"), "µs", at_most=1.5),
    Figure("chain", "the same, enqueue only", _micro("chain", "enqueue"), "µs"),
    Figure("bandwidth", "the quickest copy", lambda r: r.copy_speed(), "GB/s"),
    Figure("bandwidth", "copy", _percent("tai", "copy"), "% of it", at_least=85),
    Figure("bandwidth", "map", _percent("tai", "map"), "% of it", at_least=85),
    Figure("bandwidth", "stencil", _percent("tai", "stencil"), "% of it", at_least=85),
    Figure(
        "bandwidth", "adjoint of the stencil", _percent("tai", "adjoint"), "% of it", at_least=60
    ),
    Figure("bandwidth", "stencil over inner ranges", _percent("tai", "stencil-ranges"), "% of it"),
    Figure("bandwidth", "adjoint of that", _percent("tai", "adjoint-ranges"), "% of it"),
    Figure("bandwidth", "floor: map", _percent("floor", "map"), "% of it"),
    Figure("bandwidth", "floor: stencil", _percent("floor", "stencil"), "% of it"),
    Figure("bandwidth", "floor: adjoint of the stencil", _percent("floor", "adjoint"), "% of it"),
    Figure("sparse", "dense / 1 % active", _sparse("active-1"), "times", at_least=30),
    Figure("sparse", "dense / 10 % active", _sparse("active-10"), "times"),
    Figure("sparse", "dense / 100 % active", _sparse("active-100"), "times"),
    Figure("sparse", "1 % active, ours / floor", _sparse_floor("active-1"), "times"),
    Figure("sparse", "dense, ours / floor", _sparse_floor("dense"), "times"),
]  # fmt: skip


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def disagreements(records: list[dict]) -> list[str]:
    """Floors whose loss or gradient is not tai's: they would not time the same thing."""
    found = []
    for r in records:
        if r["peer"] != "floor" or r.get("loss") is None:
            continue
        for own in records:
            same = own["peer"] == "tai" and own["scene"] == r["scene"] and not own.get("reason")
            if not same or own.get("loss") is None:
                continue
            if own.get("variant", r["variant"]) != r["variant"]:
                continue
            # f32 in another order; the robot's gradient amplifies that.
            for key, what, bound in (("loss", "loss", 1e-3), ("gradient_norm", "gradient", 2e-2)):
                theirs, ours = r.get(key), own.get(key)
                if None in (theirs, ours) or abs(ours - theirs) <= bound * abs(theirs):
                    continue
                where = f"{r['scene']}, {r['variant']}"
                found.append(f"{where}: the floor's {what} is {theirs:.7g}, ours {ours:.7g}")
    return list(dict.fromkeys(found))


def _table(rows: list[list[str]]) -> list[str]:
    rule = ["---"] * len(rows[0])
    return ["| " + " | ".join(row) + " |" for row in [rows[0], rule, *rows[1:]]]


def figures(records: list[dict], groups: list[str], device: str, judge: bool) -> list[str]:
    """The table of figures and bars; `judge` is False where the bars mean nothing."""
    found = Records(records, device)
    rows = [["scene", "figure", "value", "bar", ""]]
    for figure in FIGURES:
        if figure.group not in groups:
            continue
        value = figure.value(found)
        text = "–" if value is None else f"{_number(value)} {figure.unit}".strip()
        verdict = figure.verdict(value) if judge else ""
        rows.append([figure.group, figure.what, text, figure.bar(), verdict])
    return _table(rows)


def _agreement(records: list[dict]) -> list[str]:
    """Losses and gradients of all programs that ran a scene, side by side."""
    rows = [["scene", "program", "loss", "norm of the gradient", "probe", "error against f64"]]
    seen = set()
    order = sorted(records, key=lambda r: (r["scene"], r["peer"] != "tai", r["peer"]))
    for r in order:
        if r.get("gradient_norm") is None:
            continue
        variant = r.get("variant") or r["phase"]
        if (r["scene"], r["peer"], variant) in seen:
            continue
        seen.add((r["scene"], r["peer"], variant))
        error = r.get("grad_rel_err")
        rows.append(
            [r["scene"], f"{r['peer']}, {variant}", f"{r['loss']:.7g}"]
            + [f"{r['gradient_norm']:.6g}", f"{r['gradient_probe']:.6g}"]
            + ["" if error is None else f"{error:.1e}"]
        )
    return _table(rows)


def _times(records: list[dict]) -> list[str]:
    rows = [["scene", "program", "phase", "ms", "10 %", "90 %", "runs", "GB/s"]]
    for r in records:
        if r.get("ms") is None or r["phase"] == "import":
            continue
        name = ", ".join(part for part in (r["peer"], r.get("variant")) if part)
        speed = f"{r['gb_per_s']:.0f}" if r.get("gb_per_s") else ""
        times = [_number(r.get(key)) for key in ("ms", "p10", "p90")]
        rows.append([r["scene"], name, r["phase"], *times, str(r.get("n", "")), speed])
    return _table(rows)


def markdown(
    records: list[dict], groups: list[str], machine: dict[str, str], judge: bool, note: str
) -> str:
    """The whole report."""
    device = machine["device"]
    lines = [f"# {device}", ""]
    lines += [f"- {name}: {value}" for name, value in machine.items()]
    lines += ["", note, "", "## Figures and bars", "", *figures(records, groups, device, judge)]
    troubles = [r for r in records if r.get("reason")]
    if troubles:
        lines += ["", "## What did not run", ""]
        for r in troubles:
            where = ", ".join(part for part in (r["scene"], r["peer"], r.get("variant")) if part)
            lines.append(f"- {where}: {r['phase']}: {r['reason']}")
    lines += ["", "## Agreement", "", *_agreement(records)]
    lines += ["", *(f"- **{line}**" for line in disagreements(records))]
    lines += ["", "## All times", "", *_times(records), ""]
    return "\n".join(lines)
