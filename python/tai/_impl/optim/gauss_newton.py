"""Gauss-Newton for sums of squares, damped as Levenberg and Marquardt do."""

from __future__ import annotations

import math
from typing import Any

from ...errors import TaiAutodiffError, TaiRuntimeTypeError
from ..ad.mode import ForwardMode, check_dual, clear_duals, one_thread
from ..ad.tape import Tape, clear_all_gradients
from ..fields.field import Field
from ..solvers.vectors import get_kernels as get_vectors
from .first_order import check_kind
from .kernels import get_kernels
from .objective import Result, refuse_start
from .parameters import Flat, check_number, check_outside, check_parameters, shares_memory


class GaussNewton:
    """Minimises half the sum of squares of residuals, by the Gauss-Newton method.

    ```python
    x = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=True)
    r = ti.field(ti.f64, shape=50, needs_grad=True, needs_dual=True)
    result = ti.optim.GaussNewton([x], r).minimize(compute_residuals)
    ```

    Each iteration solves (JᵀJ + λ) p = -Jᵀr by conjugate gradients. The Jacobian matrix J is not
    formed: one of its products is a replay in forward mode, the other one a reverse sweep. λ grows
    after steps that do not lower the sum, so also after those that lead to NaN.

    Args:
        parameters: a field, or a list of fields, with gradients and duals; not sparse.
        residuals: a field, or a list of fields, with gradients and duals.
        damping: λ at the beginning, relative to the curvature along the gradient.
        inner_iterations: the most iterations of the linear solver; twice the number of unknowns,
            at most 200, without it.
        inner_tolerance: of the linear solver, relative.
    """

    def __init__(
        self, parameters: Any, residuals: Any, damping: float = 1e-3,
        inner_iterations: int | None = None, inner_tolerance: float = 1e-6,
    ):  # fmt: skip
        user = self._user = "ti.optim.GaussNewton"
        self._parameters = check_parameters(parameters, user)
        self._residuals = check_parameters(residuals, user)
        for p in (*self._parameters, *self._residuals):
            if not isinstance(p.value, Field):
                raise TaiRuntimeTypeError(
                    f"{user} works on fields: arrays have no tangents", "copy the array to a field"
                )
            check_dual(p.value, user + ":")
            p.require_dense(user)
        for p in self._parameters:
            if any(shares_memory(p.value, r.value) for r in self._residuals):
                raise TaiAutodiffError(
                    f"{user}: {p.name} is a parameter and also a residual, and residuals are set "
                    "to zero before the function runs",
                    "copy the parameter to a field of residuals in a kernel: r[i] = x[i]",
                )
        self.damping = check_number(user, "damping", damping, 0.0)
        self._flat, self._image = Flat(self._parameters), Flat(self._residuals)
        names = ("point", "gradient", "step", "direction", "pulled", "next_point")
        self._x, self._g, self._p, self._d, self._s, self._next = map(self._flat.vector, names)
        self._r, self._left, self._q = map(self._image.vector, ("residual", "left", "product"))
        limit = min(2 * self._flat.size, 200) if inner_iterations is None else inner_iterations
        self._limit = int(check_number(user, "inner_iterations", limit, 1))
        self._tolerance = check_number(user, "inner_tolerance", inner_tolerance, 0.0, 1.0)
        self._lambda: float | None = None
        self._growth = 2.0
        self._evaluations = 0

    @property
    def parameters(self) -> list[Any]:
        """The fields that the method changes."""
        return [p.value for p in self._parameters]

    def step(self, function: Any) -> Result:
        """One iteration; see `minimize`."""
        return self.minimize(function, max_iterations=1)

    def minimize(
        self, function: Any, max_iterations: int = 50, gtol: float = 1e-8, ftol: float = 1e-12
    ) -> Result:
        """Iterates until a tolerance is reached; the parameters hold the best point then.

        Args:
            function: launches the kernels that compute the residuals; or a `ti.ad.Tape` without
                a loss that has recorded them. Residuals are zero before it runs.
            max_iterations: the most iterations, with those whose step is refused.
            gtol: stops where no component of the gradient Jᵀr is larger.
            ftol: stops where an iteration lowers the sum of squares by less, relative to it.

        Returns:
            The loss in it is half the sum of squares.

        Raises:
            TaiAutodiffError: the residuals or the gradient are not finite at the start, something
                has no tangent rule, or a tape records.
        """
        user = self._user
        if isinstance(function, Tape):
            function._note_use()
        check_outside(f"{user}.minimize()")
        gtol = check_number(user, "gtol", gtol, 0.0)
        ftol = check_number(user, "ftol", ftol, 0.0)
        self._evaluations = 0
        tape = self._record(function)
        k, v = get_kernels(), get_vectors()
        self._flat.gather(self._x, "value")
        loss = self._take_residuals()
        self._pull(tape, self._r, self._g)
        size = v.largest(self._g)
        if not (math.isfinite(loss) and math.isfinite(v.dot(self._g, self._g))):
            refuse_start(user, loss, "" if math.isfinite(size) else "the gradient is not finite")
        if self._lambda is None and size > 0:
            self._push(tape, self._g, self._q)
            square = v.dot(self._g, self._g)
            self._lambda = self.damping * v.dot(self._q, self._q) / square if square else 0.0
            if not math.isfinite(self._lambda):
                self._lambda = self.damping
        reason, iterations = "iterations", 0
        while True:
            if size <= gtol:
                reason = "gradient"
            if reason != "iterations" or iterations >= max_iterations:
                break
            iterations += 1
            assert self._lambda is not None
            self._solve(tape, self._lambda)
            k.combine(self._next, self._x, 1.0, self._p, 1.0)
            self._flat.scatter(self._next, "value")
            self._run(tape)
            after = self._take_residuals()
            square, along = v.dot(self._p, self._p), v.dot(self._p, self._g)
            expected = 0.5 * (self._lambda * square - along)
            gain = (loss - after) / expected if expected > 0 and math.isfinite(expected) else -1.0
            if math.isfinite(after) and after <= loss and gain > 1e-4:
                if loss - after <= ftol * loss:
                    reason = "loss"
                k.combine(self._x, self._next, 1.0, self._next, 0.0)
                self._pull(tape, self._r, self._g)
                size, loss = v.largest(self._g), after
                if not math.isfinite(size):
                    refuse_start(user, loss, "the gradient is not finite")
                self._lambda *= max(1 / 3, 1 - (2 * min(gain, 1e3) - 1) ** 3)
                self._growth = 2.0
                continue
            self._flat.scatter(self._x, "value")
            self._run(tape)
            self._take_residuals()
            if expected <= 1e-15 * loss:
                reason = "loss"
            self._lambda = max(self._lambda, 1e-12 * self.damping, 1e-300) * self._growth
            self._growth *= 2
            if not math.isfinite(self._lambda) or self._growth > 1e30:
                self._lambda, self._growth, reason = None, 2.0, "damping"
        return Result(loss, size, iterations, self._evaluations, reason)

    def _record(self, function: Any) -> Tape:
        if isinstance(function, Tape):
            if function.loss is not None or function._outer_loss is not None:
                raise TaiRuntimeTypeError(
                    f"{self._user} seeds the residuals itself, but got a tape with a loss",
                    "give the function, or record it without a loss: with ti.ad.Tape() as tape: …",
                )
            self._run(function)
            return function
        if not callable(function):
            raise TaiRuntimeTypeError(
                f"{self._user} takes a function that computes the residuals, or a tape, but got "
                f"{function!r}"
            )
        self._clear()
        self._evaluations += 1
        with Tape() as tape:
            function()
        tape._note_use()
        return tape

    def _clear(self) -> None:
        for p in self._residuals:
            p.value.fill(0)

    def _run(self, tape: Tape) -> None:
        self._evaluations += 1
        self._clear()
        tape.replay(backward=False)

    def _take_residuals(self) -> float:
        self._image.gather(self._r, "value")
        return 0.5 * float(get_vectors().dot(self._r, self._r))

    def _pull(self, tape: Tape, source: Any, target: Any) -> None:
        """target = Jᵀ source."""
        clear_all_gradients()
        self._image.scatter(source, "grad")
        tape.grad()
        self._flat.gather(target, "grad")

    def _push(self, tape: Tape, source: Any, target: Any) -> None:
        """target = J source."""
        with one_thread:
            clear_duals()
            self._clear()
            self._flat.scatter(source, "dual")
            with ForwardMode():
                tape.replay(forward=True, backward=False)
            self._image.gather(target, "dual")

    def _solve(self, tape: Tape, damping: float) -> None:
        """Computes the step p, by conjugate gradients for least squares."""
        k, v = get_kernels(), get_vectors()
        k.combine(self._p, self._g, 0.0, self._g, 0.0)
        k.combine(self._left, self._r, -1.0, self._r, 0.0)
        k.combine(self._d, self._g, -1.0, self._g, 0.0)
        square = first = v.dot(self._g, self._g)
        for _ in range(self._limit):
            self._push(tape, self._d, self._q)
            curvature = v.dot(self._q, self._q) + damping * v.dot(self._d, self._d)
            if not (curvature > 0 and math.isfinite(curvature)):
                break
            alpha = square / curvature
            k.combine(self._p, self._p, 1.0, self._d, alpha)
            k.combine(self._left, self._left, 1.0, self._q, -alpha)
            self._pull(tape, self._left, self._s)
            k.combine(self._s, self._s, 1.0, self._p, -damping)
            last, square = square, v.dot(self._s, self._s)
            if not math.isfinite(square) or square <= self._tolerance**2 * first:
                break
            k.combine(self._d, self._s, 1.0, self._d, square / last)

    # State

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TaiRuntimeTypeError(
            f"{self._user} cannot be copied or pickled: its memory belongs to the program",
            "pickle its state_dict(), and load_state_dict(…) into a new one",
        )

    def state_dict(self) -> dict[str, Any]:
        """Returns the damping of the method as numbers, which can be pickled."""
        return {"kind": "GaussNewton", "lambda": self._lambda, "growth": self._growth}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from a state that another minimisation has returned."""
        check_kind(self, state)
        self._lambda, self._growth = state["lambda"], state["growth"]
