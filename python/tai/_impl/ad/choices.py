"""The ways to run a program that `ti.solve_to` chooses from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import dtypes
from .precision import PrecisionReport, bytes_of, owner_of
from .solution import Part, lines_of

# No type is wider than f64, so the error of an f64 run is only estimated, and the estimate is of
# the loss: the error of the gradient may be greater by this factor.
MARGIN_OF_F64 = 8.0
# The error of f64 may exceed 2^-29 times the measured error of f32 by this factor.
MARGIN_OF_DRAW = 4.0
# The error next to shadows is of one order of the operations, and may exceed that by this factor.
MARGIN_OF_SHADOWS = 1.5
# The size of f64 roundings relative to f32 roundings, and the same for fast elementary functions.
OF_F64, OF_FAST = 2.0**-29, 4.0
# The least bytes of a field that gains from a narrower type.
LEAST_BYTES = 4096
# First-order estimates of an error, and errors of repeated runs, are within this factor as a rule.
SAFETY = 2.0
# The name of the choice that stores fields in 16 bits.
NARROW = "16-bit fields"


@dataclass
class Choice:
    """Types of fields and modes: one of the candidate ways to run the program."""

    name: str
    modes: dict[str, Any]
    base: Any
    estimate: float
    narrow: dict[str, str] = field(default_factory=dict)
    version: Any = None
    seconds: float = math.inf
    result: tuple[float, np.ndarray] = (math.nan, np.zeros(0))
    errors: tuple[float, float] = (math.inf, math.inf)
    bytes: int = 0


def others_of(best: Choice, choices: list[Choice], room: float) -> list[str]:
    """Lists the narrower choices, with the reason why each was not taken."""
    found = []
    if choices[0].name != NARROW:
        found.append(f"no field of {LEAST_BYTES} bytes or more can be stored in 16 bits")
    for choice in choices:
        if choice is best:
            break
        measured = max(choice.errors)
        if choice.seconds < math.inf:
            text = f"gives {measured:.1e} in {choice.seconds / best.seconds:.2f} times the time"
        elif measured < math.inf:
            text = f"is off by {measured:.1e}"
        elif SAFETY * choice.estimate > room:
            text = f"is expected to be off by {choice.estimate:.1e}"
        else:
            text = "was not tried"
        found.append(f"{choice.name}: {text}")
    return found


def rounding_of(chosen: Choice, report: PrecisionReport) -> Part:
    if chosen.base is dtypes.f64:
        lines = lines_of(report, OF_F64)
        return Part("rounding", max(MARGIN_OF_F64 * chosen.estimate, *chosen.errors), lines,
                    f"{chosen.name}, eight times the estimate of one sweep")  # fmt: skip
    lines = lines_of(report, 1.0)
    size = abs(report.loss)
    lines += [
        (f"the storage of '{f.name}' in {chosen.narrow[f.name]}",
         f.errors[chosen.narrow[f.name]] / size)
        for f in report.fields if f.name in chosen.narrow
    ]  # fmt: skip
    return Part("rounding", max(chosen.errors), sorted(lines, key=lambda entry: -entry[1]),
                f"{chosen.name}, measured against f64 "
                f"({chosen.estimate:.1e} of the loss was expected)")  # fmt: skip


def bytes_in(places: list[Any], choice: Choice) -> int:
    return sum(
        math.prod(f.shape + f.element_shape)
        * bytes_of(choice.narrow.get(str(owner_of(f).name)) or choice.base.name)
        for f in places
    )


def apart(a: Any, b: Any, scale: Any) -> tuple[float, float]:
    """The distance of two results, next to a third one."""
    if a[1].shape != b[1].shape:
        raise TaiRuntimeTypeError("the gradient must have the same shape for all numbers of steps")
    size = float(np.linalg.norm(scale[1]))
    return abs(a[0] - b[0]) / abs(scale[0]), float(np.linalg.norm(a[1] - b[1])) / size


def scale_of(array: np.ndarray) -> np.ndarray:
    """The magnitude of each element, but at least the average magnitude of all elements."""
    size = np.abs(array.astype(float))
    return np.maximum(size, float(np.mean(size)) or 1.0)
