"""Diagnosis of a gradient: NaN, overflow, explosion and vanishing, by record and by kernel."""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ...errors import TaiGradientWarning, shorten
from ..base import state
from ..base.callers import calling_level
from ..base.program import get_program
from ..base.targets import cuda
from .compare import READ, Accesses, differentiable_fields, elements
from .condition import weigh_inputs
from .seeds import number_of
from .snapshot import Snapshot
from .source import Place

# If the logarithm of the norm of an adjoint grows by more than this number for each replay of a
# kernel, the gradient says more about rounding than about the program.
GROWTH_LIMIT = 0.1
_LEAST_STEPS = 8


@dataclass
class HealthRow:
    """The adjoint of one field after the adjoint of one record has run.

    Attributes:
        record: number in the tape.
        kernel: name of the kernel, or of the host function.
        field: whose adjoint it is. If the field has a time axis: the part that the record reads.
        nans, infs: how many of its numbers are none, or infinite.
        max_abs, norm: the greatest magnitude, and the norm, of the finite numbers.
        symbol: the symbol of the field in the IR.
    """

    record: int
    kernel: str
    field: str
    nans: int
    infs: int
    max_abs: float
    norm: float
    symbol: str = ""


@dataclass
class KernelHealth:
    """The findings about all adjoint launches of one kernel in a reverse sweep.

    Attributes:
        replays: how many records were replayed.
        nans, infs: numbers found after them, all together.
        max_abs: the greatest finite adjoint.
        growth: slope of the logarithm of the norm from one replay to the next, backwards in
            time; nan where there are fewer than 8 replays.
    """

    kernel: str
    filename: str | None
    lineno: int | None
    replays: int
    nans: int
    infs: int
    max_abs: float
    growth: float


@dataclass
class Finding:
    """One NaN, infinity or other problem that the report has found.

    Attributes:
        kind: `nan`, `overflow`, `growth`, `flat` or `cancellation`.
        message: the problem, and its place.
        record, kernel, filename, lineno: of the record where it appears first, where known.
    """

    kind: str
    message: str
    record: int | None = None
    kernel: str | None = None
    filename: str | None = None
    lineno: int | None = None


@dataclass
class HealthReport:
    """Diagnosis of the adjoints of a reverse sweep; true if there are no findings.

    Attributes:
        rows: one for each record that was replayed and each field whose adjoint it adds to,
            in the order of the sweep (last record first).
        kernels: the rows combined by kernel.
        findings: the problems found.
        flat: names of fields on which the loss does not depend.
    """

    rows: list[HealthRow]
    kernels: list[KernelHealth]
    findings: list[Finding] = field(default_factory=list)
    flat: list[str] = field(default_factory=list)

    def __bool__(self) -> bool:
        return not self.findings

    @property
    def first_nan(self) -> Finding | None:
        """The first NaN or infinity that the reverse sweep has produced."""
        return next((f for f in self.findings if f.kind in ("nan", "overflow")), None)

    def to_dict(self) -> dict[str, Any]:
        """Returns the report as dictionaries, lists and numbers."""
        return asdict(self)

    def __str__(self) -> str:
        width = max([len(k.kernel) for k in self.kernels] + [6])
        lines = [
            f"gradient health: {'good' if self else 'NOT GOOD'}",
            f"  {'kernel':{width}} replays    nan    inf  greatest   growth  line",
        ]
        for k in self.kernels:
            growth = "-" if math.isnan(k.growth) else f"{k.growth:+.3f}"
            place = f"{shorten(k.filename)}:{k.lineno}" if k.filename else "-"
            lines.append(
                f"  {k.kernel:{width}} {k.replays:7d} {k.nans:6d} {k.infs:6d} {k.max_abs:9.2e} "
                f"{growth:>8}  {place}"
            )
        lines += [f"  {f.kind}: {f.message}" for f in self.findings]
        return "\n".join(lines)

    __repr__ = __str__


def take_health(core: Any, loss: Any, watched: bool) -> HealthReport:
    """The report of the last sweep, or of one that is run for it."""
    if watched:
        return _report(core, loss)
    with Snapshot():
        try:
            core.clear_gradients()
            core.watch_health(True)
            core.backward()
            return _report(core, loss)
        finally:
            core.watch_health(False)


def _report(core: Any, loss: Any) -> HealthReport:
    places: dict[int, Place] = {}

    def place(record: int) -> Place:
        if record not in places:
            places[record] = Place(core, record)
        return places[record]

    program_fields = _names()
    rows = [
        HealthRow(
            record,
            place(record).kernel,
            program_fields.get(symbol, symbol),
            *numbers,
            symbol,  # type: ignore[call-arg]
        )  # fmt: skip
        for record, symbol, *numbers in core.health()
    ]
    report = HealthReport(rows, _by_kernel(rows, place))
    _find_nans(report, core, loss, place)
    _find_growth(report)
    _find_amplification(report, loss, place)
    found = Accesses(core, loss)
    _find_flat(report, found)
    _find_cancellation(report, found, loss)
    return report


def _names() -> dict[str, str]:
    return {symbol: f.name for symbol, f in get_program().fields.items()}


def _by_kernel(rows: list[HealthRow], place: Any) -> list[KernelHealth]:
    kernels: dict[str, list[HealthRow]] = {}
    for row in rows:
        kernels.setdefault(row.kernel, []).append(row)
    found = []
    for name, mine in kernels.items():
        where = place(mine[0].record)
        squares: dict[int, float] = {}
        for row in mine:
            squares[row.record] = squares.get(row.record, 0.0) + row.norm**2
        found.append(
            KernelHealth(
                name,
                where.filename,
                where.lineno,
                len(squares),
                sum(row.nans for row in mine),
                sum(row.infs for row in mine),
                max(row.max_abs for row in mine),
                _slope(list(squares.values())),
            )  # fmt: skip
        )
    return found


def _slope(squares: list[float]) -> float:
    """The least-squares slope of the logarithm of an adjoint's norm over the replays of a kernel,
    in the order of the sweep.
    """
    logs = [(n, 0.5 * math.log(s)) for n, s in enumerate(squares) if 0 < s < math.inf]
    if len(logs) < _LEAST_STEPS:
        return math.nan
    x, y = np.array(logs).T
    return float(np.polyfit(x, y, 1)[0])


def _find_nans(report: HealthReport, core: Any, loss: Any, place: Any) -> None:
    if loss is not None and not np.isfinite(number_of(loss)):
        report.findings.append(_find_bad_value(core, loss, place))
    for kind, what in (("nans", "NaN"), ("infs", "an infinity")):
        bad = next((row for row in report.rows if getattr(row, kind)), None)
        if bad is None:
            continue
        where = place(bad.record)
        message = (
            f"{what} appears first in the adjoint of '{bad.field}' ({getattr(bad, kind)} of its "
            f"numbers), after record {bad.record}, {where}"
        )
        values = _bad_values(core, bad.record)
        if values:
            message += f"; the kernel reads or changes what is not finite: {', '.join(values)}"
        suspects = where.suspects()[:3]
        if suspects:
            message += "; suspects: " + "; ".join(f"line {n}: {text}" for n, text in suspects)
        report.findings.append(
            Finding(
                "nan" if kind == "nans" else "overflow",
                message,
                bad.record,
                where.kernel,
                where.filename,
                suspects[0][0] if suspects else where.lineno,
            )  # fmt: skip
        )


def _find_bad_value(core: Any, loss: Any, place: Any) -> Finding:
    """The first record that left something that is not finite, as far as it stands there still."""
    known = differentiable_fields()
    message = f"the loss '{loss.name}' itself is {number_of(loss)}"
    for record in range(core.records):
        for symbol, kind, dimension, index in core.accesses(record):
            if kind == READ or symbol not in known:
                continue
            f = known[symbol]
            if np.all(np.isfinite(Snapshot._take(f)[elements(f, dimension, index)])):
                continue
            where = place(record)
            message += f"; the first record that leaves such values is {record}, {where}"
            suspects = where.suspects()[:3]
            if suspects:
                message += "; suspects: " + "; ".join(f"line {n}: {text}" for n, text in suspects)
            line = suspects[0][0] if suspects else where.lineno
            return Finding("nan", message, record, where.kernel, where.filename, line)
    return Finding("nan", message)


def warn_of_losses(core: Any, losses: list[Any]) -> None:
    """Says, once in a program for each loss, where one that is NaN or infinite comes from.

    It reads the losses, and where one is not finite all fields of floats that are read. On a GPU
    it does nothing: to read a loss is to wait for all that was launched.
    """
    if state.options is None or state.options.arch == cuda:
        return
    told = get_program().told_losses
    for loss in losses:
        if np.isfinite(number_of(loss)) or loss.symbol in told:
            continue
        told.add(loss.symbol)
        message = _find_bad_start(core) or _find_bad_value(core, loss, partial(Place, core)).message
        if "itself" not in message:
            message = f"the loss '{loss.name}' is {number_of(loss)}: {message}"
        warnings.warn(message, TaiGradientWarning, stacklevel=calling_level())


def _find_bad_start(core: Any) -> str | None:
    """Finds a field that no kernel of the tape changes, and that has a value that is not finite
    where a kernel reads it.
    """
    known = {
        symbol: f for symbol, f in get_program().fields.items()
        if f.role == "primal" and f.dtype.is_float and f._core is not None
    }  # fmt: skip
    accesses = [core.accesses(record) for record in range(core.records)]
    changed = {symbol for listed in accesses for symbol, kind, *_ in listed if kind != READ}
    for record, listed in enumerate(accesses):
        for symbol, kind, dimension, index in listed:
            if kind != READ or symbol in changed or symbol not in known:
                continue
            f = known[symbol]
            array = Snapshot._take(f)
            where = np.zeros(array.shape, bool)
            where[elements(f, dimension, index)] = True
            bad = np.argwhere(where & ~np.isfinite(array))
            if len(bad):
                at = ", ".join(map(str, bad[0][: len(f.shape)])) or "None"
                return (
                    f"field '{f.name}' held {array[tuple(bad[0])]} when the tape began, at [{at}] "
                    f"({len(bad)} of its numbers are not finite), and {Place(core, record)} reads "
                    "it"
                )
    return None


def _bad_values(core: Any, record: int) -> list[str]:
    """Returns the fields of a record that hold NaN or infinity at present."""
    known = differentiable_fields()
    found = []
    for symbol in dict.fromkeys(a[0] for a in core.accesses(record)):
        if symbol in known and not np.all(np.isfinite(Snapshot._take(known[symbol]))):
            found.append(f"'{known[symbol].name}'")
    return found


def _find_growth(report: HealthReport) -> None:
    for k in report.kernels:
        if k.growth > GROWTH_LIMIT:
            where = f" ({shorten(k.filename)}:{k.lineno})" if k.filename else ""
            report.findings.append(
                Finding(
                    "growth",
                    f"the norm of the adjoint grows by a factor of {math.exp(k.growth):.3g} with "
                    f"each replay of '{k.kernel}'{where}, {k.replays} times: the program is "
                    "chaotic or unstable here, and far steps are rounding; shorten the rollout "
                    "or cut the gradient",
                    None,
                    k.kernel,
                    k.filename,
                    k.lineno,
                )  # fmt: skip
            )


def _find_amplification(report: HealthReport, loss: Any, place: Any) -> None:
    """The first adjoint by which the rounding of a value changes the loss more than its size.

    The number of replays does not matter, so that chaos inside one kernel is found. Large factors
    alone are no chaos: the loss must change by more than itself, relative to the field.
    """
    if loss is None or report.findings:
        return
    known = differentiable_fields()
    size = abs(float(loss.to_numpy().item()))
    for row in report.rows:
        f = known.get(row.symbol)
        if f is None or f is loss:
            continue
        values = Snapshot._take(f)
        eps = float(np.finfo(values.dtype).eps)
        if row.max_abs * eps <= 1:
            continue
        change = row.max_abs * float(np.max(np.abs(values), initial=0.0)) * eps
        if not change > size:
            continue
        where = place(row.record)
        report.findings.append(
            Finding(
                "growth",
                f"the adjoint of '{row.field}' is {row.max_abs:.3g} after record {row.record}, "
                f"{where}: rounding '{row.field}' alone changes the loss by {change:.3g}, and the "
                f"loss is {size:.3g}; the program is chaotic or unstable here; shorten the loop "
                "or cut the gradient",
                row.record,
                where.kernel,
                where.filename,
                where.lineno,
            )  # fmt: skip
        )
        return


def _find_flat(report: HealthReport, found: Accesses) -> None:
    """Fields whose initial values the tape reads, and whose gradient is exactly zero."""
    alive = {row.symbol for row in report.rows if row.norm or row.nans or row.infs}
    for symbol, reads in found.masks.items():
        f = found.known[symbol]
        # If an element may be stored before it is read, it counts as flat only if no adjoint
        # reached its field.
        mask = found.sure[symbol] if symbol in alive else reads
        if not mask.any():
            continue
        if not np.any(Snapshot._take(f._companions["grad"])[mask]):
            report.flat.append(f.name)
            report.findings.append(
                Finding(
                    "flat",
                    f"the loss does not depend on '{f.name}' here: its gradient is exactly 0",
                )
            )


def _find_cancellation(report: HealthReport, found: Accesses, loss: Any) -> None:
    """A loss of which the sums of its inputs, rounded on their way, leave no digit.

    Compensated sums keep twice the digits, and are right where the inputs are exact.
    """
    if loss is None or report.findings or get_program().options.sums == "compensated":
        return
    size = abs(float(number_of(loss)))
    weights, _, _ = weigh_inputs(found)
    total = sum(weights.values())
    eps = float(np.finfo(loss.dtype.numpy).eps)
    if not math.isfinite(total) or total * eps <= size:
        return
    largest = max(weights, key=lambda name: weights[name])
    condition = f"{total / size:.1e}" if size else "infinite"
    report.findings.append(
        Finding(
            "cancellation",
            f"the loss is {size:.3g}, and its inputs, '{largest}' above all, weigh {total:.3g}: "
            f"the condition is {condition}, and {loss.dtype} leaves no digit of the loss; use "
            "ti.f64, or ti.init(sums='compensated') if a sum loses the digits",
        )
    )


__all__ = ["Finding", "HealthReport", "HealthRow", "KernelHealth", "take_health"]
