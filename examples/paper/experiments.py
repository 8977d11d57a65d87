"""The figures and tables of the paper, an experiment each; `simulators` has those of appendix E.

Numbers of the paper are quoted next to ours. Numbers that its text omits were measured on its
published programs.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from . import lines, simulators
from .lab import Failed, Lab, usual


class Experiment(NamedTuple):
    """An experiment: its claim, and the function that runs it."""

    name: str
    shows: str  # in the paper
    title: str
    run: Callable[[Lab], None]


def lengths(lab: Lab) -> None:
    variants = {
        "area 0.1, 25 steps": ((), (0.600, 0.600, 0.529)),
        "area 0.2, 200 steps": (("--target", 0.2), (0.858, 0.858, 0.762)),
        "area 0.1, a wall, 25 steps": (("--wall",), (0.650, 0.731, 0.676)),
    }
    rows: list[list[Any]] = []
    curves: dict[str, Any] = {}
    for number, (name, (options, expected)) in enumerate(variants.items()):
        count = 200 if "200" in name else 25
        run = lab.run("mass_spring_simple", *options, label=str(number), iterations=count)
        found = run.find(r"^rest lengths +\[([\d.]+), ([\d.]+), ([\d.]+)\]")
        lab.check(tuple(found) == expected, f"{name}: rest lengths {found}, not {expected}")
        rows.append([name, _vector(found), _vector(expected), run.losses[0], run.losses[-1]])
        curves[name] = run.losses
    header = ["variant", "rest lengths", "of the paper's program", "first loss", "last loss"]
    lab.table(header, rows)
    lab.text("""The paper's text asks for an area of 0.2 in 200 steps and prints [0.600, 0.600,
        0.529], which are the lengths for 0.1 after 25. Its published program has a wall
        besides.""")
    lab.plot("losses", curves, "Descent on three rest lengths", x="iteration", y="loss", log=True)


def _vector(numbers: list[float] | tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{number:.3f}" for number in numbers) + "]"


def toi(lab: Lab) -> None:
    run = lab.run("rigid_body_toi", pictures=True)
    columns = run.table("heights")
    rows: list[list[Any]] = []
    for way, label, known in (("naive", "naive", 1.0), ("toi", "with time of impact", -1.0)):
        slopes = columns[f"{way} by y"]
        worst = max(abs(slope - known) for slope in slopes)
        lab.check(worst < 1e-5, f"{label}: a derivative is {worst:.2g} away from {known:+g}")
        span = f"{min(slopes):+.6f} … {max(slopes):+.6f}"
        rows.append([label, len(slopes), span, f"{known:+g}", columns[way][0], columns[way][14]])
    header = ["integrator", "balls", "derivative of the height at the end by that at the start"]
    lab.table([*header, "in the paper", "height, lift 0", "height, lift 0.28"], rows)
    lab.picture(run.folder / "rigid_body_toi.heights.png", "Heights at the end: both agree")
    lab.picture(run.folder / "rigid_body_toi.close_up.png", "Close up, the naive ones are a saw")


def toi_curves(lab: Lab) -> None:
    """Compares descent with and without time of impact, over several seeds."""
    seeds = lab.pick(1, 5, 5)
    scenes = [
        ("mass_spring", 1, lab.pick(1, 20, 100), -0.215316),
        ("mass_spring", 2, lab.pick(1, 20, 100), -0.212226),
        ("rigid_body", 1, lab.pick(1, 10, 20), 0.752810),
    ]
    rows: list[list[Any]] = []
    for name, robot, count, first in scenes:
        curves: dict[str, list[list[float]]] = {}
        for option, label in (("--toi", "with time of impact"), ("--no-toi", "without")):
            losses: list[list[float]] = []
            for seed in range(seeds):
                words = ("--robot", robot, option, "--seed", seed)
                where = f"{name}{robot}{option}-{seed}"
                run = lab.run(name, *words, label=where, iterations=count)
                losses.append(run.losses)
            if option == "--toi":
                lab.near(losses[0][0], first, 3e-4, f"first loss of {name}, robot {robot}")
            curves[label] = losses
            best = [min(one) for one in losses]
            mean, ends = sum(best) / seeds, f"{min(best):.4f} … {max(best):.4f}"
            firsts = sum(one[0] for one in losses) / seeds
            rows.append([f"{name}, robot {robot}", label, seeds, count, firsts, mean, ends])
        caption = f"{name}, robot {robot}: {seeds} seeds with their mean"
        lab.plot(f"{name}{robot}", curves, caption, x="iteration", y="loss", title=caption)
    header = ["scene", "integrator", "seeds", "steps of descent", "mean first loss"]
    lab.table([*header, "mean of the best loss", "best losses"], rows)
    lab.text("""The paper repeats each five times and shows curves without
        numbers: time of impact "greatly improves gradient and optimization quality". Less is
        better.""")


def flat(lab: Lab) -> None:
    samples = lab.pick(40, 400, 1000)
    run = lab.run("billiards", "--scan", "--samples", samples, pictures=True)
    rows: list[list[Any]] = []
    for part, share, least in (("1", 0.852, 0.02172), ("0.23", 0.356, 0.02130)):
        columns = run.table(f"scan_{part}")
        miss = 0.066089  # the distance of the last ball from the pocket, squared
        flat = [abs(loss - miss) < 1e-6 for loss in columns["loss"]]
        slope = max((abs(s) for s, f in zip(columns["slope"], flat, strict=True) if f), default=0.0)
        found = sum(flat) / samples
        lab.check(abs(found - share) < max(0.01, 2 / samples), f"{found:.1%} flat, not {share:.1%}")
        lab.check(slope == 0, f"the slope on flat land is {slope:g}")
        if samples == 1000:
            lab.near(min(columns["loss"]), least, 1e-3, "the least loss")
        angles = f"{180 * float(part):g}° around the front"
        rows.append([angles, f"{found:.1%}", f"{share:.1%}", slope, min(columns["loss"]), least])
        caption = f"Loss by the angle of the cue, {angles}"
        lab.picture(run.folder / f"billiards.scan_{part}.png", caption)
    header = ["angles", "flat", "of 1000 in the paper's program", "largest slope there"]
    lab.table([*header, "least loss", "in the paper's program"], rows)
    lab.text("The loss on flat land is 0.0661 (the paper writes 0.065).")
    for line in run.output.splitlines():
        if line.startswith("health"):
            lab.text("The health report of the tape for a push that misses: " + line[9:])
    lab.check("health " in run.output, "the health report of the tape is silent on flat land")


def discontinuity(lab: Lab) -> None:
    ends = {  # without and with friction, on both sides of the angle 0
        "x": ((0.290623, 0.290623), (0.30545, 0.40093)),
        "y": ((0.29806, 0.29806), (0.44557, 0.40340)),
    }
    rows: list[list[Any]] = []
    for axis, known in ends.items():
        run = lab.run("rigid_body_discontinuity", "--loss", axis, label=axis, pictures=True)
        columns = run.table("ends")
        for friction, (left, right) in zip((0, 1), known, strict=True):
            found = columns[f"friction {friction}"]
            below, above = found[len(found) // 2 - 1], found[len(found) // 2]
            lab.near(below, left, 1e-3, f"{axis} before the jump, friction {friction}")
            lab.near(above, right, 1e-3, f"{axis} after the jump, friction {friction}")
            rows.append([axis, friction, below, above, above - below, right - left])
        caption = f"Where the box ends ({axis}), by the angle at which it starts"
        lab.picture(run.folder / "rigid_body_discontinuity.ends.png", caption)
    header = ["coordinate", "friction", "angle -0.0005", "angle +0.0005", "jump"]
    lab.table([*header, "jump in the paper's program"], rows)


def table1(lab: Lab) -> None:
    steps, count = lab.pick(16, 256, 1024), lab.pick(2, 4, 6)
    options = ("--scheme", "stored", "--steps", steps)
    run = lab.run("checkpointing", *options, iterations=count, timed=True)
    forward, back = (1e3 * usual(list(times)) / (steps - 1) for times in zip(*run.tapes))
    counted = {name: count for name, count, _ in lines.counts(lab.examples)}
    rows: list[list[object]] = [
        ["TensorFlow (paper)", "GTX 1080 Ti", 13.20, 35.70, 48.90, "188", 190],
        ["CUDA by hand (paper)", "GTX 1080 Ti", 0.10, 0.14, 0.24, "0.92", 460],
        ["DiffTaichi (paper)", "GTX 1080 Ti", 0.11, 0.15, 0.26, "1.00", 110],
    ]
    device = f"{lab.arch}, here"
    rows.append(["tai", device, forward, back, forward + back, "", counted["diffmpm"]])
    header = ["approach", "device", "forward (ms)", "backward (ms)", "total (ms)"]
    lab.table([*header, "of DiffTaichi's", "essential lines"], rows)
    lab.text(f"""6400 particles on a grid of 120², a step, {steps} steps of `checkpointing.py
        --scheme stored`. Times of the paper are quoted from its table 1; no ratio is given where
        the devices differ. Lines are those of `diffmpm.py`.""")


def table2(lab: Lab) -> None:
    steps, count = lab.pick(5, 100, 100), lab.pick(2, 5, 20)
    options = ("--setting", "stripes-peace", "--steps", steps)
    run = lab.run("smoke", *options, iterations=count, timed=True)
    forward, back = (1e3 * usual(list(times)) for times in zip(*run.tapes))
    if steps == 100:
        lab.first_losses(run, [0.391074], 1e-3)
    counted = {name: count for name, count, _ in lines.counts(lab.examples)}
    known = [
        ("PyTorch (paper)", "CPU, f32", 405, 328, 733, "13.8", 74),
        ("PyTorch (paper)", "GPU, f32", 254, 457, 711, "13.4", 74),
        ("Autograd (paper)", "CPU, f64", 307, 1197, 1504, "28.4", 51),
        ("JAX (paper)", "GPU, f32", 24, 75, 99, "1.9", 90),
        ("DiffTaichi (paper)", "CPU, f32", 66, 132, 198, "3.7", 75),
        ("DiffTaichi (paper)", "GPU, f32", 24, 29, 53, "1.0", 75),
    ]
    ours = ("tai", f"{lab.arch}, f32, here", forward, back, forward + back, "", counted["smoke"])
    header = ["approach", "device", "forward (ms)", "backward (ms)", "total (ms)"]
    lab.table([*header, "of DiffTaichi's on a GPU", "essential lines"], [*known, ours])
    lab.text(f"""110² cells, {steps} steps of 6 Jacobi sweeps. Times of the paper are quoted from
        its table 2, on its machine; no ratio is given across machines. The same program in taichi,
        quadrants, jax and others on one machine: `make bench`.""")


def compiling(lab: Lab) -> None:
    """Measures how much longer the first iteration takes than the next one, with an empty and with
    a filled cache.
    """
    scenes = [("smoke", 8), ("rigid_body", 64), ("diffmpm", 16), ("diffmpm3d", 8), ("liquid", 8)]
    rows: list[list[Any]] = []
    for name, steps in scenes[: lab.pick(1, 5, 5)]:
        with tempfile.TemporaryDirectory() as folder:
            took: list[Any] = []
            for label in ("cold", "warm"):
                where = f"{name}-{label}"
                run = lab.run(name, "--steps", steps, label=where, iterations=3, cache=Path(folder))
                seconds = run.seconds
                if len(seconds) < 3:
                    raise Failed(f"{name} ran {len(seconds)} iterations in place of 3")
                took.append(max(seconds[0] - min(seconds[1:]), 0.0))
        rows.append([name, *(f"{value:.2f}" for value in took)])
    lab.table(["program", "cold (s)", "with a filled cache (s)"], rows)
    lab.text("""The first iteration less the fastest one later: compiling all kernels and their
        gradients. The paper says of smoke on a GPU that DiffTaichi compiles 2 s, and JAX 2
        minutes.""")


def checkpointing(lab: Lab) -> None:
    steps, side = lab.pick(32, 512, 1024), lab.pick(16, 80, 80)
    run = lab.run("checkpointing", "--steps", steps, "--side", side)
    pattern = (
        r"^(\w+) +([\d.]+) MB of fields, +([\d.]+) MB on the tape, +([\d.]+) s, loss (\S+),"
        r" gradient (\S+) (\S+)$"
    )
    found = re.findall(pattern, run.output, re.M)
    lab.check(len(found) == 5, f"{len(found)} schemes in place of 5")
    names = {
        "stored": "a slot and a grid for each step",
        "grid": "one grid, filled again by hand (appendix D.1)",
        "segments": "and segments, run again by hand (appendix D.2)",
        "tape": "in place, the tape saves",
        "budget": "in place, within 50 MB",
    }
    rows: list[list[Any]] = []
    slopes: dict[str, Any] = {}
    for scheme, fields, tape, seconds, loss, *slope in found:
        rows.append([names[scheme], fields, tape, float(fields) + float(tape), seconds, loss])
        slopes[scheme] = tuple(map(float, slope))
    for scheme, slope in slopes.items():
        off = math.dist(slope, slopes["stored"]) / math.hypot(*slopes["stored"])
        lab.check(off < 1e-3, f"the gradient by {scheme} is off by {off:.1e}")
    header = ["scheme", "fields (MB)", "tape (MB)", "together (MB)", "a gradient (s)", "loss"]
    lab.table(header, rows)
    lab.text(f"""{side**2} particles, {steps} steps; the gradients agree. The paper describes the
        two schemes by hand and gives no numbers.""")


def explosion(lab: Lab) -> None:
    run = lab.run("gradient_explosion", pictures=True, label="growth")
    columns = run.table("growth")
    known = {0: (450.775, 142444), 1: (336.602, 0), 3: (212.144, 0), 10: (85.3762, 7566.1)}
    rows: list[list[Any]] = []
    for alpha, (by_push, by_decay) in known.items():
        push, decay = (columns[f"by {what}, alpha {alpha}"][-1] for what in ("push", "decay"))
        lab.near(push, by_push, 1e-4, f"the derivative by the push, alpha {alpha}")
        if by_decay:
            lab.near(decay, by_decay, 1e-3, f"the derivative by the decay, alpha {alpha}")
        rows.append([alpha, push, by_push, decay])
    header = ["damping", "by the push, 950 slots", "by the formula", "by the decay"]
    lab.table(header, rows)
    run_ = lab.run("gradient_explosion", "--descend", pictures=True, label="descent")
    pattern = r"^(alpha .*): loss (\S+) -> (\S+) in (\d+)(, flew off)?$"
    found = re.findall(pattern, run_.output, re.M)
    lab.check(len(found) == 4, f"{len(found)} descents in place of 4")
    for name, _, _, _, flew in found:
        should = name.startswith("alpha 0,") and "not clipped" in name
        lab.check(bool(flew) == should, f"{name}: {'flew off' if flew else 'stayed'}")
    shown = [[name, a, b, n, "flew off" if flew else ""] for name, a, b, n, flew in found]
    lab.table(["descent", "first loss", "last loss", "steps", ""], shown)
    folder, other = run.folder, run_.folder
    lab.picture(folder / "gradient_explosion.growth.png", "Gradients grow with the length")
    lab.picture(other / "gradient_explosion.descent.png", "With clipping, and without")


def line_counts(lab: Lab) -> None:
    rows: list[list[Any]] = []
    for name, count, code in lines.counts(lab.examples):
        rows.append([f"`{name}.py`", count, lines.PAPER.get(name, ""), code])
    lab.check(bool(rows), f"no simulators in {lab.examples}")
    lab.table(["program", "essential lines", "in the paper", "lines of code"], rows)
    lab.text("""Essential lines are fields, kernels and functions that a tape records; options,
        set-up, descent and pictures are not: `python scripts/line_counts.py --show smoke`.""")


EXPERIMENTS = [
    Experiment("lengths", "section 3", "Three springs of the right length", lengths),
    Experiment("table1", "table 1", "diffmpm: time and lines", table1),
    Experiment("table2", "table 2", "smoke: time and lines", table2),
    Experiment("toi", "figure 4, time of impact", "Gradients through a bounce", toi),
    Experiment("toi_curves", "figure 5", "Learning with time of impact, and without", toi_curves),
    Experiment("svd", "appendix C", "A gradient by hand", simulators.svd),
    Experiment("checkpointing", "appendix D", "Memory of checkpointing", checkpointing),
    Experiment("diffmpm", "appendix E", "A soft robot crawls", simulators.diffmpm),
    Experiment("diffmpm3d", "appendix E", "Thirty thousand particles", simulators.diffmpm3d),
    Experiment("liquid", "appendix E", "With liquid on the back", simulators.liquid),
    Experiment("smoke", "appendix E", "Smoke becomes a sign", simulators.smoke),
    Experiment("wave", "appendix E", "A ripple becomes a sign", simulators.wave),
    Experiment("mass_spring", "appendix E", "Robots of springs", simulators.mass_spring),
    Experiment("billiards", "appendix E", "Billiards", simulators.billiards),
    Experiment("rigid_body", "appendix E", "Robots of boxes", simulators.rigid_body),
    Experiment("water_renderer", "appendix E", "A ripple that deceives", simulators.water_renderer),
    Experiment("volume_renderer", "appendix E", "A body from shadows", simulators.volume_renderer),
    Experiment("electric", "appendix E", "Charges lead a ball", simulators.electric),
    Experiment("flat", "appendix G", "Flat land of billiards", flat),
    Experiment("discontinuity", "appendix G", "Friction makes a jump", discontinuity),
    Experiment("explosion", "published program", "Gradients that grow", explosion),
    Experiment("compiling", "section 4.2", "Compile times", compiling),
    Experiment("lines", "tables 1 and 2", "Lines of all simulators", line_counts),
]
