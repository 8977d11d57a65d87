"""The effect of rounding on a loss, by line and by field: the report of a tape.

The estimates are those of `rounding`: sums of adjoint times rounding error, of first order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, shorten, source_line
from ..base import dtypes
from ..base.program import get_program
from .rounding import BITS, Sweep
from .seeds import number_of
from .snapshot import Snapshot

# The types that a field may be stored in, from narrow to wide, and the digits of each in bits.
STORAGE = {"bf16": 8, "f16": 11, "f32": 24, "f64": 53}
LARGEST_F16 = 65504.0
# The loss itself is rounded, too, so an estimate of its error is never less than half of an ulp of
# the loss.
_UNIT = 2.0**-24
# The rounding error of a sum that is added up by blocks, as a multiple of the rounding of one of
# its partial sums.
_STEPS_OF_SUM = 4.0


@dataclass
class FieldPrecision:
    """The effect on the loss of storing a field in other types.

    Attributes:
        name, dtype: of the field.
        errors: by the name of the type, the expected error of the loss; infinite if a value of the
            field does not fit.
        is_accumulated: kernels add to it, so that a narrower type would round each sum on its
            way: no type is proposed for it.
        bytes: the bytes that the field takes now.
        greatest: the greatest magnitude of its elements.
    """

    name: str
    dtype: str
    errors: dict[str, float]
    is_accumulated: bool
    bytes: int
    greatest: float
    symbols: list[str] = field(default_factory=list)


@dataclass
class LinePrecision:
    """The effect on the loss of all roundings in one line of the program.

    Attributes:
        filename, lineno, text: of the line.
        error: how much they change the loss, with its sign, to first order.
    """

    filename: str
    lineno: int
    text: str
    error: float


@dataclass
class SolvePrecision:
    """The effect on the loss of the point at which a solver stopped.

    Attributes:
        filename, lineno: of the call.
        solver: its name.
        backward_error: the greatest of its calls there; NaN of problems that are not linear.
        error: how much the loss may change, to first order: a bound, summed over the calls.
        calls: how many there were.
    """

    filename: str
    lineno: int
    solver: str
    backward_error: float
    error: float
    calls: int

    def __str__(self) -> str:
        text = f"{shorten(self.filename)}:{self.lineno}  {self.solver}"
        if not math.isnan(self.backward_error):
            text += f", backward error {self.backward_error:.1e}"
        return text + (f", the greatest of {self.calls} calls" if self.calls > 1 else "")


@dataclass
class PrecisionReport:
    """Estimated effect of the rounding errors of a program on its loss.

    Attributes:
        loss: its value.
        expected: its expected absolute error if all arithmetic is in f32: the errors of all
            lines, accumulated errors of fields, and the rounding of the loss itself.
        fields, lines: the contribution of each to that, largest first.
        target: the requested relative error.
        others: contributions that belong to no line, by name: sums that fields keep, storage, and
            the loss itself.
        solves: the effect of solvers, by the line of the call, largest first. They stop at their
            tolerances in any type, so `expected` does not contain it.
    """

    loss: float
    expected: float
    fields: list[FieldPrecision]
    lines: list[LinePrecision]
    target: float
    others: list[tuple[str, float]] = field(default_factory=list)
    solves: list[SolvePrecision] = field(default_factory=list)

    @property
    def relative(self) -> float:
        """The expected error divided by the magnitude of the loss."""
        return self.expected / abs(self.loss) if self.loss else math.inf

    def storable(self, error: float | None = None) -> dict[str, str]:
        """The narrowest types that keep the loss within a relative error, by name of the field.

        Args:
            error: the target; that of the report if left out.

        Returns:
            The fields whose type would change. Together, and with the rounding of arithmetic,
            their errors are expected to stay below half of the target.
        """
        room = (error or self.target) * abs(self.loss) / 2
        # If all fields are f64, the arithmetic rounds less than the estimate of f32 roundings says.
        spent = 0.0 if all(f.dtype == "f64" for f in self.fields) else self.expected**2
        chosen: dict[str, str] = {}
        kinds = [name for name in ("bf16", "f16", "f32") if hasattr(dtypes, name)]
        # The fields whose type costs the least error for each byte saved come first.
        offers = sorted(
            (f.errors[kind] / f.bytes, number, kind)
            for number, f in enumerate(self.fields)
            for kind in kinds
            if not f.is_accumulated and STORAGE[kind] < STORAGE[f.dtype] and f.bytes
            and math.isfinite(f.errors[kind])
        )  # fmt: skip
        costs: dict[str, float] = {}
        for _, number, kind in offers:
            f = self.fields[number]
            name = f.name
            old = chosen.get(name)
            saves = bytes_of(kind) < bytes_of(old or f.dtype)
            cost = f.errors[kind] ** 2
            if saves and spent - costs.get(name, 0.0) + cost <= room**2:
                spent += cost - costs.get(name, 0.0)
                chosen[name], costs[name] = kind, cost
        return chosen

    def to_dict(self) -> dict[str, Any]:
        """Returns the report as dictionaries, lists and numbers."""
        return asdict(self)

    def __str__(self) -> str:
        lines = [
            f"precision: the loss {self.loss:.6g} is expected to be off by {self.expected:.1e} "
            f"({self.relative:.1e} of it) in f32"
        ]
        chosen = self.storable()
        width = max([len(f.name) for f in self.fields] + [5])
        kinds = list(STORAGE)[:-1]
        lines.append(
            f"  {'field':{width}} type  {' '.join(f'{kind:>8}' for kind in kinds)}  for an error "
            f"of {self.target:.0e}"
        )
        for f in self.fields:
            errors = " ".join(f"{_relative(f.errors.get(k), self.loss):>8}" for k in kinds)
            advice = "sums are kept in it" if f.is_accumulated else chosen.get(f.name, "as it is")
            lines.append(f"  {f.name:{width}} {f.dtype:4}  {errors}  {advice}")
        lines.append("  lines and sums that lose most:")
        losses = [
            (abs(line.error), f"{shorten(line.filename)}:{line.lineno}  {line.text}")
            for line in self.lines
        ]
        losses += [(abs(error), name) for name, error in self.others if error]
        for error, name in sorted(losses, key=lambda entry: -entry[0])[:5]:
            lines.append(f"  {_relative(error, self.loss):>8}  {name}")
        if self.solves:
            lines.append("  solvers, which stop at their tolerances in any type:")
        for found in self.solves[:5]:
            lines.append(f"  {_relative(found.error, self.loss):>8}  {found}")
        return "\n".join(lines)

    __repr__ = __str__


def owner_of(f: Any) -> Any:
    """The field that the user has made, given the scalar field that holds one of its components."""
    for name in ("field", "_whole"):
        owner = getattr(f, name, None)
        if owner is not None:
            return owner
    return f


def bytes_of(name: str) -> int:
    return {"bf16": 2, "f16": 2, "f32": 4, "f64": 8}[name]


def _relative(error: float | None, loss: float) -> str:
    return "-" if error is None else f"{error / abs(loss):.1e}" if loss else f"{error:.1e}"


def find_not_finite() -> dict[str, str]:
    """The fields that hold NaN or an infinity: the name of each, and the text about it."""
    found = {}
    for f in own_fields():
        array = Snapshot._take(f)
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            index = ", ".join(map(str, bad[0][: len(f.shape)])) or "None"
            found[f.symbol] = (
                f"holds {array[tuple(bad[0])]} at the start, at [{index}] ({len(bad)} of its "
                "numbers are not finite): nothing can be said of its rounding"
            )
    return found


def own_fields() -> list[Any]:
    """Returns the fields of floats that the user made, without gradients and duals."""
    program = get_program()
    internal = {pool.field.symbol for pool in program.pools}
    if program.probes is not None:
        internal.add(program.probes.field.symbol)
    return [
        f for symbol, f in program.fields.items()
        if f.role == "primal" and f.dtype.is_float and f._core is not None
        and symbol not in internal
    ]  # fmt: skip


def make_report(
    sweep: Sweep, loss: Any, target: float, solves: Sequence[Any] = ()
) -> PrecisionReport:
    """The report of a sweep, and of the solves of its tape.

    Raises:
        TaiAutodiffError: a field that it reads held NaN or an infinity at its start.
    """
    for symbol, message in sweep.not_finite.items():
        if symbol in sweep.loaded:
            # A field gets its name from the first kernel that uses it, and that kernel may be
            # recorded in the tape.
            name = owner_of(get_program().fields[symbol]).name
            raise TaiAutodiffError(
                f"field '{name}' {message}", "fill it before the tape is entered"
            )
    value = float(number_of(loss))
    lines = [
        LinePrecision(key[1], key[2], source_line(key[1], key[2]).strip(), total)
        for key, total in sweep.sums.items()
        if key[0] == "line" and total
    ]
    lines.sort(key=lambda line: -abs(line.error))
    fields = _fields(sweep)
    unit = 2.0 ** (BITS["14 bits"] - STORAGE["f32"])
    known = get_program().fields
    # Compensated sums keep twice the digits, so the roundings of their additions do not count.
    is_compensated = get_program().options.sums == "compensated"
    others = (
        []
        if is_compensated
        else [
            (f"the sum in '{owner_of(known[key[1]]).name}'", _STEPS_OF_SUM * unit * total)
            for key, total in sweep.sums.items()
            if key[0] == "sum"
        ]
    )
    others += [(f"the sum in '{f.name}'", f.errors["f32"]) for f in fields if f.is_accumulated]
    # A value that no kernel computes is rounded only when it is stored.
    others += [
        (f"the storage of '{f.name}'", f.errors["f32"]) for f in fields
        if f.dtype == "f64" and not f.is_accumulated and not sweep.stored & set(f.symbols)
    ]  # fmt: skip
    is_summed = loss.symbol in sweep.accumulated and not is_compensated
    steps = _STEPS_OF_SUM if is_summed else 1.0
    others.append((f"the loss '{owner_of(loss).name}' itself", steps * _UNIT * value))
    whole = math.fsum(line.error for line in lines)
    expected = math.hypot(whole, *(error for _, error in others))
    return PrecisionReport(value, expected, fields, lines, target, others, _solves(solves))


def _solves(infos: Sequence[Any]) -> list[SolvePrecision]:
    groups: dict[tuple, list[Any]] = {}
    for info in infos:
        groups.setdefault((*info.place, info.solver), []).append(info)
    found = []
    for (filename, lineno, solver), group in groups.items():
        errors = [info.backward_error for info in group]
        worst = max((e for e in errors if not math.isnan(e)), default=math.nan)
        # A solver call that no gradient has passed has no effect on the loss.
        effects = [0.0 if math.isnan(info.effect) else info.effect for info in group]
        found.append(
            SolvePrecision(filename, lineno, solver, worst, math.fsum(effects), len(group))
        )
    return sorted(found, key=lambda entry: -entry.error)


def _fields(sweep: Sweep) -> list[FieldPrecision]:
    groups: dict[int, list[Any]] = {}
    for f in own_fields():
        if f.symbol in sweep.loaded and any((kind, f.symbol) in sweep.sums for kind in BITS):
            owner = owner_of(f)
            groups.setdefault(id(owner), []).append((owner, f))
    found = []
    for group in groups.values():
        owner, parts = group[0][0], [f for _, f in group]
        arrays = [Snapshot._take(f) for f in parts]
        greatest = max(float(np.max(np.abs(a), initial=0.0)) for a in arrays)
        errors = {
            kind: math.hypot(*(_error(kind, f, sweep.sums) for f in parts))
            for kind in STORAGE
            if kind != "f64"
        }
        if greatest > LARGEST_F16:
            errors["f16"] = math.inf
        symbols = [f.symbol for f in parts]
        accumulated = bool(sweep.accumulated & set(symbols))
        size = sum(a.size for a in arrays) * parts[0].dtype.bits // 8
        found.append(
            FieldPrecision(owner.name, parts[0].dtype.name, errors, accumulated, size, greatest,
                           symbols)
        )  # fmt: skip
    return sorted(found, key=lambda f: -f.errors["bf16"])


def _error(kind: str, f: Any, sums: dict[tuple, float]) -> float:
    """The expected error of the loss if the field is stored in a type.

    The effects of one rounding may cancel by chance; roundings to several widths do not all cancel.
    """
    unit = max(
        abs(sums.get((name, f.symbol), 0.0)) * 2.0**bits for name, bits in BITS.items()
    )  # fmt: skip
    return max(abs(sums.get((kind, f.symbol), 0.0)), unit * 2.0 ** -STORAGE[kind])
