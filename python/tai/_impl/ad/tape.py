"""Gradients across kernels: the tape, and custom gradients."""

from __future__ import annotations

import functools
import html
import sys
import warnings
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import TaiAutodiffError, TaiGradientWarning, TaiRuntimeError, TaiRuntimeTypeError
from ..base import native, state
from ..base.program import get_program
from ..fields import notebook
from ..fields.arrays import Ndarray
from ..history import gradients, origins
from ..tracking import tracked
from ..tracking.tape_arrays import Ordered
from . import library as library
from . import rounding
from .compare import GradCheck
from .condition import Condition, take_condition
from .health import HealthReport, take_health, warn_of_losses
from .memory import TapeStats, parse_checkpoint
from .precision import PrecisionReport, find_not_finite, make_report
from .seeds import (
    as_losses,
    as_seed,
    as_seeds,
    as_wanted,
    is_number,
    parts_of,
    require_grad,
    set_seeds,
    warn,
)
from .validation import LIMIT, raise_violations


class _Missing:
    """Warns, when a tape is garbage collected, that a gradient was never computed: of its losses,
    or if it has none, of what its launches computed.

    This is a class beside the tape because Python loses a Ctrl-C that comes in a `__del__`: most
    tapes make no such object.
    """

    def __init__(self, losses: list[Any]):
        self._losses, self.is_missing = losses, False

    def __del__(self) -> None:
        if self.is_missing and not self._losses:
            warnings.warn(
                "a tape without a loss has recorded launches, and no gradient was computed: write "
                "with ti.ad.Tape(loss), or take the tape by 'as tape' and call tape.backward(…)",
                TaiGradientWarning,
                stacklevel=2,
            )
        elif self.is_missing:
            names = ", ".join(f"'{field.name}'" for field in self._losses)
            remedy = "needs a seed, as in tape.grad(seed=np.ones(loss.shape))"
            if all(field.batch is not None for field in self._losses):
                remedy = "in each world takes the tape of its batch: with batch.tape(loss)"
            warnings.warn(
                f"the gradient of {names} was never computed: a loss of more than one number "
                f"{remedy}",
                TaiGradientWarning,
                stacklevel=2,
            )


class Tape(native.WithBlock):
    """Records the kernels that run in its block, and then runs their gradients in reverse.

    ```python
    with ti.ad.Tape(loss):
        simulate()
    print(x.grad[0])
    ```

    A kernel may overwrite elements that others have read, as in `x[i] += dt * v[i]`: the tape saves
    the old values that the reverse sweep reads, and restores them during it. After the sweep, all
    fields have the values of the end of the block again. If that takes too much memory, the tape
    keeps snapshots and runs kernels again: see `memory_budget` and `checkpoint`.

    Args:
        loss: a field or `ti.ndarray` of one number that has a gradient. The tape sets it to zero
            when the block is entered, and starts the reverse sweep from the gradient 1. Or any
            field with a gradient, or a list of fields: fields of more than one number need a seed,
            here or in `grad`. Without a loss, the sweep does not run at the end of the block: call
            `backward(…)`, or set gradients by hand and call `grad()`.
        clear_gradients: set all gradients to zero first, except those that another thread has
            computed and this tape does not use.
        validation: check the global data access rules at run time, element by element: no
            element is written again except by accumulation, and none after it was read.
            Violations raise `TaiAssertionError` at the end of the block, even if the tape
            could have saved the value; the `violations` of the error list them. In debug
            mode, conflicting accesses of iterations of one loop are reported without it.
        grad_check: a list of f64 fields whose gradients are compared with forward mode and
            finite differences at the end of the block; a wrong one raises
            `GradientCheckError`, with a report that names the first kernel at fault. See
            `ti.ad.check`.
        health: look at the adjoints after each record of the reverse sweep; see `health()`.
        precision: estimate the effect of the rounding errors of the kernels on the loss; see
            `precision_report()`. The kernels are compiled again for it, and slower.
        seed: the gradient of the loss from which the reverse sweep starts: a number or an
            array of the shape of the loss; for several losses, a list of them.
        memory_budget: maximum bytes of saved old values. Values that do not fit are
            recomputed: kernels run once more, with the same random numbers.
        checkpoint: the strategy: "periodic" (snapshots at even distances, and saved values
            between two of them), "binomial" (only snapshots, placed such that recomputation
            is minimal), a number (binomial, with that many snapshots), "mixed" (periodic if
            the values in between fit). The default saves everything, or is "mixed" under a budget.
        wrt: the fields whose gradients are wanted, one or a list; all if left out. Kernels that
            lead to none of these gradients do not run in reverse. After the sweep the
            gradients of all other fields that the tape uses are zero, except those of losses;
            arrays and returned values always have theirs.
        incremental: record a launch without running it if an incremental tape has run it before,
            with the same arguments, and nothing has written the fields that it reads or writes
            since. Kernels that accumulate, read what they write, draw random numbers, print, or
            use arrays or sparse fields always run. See the guide of tapes.
    """

    # The number of reverse sweeps of all tapes, by which an optimiser sees whether a function has
    # run a tape.
    sweeps = 0
    # Weak references to the losses of one number of the last sweep.
    _swept_losses: tuple[weakref.ref[Any], ...] = ()

    def __init__(
        self, loss: Any = None, clear_gradients: bool = True, validation: bool = False,
        grad_check: Any = None, health: bool = False, *, validate: bool = False,
        seed: Any = None, memory_budget: Any = None, checkpoint: Any = None,
        precision: bool = False, wrt: Any = None, incremental: bool = False,
    ):  # fmt: skip
        # The loss that is an array and not a field, from which the sweep starts as well.
        self._outer_loss = loss if isinstance(loss, Ndarray) else None
        if self._outer_loss is not None:
            tracked.check_loss(loss)
            loss = None
        if grad_check and loss is None:
            raise TaiAutodiffError(
                "grad_check needs the field of the loss", "see also ti.ad.check and tai.testing"
            )
        self._losses = as_losses(loss)
        self._sums = [f for f in self._losses if is_number(f) and f.shape + f.element_shape]
        cleared = [f for f in self._losses if is_number(f)]
        cleared += [] if self._outer_loss is None else [self._outer_loss]
        self._cleared = tuple(map(weakref.ref, cleared))
        self._seed = seed
        self._wanted = as_wanted(wrt)
        self._is_incremental = incremental
        self._checkpoint = parse_checkpoint(checkpoint, memory_budget)
        self.loss, self.clear_gradients = loss, clear_gradients
        self._core: Any = None
        self._values: Any = None
        self._is_open = self._is_recording = False
        self._was_seeded = False
        self.solves: list[Any] = []
        self._missing: _Missing | None = None
        self._check = GradCheck(grad_check) if grad_check else None
        self._watches = health
        self._validates = validation or validate
        self._probes: rounding.Probes | None = None
        self._rounding: rounding.Sweep | None = None
        self._looks_at_rounding = precision
        if (grad_check or health or precision) and not (
            len(self._losses) == 1 and is_number(self._losses[0]) and seed is None
        ):
            raise TaiAutodiffError("grad_check, health and precision need a loss of one number")

    if TYPE_CHECKING:

        def __enter__(self) -> Tape: ...

    def _enter(self) -> Tape:
        if state.tape is not None:
            raise TaiRuntimeError("tapes do not nest", "close the outer ti.ad.Tape first")
        program = get_program()
        for field in [*self._losses, *self._wanted]:
            require_grad(field, sys._getframe(1))
        if self._check:
            self._check.begin(self.loss)
        # The seeds are checked first, so that wrong ones are found before anything is computed.
        seeds = None if self._seed is None else as_seeds(self._losses, self._seed)
        if self._outer_loss is not None:
            self._outer_loss.fill(0)
        self._clear_sums()
        if seeds is None and self._sums and all(map(is_number, self._losses)):
            seeds = as_seeds(self._losses, [1.0] * len(self._losses))
        if self.clear_gradients:
            gradients.clear_gradients(all_threads=False)
        was_seeded = (seeds is not None or self._outer_loss is not None) or (
            bool(self._losses) and all(map(is_number, self._losses))
        )
        self._is_open = True
        if self._looks_at_rounding:
            self._probes = rounding.begin(program, find_not_finite())
        self._core = program.context.tape(None, bool(self.clear_gradients))
        recomputes = self._checkpoint is not None
        if self._checkpoint is not None:
            self._core.set_checkpoint(*self._checkpoint)
        self._values = tracked.begin(self._core, recomputes, self.clear_gradients)
        for field in self._losses:
            for part, _ in parts_of(field):
                self._core.add_loss(part.core)
        if seeds is not None:
            set_seeds(self._core, self._losses, seeds)
        if self._wanted:
            self._core.want([part.core for f in self._wanted for part, _ in parts_of(f)])
        if self._is_incremental:
            self._core.skip_unchanged()
        self._core.watch_health(self._watches)
        self._checks = self._validates or program.options.debug
        if self._checks:
            self._core.check_accesses(LIMIT, not self._validates)
        state.of_thread.tape = self._core
        native.set_tape(self._core)
        self._values.arrays.follow()
        # How the solves of its block ended, in order: `ti.linalg.SolveInfo` of each.
        self.solves = state.of_thread.solves = []
        origins.note_tape(self._core, self._checks)
        self._was_seeded = was_seeded
        if self._losses and not was_seeded:
            self._missing = self._missing or _Missing(self._losses)
            self._missing.is_missing = True
        self._is_recording = True
        return self

    def _clear_sums(self) -> None:
        """Sets losses of shape (1,) to zero, because the C++ tape clears only losses without
        dimensions.
        """
        for field in self._sums:
            field.fill(0)

    def _forget(self) -> None:
        """Ends the recording: the tape records no later launches."""
        native.set_tape(None)
        tracked.end()
        state.of_thread.tape = None
        self._is_recording = False

    def _end(self) -> None:
        """Releases the fields to other threads, even if there was no sweep."""
        if self._is_open:
            self._forget()
            self._release()

    def _release(self) -> None:
        """Releases the fields of a tape that no longer records."""
        if self._core is not None:
            self._core.end(False)
        if self._values is not None:
            self._values.end_work()
        if self._looks_at_rounding:
            rounding.end(get_program())
        self._is_open = False

    def _leave(self, kind: Any, error: Any, trace: Any) -> None:
        is_swept = kind is None and self._was_seeded
        if is_swept:
            origins.check_views()
        self._forget()
        self._core.end(is_swept and not self._checks)
        try:
            if kind is None and self._checks:
                raise_violations(self._core)
            if is_swept:
                self._note_sweep()
                with tracked.ValueSweep(self._values, self._outer_seeds()):
                    self._core.backward()
        finally:
            if self._probes is not None:
                self._rounding = self._probes.take()
        self._release()
        if kind is None and not self._losses and self._outer_loss is None and self._core.records:
            self._missing = _Missing([])
            self._missing.is_missing = True
        if is_swept:
            warn(self._core)
            program = get_program()
            program.sweeps += 1
            # Reading a loss takes about a tenth of the time of the smallest tape, so it is checked
            # after the 1st, 2nd, 4th, … tape only.
            if program.sweeps & (program.sweeps - 1) == 0:
                warn_of_losses(self._core, [f for f in self._losses if is_number(f)])
            if self._check:
                self._check.end(self._core, self.loss)

    @staticmethod
    def _get_swept_losses() -> list[Any]:
        """The losses of one number of the last sweep of any tape.

        A tape sets them to zero when its block is entered, so an optimiser refuses them as
        parameters.
        """
        return [loss for ref in Tape._swept_losses if (loss := ref()) is not None]

    def _note_sweep(self) -> None:
        Tape.sweeps, Tape._swept_losses = Tape.sweeps + 1, self._cleared

    def _note_seeds(self) -> None:
        self._was_seeded = True
        self._note_use()

    def _note_use(self) -> None:
        """Ends the warning of a gradient that was never computed: the record is in use."""
        if self._missing is not None:
            self._missing.is_missing = False

    def _note_reading(self) -> None:
        """Ends the warning for a tape without a loss, because its record is used."""
        if not self._losses:
            self._note_use()

    def grad(self, seed: Any = None) -> None:
        """Runs the gradients of the recorded kernels, again or with other seeds.

        Args:
            seed: as for the tape itself. Without it, the seeds of the last sweep are used.
                Gradients are set to zero first, unless the tape was made with
                `clear_gradients=False` or has no loss.

        Raises:
            TaiRuntimeTypeError: a seed of the wrong shape.
            TaiRuntimeError: a field that the gradient reads has been changed since.
        """
        self._need_record()
        if seed is not None:
            if not self._losses:
                raise TaiRuntimeTypeError(
                    "the tape has no loss that a seed could belong to",
                    "tape.backward({field: seed})",
                )
            set_seeds(self._core, self._losses, as_seeds(self._losses, seed))
            self._note_seeds()
        self._sweep(self.clear_gradients and (bool(self._losses) or self._outer_loss is not None))

    def backward(self, *losses: Any) -> None:
        """Runs the gradients of the recorded kernels, from seeds given for any values.

        ```python
        with ti.ad.Tape() as tape:
            energy = step(a)
            drift = deviation(a)
        tape.backward(energy, (drift, 0.5), {x: np.ones(x.shape)})
        ```

        Args:
            losses: numbers, or pairs of a value and its seed, which has the shape of the value:
                numbers, vectors and matrices that kernels returned under the tape, numbers
                computed from these, and arrays with a gradient. Or a dictionary of fields that
                have a gradient and their seeds, arrays of the shapes of the fields. A loss of the
                tape that is not given starts from zero. `backward()` without arguments is `grad()`.

        Raises:
            TaiRuntimeTypeError: a value that is none of these, or a seed that does not fit.
        """
        losses = tuple(loss for loss in losses if loss is not None)
        if not losses and (self._losses or self._outer_loss is not None):
            return self.grad()
        self._need_record()
        if not losses:
            raise TaiRuntimeTypeError(
                "the tape has no loss: say what to differentiate", "tape.backward(L)"
            )
        seeds: dict[Any, Any] = {}
        for loss in losses:
            if isinstance(loss, dict):
                seeds.update(loss)
        values = tracked.parse_losses(tuple(x for x in losses if not isinstance(x, dict)))
        fields = as_losses(list(seeds))
        for field in fields:
            require_grad(field, sys._getframe(1))
        arrays = [as_seed(field, seed) for field, seed in zip(fields, seeds.values(), strict=True)]
        given = {id(field) for field in fields}
        for field in self._losses:
            if id(field) not in given:
                fields.append(field)
                arrays.append(as_seed(field, np.zeros(field.shape + field.element_shape)))
        if self.clear_gradients:
            self._clear()
        known = {id(field) for field in self._losses}
        for field, array in zip(fields, arrays, strict=True):
            if id(field) in known:
                set_seeds(self._core, [field], [array])
            else:
                field.grad.from_numpy(array)
        self._note_seeds()
        self._sweep(False, values)

    def _outer_seeds(self) -> tuple:
        return () if self._outer_loss is None else ((self._outer_loss, 1.0),)

    def _clear(self) -> None:
        self._core.clear_gradients()
        gradients.clear_gradients(all_threads=False)

    def _sweep(self, clear: bool, losses: tuple | None = None) -> None:
        if clear:
            self._clear()
        self._note_sweep()
        losses = self._outer_seeds() if losses is None else losses
        with tracked.ValueSweep(self._values, losses):
            self._core.backward()
        warn(self._core)

    def stats(self) -> TapeStats:
        """The memory that the tape uses, and the amount of recomputation."""
        if self._core is None:
            raise TaiRuntimeError("the tape holds nothing yet", "enter its `with` block first")
        self._note_reading()
        return TapeStats(*self._core.stats())

    @property
    def memory(self) -> int:
        """The most bytes of old values that the tape has kept at any time."""
        return self.stats().peak_bytes

    def replay(self, forward: bool = True, backward: bool = True) -> None:
        """Runs the recorded kernels, and their gradients, on the current contents of the fields.

        One native call, without Python between the kernels. Host writes inside the
        block are repeated. Gradients are cleared before the reverse sweep.
        """
        self._need_record()
        # This check comes before gradients are cleared, so that a refused call changes nothing.
        if state.tape is not None:
            raise TaiRuntimeError(
                "a tape cannot be replayed while another one records",
                "replay it after the `with` block of the other tape",
            )
        if forward:
            self._values.check_replay()
            self._clear_sums()
        if backward:
            gradients.clear_gradients(all_threads=False)
        if self._outer_loss is not None:
            if forward:
                self._outer_loss.fill(0)
            losses: tuple = ((self._outer_loss, 1.0),)
        else:
            losses = ()
        arrays = self._values.arrays
        if forward and (not backward or arrays.restores):
            # The sweep leaves the arrays with the contents that the kernels have left in them.
            arrays.take_versions()
            with Ordered(arrays):
                self._core.replay(True, False)
            arrays.renew_digests()
            forward = False
        if not backward:
            return
        self._note_sweep()
        with tracked.ValueSweep(self._values, losses, forward):
            self._core.replay(forward, True)
        if forward:
            arrays.renew_digests()

    def explain(self) -> str:
        """One line for each record: replayed or skipped, and why.

        Lines on the gradients of the kernels follow: whether additions to other elements are
        gathered, or the condition that failed and its line.
        """
        self._need_record()
        return self._core.explain()

    def health(self) -> HealthReport:
        """Diagnosis of the adjoints of the reverse sweep: NaN, overflow, explosion, vanishing.

        From the last sweep if the tape was made with `health=True`; otherwise the sweep runs
        once more, and the gradients are restored.
        """
        self._need_record()
        with Ordered(self._values.arrays):
            return take_health(self._core, self.loss, self._watches)

    def precision_report(self, error: float = 1e-4) -> PrecisionReport:
        """The effect of rounding on the loss: lines that lose digits, fields that may be narrower.

        ```python
        with ti.ad.Tape(loss, precision=True) as tape:
            simulate()
        print(tape.precision_report(error=1e-4))
        ```

        Args:
            error: the relative error of the loss that proposed types may cause.

        Raises:
            TaiAutodiffError: the tape was made without `precision=True`, or a field that its
                kernels read held NaN or an infinity when it was entered.
        """
        self._need_record()
        if self._rounding is None:
            raise TaiAutodiffError(
                "the kernels of this tape have not looked at their rounding",
                "make it with precision=True: ti.ad.Tape(loss, precision=True)",
            )
        return make_report(self._rounding, self.loss, error, self.solves)

    def condition(self) -> Condition:
        """Condition numbers of the loss and its gradient by relative changes of the inputs.

        The sweep runs once more, and the gradients are restored.

        Raises:
            TaiAutodiffError: the tape has no loss of one number.
        """
        self._need_record()
        if len(self._losses) != 1 or not is_number(self._losses[0]) or self._seed is not None:
            raise TaiAutodiffError("condition() needs a tape with a loss of one number")
        with Ordered(self._values.arrays):
            return take_condition(self._core, self._losses[0], self.replay)

    def _need_record(self) -> None:
        if self._core is None or self._is_recording:
            raise TaiRuntimeError("the tape holds nothing yet", "leave its `with` block first")
        self._note_reading()

    def __repr__(self) -> str:
        if self._core is None:
            return "<ti.ad.Tape: nothing recorded yet>"
        if self._is_recording:
            return f"<ti.ad.Tape: records, {self._core.records} so far>"
        return (
            f"<ti.ad.Tape: {self._core.records} records, {self._core.skipped} skipped in reverse, "
            f"{self.memory:,} bytes of old values>"
        )

    def _repr_html_(self) -> str:
        """Shows the tape in a notebook: its records and its memory."""
        if self._core is None or self._is_recording:
            return f"<code>{html.escape(repr(self))}</code>"
        rows = {"records": self._core.records, "skipped in reverse": self._core.skipped}
        rows |= {name.replace("_", " "): n for name, n in self.stats()._asdict().items() if n >= 0}
        return notebook.table_html("ti.ad.Tape", rows)

    @property
    def num_records(self) -> int:
        self._note_reading()
        return self._core.records

    @property
    def num_skipped(self) -> int:
        self._note_reading()
        return self._core.skipped


def clear_all_gradients() -> None:
    """Sets the gradients of all fields, arrays and variables to zero."""
    get_program().context.clear_gradients()
    gradients.clear_gradients()


def no_grad(function: Callable[..., Any] | None = None) -> Any:
    """Excludes a function or a block from recording: no gradient passes through it.

    ```python
    @ti.ad.no_grad
    def show(): ...

    with ti.ad.no_grad():
        diagnose()
    ```

    A tape that runs its kernels again, by `replay` or to save memory, calls the function again. If
    a `with` block stands among them, it raises an error, because it cannot run the block again.
    """
    if function is None:
        return _NoGradBlock()
    if not callable(function):
        raise TaiRuntimeTypeError(
            f"ti.ad.no_grad takes a function, but got {function!r}", "with ti.ad.no_grad():"
        )

    @functools.wraps(function)
    def decorated(*args: Any, **kwargs: Any) -> Any:
        if state.forward:
            raise TaiAutodiffError(
                f"function '{function.__name__}' is marked by no_grad, which forward mode "
                "does not know yet",
                "call it outside of forward mode",
            )
        tape = state.tape
        if tape is None:
            return function(*args, **kwargs)
        result = run_unrecorded(tape, function, *args, **kwargs)
        tape.record(functools.partial(function, *args, **kwargs), None)
        return result

    decorated._is_unrecorded = True  # type: ignore[attr-defined]
    return decorated


class _NoGradBlock(native.WithBlock):
    """Implements the block `with ti.ad.no_grad():`, and the decorator `@ti.ad.no_grad()`."""

    def __init__(self) -> None:
        self._inner: _Unrecorded | None = None
        self._tape: Any = None

    def __call__(self, function: Callable[..., Any]) -> Any:
        return no_grad(function)

    def _enter(self) -> None:
        if state.forward:
            raise TaiAutodiffError(
                "a block of ti.ad.no_grad stands in forward mode, which does not know it yet",
                "leave forward mode first",
            )
        if self._inner is not None:
            raise TaiRuntimeError("this block of ti.ad.no_grad is entered already")
        if state.tape is not None:
            self._tape, self._inner = state.tape, _Unrecorded(state.tape)
            self._inner._enter()

    def _end(self) -> None:
        inner, tape = self._inner, self._tape
        if inner is not None:
            inner._end()
            self._inner = self._tape = None
            tape.record(_refuse_again, None)


def _refuse_again() -> None:
    raise TaiAutodiffError(
        "a tape cannot run the block of a `with ti.ad.no_grad():` again",
        "move the block to a function that is marked @ti.ad.no_grad",
    )


def grad_replaced(function: Callable[..., Any]) -> Callable[..., Any]:
    """Gives a function a gradient of its own, which `grad_for` defines.

    The function may run many kernels; the tape runs the other function in their place.
    """

    @functools.wraps(function)
    def replaced(*args: Any, **kwargs: Any) -> Any:
        tape = state.tape
        if tape is None:
            return function(*args, **kwargs)
        if decorated.grad is None:
            raise TaiAutodiffError(
                f"function '{function.__name__}' is marked by grad_replaced but has no gradient",
                f"define one: @ti.ad.grad_for({function.__name__})",
            )
        result = run_unrecorded(tape, function, *args, **kwargs)
        gradient = decorated.grad
        forward = functools.partial(function, *args, **kwargs)
        tape.record(forward, lambda: gradient(*args, **kwargs))
        return result

    decorated: Any = replaced
    decorated.grad = None
    return decorated


def run_unrecorded(tape: Any, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Calls a function whose launches become parts of the next record of the tape."""
    with _Unrecorded(tape):
        return function(*args, **kwargs)


class _Unrecorded(native.WithBlock):
    """A block in which no launch is recorded by itself."""

    def __init__(self, tape: Any):
        self._tape, self._is_suspended = tape, False

    def _enter(self) -> None:
        self._is_suspended = True
        self._tape.suspend()
        state.of_thread.tape = None
        native.set_tape(None)

    def _end(self) -> None:
        state.of_thread.tape = self._tape
        native.set_tape(self._tape)
        if self._is_suspended:
            self._is_suspended = False
            self._tape.resume()


def grad_for(primal: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Defines the gradient of a function that is decorated by `grad_replaced`."""
    if not hasattr(primal, "grad") or getattr(primal, "_tai_kernel", False):
        raise TaiAutodiffError(
            f"'{getattr(primal, '__name__', primal)}' takes no gradient of its own",
            "mark it by @ti.ad.grad_replaced",
        )

    def decorator(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def decorated(*args: Any, **kwargs: Any) -> Any:
            return function(*args, **kwargs)

        primal.grad = decorated
        return decorated

    return decorator


# The DiffTaichi paper calls these decorators by the following names.
complex_kernel = grad_replaced
complex_kernel_grad = grad_for
