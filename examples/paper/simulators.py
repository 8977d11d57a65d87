"""The simulators of the paper's appendix, each by gradient descent with known first losses.

Known losses were measured on the paper's published programs, in f32 and with atomics; tolerances
are those to which two correct programs agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .lab import Lab, Run, usual

Known = dict[int, float]


def _descent(
    lab: Lab, name: str, *options: Any, iterations: int, known: Known, rel: float,
    label: str = "run", pictures: bool = False,
) -> Run:  # fmt: skip
    """Runs a descent and compares the losses of some iterations."""
    run = lab.run(name, *options, iterations=iterations, label=label, pictures=pictures)
    losses = run.losses
    for number, loss in known.items():
        if number < len(losses):
            lab.near(losses[number], loss, rel, f"loss {number} of {name}")
    return run


def _row(what: str, run: Run, known: Known) -> list[Any]:
    losses = run.losses
    last = len(losses) - 1
    milliseconds = 1e3 * usual(run.seconds)
    digits = 0 if milliseconds >= 100 else 1 if milliseconds >= 10 else 2
    time = f"{milliseconds:.{digits}f} ms" if last else "-"
    there = known.get(last, "")
    return [what, losses[0], known.get(0, ""), last + 1, losses[-1], there, min(losses), time]


HEADER = [
    "scene", "first loss", "in the paper's program", "steps of descent", "last loss",
    "in the paper's program", "best loss", "an iteration",
]  # fmt: skip


def _show(lab: Lab, rows: Sequence[list[Any]], curves: dict[str, Any], log: bool = False) -> None:
    lab.table(HEADER, rows)
    if max(map(len, curves.values())) > 1:
        title = lab.result.name
        lab.plot("losses", curves, f"Descent of {title}", x="iteration", y="loss", log=log)


def _one(
    lab: Lab, name: str, *options: Any, iterations: int, known: Known, rel: float,
    log: bool = False, pictures: bool = False, what: str = "",
) -> Run:  # fmt: skip
    """Makes an experiment that consists of a single descent."""
    run = _descent(
        lab, name, *options, iterations=iterations, known=known, rel=rel, pictures=pictures
    )
    _show(lab, [_row(what or name, run, known)], {name: run.losses}, log)
    return run


def svd(lab: Lab) -> None:
    count = lab.pick(1, 400, 400)
    run = _one(lab, "svd_gradient", iterations=count, known={}, rel=0, log=True)
    slope, difference = run.find(r"^slope +(\S+) by the gradient, (\S+) by differences")
    lab.near(slope, difference, 1e-6, "the slope by the gradient")
    lab.table(["slope by the gradient", "by differences"], [[f"{slope:.9f}", f"{difference:.9f}"]])


def diffmpm(lab: Lab) -> None:
    known = {0: -0.250387, 1: -0.257541, 2: -0.263767, 3: -0.268429, 4: -0.271243}
    count, steps = lab.pick(1, 5, 100), lab.pick(16, 1024, 1024)
    options = () if steps == 1024 else ("--steps", steps)
    known = known if steps == 1024 else {}
    _one(lab, "diffmpm", *options, iterations=count, known=known, rel=1e-3)
    lab.text("After 65 steps the paper's program has a loss of -0.465135; from step 5 on the runs "
             "of two correct programs part.")  # fmt: skip


def _thirty_thousand(lab: Lab, name: str, known: Known, *options: Any) -> None:
    if lab.level == "once":
        _one(lab, name, "--steps", 8, "--density", 1, iterations=1, known={}, rel=0)
        return
    count = lab.pick(0, 2, 5)
    _one(
        lab, name, "--steps", 128, *options, iterations=count, known=known, rel=5e-5,
        what=f"{name}, 128 slots",
    )  # fmt: skip
    if lab.level == "full":
        run = lab.run(name, iterations=100, label="full", pictures=True)
        lab.table(HEADER, [_row(f"{name}, 512 slots", run, {})])
        lab.plot("full", {name: run.losses}, "512 slots", x="iteration", y="loss")


def diffmpm3d(lab: Lab) -> None:
    _thirty_thousand(lab, "diffmpm3d", {0: -0.250005, 1: -0.250917}, "--start", "sines")


def liquid(lab: Lab) -> None:
    _thirty_thousand(lab, "liquid", {0: -0.220104, 1: -0.220364})


def smoke(lab: Lab) -> None:
    known = {0: 0.5, 1: 0.320631, 2: 0.227978, 3: 0.185877, 9: 0.126654, 19: 0.0984557}
    count, steps = lab.pick(1, 20, 240), lab.pick(5, 100, 100)
    options = ("--steps", steps)
    _one(lab, "smoke", *options, iterations=count, known=known if steps == 100 else {}, rel=5e-3)
    lab.text("On a grid of 128² with 10 sweeps, to the yin-yang sign.")


def wave(lab: Lab) -> None:
    known = {0: 0.246349, 1: 0.224315, 2: 0.207216, 19: 0.135361, 49: 0.112776, 199: 0.07538}
    _one(lab, "wave", iterations=lab.pick(1, 200, 200), known=known, rel=1e-3)
    lab.text("The exact first loss is 0.246378; the published program adds it up in f32.")


def mass_spring(lab: Lab) -> None:
    firsts = {
        1: {0: -0.215316, 1: -0.225342},
        2: {0: -0.212226, 1: -0.215992},
        3: {0: -0.227929, 1: -0.246183},
    }
    count = lab.pick(1, 30, 100)
    rows: list[list[Any]] = []
    curves: dict[str, Any] = {}
    for robot in lab.pick((1,), (1, 2, 3), (1, 2, 3)):
        run = _descent(
            lab, "mass_spring", "--robot", robot, iterations=count, known=firsts[robot], rel=1e-3,
            label=f"robot{robot}",
        )  # fmt: skip
        rows.append(_row(f"robot {robot}", run, firsts[robot]))
        curves[f"robot {robot}"] = run.losses
    _show(lab, rows, curves)
    lab.text("""The loss is minus the way. The best losses of the paper's program in 100 steps are
        -0.452, -0.452 and -0.454; after the first steps two correct programs part.""")


def billiards(lab: Lab) -> None:
    known = {0: 0.045418, 1: 0.029303, 2: 0.028748, 19: 0.005971, 199: 2.23e-5}
    count = lab.pick(1, 200, 200)
    run = _one(lab, "billiards", iterations=count, known={0: 0.045418}, rel=1e-4, log=True)
    if count == 200:
        lab.check(run.losses[-1] < 1e-3, f"the last loss is {run.losses[-1]:.3g}")
        lab.near(run.losses[19], known[19], 0.05, "loss 19 of billiards")
        lab.text("The paper's program ends at 2.23e-5, on a plateau.")


def rigid_body(lab: Lab) -> None:
    firsts = {
        1: {0: 0.75281, 1: 0.744555, 19: 0.464376},
        2: {0: 0.586751, 1: 0.547042, 19: 0.33569},
    }
    rows: list[list[Any]] = []
    curves: dict[str, Any] = {}
    for robot in lab.pick((1,), (1, 2), (1, 2)):
        known = firsts[robot]
        first = {number: known[number] for number in (0, 1)}
        run = _descent(
            lab, "rigid_body", "--robot", robot, iterations=lab.pick(1, 20, 20), known=first,
            rel=1e-3, label=f"robot{robot}",
        )  # fmt: skip
        rows.append(_row(f"robot {robot}", run, known))
        curves[f"robot {robot}"] = run.losses
        if len(run.losses) == 20:
            lab.check(run.losses[-1] < 0.75 * run.losses[0], f"robot {robot} does not walk")
    _show(lab, rows, curves)
    lab.text("The loss is the distance from the goal after two seconds.")


def water_renderer(lab: Lab) -> None:
    options = lab.pick(("--quick",), ("--quick", "--iterations", "10"), ())
    run = lab.run("water_renderer", *options)
    losses, chances = run.losses, run.table()["probability"]
    if len(losses) > 1:
        lab.check(losses[-1] < losses[0], "the loss does not fall")
    lab.table(
        ["steps of descent", "first loss", "last loss", "probability at first", "at the end"],
        [[len(losses), losses[0], losses[-1], chances[0], chances[-1]]],
    )
    lab.text("""A small network that learns to tell patterns. The paper's experiment, a squirrel
        that VGG-16 takes for a goldfish (99.91 %), takes its weights: `--weights`.""")


def volume_renderer(lab: Lab) -> None:
    if lab.level == "full":
        _one(lab, "volume_renderer", iterations=100, known={}, rel=0, log=True)
        return
    known = {0: 0.00379664, 1: 0.00129887, 2: 0.000452985, 9: 5.17796e-06, 19: 2.81761e-06}
    options = ("--res", 64, "--views", 3)
    count = lab.pick(1, 20, 0)
    _one(lab, "volume_renderer", *options, iterations=count, known=known, rel=1e-3, log=True)
    lab.text("Three pictures of 64² of a body of 128³ voxels.")


def electric(lab: Lab) -> None:
    known = {0: 2.43744, 1: 0.643623, 2: 3.64072, 3: 0.329470, 4: 2.87283, 7: 1.02519}
    options = ("--controller", "published", "--gradient", "reread")
    count = lab.pick(1, 100, 1000)
    published = _descent(
        lab, "electric", *options, iterations=count, known=known, rel=1e-3, label="published"
    )
    ours = _descent(lab, "electric", iterations=count, known={}, rel=0, label="before")
    names = ("as published", "sees the slot before, right gradient")
    rows: list[list[Any]] = []
    for name, run in zip(names, (published, ours), strict=True):
        tail = run.losses[-50:]
        rows.append([name, run.losses[0], count, sum(tail) / len(tail)])
    lab.table(["controller", "first loss", "steps of descent", "mean of the last 50 losses"], rows)
    lab.text("""Each step of descent has a new path. The published controller reads slots that are
        overwritten afterwards; see docs/reports/gradients-compared.md.""")
