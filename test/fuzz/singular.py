"""Derivatives that may be infinite, or noise, though the slopes of the program are not, and tests
for them.

Things that floats and the conventions of docs/reference/derivatives.md leave:

- The derivative of a part is beyond the range, such as that of log at a denormal number, and
  comes back into it later. A gradient is linear in its seed: with a small one it must be right.
- At a tie one operand gets the whole gradient, and its slope is infinite, as in
  min(x, sqrt(x)) at zero.
- A derivative that is infinite in itself, such as that of sqrt at zero, was stored in a field by
  one kernel and meets a factor of zero in another. Rule 1 holds within kernels.
- Rounding decides: the remainder of a derivative after it has cancelled.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from tai._impl.ad import compare, mode

SEED = 2.0**-600
TIE = re.compile(r"\b(min|max|clamp|atomic_min|atomic_max)\(")
STEEP = re.compile(r"\b(sqrt|rsqrt|log|asin|acos)\(|1 / ")


def is_right_when_scaled(program, f, at: tuple, slopes: list[float]) -> bool:
    """Whether the gradient of the loss times a small number lies between the slopes times that."""
    loss, program.loss = program.loss, None
    try:
        found = program.sweep([np.full((), SEED)])[f.symbol][at] / SEED
    finally:
        program.loss = loss
    low, high = min(slopes), max(slopes)
    slack = 1e-3 * max(1e-6, abs(low), abs(high))
    return bool(np.isfinite(found) and low - slack <= found <= high + slack)


def may_be_a_steep_tie(program, gradient: float) -> bool:
    """Whether an operand of infinite slope may have won a tie in the program."""
    text = source(program)
    return bool(np.isinf(gradient) and TIE.search(text) and STEEP.search(text))


def stores_infinite_tangents(program, f, along: np.ndarray) -> bool:
    """Whether a launch leaves an infinite tangent in a field for the next one; the loss aside.

    A tangent that is NaN is not meant: it comes after an infinite one, or is an error.
    """
    text = source(program)
    launches = [line.strip() for line in text[text.index("def run():") :].splitlines()[1:]]
    duals = [
        known._companions["dual"]
        for known in compare.differentiable_fields().values()
        if known.symbol not in {output.symbol for output in program.outputs}
    ]
    program.start.restore(only_primal=True)
    mode.clear_duals()
    f._companions["dual"].core.copy_from(np.ascontiguousarray(along, f.dtype.numpy))
    with mode.ForwardMode():
        for launch in filter(None, launches):
            exec(launch, program.run.__globals__)
            if any(np.isinf(compare.Snapshot._take(dual)).any() for dual in duals):
                return True
    return False


def is_lost_in_rounding(program, f, along: np.ndarray, error: float) -> bool:
    """Whether the derivative differs by more than `error` where each number is off by an ulp.

    A matrix of the condition 1e160 leaves nothing of the derivatives of its inverse.
    """
    generator = np.random.default_rng(0)
    start = program.start
    start.restore(only_primal=True)
    for known in compare.differentiable_fields().values():
        values = compare.Snapshot._take(known)
        off = values * (1 + np.finfo(float).eps * generator.uniform(-2, 2, values.shape))
        known.core.copy_from(np.ascontiguousarray(off, known.dtype.numpy))
    program.start = compare.Snapshot()
    found = []
    try:
        for _ in range(2):
            gradient = program.sweep([np.ones(())])[f.symbol]
            found.append(float(np.sum(np.where(along != 0, gradient * along, 0.0))))
            program.start = start
    finally:
        program.start = start
        start.restore(only_primal=True)
    return abs(found[0] - found[1]) > 0.1 * error


def is_below_rounding(program, error: float) -> bool:
    """Whether the error is nothing beside the greatest derivative of the program.

    A remainder of parts that cancel inside of a program has their rounding.
    """
    gradients = program.sweep([np.ones(())]).values()
    greatest = max(float(np.max(np.abs(g[np.isfinite(g)]), initial=0.0)) for g in gradients)
    return error <= 8 * np.finfo(float).eps * greatest


def source(program) -> str:
    """The text of the module that the program is in."""
    return Path(program.run.__code__.co_filename).read_text()
