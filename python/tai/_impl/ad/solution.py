"""The result of `ti.solve_to`: the choice, its error, its causes; parameters that are chosen."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiGradientWarning, TaiRuntimeTypeError, shorten
from ..base.callers import calling_level
from .precision import PrecisionReport


@dataclass
class Part:
    """One cause of the error of a solution, and its share.

    Attributes:
        name: "rounding", "discretisation" or "solver".
        error: relative, of the loss or of the gradient (L2), whichever is greater.
        lines: the places that cause it, largest first: text and relative error of the loss.
        how: how it was found.
    """

    name: str
    error: float
    lines: list[tuple[str, float]]
    how: str

    def __str__(self) -> str:
        head = f"  {self.error:8.1e}  {self.name}: {self.how}"
        return "\n".join([head, *(f"            {e:8.1e}  {text}" for text, e in self.lines[:4])])


@dataclass
class Solution:
    """The result of `ti.solve_to`.

    Attributes:
        modes: the choice: `precision`, `sums` and `math` as in `ti.init`, `types` of fields by name
            where they differ from the program's own; `tape`: "everything" or "snapshots", the
            values that the tape keeps; `steps` and `tol` where `run` takes them.
        error: the relative error that is expected, at most the one that was asked for: the sum of
            the parts.
        parts: the causes, each with the lines that it comes from.
        time: seconds of one run and its sweep in these modes.
        asked: the error that was asked for.
        loss, gradients: the results, in f64, an array for each field of `wrt`; the fields have
            them too, rounded to their own types.
        iterations: runs and sweeps that it took to choose.
        reference_time: seconds of one run and its sweep in the reference.
        tried: lines about the modes that were measured.
        notes: remarks, such as that the fields cannot hold the digits that were asked for.
        room: why the error is below 0.05 times the one that was asked for, where it is: the modes
            that have more error, and their times. Otherwise empty.
        memory: the most bytes that the tape keeps at any time.
    """

    modes: dict[str, Any]
    error: float
    parts: list[Part]
    time: float
    asked: float
    loss: float
    gradients: list[np.ndarray]
    iterations: int
    reference_time: float
    tried: list[str]
    notes: list[str]
    room: str = ""
    memory: int = 0
    _again: Callable[[], None] = field(repr=False, default=lambda: None)

    def run(self) -> None:
        """Runs the program and its sweep once more, in the chosen modes.

        It begins with the fields as they are, and leaves values and gradients in them.
        """
        self._again()

    def __str__(self) -> str:
        shown = ", ".join(f"{n}={v!r}" for n, v in self.modes.items() if n != "types")
        kinds: dict[str, list[str]] = {}
        for name, kind in self.modes["types"].items():
            kinds.setdefault(kind, []).append(name)
        for kind, names in kinds.items():
            more = f" and {len(names) - 6} more" if len(names) > 6 else ""
            shown += f"; {', '.join(names[:6])}{more} in {kind}"
        lines = [
            f"solve_to: {shown}",
            f"  {self.error:8.1e}  expected, {self.asked:.0e} allowed; "
            f"{1e3 * self.time:.3g} ms for an iteration ({1e3 * self.reference_time:.3g} ms in the "
            f"reference), chosen by {self.iterations} iterations; the tape keeps "
            f"{self.memory / 2**20:.3g} MiB",
        ]
        notes = [f"  note: {n}" for n in self.notes]
        notes += [f"  room: {self.room}"] if self.room else []
        return "\n".join([*lines, *map(str, self.parts), *notes])


def find_short_fields(loss: Any, unknowns: list[Any], error: float) -> list[str]:
    """Warns of fields whose type cannot hold as many digits as were asked for, and lists them."""
    units = {16: 2.0**-9, 32: 2.0**-24, 64: 0.0}
    results = [loss, *(f._companions["grad"] for f in unknowns)]
    short = [f for f in results if units[f.dtype.bits] > error / 2]
    if not short:
        return []
    text = (
        f"'{short[0].name}' is of {short[0].dtype}, which cannot hold an error of {error:.1e}: "
        "`loss` and `gradients` of the result have all digits"
    )
    warnings.warn(f"ti.solve_to: {text}", TaiGradientWarning, stacklevel=calling_level())
    return [text]


def options_of(run: Callable[..., Any]) -> dict[str, Any]:
    """The parameters of a program that can be chosen, with their defaults.

    Raises:
        TaiRuntimeTypeError: it has another parameter without a default, or these have none.
    """
    try:
        parameters = inspect.signature(run).parameters.values()
    except (TypeError, ValueError):  # a kernel
        return {}
    found: dict[str, Any] = {}
    for p in parameters:
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        if p.name in ("steps", "tol"):
            known = isinstance(p.default, (int, float)) and not isinstance(p.default, bool)
            if not known or p.default <= 0 or (p.name == "steps" and p.default != int(p.default)):
                raise TaiRuntimeTypeError(
                    f"the parameter '{p.name}' of run needs a default, a positive number",
                    "def run(steps=64): …" if p.name == "steps" else "def run(tol=1e-6): …",
                )
            found[p.name] = p.default
        elif p.default is p.empty:
            raise TaiRuntimeTypeError(
                f"run takes an argument '{p.name}', and ti.solve_to knows 'steps' and 'tol' alone",
                "lambda: run(…)",
            )
    return found


def place_of(function: Callable[..., Any]) -> str:
    """Returns the file and line at which a function is defined."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return "run" if code is None else f"{shorten(code.co_filename)}:{code.co_firstlineno}"


def lines_of(report: PrecisionReport, unit: float) -> list[tuple[str, float]]:
    """Returns the lines and sums of a report with their relative effect on the loss."""
    size = abs(report.loss) / unit
    found = [
        (f"{shorten(line.filename)}:{line.lineno}  {line.text}", abs(line.error) / size)
        for line in report.lines
    ]
    found += [(name, abs(part) / size) for name, part in report.others if part]
    return sorted(found, key=lambda entry: -entry[1])


def worst_of(report: PrecisionReport, unit: float) -> str:
    """Describes the lines of the program that lose most digits."""
    return "; ".join(f"{text} ({off:.1e})" for text, off in lines_of(report, unit)[:3])
