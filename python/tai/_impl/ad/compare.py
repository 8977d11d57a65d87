"""Gradients compared with forward mode and with finite differences, and the kernel at fault.

Forward mode's tangents need no step size; finite differences use a sequence of step sizes. Every
comparison is along random directions. All fields are restored bit for bit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import native, state
from ..base.program import get_program
from ..fields.field import Field
from ..tracking import tracked
from .mode import ForwardMode, clear_duals
from .probe import FORWARD_TOLERANCE, Probe, climb, direction, relative_error
from .snapshot import Snapshot, storage
from .source import Place
from .sparse import active_elements, sparse_level

READ, WRITE, ACCUMULATE = 0, 1, 2


class GradientCheckError(TaiAutodiffError, AssertionError):
    """Raised where a gradient disagrees with finite differences; `result` says where."""

    result: CheckResult


@dataclass
class FieldCheck:
    """The result of the check of one field's gradient.

    Attributes:
        name, dtype: of the field.
        probes: one for each direction and method.
        skipped: why it was not checked, or None.
    """

    name: str
    dtype: str
    probes: list[Probe] = field(default_factory=list)
    skipped: str | None = None

    @property
    def passed(self) -> bool:
        """Whether the gradient of this field was checked, and agrees."""
        return bool(self.probes) and all(probe.passed for probe in self.probes)

    @property
    def is_flat(self) -> bool:
        """Whether no checked output depends on the field, so that 0 was compared with 0."""
        return all(probe.is_flat for probe in self.probes)

    @property
    def worst(self) -> Probe:
        """The probe with the greatest error relative to its tolerance."""
        return max(
            self.probes,
            key=lambda p: (not p.passed, np.inf if np.isnan(p.error) else p.error / p.tolerance),
        )

    @property
    def error(self) -> float:
        """The greatest relative error."""
        errors = [probe.error for probe in self.probes]
        return float("nan") if any(np.isnan(errors)) else max(errors, default=0.0)

    @property
    def best_step(self) -> float | None:
        """The step of the most accurate finite difference along the worst direction."""
        return self.worst.step if self.probes else None

    @property
    def kink(self) -> bool:
        return any(probe.kink for probe in self.probes)

    @property
    def verdict(self) -> str:
        if self.skipped:
            return f"not checked: {self.skipped}"
        text = "agrees" if self.passed else "DISAGREES"
        if any(np.isnan(probe.reverse) for probe in self.probes):
            text = "IS NAN"
        if any(probe.jump for probe in self.probes):
            text += ", the program jumps here"
        elif self.kink:
            text += ", a kink is suspected: the slopes of the two sides differ"
        return text


@dataclass
class Culprit:
    """The first record of a tape whose own gradient is wrong: the cause of a failed check."""

    record: int
    kernel: str
    filename: str | None
    lineno: int | None
    fields: list[FieldCheck]
    place: str

    def __str__(self) -> str:
        names = ", ".join(f"'{f.name}'" for f in self.fields)
        return f"record {self.record}, {self.place}: its gradient by {names} is wrong"


@dataclass
class CheckResult:
    """The result of `ti.ad.check`; true if something was checked, and all of it agrees.

    Attributes:
        what: the program that was checked.
        fields: one entry for each field.
        culprit: the first record that is wrong by itself, where one was found.
        note: further remarks.
        unchecked: why nothing was checked, which is a failure; or None.
    """

    what: str
    fields: list[FieldCheck]
    culprit: Culprit | None = None
    note: str | None = None
    unchecked: str | None = None

    def __bool__(self) -> bool:
        return self.unchecked is None and self.culprit is None and not self._wrong

    @property
    def _wrong(self) -> list[FieldCheck]:
        return [f for f in self.fields if f.probes and not f.passed]

    @property
    def error(self) -> float:
        """The greatest relative error over all fields."""
        errors = [f.error for f in self.fields]
        return float("nan") if any(np.isnan(errors)) else max(errors, default=0.0)

    def __str__(self) -> str:
        verdict = "agrees" if self else "NOT CHECKED" if self.unchecked else "DISAGREES"
        lines = [f"gradient of {self.what}: {verdict}"]
        if self.unchecked:
            lines.append(f"  nothing was checked: {self.unchecked}")
        if not self.fields:
            return "\n".join(lines)
        width = max([len(f.name) for f in self.fields] + [5])
        lines.append(f"  {'field':{width}} type method        error   bound  step  verdict")
        for f in self.fields:
            if not f.probes:
                lines.append(f"  {f.name:{width}} {f.dtype:4} {f.verdict}")
            for method in dict.fromkeys(p.method for p in f.probes):
                part = FieldCheck(f.name, f.dtype, [p for p in f.probes if p.method == method])
                p = part.worst
                step = "-" if p.step is None else f"{p.step:.0e}"
                lines.append(
                    f"  {f.name:{width}} {f.dtype:4} {method:11} {part.error:7.1e} "
                    f"{p.tolerance:7.0e} {step:>5}  {part.verdict}"
                )
        for f in self._wrong:
            p = f.worst
            lines.append(
                f"  '{f.name}' along one direction: {p.reverse:.15g} by the reverse sweep, "
                f"{p.expected:.15g} by {p.method}"
            )
            lines += [f"  {line}" for line in p.show()] if p.ladder else []
        if self.culprit:
            lines.append(f"  first wrong: {self.culprit}")
        if self.note:
            lines.append(f"  note: {self.note}")
        return "\n".join(lines)

    __repr__ = __str__

    def raise_if_wrong(self) -> CheckResult:
        """Raises GradientCheckError if a gradient does not agree, or none was checked."""
        if not self:
            error = GradientCheckError(str(self))
            error.result = self
            raise error
        return self


# State


def differentiable_fields() -> dict[str, Any]:
    """The placed fields of the program that have a gradient, by their symbol in the IR."""
    found = {}
    program = get_program()
    internal = {pool.field.symbol for pool in program.pools}
    for symbol, f in program.fields.items():
        if symbol in internal:
            continue
        if f.role == "primal" and f.dtype.is_float and f._core is not None:
            grad = f._companions.get("grad")
            if grad is not None and grad._core is not None:
                found[symbol] = f
    return found


def _seed(f: Any, array: np.ndarray) -> None:
    f._companions["grad"].core.copy_from(np.ascontiguousarray(array, f.dtype.numpy))


def _gradient(f: Any) -> np.ndarray:
    return Snapshot._take(f._companions["grad"]).astype(np.float64)


class Recording(native.WithBlock):
    """A tape that clears the gradients when it is entered; its `with` block gets the tape object of
    the C++ library.
    """

    def __init__(self, loss: Any = None):
        self._loss = loss
        self._core: Any = None

    def _enter(self) -> Any:
        if state.tape is not None:
            raise TaiRuntimeError(
                "a gradient cannot be checked inside a tape", "leave the tape first"
            )
        loss = None if self._loss is None else self._loss.core
        core = self._core = get_program().context.tape(loss, True)
        state.of_thread.tape = core
        native.set_tape(core)
        return core

    def _end(self) -> None:
        if self._core is None:
            return
        native.set_tape(None)
        tracked.end()
        state.of_thread.tape = None
        self._core.end()
        self._core = None


class Accesses:
    """The fields and elements that a tape reads, and those that it changes.

    Attributes:
        known: the fields with gradients, by symbol.
        masks: the elements that are read, by symbol.
        first: those of them that no earlier record has stored.
        sure: those of them that are certainly read before they are stored.
        changed: the fields that are stored or accumulated, by symbol.
    """

    def __init__(self, core: Any, loss: Any, run_host_functions: bool = False):
        self.known = differentiable_fields()
        self.masks: dict[str, np.ndarray] = {}
        self.changed: dict[str, Any] = {}
        self.first: dict[str, np.ndarray] = {}
        self.sure: dict[str, np.ndarray] = {}
        self._written: dict[str, np.ndarray] = {}
        self._loss = None if loss is None else loss.symbol
        for record in range(core.records):
            if core.kernel_of(record) is not None:
                self._of_kernel(core.accesses(record))
            elif run_host_functions:
                self._of_host_function(core, record)

    def _of_kernel(self, accesses: list[tuple[str, int, int, int]]) -> None:
        here: dict[int, dict[str, np.ndarray]] = {READ: {}, WRITE: {}}
        for symbol, kind, dimension, index in accesses:
            if symbol not in self.known or symbol == self._loss:
                continue
            f = self.known[symbol]
            if kind != READ:
                self.changed[symbol] = f
            empty = np.zeros(f.shape + f.element_shape, bool)
            where = here[WRITE if kind == WRITE else READ].setdefault(symbol, empty)
            where[elements(f, dimension, index)] = True
        for symbol, read in here[READ].items():
            # The same kernel stores the element and reads it, and which comes first is not known.
            none = np.zeros_like(read)
            first = read & ~self._written.get(symbol, none)
            _join(self.masks, symbol, read)
            _join(self.first, symbol, first)
            _join(self.sure, symbol, first & ~here[WRITE].get(symbol, none))
        for symbol, write in here[WRITE].items():
            _join(self._written, symbol, write)

    def _of_host_function(self, core: Any, record: int) -> None:
        """The effect of a function with a custom gradient on the fields is unknown, so the function
        is run and the changes are looked up.
        """
        # The function runs from changed values: with the present values it may have run already,
        # and would then change nothing.
        here = Snapshot()
        generator = np.random.default_rng(1)
        before = {}
        for symbol, f in self.known.items():
            array = Snapshot._take(f)
            array += (1e-3 * (1 + np.abs(array)) * generator.random(array.shape)).astype(
                array.dtype
            )
            f.core.copy_from(array)
            before[symbol] = array.tobytes()
        core.run_record(record)
        after = {symbol: Snapshot._take(f).tobytes() for symbol, f in self.known.items()}
        here.restore()
        for symbol, f in self.known.items():
            if before[symbol] != after[symbol]:
                self.changed[symbol] = f
            elif symbol != self._loss and symbol not in self._written:
                everything = np.ones(f.shape + f.element_shape, bool)
                _join(self.masks, symbol, everything)
                _join(self.first, symbol, everything)
                _join(self.sure, symbol, everything)


def _join(masks: dict[str, np.ndarray], symbol: str, more: np.ndarray) -> None:
    masks[symbol] = masks[symbol] | more if symbol in masks else more


# Programs


class Program:
    """The checked program: a function that can be run again from a state of the fields.

    Attributes:
        run: runs it on the current values of the fields.
        outputs: fields whose weighted sum is differentiated; found from the accesses if None.
        loss: the only output, zeroed first; or None.
    """

    def __init__(self, run: Callable[[], Any], loss: Any = None, start: Snapshot | None = None):
        mesh = get_program().options.mesh
        if mesh is not None and mesh.ranks > 1:
            raise TaiRuntimeError(
                f"gradients are checked on one process; mesh '{mesh.name}' has {mesh.ranks}",
                'run the check with a mesh of one: ti.init(mesh=ti.mesh("x", 1))',
            )
        self.run, self.loss = run, loss
        self.start = start or Snapshot()
        self.core: Any = None
        self.outputs: list[Any] = [] if loss is None else storage(loss)
        self.inputs: list[tuple[Any, np.ndarray]] = []
        self.overwritten = 0
        self.lost: list[str] = []

    def record(self) -> None:
        """Runs it once on a tape, and finds the places that it reads and changes."""
        # If it is not limited, the snapshot has only just been taken.
        if self.start.is_limited:
            self.start.restore(only_primal=True)
        with Recording(self.loss) as core:
            self.run()
        self.core = core
        self.start.limit(core)
        if core.records == 0:
            raise TaiAutodiffError("nothing was launched, so there is no gradient to check")
        reads, changes = self._find_accesses()
        if self.loss is None:
            self.outputs = changes
        self.inputs = reads

    def _find_accesses(self) -> tuple[list[tuple[Any, Any]], list[Any]]:
        found = Accesses(self.core, self.loss, run_host_functions=True)
        self.written = set(found.changed)
        inputs = [(found.known[s], mask) for s, mask in found.masks.items() if mask.any()]
        return inputs, list(found.changed.values())

    def values(self) -> list[np.ndarray]:
        """Runs the program from the current values of the fields; returns the outputs."""
        if self.loss is not None:
            self.loss.core.fill(0.0)
        self.run()
        return [Snapshot._take(f).astype(np.float64) for f in self.outputs]

    def at(self, f: Any, offset: np.ndarray) -> Callable[[float], list[np.ndarray]]:
        """The outputs of the program as a function of the distance along a direction of one
        input field.
        """

        def value(step: float) -> list[np.ndarray]:
            self.start.restore(only_primal=True)
            if step:
                f.core.copy_from((begin + step * offset).astype(f.dtype.numpy))
            return self.values()

        self.start.restore(only_primal=True)
        begin = Snapshot._take(f)
        return value

    def sweep(self, seeds: list[np.ndarray]) -> dict[str, np.ndarray]:
        """The gradient of the weighted outputs by the initial value of each input."""
        self.start.restore(only_primal=True)
        with Recording(self.loss) as core:
            self.run()
        if self.loss is None:
            for f, seed in zip(self.outputs, seeds, strict=True):
                _seed(f, seed)
        core.backward()
        # The warnings of the sweep are kept, because lost derivatives explain why a gradient
        # disagrees.
        self.lost += [line for line in core.warnings() if "the derivative ends there" in line]
        return {f.symbol: _gradient(f) for f, _ in self.inputs}

    def is_input(self, f: Any, mask: Any) -> bool:
        """Whether the initial value of a field that the program writes can influence the
        outputs.
        """
        if f.symbol not in self.written:
            return True
        value = self.at(f, np.where(mask, 0.37, 0.0))
        base = value(0.0)
        for step in (1.0, -2.7):
            moved = value(step)
            doubles = all(g.dtype.name == "f64" for g in self.outputs)
            if not all(_are_same(a, b, doubles) for a, b in zip(base, moved, strict=True)):
                return True
        return False


def elements(f: Any, dimension: int, index: int) -> tuple:
    """Returns the index of the elements of a field that an access touches."""
    if dimension < 0 or not 0 <= index < f.shape[dimension]:
        return (...,)
    return (slice(None),) * dimension + (index,)


# The check


def probe_program(
    program: Program,
    wrt: Sequence[Any] | None,
    directions: int,
    generator: np.random.Generator,
    tolerance: float | None = None,
    forward_tolerance: float | None = None,
    methods: Sequence[str] = ("forward", "differences"),
    quick: bool = False,
) -> list[FieldCheck]:
    """Compares the gradients of a recorded program with finite differences."""
    # The value of an inactive cell is a constant, so the inputs are the active elements.
    program.start.restore(only_primal=True)
    if wrt is not None:
        program.inputs = [(p, active_elements(p)) for f in wrt for p in storage(f)]
    else:
        inputs = [(f, mask & active_elements(f)) for f, mask in program.inputs]
        program.inputs = [(f, mask) for f, mask in inputs if program.is_input(f, mask)]
        program.overwritten = len(inputs) - len(program.inputs)
    wanted = program.inputs
    checks = []
    rounds = [None] if program.loss is not None else range(directions)
    for number in rounds:
        if number is None:
            seeds = [np.ones(f.shape + f.element_shape) for f in program.outputs]
        else:
            seeds = [generator.standard_normal(f.shape + f.element_shape) for f in program.outputs]
        gradients = program.sweep(seeds)
        for place, (f, mask) in enumerate(wanted):
            if number in (None, 0):
                checks.append(FieldCheck(f.name, f.dtype.name))
                if f.dtype.name not in ("f64", "f32"):
                    checks[-1].skipped = "differences need f64 or f32"
                elif not np.any(mask):
                    sparse = sparse_level(f) is not None
                    checks[-1].skipped = (
                        "none of its cells is active" if sparse else "it has no elements"
                    )
                elif wrt is not None and not program.is_input(f, mask):
                    checks[-1].skipped = "it is overwritten before it is read"
            check = checks[place]
            if check.skipped:
                continue
            gradient = gradients[f.symbol]
            count = directions if number is None else 1
            for _ in range(count):
                check.probes += _probe_field(
                    program, f, mask, gradient, seeds, generator, tolerance, forward_tolerance,
                    methods, quick,
                )  # fmt: skip
    return checks


def _probe_field(
    program: Program, f: Any, mask: Any, gradient: np.ndarray, seeds: list[np.ndarray],
    generator: np.random.Generator, tolerance: float | None, forward_tolerance: float | None,
    methods: Sequence[str], quick: bool,
) -> list[Probe]:  # fmt: skip
    along = direction(generator, gradient, mask)
    with np.errstate(all="ignore"):
        reverse = float(np.sum(gradient[along != 0] * along[along != 0]))
        finite = gradient[np.isfinite(gradient)]
        scale = float(np.linalg.norm(finite)) / max(1.0, np.sqrt(gradient.size))
    dtype = f.dtype.name
    probes = []
    if "forward" in methods:
        expected = forward_derivative(program, f, along, seeds)
        if expected is not None:
            bound = forward_tolerance or FORWARD_TOLERANCE[dtype]
            error = relative_error(reverse, expected, scale)
            probes.append(Probe("forward", reverse, expected, error, bound))
    if "differences" in methods:
        value = program.at(f, along)
        probes.append(climb(value, seeds, reverse, scale, dtype, tolerance, quick))
    return probes


def forward_derivative(
    program: Program, f: Any, along: np.ndarray, seeds: list[np.ndarray]
) -> float | None:
    """Returns the derivative of the weighted outputs, computed by forward mode.

    Returns None if a field has a gradient and no dual, since a tangent would end there.
    """
    if any(not _has_dual(known) for known in differentiable_fields().values()):
        return None
    program.start.restore(only_primal=True)
    with ForwardMode():
        clear_duals()
        f._companions["dual"].core.copy_from(np.ascontiguousarray(along, f.dtype.numpy))
        program.values()
        total = 0.0
        for output, seed in zip(program.outputs, seeds, strict=True):
            tangent = Snapshot._take(output._companions["dual"]).astype(np.float64)
            total += float(np.sum(tangent[seed != 0] * seed[seed != 0]))
    return total


def _has_dual(f: Any) -> bool:
    dual = f._companions.get("dual")
    return dual is not None and dual._core is not None


def check_program(
    program: Program, core: Any, what: str, wrt: Any, directions: int, seed: int,
    tolerance: float | None, forward_tolerance: float | None, bisect: bool,
) -> CheckResult:  # fmt: skip
    generator = np.random.default_rng(seed)
    checks = probe_program(program, wrt, directions, generator, tolerance, forward_tolerance)
    result = CheckResult(what, checks)
    result.unchecked = _why_unchecked(program, checks)
    if result._wrong and bisect:
        result.culprit = find_culprit(
            core, program.start, program.loss, generator, tolerance, forward_tolerance
        )
        if result.culprit is None:
            result.note = (
                "each record is right by itself: look for values that are overwritten, or "
                "changed from Python, between records"
            )
    if program.lost:
        result.note = "; ".join([*program.lost, *([result.note] if result.note else [])])
    return result


def _why_unchecked(program: Program, checks: list[FieldCheck]) -> str | None:
    """Returns why a check has compared nothing, or None if it has compared something."""
    if not checks:
        if program.overwritten:
            return "each field with a gradient that it reads is overwritten before it is read"
        return "it reads no field that has a gradient"
    if not any(f.probes for f in checks):
        return "; ".join(f"'{f.name}': {f.skipped}" for f in checks)
    if all(f.is_flat for f in checks):
        names = ", ".join(f"'{f.name}'" for f in checks if f.probes)
        what = "the loss does" if program.loss is not None else "what it changes does"
        return f"{what} not depend on {names} here: both gradients are exactly 0"
    return None


def as_fields(wanted: Any, what: str) -> list[Any] | None:
    if wanted is None:
        return None
    fields = list(wanted) if isinstance(wanted, (list, tuple)) else [wanted]
    for f in fields:
        if not isinstance(f, Field):
            raise TaiRuntimeTypeError(f"{what} takes fields, but got {f!r}")
        f.placed_grad()  # raises
    return fields


def _adds_in_any_order() -> bool:
    """Whether sums of floats may differ in their last bits from one run to the next."""
    options = state.program.options
    return options.arch == "cuda" and not options.deterministic


def _are_close(a: Any, b: Any, tolerance: float) -> bool:
    """Whether two arrays agree; if sums are in any order, relative to the largest number."""
    largest = np.max(np.abs(a[np.isfinite(a)]), initial=0.0) if _adds_in_any_order() else 0.0
    atol = max(1e-8, tolerance * float(largest))
    return np.allclose(a, b, rtol=tolerance, atol=atol, equal_nan=True)


def _are_same(a: Any, b: Any, doubles: bool) -> bool:
    """Whether two results can come from two runs of the same computation."""
    if _adds_in_any_order() and a.dtype.kind == "f":
        return _are_close(a, b, 1e-13 if doubles else 1e-5)
    return a.tobytes() == b.tobytes()


def check_start(program: Program, recorded: float | None) -> None:
    """Refuses programs that do not give the same result when they run again from the same state."""
    program.start.restore(only_primal=True)
    first = program.values()
    program.start.restore(only_primal=True)
    second = program.values()
    # If sums are in any order, their last bits depend on chance.
    loose = _adds_in_any_order() and any(f.dtype.name != "f64" for f in program.outputs)
    for a, b in zip(first, second, strict=True):
        if not _are_close(a, b, 1e-9 if a.dtype == np.float64 and not loose else 1e-4):
            raise TaiRuntimeError(
                "the program gives another result when it is run again from the same state",
                "record it by ti.ad.Tape and check the tape: its random numbers are drawn again",
            )
    if recorded is not None:
        again = float(first[0].ravel()[0])
        if not np.isclose(again, recorded, rtol=1e-4 if loose else 1e-6, atol=0, equal_nan=True):
            raise TaiRuntimeError(
                f"the tape gives {again!r} when it is run again, but gave {recorded!r}: the fields "
                "do not hold any more what they held at its start",
                "check the function: ti.ad.check(function, loss=…), or use Tape(grad_check=[x])",
            )


def run_records(core: Any) -> None:
    """Runs all records of a tape, each with the random numbers it had."""
    for record in range(core.records):
        core.run_record(record)


def find_culprit(
    core: Any, start: Snapshot, loss: Any, generator: np.random.Generator,
    tolerance: float | None = None, forward_tolerance: float | None = None,
) -> Culprit | None:  # fmt: skip
    """The first record of a tape whose gradient is wrong when it is checked alone, on the field
    values that the record had.
    """
    start.restore(only_primal=True)
    if loss is not None:
        loss.core.fill(0.0)
    for record in range(core.records):
        with Snapshot() as here:
            program = Program(functools.partial(core.run_record, record), None, here)
            program.record()
            wrong: list[FieldCheck] = []
            if program.outputs and program.inputs:
                checks = probe_program(
                    program, None, 2, generator, tolerance, forward_tolerance, quick=True
                )
                wrong = [c for c in checks if c.probes and not c.passed]
        if wrong:
            place = Place(core, record)
            return Culprit(record, place.kernel, place.filename, place.lineno, wrong, str(place))
        core.run_record(record)
    return None


class GradCheck:
    """`Tape(grad_check=[…])`: checks the gradients of these fields when the tape is left."""

    def __init__(self, fields: Any):
        if not isinstance(fields, (list, tuple)):
            raise TaiRuntimeTypeError(
                f"grad_check takes a list of fields, but got {fields!r}", "grad_check=[x]"
            )
        self.fields = as_fields(fields, "grad_check")
        for f in self.fields or ():
            if f.dtype.name != "f64":
                raise TaiAutodiffError(
                    f"grad_check needs f64, but field '{f.name}' is of type {f.dtype}",
                    "make the fields f64 while checking, or use ti.ad.check with its bound for f32",
                )

    def begin(self, loss: Any) -> None:
        """Keeps the state of all fields when the tape is entered."""
        if loss.dtype.name != "f64":
            raise TaiAutodiffError(
                f"grad_check needs f64, but the loss '{loss.name}' is of type {loss.dtype}"
            )
        for f in self.fields or ():
            f.materialize()
        self._start = Snapshot()

    def end(self, core: Any, loss: Any) -> CheckResult:
        """Called after the reverse sweep of the tape: compares the gradients, prints a line for
        each field, and raises an exception if one is wrong.
        """
        after = Snapshot()
        after.limit(core)
        self._start.limit(core)
        with after:
            program = Program(functools.partial(run_records, core), loss, self._start)
            program.record()
            result = check_program(
                program, core, f"the tape, loss '{loss.name}'", self.fields, 4, 0, None, None, True
            )
        for f in result.fields:
            if f.passed:
                print(f"gradient check: field '{f.name}' passes (error {f.error:.1e})")
        return result.raise_if_wrong()
