"""`ti.solve_to`, the cheapest types, modes and steps for an error: docs/guides/solve-to.md."""

from __future__ import annotations

import inspect
import math
import time
import warnings
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from ...errors import (
    TaiAutodiffError,
    TaiError,
    TaiGradientWarning,
    TaiRuntimeError,
    TaiRuntimeTypeError,
)
from ..base import dtypes, state
from ..base.callers import calling_frame
from ..base.keywords import check_keywords
from ..base.program import get_program, sync
from .choices import (
    LEAST_BYTES,
    MARGIN_OF_DRAW,
    MARGIN_OF_F64,
    MARGIN_OF_SHADOWS,
    NARROW,
    OF_F64,
    OF_FAST,
    SAFETY,
    Choice,
    apart,
    bytes_in,
    others_of,
    rounding_of,
    scale_of,
)  # fmt: skip
from .compare import as_fields
from .density import choose_density
from .memory import parse_checkpoint
from .precision import PrecisionReport, find_not_finite, owner_of
from .retype import Version, can_change
from .seeds import as_float_field, number_of, require_grad
from .shadowed import error_of_f64
from .slopes import Slopes
from .snapshot import Snapshot
from .solution import Part, Solution, find_short_fields, options_of, place_of, worst_of
from .tape import Tape
from .tuning import Types, distance, is_named, made_by, parts_among, unknowns_of

# The most iterations (a run of the program and its sweep) that the choice of types may cost.
MOST_ITERATIONS = 20
# Modes whose time is within this factor of the fastest are timed again. The second number:
# iterations that are reserved for checks of the choice.
_NEAR, _LAST_CHECKS = 3.0, 5
# The factor by which times of programs with 16-bit fields count more than those of others, and
# times of f64 more than those of f32.
_DOUBT = 1.15
# A mode that takes at most this many times as long is preferred if its fields take fewer bytes.
_TIE = 1.05
# The share of the allowed error that each cause of error may have.
_SHARE = {"discretisation": 0.5, "solver": 0.2, "only solver": 0.6}
# The greatest solver tolerance that is tried.
_LOOSEST = 0.3
# The greatest number of time steps, as a multiple of the number with which the search begins.
_MOST_REFINED = 256
# The factor by which the tolerances of solvers are multiplied in a run that measures their effect.
_TIGHTENED = 1e-3
# A result names the reason if its error is below this share of the one that was asked for.
_LEAST_SHARE = 0.05
# Fewer steps are tried if the discretisation error is below this part of its share, unless more
# runs than the second number have been made.
_FILLED, _RUNS_TO_SHRINK = 0.4, 12
# An estimate of the rounding error that is greater says nothing about the size of the error.
_HOPELESS = 0.1
# A measured error of f32 that is greater says nothing about that of f64.
_NO_DIGITS = 0.05


class _TooManyRuns(TaiAutodiffError):
    """Raised when the budget of iterations is spent."""


def solve_to(
    run: Callable[..., Any], loss: Any = None, wrt: Any = None, error: float = 1e-4,
    verbose: bool = False, memory_budget: int | None = None,
) -> Solution:  # fmt: skip
    """Computes a loss and its gradient to a relative error, in the cheapest way that keeps it.

    ```python
    result = ti.solve_to(simulate, loss=loss, wrt=[v0], error=1e-4)
    print(result)
    ```

    Types of fields, arithmetic, the form of sums and the math library are chosen by the estimates
    of one reverse sweep, and the choice is compared with a run in f64. A parameter `steps` of `run`
    is a number of time steps, which is chosen by runs with other numbers of steps, and a parameter
    `tol` a tolerance of solvers; the default of `steps` is where the search begins. Whether the
    tape saves all values or keeps snapshots is chosen by time and memory.

    Args:
        run: a function that launches kernels on the existing fields; or, without a loss, a function
            that makes the program, as for `ti.ad.tune_precision`.
        loss: a field of one number.
        wrt: the fields whose gradient counts; those that kernels read and do not write, if left
            out. Their names, if `run` makes the program.
        error: the greatest relative error of the loss, and of the gradient (L2).
        verbose: print the result.
        memory_budget: the most bytes that the tape of the choice keeps, as for `ti.ad.Tape`; the
            reference in f64 may keep twice as many.

    Returns:
        The choice with its error, parts and time. The fields are as before, but for the loss
        and the gradients of `wrt`, which hold the results.

    Raises:
        TaiAutodiffError: the error cannot be kept, or no estimate can be trusted: the message has
            the reason.
    """
    if state.tape is not None or state.forward:
        raise TaiRuntimeError(
            "ti.solve_to runs tapes of its own", "leave the tape or forward mode first"
        )
    if isinstance(error, bool) or not isinstance(error, (int, float)) or not 0 < error < 1:
        raise TaiRuntimeTypeError(f"error is a relative error between 0 and 1, but got {error!r}")
    if not callable(run):
        raise TaiRuntimeTypeError(f"run must be a function that launches kernels, but got {run!r}")
    names = None
    if loss is None:
        names = [wrt] if isinstance(wrt, str) else wrt
        run, loss = made_by(run, Types(), "solve_to")
        wrt = None
    elif wrt is not None and not isinstance(wrt, (list, tuple)):
        wrt = [wrt]
    if memory_budget is not None:
        parse_checkpoint(None, memory_budget)
    wanted = as_fields(wrt, "wrt") if wrt is not None else None
    as_fields([as_float_field(loss, "the loss")], "loss")
    for f in (loss, *(wanted or ())):
        require_grad(f, inspect.currentframe())
    try:
        found = _Search(run, loss, wanted, names, float(error), memory_budget).result()
    except TaiAutodiffError as failure:
        if failure.filename is None:
            frame = calling_frame()
            if frame is not None:
                failure.locate(frame.f_code.co_filename, frame.f_lineno, 1)
        raise
    if verbose:
        print(found)
    return found


class _Search:
    """The state and measurements of one call of `ti.solve_to`."""

    def __init__(
        self, run: Any, loss: Any, wrt: Any, names: Any, error: float, budget: int | None = None
    ):
        self._run, self._loss, self._wrt, self._error = run, loss, wrt, error
        self._names, self._budget, self._density = names, budget, ""
        self._options = options_of(run)
        self._start = Snapshot()
        self._versions: list[Version] = []
        self._places: list[Any] = []
        self._unknowns: list[Any] = []
        self._iterations = 0
        self._tried: list[str] = []
        self._others: list[str] = []
        self._generator = np.random.default_rng(5)

    # Runs

    def _version(self, modes: dict[str, Any], types: Any = (), is_plain: bool = False) -> Version:
        made = Version(modes, types, is_plain)
        if self._budget is not None:
            wider = 2 if modes.get("precision") == "f64" else 1
            made.checkpoint = {"memory_budget": wider * self._budget}
        self._versions.append(made)
        return made

    def _measure(
        self, version: Version, change: Any = None, precision: bool = False, **options: Any
    ) -> tuple[float, np.ndarray, float, Any]:
        """Loss, gradient and seconds of a run and its sweep from the start, and its report."""
        if self._iterations >= MOST_ITERATIONS:
            raise _TooManyRuns(
                f"{MOST_ITERATIONS} runs have not shown that an error of {self._error:.1e} is kept",
                "ask for a greater error",
            )
        self._iterations += 1
        self._start.restore()
        with version:
            if change is not None:
                change()
            sync()
            begin = time.perf_counter()
            report = None
            with Tape(self._loss, precision=precision, **version.checkpoint) as tape:
                self._run(**{**self._options, **options})
            sync()
            seconds = time.perf_counter() - begin
            version.note_memory(tape)
            if not precision and change is None and options == {}:
                version.seconds = min(version.seconds, seconds)
            if precision:
                report = tape.precision_report(self._error)
            gradients = [
                Snapshot._take(f._companions["grad"]).astype(float).ravel() for f in self._unknowns
            ]
            gradient = np.concatenate(gradients) if gradients else np.zeros(0)
            return float(number_of(self._loss)), gradient, seconds, report

    @property
    def iterations_left(self) -> int:
        return int(MOST_ITERATIONS - self._iterations)

    def measure(self, version: Version) -> tuple[float, np.ndarray]:
        return self._measure(version)[:2]

    # Phases

    def result(self) -> Solution:
        chosen = None
        try:
            self._discover()
            reference, base = self._reference()
            report = self._estimate(reference)
            parts: list[Part] = []
            # Solvers that stop early give gradients that finite differences do not confirm.
            if "tol" in self._options:
                part, base = self._choose_tol(reference, base)
                parts.append(part)
            elif report.solves:
                parts.append(self._measure_solvers(reference, base, report))
            self._check_gradient(reference, base, report)
            if "steps" in self._options:
                part, base = self._choose_steps(reference, base)
                parts.append(part)
            if self._options:
                report = self._estimate(reference)
                self._name_solves(parts, report)
            room = self._error - sum(part.error for part in parts)
            chosen = self._choose(reference, base, report, room)
            self._density = choose_density(self, chosen, base, room, self._budget)
            parts.append(rounding_of(chosen, report))
            return self._finish(chosen, base, parts)
        finally:
            self._start.restore()
            for version in self._versions:
                if chosen is None or version is not chosen.version:
                    version.destroy()
            if chosen is not None:
                self._leave_results(chosen)

    def _discover(self) -> None:
        """Runs the program once; finds the fields it uses and actions that a tape cannot record."""
        for f, message in find_not_finite().items():
            name = owner_of(get_program().fields[f]).name
            _refuse(f"field '{name}' {message}", "fill it before")
        first = self._version({}, is_plain=True)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", TaiGradientWarning)
            self._measure(first)
        for text in (str(warning.message) for warning in said):
            if "it is a constant" in text:  # a detour through Python
                _refuse(
                    "a part of the program is outside of kernels, where no estimate sees it: "
                    + text,
                    "compute it in kernels",
                )
        if first.writes:
            _refuse(
                f"kernel '{first.writes[0]}' writes to an array of the caller, whose type cannot "
                "be changed, so that nothing can be compared with a wider one",
                "keep it in a field",
            )
        used = first.loaded | first.stored
        self._places = [f for f in first.places.values() if f.symbol in used]
        if self._names is not None:
            self._wrt = self._by_name(self._names)
        self._unknowns = parts_among(self._wrt) if self._wrt is not None else unknowns_of(first)
        if not self._unknowns:
            _refuse("nothing is differentiated: no field with a gradient is read and not written",
                    "name the fields: wrt=[x]")  # fmt: skip
        fixed = [f for f in self._places if not can_change(f) and f.dtype is not dtypes.f64]
        if fixed:
            _refuse(
                f"field '{owner_of(fixed[0]).name}' is sparse, so that its type cannot be changed, "
                "and nothing can be compared with a wider one",
                "make it of f64, or dense",
            )

    def _by_name(self, names: Any) -> list[Any]:
        owners = {id(owner_of(f)): owner_of(f) for f in self._places}
        found = []
        for name in names:
            f = next((f for f in owners.values() if is_named(f, name)), None)
            if f is None:
                raise TaiRuntimeTypeError(f"wrt: the program uses no field '{name}'")
            found.append(f)
        return found

    def _types(self, base: Any, narrow: dict[str, str] | None = None) -> list[tuple[Any, Any]]:
        """The type of each field's storage. The loss and single unknowns keep all digits."""
        pairs = []
        for f in self._places:
            kind = (narrow or {}).get(owner_of(f).name)
            if can_change(f):
                pairs.append((f, getattr(dtypes, kind) if kind else base))
        return pairs

    def _reference(self) -> tuple[Version, tuple[float, np.ndarray]]:
        """Makes two runs in f64, which must agree, as the reference."""
        version = self._version(self._modes("f64"), self._types(dtypes.f64))
        first = self._measure(version)[:2]
        loss, gradient, self._reference_time, _ = self._measure(version)
        if not math.isfinite(loss) or not np.all(np.isfinite(gradient)):
            _refuse("the loss or its gradient is not finite, so that no error can be measured",
                    "tape.health() says where that begins")  # fmt: skip
        if loss == 0:
            _refuse("the loss is 0, so that no error of it is a relative one",
                    "start from a point where it is not 0")  # fmt: skip
        if not gradient.any():
            _refuse("the gradient is 0, so that no error of it is a relative one",
                    "start from another point, or name other fields: wrt=[x]")  # fmt: skip
        apart = max(distance(first, (loss, gradient)))
        if apart > self._error / 10:
            _refuse(
                f"the program is not repeatable: two runs in f64 from the same fields differ by "
                f"{apart:.1e}",
                "draw random numbers before, into a field; deterministic=True gives sums one order",
            )
        return version, (loss, gradient)

    def _modes(self, precision: str) -> dict[str, Any]:
        """The words for a precision; what `ti.init` says of order and rounding stays."""
        options = get_program().options
        words = {"precision": precision}
        if not (options.strict or options.shadow):
            words["math"] = "default"
        if not options.deterministic:
            words["sums"] = "default"
        return words

    def _perturb(self, steps: list[np.ndarray]) -> Callable[[], None]:
        """Adds a step to the unknowns; the step is in units of the magnitude of each element."""

        def change() -> None:
            for f, step in zip(self._unknowns, steps, strict=True):
                array = Snapshot._take(f)
                moved = array + step * scale_of(array)
                f.core.copy_from(np.ascontiguousarray(moved, array.dtype))

        return change

    def _check_gradient(self, reference: Version, base: Any, report: PrecisionReport) -> None:
        """Compares the gradient with differences of the loss, which host code cannot interrupt."""
        parts = self._split(base[1])
        self._start.restore()
        start = [Snapshot._take(f).astype(float) for f in self._unknowns]
        steps = [np.sign(g) * scale_of(x) for g, x in zip(parts, start, strict=True)]
        slope = sum(float(np.sum(g * s)) for g, s in zip(parts, steps, strict=True))

        def at(h: float) -> tuple[float, np.ndarray]:
            change = self._perturb([h * np.sign(g) for g in parts])
            loss, gradient = self._measure(reference, change)[:2]
            # A moved input is rounded; that is no error of the program.
            rounded = [(x + h * s - x) - h * s for x, s in zip(start, steps, strict=True)]
            off = sum(float(np.sum(g * r)) for g, r in zip(parts, rounded, strict=True))
            return loss - off, gradient

        self._slopes = Slopes(at, base, slope, self._error)
        trouble = self._slopes.find_trouble(OF_F64 * report.expected, worst_of(report, OF_F64))
        if trouble is not None:
            _refuse(*trouble)

    def _measure_solvers(self, reference: Version, base: Any, report: PrecisionReport) -> Part:
        """Measures the effect of the program's solver tolerances, by a run with smaller ones."""
        reference.tolerances = _TIGHTENED
        try:
            exact = self._measure(reference)[:2]
        finally:
            reference.tolerances = 1.0
        off = max(distance(base, exact))
        worst = report.solves[0]
        if off > self._error / 2:
            _refuse(
                f"the solvers stop too early for an error of {self._error:.1e}: with smaller "
                f"tolerances the results differ by {off:.1e}, most of it from {worst}",
                "let ti.solve_to choose: def run(tol=1e-6), and pass tol on; or give a smaller tol",
            )
        size = abs(report.loss)
        lines = [(str(found), found.error / size) for found in report.solves]
        return Part("solver", off, lines, "compared with a run of smaller tolerances")

    @staticmethod
    def _name_solves(parts: list[Part], report: PrecisionReport) -> None:
        """Attributes the share of solvers in the error to the lines of the solves."""
        for part in parts:
            if part.name == "solver" and report.solves:
                size = abs(report.loss)
                part.lines = [(str(found), found.error / size) for found in report.solves]

    def _choose_tol(self, reference: Version, base: Any) -> tuple[Part, Any]:
        """Finds the greatest solver tolerance whose effect is within its share of the error."""
        room = _SHARE["solver" if "steps" in self._options else "only solver"] * self._error
        exact = self._measure(reference, tol=max(1e-13, min(1e-10, 1e-4 * self._error)))[:2]
        tol, last = min(self._error, 0.1), math.inf
        kept: Any = None
        off = math.inf
        for _ in range(4):
            found = self._measure(reference, tol=tol)[:2]
            off = max(distance(found, exact))
            if off <= room:
                kept = tol, off, found
                # A looser tolerance is tried next, unless it has proved to be too loose.
                if off > 0.1 * self._error or tol >= _LOOSEST or last < math.inf:
                    break
                tol = min(_LOOSEST, tol * max(2.0, min(0.5 * room / max(off, 1e-300), 1e3)))
            elif kept is not None:
                break
            else:
                last = tol
                tol *= max(min(0.5 * room / off, 0.3), 1e-4)
        if kept is None:
            _refuse(
                f"no tolerance of the solvers keeps an error of {room:.1e} "
                f"({off:.1e} with tol={last:.1e})",
                "ask for a greater error",
            )
        tol, off, found = kept
        self._options["tol"] = tol
        return Part("solver", off, [(f"{place_of(self._run)}: tol={tol:.2g}", off)],
                    "compared with a run of a smaller tolerance"), found  # fmt: skip

    def _choose_steps(self, reference: Version, base: Any) -> tuple[Part, Any]:
        """The fewest time steps whose extrapolated discretisation error is within its share."""
        room = _SHARE["discretisation"] * self._error
        n = first = int(self._options["steps"])
        results = {n: base if "tol" not in self._options else self._at_steps(reference, n)}
        order, off, fine = 0.0, math.inf, (math.inf, math.inf)
        for _ in range(4):
            for m in (2 * n, 4 * n):
                if m not in results:
                    results[m] = self._at_steps(reference, m)
            coarse = apart(results[n], results[2 * n], results[4 * n])
            fine = apart(results[2 * n], results[4 * n], results[4 * n])
            ratio = min(a / b if b else math.inf for a, b in zip(coarse, fine, strict=True))
            if max(fine) < 1e-13:
                order, off = 1.0, 0.0
                break
            order = math.log2(ratio) if ratio > 0 else -math.inf
            if order > 0.5:
                order = min(order, 6.0)
                # The error with 4n steps is at most as great as the change from n to 4n steps.
                off = max(coarse) / (1 - 2.0**-order)
                break
            n *= 2
        if order <= 0.5:
            _refuse(
                f"the results do not converge in the number of steps: from {n // 2} to {2 * n} "
                f"steps they change by {max(fine):.1e}, no less than before, as in chaos or at a "
                "jump",
                "begin with more steps, or over a shorter time",
            )
        at, wanted = n, max(1, math.ceil(n * (SAFETY * off / room / 1.6) ** (1 / order)))
        for _ in range(3):
            if wanted > _MOST_REFINED * first:
                _refuse(
                    f"error={self._error:.1e} would take about {wanted} steps (order {order:.1f}, "
                    f"{off:.1e} with {at})",
                    "begin with more steps: the default of `steps`; or a method of higher order",
                )
            here = results[wanted] = results.get(wanted) or self._at_steps(reference, wanted)
            double = results[2 * wanted] = results.get(2 * wanted) or self._at_steps(
                reference, 2 * wanted
            )
            off = max(apart(here, double, double)) / (1 - 2.0**-order)
            if off <= room:
                break
            at, wanted = wanted, math.ceil(wanted * max((1.2 * off / room) ** (1 / order), 1.1))
        else:
            _refuse(f"error={self._error:.1e} is not reached by {wanted} steps ({off:.1e})",
                    "begin with more steps: the default of `steps`")  # fmt: skip
        finest = 2 * wanted
        # The order is that of few steps, and may have asked for more than it takes.
        fewer = math.ceil(wanted * (1.5 * off / room) ** (1 / order))
        if off <= _FILLED * room and fewer < wanted and self._iterations <= _RUNS_TO_SHRINK:
            less = self._at_steps(reference, fewer)
            more = max(apart(less, double, double)) + off
            if more <= room:
                wanted, off, here = fewer, more, less
        self._options["steps"] = wanted
        how = f"steps={wanted} against {finest}, of order {order:.1f}"
        return Part("discretisation", off, [(f"{place_of(self._run)}: steps={wanted}", off)],
                    how), here  # fmt: skip

    def _at_steps(self, reference: Version, steps: int) -> tuple[float, np.ndarray]:
        try:
            return self._measure(reference, steps=steps)[:2]
        except _TooManyRuns:
            raise
        except TaiError as error:
            raise TaiAutodiffError(
                f"run(steps={steps}) fails, and the error of the discretisation is estimated from "
                f"several numbers of steps: {error.message}",
                "give fields with a time axis room for more steps",
            ) from None

    def _estimate(self, reference: Version) -> PrecisionReport:
        """Estimates the effect of rounding on the loss, by one reverse sweep."""
        report = self._measure(reference, precision=True)[3]
        off = OF_F64 * report.relative
        if off > _HOPELESS:
            _refuse(
                f"rounding changes the loss by {off:.1e} of it even in f64, as in chaos: most of "
                f"it comes from {worst_of(report, OF_F64)}",
                "differentiate over a shorter time",
            )
        return report

    def _choices(self, report: PrecisionReport) -> list[Choice]:
        """Lists the candidate ways to run the program, the narrowest types first."""
        size = abs(report.loss)
        whole = report.expected / size
        terms = [line.error for line in report.lines]
        others = [part for name, part in report.others if not name.startswith("the sum in")]
        without = math.hypot(math.fsum(terms), *others) / size
        bytes_now = {f.name: f.bytes for f in report.fields}
        narrow = {
            name: kind for name, kind in report.storable(self._error).items()
            if kind in ("f16", "bf16") and bytes_now[name] >= LEAST_BYTES
        }  # fmt: skip
        errors = {f.name: f.errors for f in report.fields}
        choices = []
        if narrow:
            wide = math.hypot(whole, *(errors[n][k] / size for n, k in narrow.items()))
            choices.append(Choice(NARROW, self._modes("f32"), dtypes.f32, wide, narrow))
        f32, f64, more = self._modes("f32"), self._modes("f64"), {"sums": "compensated"}
        if "math" in f32:
            fast = {**f32, "math": "fast"}
            choices.append(Choice("f32, fast", fast, dtypes.f32, OF_FAST * whole))
        choices += [
            Choice("f32", f32, dtypes.f32, whole),
            Choice("f32, compensated sums", {**f32, **more}, dtypes.f32, without),
            Choice("f64", f64, dtypes.f64, OF_F64 * whole),
            Choice("f64, compensated sums", {**f64, **more}, dtypes.f64, OF_F64 * without),
        ]
        return choices

    def _choose(
        self, reference: Version, base: Any, report: PrecisionReport, room: float
    ) -> Choice:
        """The fastest modes whose estimated and measured errors are at most `room`."""
        choices = self._choices(report)
        hopeful = [choice for choice in choices if SAFETY * choice.estimate <= room]
        if not hopeful:
            best = min(choices, key=lambda choice: choice.estimate)
            _refuse(
                f"error={self._error:.1e} cannot be kept: {best.name} is expected to be off by "
                f"{best.estimate:.1e}, most of it from {worst_of(report, OF_F64)}"
                f"{self._slopes.magnified()}",
                f"error={1.5 * MARGIN_OF_F64 * best.estimate:.1e} can be had",
            )
        passed: list[Choice] = []
        for choice in hopeful:
            if passed and choice.base is dtypes.f64:
                # The code of f64 exists. It may be faster: a solver converges in fewer iterations.
                if choice.modes == reference.modes and self._iterations < MOST_ITERATIONS - 6:
                    reference.seconds = math.inf
                    self._scale_from_f32(choices, reference, base)
                    if self._try(choice, reference, base, room):
                        passed.append(choice)
                break
            # Compensated sums cost more than plain sums, which have passed already.
            if choice.name == "f32, compensated sums" and any(c.name == "f32" for c in passed):
                continue
            # The remaining iterations are reserved for the check of the choice and for the f64 run.
            if self._iterations > MOST_ITERATIONS - 6 and choice.base is not dtypes.f64:
                continue
            if choice.base is dtypes.f64:
                self._scale_from_f32(choices, reference, base)
            if self._try(choice, reference, base, room):
                passed.append(choice)
                if choice.base is dtypes.f64:
                    break
        self._time_again(passed)
        while passed:
            # Conversions from 16 bits cost time on a CPU, so a mode with them must be much faster.
            doubtful = {c.name for c in passed if c.narrow or c.base is dtypes.f64}
            costs = {c.name: c.seconds * (_DOUBT if c.name in doubtful else 1) for c in passed}
            near = [c for c in passed if costs[c.name] <= _TIE * min(costs.values())]
            best = min(near, key=lambda choice: (choice.bytes, len(choice.name), choice.seconds))
            trouble = self._find_trouble(reference, base, best, room)
            if trouble is None:
                self._others = others_of(best, choices, room)
                return best
            passed = [choice for choice in passed if choice.base is not best.base]
            if best.base is dtypes.f64:
                _refuse(*trouble)
            self._tried.append(f"{best.name}: {trouble[0]}")
            if not passed:
                wide = next((c for c in hopeful if c.base is dtypes.f64), None)
                if wide is not None:
                    self._scale_from_f32(choices, reference, base)
                if wide is not None and self._try(wide, reference, base, room):
                    passed = [wide]
        _refuse(
            f"error={self._error:.1e} is not kept by any mode: "
            + "; ".join(self._tried)
            + self._slopes.magnified(),
            "ask for a greater error",
        )

    def _scale_from_f32(self, choices: list[Choice], reference: Version, base: Any) -> None:
        """Raises the error estimates of f64 to what the measured error of f32 implies; or, where
        f32 has no digits, to what shadows and the results of near inputs show.
        """
        plain = next(choice for choice in choices if choice.name == "f32")
        if not math.isfinite(max(plain.errors)):
            version = self._version(plain.modes, self._types(plain.base, {}))
            try:
                plain.errors = distance(self._measure(version)[:2], base)
            except _TooManyRuns:
                raise
            except TaiError:
                pass
        measured = max(plain.errors)
        least = OF_F64 * measured * MARGIN_OF_DRAW
        if not measured < _NO_DIGITS:
            least = self._slopes.spread(MOST_ITERATIONS - 5 - self._iterations)
            self._iterations += 1
            self._start.restore()
            with reference:
                off = error_of_f64(self._run, self._options, self._loss, self._unknowns)
            least = max(least, MARGIN_OF_SHADOWS * off)
        for choice in choices:
            if choice.base is dtypes.f64:
                choice.estimate = max(choice.estimate, least / MARGIN_OF_F64)

    def _time_again(self, passed: list[Choice]) -> None:
        """Times the fastest modes again, in turns, since a single time is a matter of chance."""
        while len(passed) > 1 and self._iterations < MOST_ITERATIONS - _LAST_CHECKS:
            fastest = min(choice.seconds for choice in passed)
            near = [choice for choice in passed if choice.seconds <= _NEAR * fastest]
            if len(near) < 2:
                return
            for choice in near:
                if self._iterations < MOST_ITERATIONS - _LAST_CHECKS:
                    self._measure(choice.version)
                    choice.seconds = choice.version.seconds

    def _try(self, choice: Choice, reference: Version, base: Any, room: float) -> bool:
        """Runs the program with a choice of types, and measures its error and time."""
        for _ in range(1 + len(choice.narrow)):
            same = choice.base is dtypes.f64 and choice.modes == reference.modes
            choice.version = reference if same else self._version(
                choice.modes, self._types(choice.base, choice.narrow)
            )  # fmt: skip
            try:
                loss, gradient, seconds, _ = self._measure(choice.version)
            except _TooManyRuns:
                raise
            except TaiError as error:
                self._tried.append(f"{choice.name}: {error.message}")
                return False
            choice.errors = distance((loss, gradient), base)
            choice.bytes = bytes_in(self._places, choice)
            # No type is wider than f64, so the error of an f64 run is the estimated one.
            is_widest = choice.base is dtypes.f64
            least = (MARGIN_OF_F64 if is_widest else 1.0) * choice.estimate
            self._tried.append(
                f"{choice.name}: {max(choice.errors):.1e} measured, {least:.1e} expected"
            )
            off = 1.25 * max(choice.errors)
            if max(off, MARGIN_OF_F64 * choice.estimate if is_widest else 0.0) <= room:
                # The first run is not timed, because it has compiled the kernels.
                if not same:
                    loss, gradient, seconds, _ = self._measure(choice.version)
                    again = distance((loss, gradient), base)
                    choice.errors = max(choice.errors[0], again[0]), max(choice.errors[1], again[1])
                choice.seconds, choice.result = choice.version.seconds, (loss, gradient)
                return max(choice.errors) <= room
            if not choice.narrow:
                return False
            # The first field gets a wider type: its type is expected to cause the largest error.
            choice.narrow = dict(list(choice.narrow.items())[1:])
            if not choice.narrow:
                return False
        return False

    def _find_trouble(
        self, reference: Version, base: Any, choice: Choice, room: float
    ) -> tuple[str, str] | None:
        """Finds out whether inputs that differ in their last bit give another gradient."""
        unit = 2.0 ** (-52 if choice.base is dtypes.f64 else -23)
        signs = [self._generator.choice([-1.0, 1.0], f.shape + f.element_shape)
                 for f in self._unknowns]  # fmt: skip

        def perturbed(size: float) -> tuple[float, np.ndarray]:
            change = self._perturb([size * sign for sign in signs])
            return self._measure(reference, change)[:2]

        far = distance(perturbed(16 * unit), base)
        if max(far) <= room:
            return None
        near = distance(perturbed(unit), base)
        if max(near) <= min(room, max(far) / 4):
            return None  # smooth, and no more than roundings of inputs do
        kind = "f64" if choice.base is dtypes.f64 else "f32"
        where = f"inputs that differ by 16 units of {kind} ({16 * unit:.0e})"
        if not all(map(math.isfinite, far)):
            return f"{where} give no finite result", "tape.health() says where that begins"
        if max(near) > max(far) / 4:
            jumps = near[0] > max(far[0] / 4, room)
            what = "loss" if jumps else "gradient"
            return (
                f"{where} change the {what} by {max(far):.1e}, and 16 times smaller ones by "
                f"{max(near):.1e}: a {'jump' if jumps else 'kink'} is near by, where no estimate "
                "of first order holds",
                "move the point, or smooth the condition; ti.ad.check shows the slopes",
            )
        return (
            f"{where} change loss or gradient by {max(far):.1e}: it magnifies them "
            f"{max(far) / unit / 16:.0e} times, as chaos does",
            "differentiate over a shorter time, or ask for a greater error",
        )

    # Results

    def _finish(self, chosen: Choice, base: Any, parts: list[Part]) -> Solution:
        total = sum(part.error for part in parts)
        assert total <= self._error
        loss, gradient = self._values = chosen.result
        own = {owner_of(f).name: f.dtype for f in self._places}
        types = {
            owner_of(f).name: dtype.name
            for f, dtype in self._types(chosen.base, chosen.narrow)
            if dtype is not own[owner_of(f).name]
        }
        words = {word: chosen.modes.get(word, "default") for word in ("precision", "sums", "math")}
        modes = {**words, "types": types, "tape": self._density, **self._options}
        notes = find_short_fields(self._loss, self._unknowns, self._error)
        return Solution(
            modes, total, parts, chosen.seconds, self._error, loss, self._by_field(gradient),
            self._iterations, self._reference_time, self._tried, notes,
            self._room(chosen, total), chosen.version.memory, lambda: self._again(chosen.version),
        )  # fmt: skip

    def _room(self, chosen: Choice, total: float) -> str:
        """Names the reason why the error is far below the one that was asked for."""
        if total >= _LEAST_SHARE * self._error:
            return ""
        text = f"{chosen.name} already gives {total:.1e}, and no cheaper mode keeps the error"
        return f"{text}: {'; '.join(self._others)}" if self._others else text

    def _split(self, gradient: np.ndarray) -> list[np.ndarray]:
        arrays, at = [], 0
        for f in self._unknowns:
            shape = f.shape + f.element_shape
            size = math.prod(shape)
            arrays.append(gradient[at : at + size].reshape(shape))
            at += size
        return arrays

    def _by_field(self, gradient: np.ndarray) -> list[np.ndarray]:
        """An array for each field; the components of a vector field may be stored separately."""
        arrays = {id(f): a for f, a in zip(self._unknowns, self._split(gradient), strict=True)}
        owners = self._wrt or list({id(owner_of(f)): owner_of(f) for f in self._unknowns}.values())
        found = []
        for owner in owners:
            parts = [arrays[id(part)] for part in getattr(owner, "parts", [owner])]
            shape = owner.shape + owner.element_shape
            found.append(parts[0] if len(parts) == 1 else np.stack(parts, -1).reshape(shape))
        return found

    def _leave_results(self, chosen: Choice) -> None:
        values = getattr(self, "_values", None)
        if values is None:
            return
        self._loss.fill(values[0])
        for f, array in zip(self._unknowns, self._split(values[1]), strict=True):
            grad = f._companions["grad"]
            grad.core.copy_from(np.ascontiguousarray(array, grad.dtype.numpy))

    def _again(self, version: Version) -> None:
        with version, Tape(self._loss, **version.checkpoint):
            self._run(**self._options)
        version.copy_out()


def _refuse(message: str, hint: str) -> NoReturn:
    raise TaiAutodiffError(message, hint)


check_keywords(globals(), ["solve_to"])
