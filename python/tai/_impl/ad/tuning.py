"""`ti.ad.tune_precision`: narrower types for fields, chosen by estimates and verified by runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError, shorten
from ..base import dtypes, native, state
from ..base.program import get_program, sync
from .compare import as_fields
from .precision import STORAGE, PrecisionReport, bytes_of, own_fields, owner_of
from .seeds import number_of
from .snapshot import Snapshot
from .tape import Tape

_TIMED_RUNS = 5


class Types(dict):
    """A dictionary of field types by name; a name that it does not have gets the default type of
    floats.
    """

    def __missing__(self, name: str) -> Any:
        return state.options.default_fp


@dataclass
class TunedPrecision:
    """The types of fields that were chosen, and measurements with these types.

    Attributes:
        types: the narrower types, by name of the field.
        target: the relative error that was allowed.
        loss_error, gradient_error: relative (L2), next to the program as it was.
        bytes_before, bytes_after: of the fields that the program reads.
        seconds_before, seconds_after: the least of a few runs with their gradients; None where the
            fields were not made again.
        report: the estimates.
    """

    types: dict[str, str]
    target: float
    loss_error: float
    gradient_error: float
    bytes_before: int
    bytes_after: int
    report: PrecisionReport
    seconds_before: float | None = None
    seconds_after: float | None = None
    dropped: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        chosen = ", ".join(f"{name}: {kind}" for name, kind in self.types.items())
        text = (
            f"precision: {chosen or 'all fields as they are'}; the loss is off by "
            f"{self.loss_error:.1e}, its gradient by {self.gradient_error:.1e} (allowed "
            f"{self.target:.0e}); {self.bytes_before:,} -> {self.bytes_after:,} bytes"
        )
        if self.seconds_before is not None and self.seconds_after is not None:
            text += f"; {1e3 * self.seconds_before:.3g} -> {1e3 * self.seconds_after:.3g} ms"
        if self.dropped:
            text += f"; refused when it was measured: {', '.join(self.dropped)}"
        return text

    __repr__ = __str__


def tune_precision(
    run: Callable[..., Any], loss: Any = None, error: float = 1e-4, wrt: Any = None,
    verbose: bool = True,
) -> TunedPrecision:  # fmt: skip
    """Finds the narrowest types of fields with which loss and gradient stay within an error.

    ```python
    tuned = ti.ad.tune_precision(simulate, loss, error=1e-4)
    x = ti.field(tuned.types.get("x", ti.f32), …)
    ```

    With a loss, `run` is a function that launches kernels on the existing fields. Narrower fields
    are simulated in them: each number that a kernel loads is rounded first. Without one, `run`
    makes the program: it gets the types (`ti.field(types["x"], …)`), makes fields and kernels, and
    returns the function that launches and the field of the loss. It is called again with the
    chosen types, and these are measured.

    Args:
        run: see above. All fields are restored.
        loss: a field without dimensions.
        error: the greatest relative error of the loss, and of the gradient (L2).
        wrt: the fields whose gradient counts; those that kernels read and do not write, if left
            out.
        verbose: print the savings.

    Raises:
        TaiAutodiffError: the error is too small: arithmetic in the types that the program has is
            off by more. Or a field holds NaN or an infinity.
    """
    if state.tape is not None:
        raise TaiRuntimeError("precision cannot be tuned inside a tape", "leave the tape first")
    if not isinstance(error, (int, float)) or not 0 < error < 1:
        raise TaiRuntimeTypeError(f"error is a relative error between 0 and 1, but got {error!r}")
    builds = loss is None
    build = run
    if builds:
        run, loss = made_by(build, Types())
    wrt = as_fields(wrt, "wrt")
    as_fields([loss], "loss")
    loss.materialize()
    result = _tune(run, loss, error, wrt)
    if builds:
        result = _rebuild(build, run, loss, wrt, result)
    if verbose:
        print(result)
    return result


def made_by(
    build: Callable[..., Any], types: Types, who: str = "tune_precision"
) -> tuple[Callable[..., Any], Any]:
    made = build(types)
    if not (isinstance(made, tuple) and len(made) == 2 and callable(made[0])):
        raise TaiRuntimeTypeError(
            "without a loss, tune_precision takes a function that makes the program and returns "
            f"(function that launches kernels, field of the loss), but it returned {made!r}"
        )
    return made


class _Emulation(native.WithBlock):
    """After this block, no storage type is simulated, and the fields have their former values."""

    def __init__(self, program: Any, start: Snapshot):
        self._program, self._start = program, start

    def _end(self) -> None:
        if self._program.probes is not None:
            self._start.restore()
            self._program.probes.emulate(set())


def _tune(run: Callable[..., Any], loss: Any, error: float, wrt: Any) -> TunedPrecision:
    """Chooses types by estimates, and by emulating them in the fields that exist."""
    program, start = get_program(), Snapshot()
    with _Emulation(program, start):
        with Tape(loss, precision=True) as tape:
            run()
        report = tape.precision_report(error)
        probes = program.probes
        unknowns = parts_among(wrt) if wrt else unknowns_of(probes.sweep)
        base = _results(loss, unknowns)
        _refuse_impossible(report, base, error)
        chosen, dropped = report.storable(), []
        while True:
            keys = _keys(report, chosen)
            start.restore()
            probes.emulate(keys)
            with Tape(loss, precision=True):
                run()
            errors = distance(_results(loss, unknowns), base)
            if max(errors) <= error or not chosen:
                break
            dropped.append(_widen(report, chosen))
    before = sum(f.bytes for f in report.fields)
    after = before - _all_saved(report, chosen)
    return TunedPrecision(chosen, error, *errors, before, after, report, dropped=dropped)


def _rebuild(
    build: Callable[..., Any], run: Callable[..., Any], loss: Any, wrt: Any, result: TunedPrecision
) -> TunedPrecision:
    """Makes the program with the chosen types and measures its error; widens types until the error
    is within the target.
    """
    unknowns = parts_among(wrt) if wrt else unknowns_of(get_program().probes.sweep)
    names = [owner_of(f).name for f in unknowns]
    start = Snapshot()
    result.seconds_before = _seconds(run, loss, start)
    base = _results(loss, unknowns)
    start.restore()
    while True:
        known = {id(f) for f in own_fields()}
        types = Types({name: getattr(dtypes, kind) for name, kind in result.types.items()})
        again, other = made_by(build, types)
        other.materialize()
        beginning = Snapshot()
        result.seconds_after = _seconds(again, other, beginning)
        fresh = [f for f in own_fields() if id(f) not in known]
        same = [next((f for f in fresh if is_named(f, name)), None) for name in names]
        if None in same:
            lost = names[same.index(None)]
            raise TaiRuntimeError(f"the program has no field '{lost}' when it is made again")
        found = _results(other, same)
        beginning.restore()
        result.loss_error, result.gradient_error = distance(found, base)
        if max(result.loss_error, result.gradient_error) <= result.target or not result.types:
            return result
        result.dropped.append(_widen(result.report, result.types))
        result.bytes_after = result.bytes_before - _all_saved(result.report, result.types)


def is_named(f: Any, name: str) -> bool:
    """Whether a field has the given name. A later field of the same name has a number at its
    end.
    """
    stem, _, number = owner_of(f).name.rpartition("_")
    return owner_of(f).name == name or (stem == name and number.isdigit())


def _seconds(run: Callable[..., Any], loss: Any, start: Snapshot) -> float:
    """The shortest time of a few runs with their gradients; the fields keep the results of the last
    run.
    """
    taken = []
    for number in range(_TIMED_RUNS):
        if number:
            start.restore()
        sync()
        begin = time.perf_counter()
        with Tape(loss):
            run()
        sync()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def unknowns_of(sweep: Any) -> list[Any]:
    """The fields with a gradient that kernels read and do not write."""
    return [
        f for f in own_fields()
        if f._companions.get("grad") is not None and f._companions["grad"]._core is not None
        and f.symbol in sweep.loaded - sweep.stored
    ]  # fmt: skip


def parts_among(fields: Any) -> list[Any]:
    wanted = {id(f) for f in fields}
    return [f for f in own_fields() if id(owner_of(f)) in wanted or id(f) in wanted]


def _results(loss: Any, unknowns: list[Any]) -> tuple[float, np.ndarray]:
    gradients = [Snapshot._take(f._companions["grad"]).astype(float).ravel() for f in unknowns]
    return float(number_of(loss)), np.concatenate(gradients) if gradients else np.zeros(1)


def distance(found: tuple, base: tuple) -> tuple[float, float]:
    """Relative errors of loss and gradient; infinite where something is not finite."""
    if not np.isfinite(found[0]) or not np.all(np.isfinite(found[1])):
        return np.inf, np.inf
    size = float(np.linalg.norm(base[1]))
    apart = float(np.linalg.norm(found[1] - base[1]))
    loss = abs(found[0] - base[0]) / abs(base[0]) if base[0] else abs(found[0])
    return float(loss), apart / size if size else apart


def _field(report: PrecisionReport, name: str) -> Any:
    return next(f for f in report.fields if f.name == name)


def _all_saved(report: PrecisionReport, chosen: dict[str, str]) -> int:
    """Returns the bytes of memory that the chosen narrower types save."""
    pairs = [(_field(report, name), kind) for name, kind in chosen.items()]
    return sum(f.bytes - f.bytes * bytes_of(kind) // bytes_of(f.dtype) for f, kind in pairs)


def _widen(report: PrecisionReport, chosen: dict[str, str]) -> str:
    """Gives the field that causes the largest error the next wider type; returns that field and
    type.
    """
    name = max(chosen, key=lambda name: _field(report, name).errors[chosen[name]])
    old = chosen.pop(name)
    own = STORAGE[_field(report, name).dtype]
    wider = [kind for kind, bits in STORAGE.items() if STORAGE[old] < bits < own]
    wider = [kind for kind in wider if bytes_of(kind) > bytes_of(old) or hasattr(dtypes, kind)]
    if wider:
        chosen[name] = wider[0]
    return f"{name}: {old}"


def _keys(report: PrecisionReport, chosen: dict[str, str]) -> set[tuple]:
    return {
        (kind, symbol) for name, kind in chosen.items() for symbol in _field(report, name).symbols
    }


def _refuse_impossible(report: PrecisionReport, base: tuple, error: float) -> None:
    if not np.isfinite(base[0]) or not np.all(np.isfinite(base[1])):
        raise TaiAutodiffError(
            "the loss or its gradient is not finite, so that no error can be measured",
            "tape.health() says where that begins",
        )
    if all(f.dtype == "f64" for f in report.fields):
        return  # an adjoint in f32 is only offered, and need not be taken
    if report.loss == 0:
        raise TaiAutodiffError(
            "the loss is 0, so that no error of it is a relative one",
            "start from a point where it is not 0",
        )
    if report.relative > error:
        parts = [(f"{shorten(line.filename)}:{line.lineno}", line.error) for line in report.lines]
        parts = sorted(parts + report.others, key=lambda part: -abs(part[1]))
        worst = "; ".join(f"{name} ({abs(part / report.loss):.1e})" for name, part in parts[:3])
        raise TaiAutodiffError(
            f"error={error:.1e} cannot be met: with all fields as they are, arithmetic in f32 is "
            f"expected to be off by {report.relative:.1e}, most of it from {worst}",
            f"error={2 * report.relative:.1e} is the best that f32 can have here; or "
            "ti.init(default_fp=ti.f64)",
        )
