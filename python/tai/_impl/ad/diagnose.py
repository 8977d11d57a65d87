"""`ti.ad.diagnose`: all diagnostics of a gradient in one table, a row for each."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import TaiAssertionError, TaiError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import state
from .check import check
from .compare import as_fields
from .snapshot import Snapshot
from .tape import Tape
from .tuning import tune_precision
from .validation import Violation


@dataclass
class DiagnosisRow:
    """The result of one diagnostic.

    Attributes:
        name: `gradient`, `health`, `rules`, `precision` or `types`.
        verdict: `good`, `BAD`, `note` (a fact that need not be wrong) or `FAILED` (an error).
        summary: one line.
        report: the result in full: a `CheckResult`, a `HealthReport`, a list of `Violation`, a
            `PrecisionReport`, a `TunedPrecision`, or the error.
    """

    name: str
    verdict: str
    summary: str
    report: Any


@dataclass
class Diagnosis:
    """The results of the diagnostics of one program; true if no row is `BAD` or `FAILED`.

    Attributes:
        rows: one for each diagnostic, in the order of execution.
    """

    rows: list[DiagnosisRow]

    def __bool__(self) -> bool:
        return all(row.verdict in ("good", "note") for row in self.rows)

    def __getitem__(self, name: str) -> DiagnosisRow:
        """Returns the row of a diagnostic."""
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    def __str__(self) -> str:
        lines = [f"diagnosis: {'good' if self else 'NOT GOOD'}"]
        lines += [f"  {row.name:10} {row.verdict:7} {row.summary}" for row in self.rows]
        return "\n".join(lines)

    __repr__ = __str__


@dataclass
class _Program:
    """A program under diagnosis, and the numbers that the caller asks for."""

    run: Callable[[], Any]
    loss: Any
    wrt: Any
    error: float


def _check_gradient(program: _Program) -> DiagnosisRow:
    result = check(program.run, loss=program.loss, wrt=program.wrt)
    if result:
        text = f"agrees with forward mode and differences within {result.error:.1e}"
    elif result.unchecked:
        text = f"nothing was checked: {result.unchecked}"
    else:
        wrong = f", first in kernel '{result.culprit.kernel}'" if result.culprit else ""
        text = f"is off by {result.error:.1e}{wrong}"
    return DiagnosisRow("gradient", "good" if result else "BAD", text, result)


def _look_at_health(program: _Program) -> DiagnosisRow:
    with Tape(program.loss, health=True) as tape:
        program.run()
    report = tape.health()
    if report:
        text = "no NaN, overflow, growth or vanishing"
    else:
        first, rest = report.findings[0], len(report.findings) - 1
        text = f"{first.kind}: {first.message}" + (f" (and {rest} more)" if rest else "")
    return DiagnosisRow("health", "good" if report else "BAD", text, report)


def _check_rules(program: _Program) -> DiagnosisRow:
    """A tape saves elements that are overwritten, so breaking the rules of access is no error."""
    found: list[Violation] = []
    try:
        with Tape(program.loss, validation=True):
            program.run()
    except TaiAssertionError as error:
        if not hasattr(error, "violations"):
            raise
        found = error.violations
    text = (
        f"the tape saves old values: {found[0].message}" if found else "no element is overwritten"
    )
    return DiagnosisRow("rules", "note" if found else "good", text, found)


def _estimate_precision(program: _Program) -> DiagnosisRow:
    with Tape(program.loss, precision=True) as tape:
        program.run()
    report = tape.precision_report(program.error)
    text = f"rounding changes the loss by {report.relative:.1e} of it (allowed {program.error:.0e})"
    good = report.relative <= program.error
    return DiagnosisRow("precision", "good" if good else "BAD", text, report)


def _tune_types(program: _Program) -> DiagnosisRow:
    tuned = tune_precision(program.run, program.loss, program.error, program.wrt, verbose=False)
    chosen = ", ".join(f"{name}: {kind}" for name, kind in tuned.types.items())
    text = f"{tuned.bytes_before:,} -> {tuned.bytes_after:,} bytes by {chosen}" if chosen else ""
    return DiagnosisRow("types", "note", text or "no field may be narrower", tuned)


_DIAGNOSTICS = {
    "gradient": _check_gradient,
    "health": _look_at_health,
    "rules": _check_rules,
    "precision": _estimate_precision,
    "types": _tune_types,
}


def diagnose(
    target: Callable[..., Any],
    *args: Any,
    loss: Any,
    wrt: Any = None,
    error: float = 1e-4,
    only: str | Sequence[str] | None = None,
) -> Diagnosis:
    """Runs all diagnostics of a gradient, and returns a table with a row for each.

    ```python
    print(ti.ad.diagnose(simulate, loss=loss, wrt=[x], error=1e-3))
    ```

    | row | says | alone |
    |---|---|---|
    | `gradient` | whether the gradient agrees with forward mode and differences | `ti.ad.check` |
    | `health` | NaN, overflow, growth and vanishing of adjoints | `Tape.health` |
    | `rules` | whether an element is overwritten | `Tape(loss, validation=True)` |
    | `precision` | the effect of rounding on the loss | `Tape.precision_report` |
    | `types` | the fields that may be narrower, as measured | `ti.ad.tune_precision` |

    The program runs several times for each row, with the fields as they are at the call; they are
    restored. A diagnostic that raises an error becomes a row with that error.

    Args:
        target: a kernel, or a function that runs kernels.
        args: its arguments.
        loss: the field of the loss, of one number.
        wrt: the fields whose gradients matter; if left out, all that the target reads.
        error: the relative error that rounding and narrower types may cause in the loss.
        only: the rows to make, one or several; all if left out.

    Raises:
        TaiRuntimeTypeError: the target, the loss or a name of a row is none.
        TaiRuntimeError: called inside a tape.
    """
    if state.tape is not None:
        raise TaiRuntimeError(
            "a gradient cannot be diagnosed inside a tape", "leave the tape first"
        )
    if not callable(target):
        raise TaiRuntimeTypeError(
            f"ti.ad.diagnose takes a kernel or a function, but got {target!r}",
            "ti.ad.diagnose(run, loss=loss, wrt=[x])",
        )
    names = list(_DIAGNOSTICS) if only is None else [only] if isinstance(only, str) else list(only)
    for name in names:
        if name not in _DIAGNOSTICS:
            raise TaiRuntimeTypeError(
                f"ti.ad.diagnose has no row {name!r}", f"the rows are {', '.join(_DIAGNOSTICS)}"
            )
    as_fields([loss], "loss")
    loss.materialize()
    program = _Program(functools.partial(target, *args), loss, as_fields(wrt, "wrt"), error)
    rows = []
    for name in names:
        with Snapshot():
            try:
                rows.append(_DIAGNOSTICS[name](program))
            except TaiError as raised:
                rows.append(DiagnosisRow(name, "FAILED", str(raised).splitlines()[0], raised))
    return Diagnosis(rows)
