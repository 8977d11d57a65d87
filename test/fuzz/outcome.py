"""The outcome of one random program: agree, refused, undefined or FAIL."""

from __future__ import annotations

import functools
import importlib.util
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import random_kernels as programs
import singular
import tai as ti
from configurations import Configuration
from tai._impl.ad import compare, probe
from tai.errors import TaiCompilationError, TaiError

# Elements of which sums are right to the last digits.
FEW = 67

# Sums of more elements grow until functions of them turn faster than any step resolves. Above, the
# gradient must be that of forward mode and of the plain configuration.
MOST_FOR_DIFFERENCES = 300


_LAST_DIGITS = "reverse and forward mode differ in the last digits"

# The disturbance of each element of the sum of all elements, which a program may read: at a point
# beside, it shows how a program amplifies rounding.
JITTER = 1e-15

# Where the loss is off by as much at a point beside, the program repeats a map that pulls points
# apart, and a field may have its digits at one point beside and none at the next.
CHAOTIC = 1e-6


@dataclass
class Outcome:
    """The outcome of one seed.

    Attributes:
        kind: `agree`; `kink` (the differences see a kink, and the gradient lies between the
            slopes of its sides); `undefined` (the program itself gives no finite number);
            `undecided` (the differences do not settle, and there is no other reference);
            `refused` (an error that points to a line); or `FAIL`.
        reason: why, without names and numbers, so that it can be counted.
        detail: the whole message.
    """

    kind: str
    reason: str = ""
    detail: str = ""


def load(text: str, folder: Path, name: str, configuration: Configuration):
    """The program as a module, with its own fields."""
    configuration.init(default_fp=ti.f64, offline_cache=False)
    file = folder / f"{name}.py"
    file.write_text(programs.resize(text, configuration.elements))
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def fill(module, seed: int, kinked: bool, jitter: float = 0.0) -> None:
    """The point at which the program is differentiated, up to `jitter` in each number."""
    generator, noise = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    for name in programs.FLOAT_FIELDS:
        f = getattr(module, name)
        f.suggest_name(name)
        shape = f.shape + f.element_shape
        values = generator.uniform(-1.5, 1.5, shape)
        if kinked:
            special = generator.choice(np.array(programs.SPECIAL), shape)
            values = np.where(generator.random(shape) < 0.7, special, values)
            huge = generator.choice(np.array(programs.HUGE), shape)
            values = np.where(generator.random(shape) < 0.01, huge, values)
        f.from_numpy(values + jitter * noise.uniform(-1.0, 1.0, shape))
    n = module.N
    module.p.from_numpy(generator.permutation(n).astype(np.int32))
    module.q.from_numpy(generator.integers(0, n, n).astype(np.int32))
    module.k.from_numpy(generator.integers(0, 4, n).astype(np.int32))


def judge(
    text: str, seed: int, kinked: bool, folder: Path, configuration: Configuration | None = None
) -> Outcome:
    """Runs and differentiates a program; never raises."""
    configuration = configuration or Configuration()
    name = f"seed_{seed}".replace("-", "m")

    def at(where: Configuration, work: Callable) -> Any:
        with where.chosen():
            module = load(text, folder, name, where)
            fill(module, seed, kinked)
            return work(module, seed, kinked)

    try:
        found, values = at(configuration, _judge)
        if found.reason == _LAST_DIGITS and not kinked and configuration.arch == "cpu":
            # Parts of a derivative that cancel within one element leave the rounding of their sums,
            # which is large beside the remainder. With exact sums they agree.
            exact = _with_exact_sums(at, configuration, _judge)
            if exact and exact[0].kind in ("agree", "kink"):
                return Outcome("undecided", "rounding of sums decides", found.detail)
        reference = configuration.plain()
        if found.kind not in ("agree", "kink") or kinked or reference == configuration:
            return found
        expected, *beside = at(reference, _run_beside)
        differs = _compare(values, expected, beside)
        # The effect of the rounding of sums in the plain configuration, measured: equal terms are
        # all rounded to the same side, and the error grows with their number.
        exact = differs and _with_exact_sums(at, reference, lambda module, *_: _run(module)[1])
        differs = _compare(values, expected, [*beside, exact]) if exact else differs
        if differs and _noise("loss", expected, beside) > CHAOTIC:
            return Outcome("undecided", "rounding decides the loss", differs.detail)
        return differs or found
    except TaiError as error:
        located = error.lineno is not None
        if isinstance(error, TaiCompilationError) and located and not _is_bug(error):
            return Outcome("refused", f"{type(error).__name__}: {plain(error.message)}", str(error))
        return Outcome("FAIL", f"{type(error).__name__}: {plain(error.message)}", str(error))
    except Exception as error:
        return Outcome("FAIL", f"{type(error).__name__}: {plain(str(error))}", repr(error))


def _with_exact_sums(at: Callable, where: Configuration, work: Callable) -> Any:
    """The result of `work` with sums of twice the digits; None if they cannot be kept apart."""
    try:
        return at(replace(where, compensated=True), work)
    except TaiError:
        return None


def _is_bug(error: TaiError) -> bool:
    return "bug" in (error.hint or "") or "internal" in error.message


def plain(message: str) -> str:
    """A message without names and numbers."""
    line = message.splitlines()[0] if message else ""
    line = re.sub(r"'[^']*'", "'…'", line)
    line = re.sub(r"@\w+", "@…", line)
    return re.sub(r"-?\d+(\.\d+)?(e[-+]?\d+)?", "#", line)[:150]


def _run(module):
    """The program, and its loss and gradients by the names of the fields."""
    program = compare.Program(module.run, module.loss)
    program.record()
    program.start.restore(only_primal=True)
    base = program.values()[0]
    # Intermediate fields have no derivative of their own. Where the loss is not finite, there is
    # none at all; still nothing may crash.
    if np.isfinite(base).all():
        program.inputs = [(f, mask) for f, mask in program.inputs if program.is_input(f, mask)]
    gradients = program.sweep([np.ones(())])
    values = {f.name: np.array(gradients[f.symbol]) for f, _ in program.inputs}
    return program, {"loss": np.array(base)} | values


def _run_beside(module, seed: int, kinked: bool) -> list[dict]:
    """Loss and gradients, and those at a point beside."""
    values = _run(module)[1]
    fill(module, seed, kinked, JITTER * module.N)
    return [values, _run(module)[1]]


def _scale(values: np.ndarray) -> float:
    # Sums of many parts cancel, in another order each time.
    return max(float(np.max(np.abs(values))), 1e-6)


def _noise(name: str, reference: dict, beside: list[dict]) -> float:
    """The effect of rounding on a value, by the points beside."""
    expected = reference[name]
    off = (float(np.max(np.abs(other.get(name, expected) - expected))) for other in beside)
    return max(off) / _scale(expected)


def _compare(found: dict, reference: dict, beside: list[dict]) -> Outcome | None:
    """The same program has the same values in each configuration.

    `beside` are those at a point beside, and by other sums, which show how much of rounding must
    be let pass.
    """
    for name, expected in reference.items():
        value = found.get(name)
        if value is None or not np.isfinite(expected).all() or not np.isfinite(value).all():
            continue
        noise = _noise(name, reference, beside)
        scale = _scale(expected)
        error = float(np.max(np.abs(value - expected))) / scale
        # Where a program amplifies it this much, no digits are left to check.
        if noise < 1e-8 and not error <= 1e-9 + 100 * noise:
            what = "loss" if name == "loss" else "gradient"
            return Outcome(
                "FAIL",
                f"the {what} is not that of the plain configuration",
                f"{name}: differs by {error:.2g} of {scale:.6g}, rounding by {noise:.2g}",
            )
    return None


def _judge(module, seed: int, kinked: bool) -> tuple[Outcome, dict]:
    generator = np.random.default_rng(seed)
    program, values = _run(module)
    if not np.isfinite(values["loss"]).all():
        return Outcome("undefined", "the loss is not finite"), values
    gradients = {f.symbol: values[f.name] for f, _ in program.inputs}
    worst = Outcome("agree")
    for f, mask in program.inputs:
        gradient = gradients[f.symbol]
        outcome = _check_finite(program, f, mask, gradient)
        if outcome.kind == "agree":
            # Where threads sum in another order each time, as much is rounding.
            bound = 1e-9 if kinked or module.N > FEW else 1e-12
            beside = None
            if not kinked and module.N > FEW:
                beside = functools.partial(_gradient_beside, module, seed, f)
            outcome = _check_forward(program, f, mask, gradient, generator, kinked, bound, beside)
        if outcome.kind == "agree" and not kinked and module.N <= MOST_FOR_DIFFERENCES:
            outcome = _check_differences(program, f, mask, gradient, generator)
        if _RANK[outcome.kind] > _RANK[worst.kind]:
            worst = outcome
    return worst, values


_RANK = {"agree": 0, "kink": 1, "undecided": 2, "undefined": 3, "refused": 4, "FAIL": 5}


def _check_finite(program, f, mask, gradient) -> Outcome:
    """Where the gradient is NaN or infinite, the slopes must not have a finite limit."""
    for position in np.argwhere(~np.isfinite(gradient) & mask):
        at = tuple(position)
        limits = [_one_sided_limit(program, f, at, sign) for sign in (1.0, -1.0)]
        if all(limit is not None for limit in limits):
            if singular.is_right_when_scaled(program, f, at, limits):
                continue
            if singular.may_be_a_steep_tie(program, gradient[at]):
                return Outcome("kink", "infinite at a tie")
            return Outcome(
                "FAIL",
                "the gradient is not finite, but the slopes are",
                f"{f.name}{list(map(int, at))} = {_value(program, f, at)!r}: gradient "
                f"{gradient[at]!r}, slopes {limits}",
            )
    return Outcome("agree")


def _value(program, f, at):
    program.start.restore(only_primal=True)
    return compare.Snapshot._take(f)[at]


def _one_sided_limit(program, f, at, sign: float) -> float | None:
    """The limit of the slopes on one side, or None where they do not settle on a finite one."""
    here = abs(_value(program, f, at))
    if not here < 1e100 or 0 < here < 1e-100:
        return None  # differences cannot be taken at such scales
    offset = np.zeros(f.shape + f.element_shape)
    offset[at] = sign
    value = program.at(f, offset)
    base = float(value(0.0)[0])
    slopes = []
    for exponent in range(3, 10):
        step = 4.0**-exponent
        slopes.append(sign * (float(value(step)[0]) - base) / step)
    last = np.array(slopes[-4:])
    if not np.isfinite(last).all():
        return None
    scale = max(1e-6, float(np.max(np.abs(last))))
    if not 1e-15 * abs(base) * 4.0**9 < 1e-4 * scale:
        return None  # the loss is too large to see them
    changes = np.abs(np.diff(last))
    settles = changes[-1] <= 1e-3 * scale and changes[-1] <= 0.6 * changes[0] + 1e-6 * scale
    return float(last[-1]) if settles else None


def _gradient_beside(module, seed: int, f) -> np.ndarray:
    """The gradient at a point as far away as rounding of sums of all elements is."""
    fill(module, seed, False, JITTER * module.N)
    gradient = _run(module)[1][f.name]
    fill(module, seed, False)
    return gradient


def _check_forward(program, f, mask, gradient, generator, kinked, bound, beside=None) -> Outcome:
    finite = np.isfinite(gradient) & mask
    if not finite.any():
        return Outcome("agree")
    along = probe.direction(generator, gradient, finite)
    expected = compare.forward_derivative(program, f, along, [np.ones(())])
    if expected is None:
        return Outcome("agree")
    parts = (gradient * along)[finite]
    reverse = float(np.sum(parts))
    if not np.isfinite(expected) and singular.stores_infinite_tangents(program, f, along):
        return Outcome("undefined", "a kernel stores an infinite derivative")
    scale = float(np.sum(np.abs(parts)))
    error = probe.relative_error(reverse, expected, scale)
    # Products of huge and tiny numbers may cancel in one order and not in the other.
    if error <= bound or (kinked and not scale < 1e250):
        return Outcome("agree")
    off = abs(reverse - expected)
    if kinked and singular.is_lost_in_rounding(program, f, along, off):
        return Outcome("undecided", "rounding decides")
    if error <= 1e-9 and singular.is_below_rounding(program, off):
        return Outcome("agree")
    if beside:
        # Each mode ran the program once. If threads add in another order each time, they have seen
        # other sums, and a program may amplify their differences: a cosine of a sum. However much
        # it amplifies, some digits are the same.
        noise = abs(float(np.sum((beside() - gradient)[finite] * along[finite]))) / scale
        if error <= min(100 * noise, 1e-4):
            return Outcome("undecided", "rounding decides")
    return Outcome(
        "FAIL",
        _LAST_DIGITS if error <= 1e-9 else "reverse and forward mode differ",
        f"{f.name}: reverse {reverse!r}, forward {expected!r}, error {error:.2g}",
    )


def _check_differences(program, f, mask, gradient, generator) -> Outcome:
    along = probe.direction(generator, gradient, mask)
    reverse = float(np.sum(gradient * along))
    scale = float(np.linalg.norm(gradient)) / math.sqrt(gradient.size)
    value = program.at(f, along)
    climb = probe.climb(value, [np.ones(())], reverse, scale, quick=True)
    if climb.error <= climb.tolerance:
        return Outcome("agree")
    detail = "\n".join([f"{f.name}: reverse {reverse!r}, {climb.method} {climb.expected!r}, "
                        f"error {climb.error:.2g}", *climb.show()])  # fmt: skip
    if climb.passed:
        return Outcome("kink", "", detail)
    rungs = [r for r in climb.ladder if r.improved is not None]
    spread = min(
        abs(a.improved - b.improved) / max(abs(a.improved), scale, 1e-300)
        for a, b in zip(rungs, rungs[1:], strict=False)
    )
    if climb.jump or not spread < 1e-2 * climb.error:
        return Outcome("undecided", "the differences do not settle", detail)
    return Outcome("FAIL", "the gradient and differences disagree", detail)
