"""L-BFGS: a quasi-Newton method that remembers the last steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import dtypes
from ..fields.make import make_field
from ..solvers.vectors import get_kernels as get_vectors
from .first_order import check_kind
from .kernels import get_kernels
from .line_search import Trial, search
from .objective import Objective, Result, refuse_start
from .parameters import Flat, check_number, check_outside, check_parameters


class LBFGS:
    """L-BFGS with a line search for the strong Wolfe conditions.

    ```python
    with ti.ad.Tape(loss) as tape:
        simulate()
    result = ti.optim.LBFGS([x]).minimize(tape)
    ```

    A trial whose loss or gradient is not finite is a step too far: it is shortened. The parameters
    always end at finite numbers.

    Args:
        parameters: a field or `ti.ndarray` with a gradient, or a list of them; not sparse.
        history: how many steps it remembers.
    """

    def __init__(self, parameters: Any, history: int = 10):
        self._user = "ti.optim.LBFGS"
        if isinstance(history, bool) or not isinstance(history, int) or history < 1:
            raise TaiRuntimeTypeError(
                f"{self._user}: history must be a whole number from 1 on, but got {history!r}"
            )
        self._parameters = check_parameters(parameters, self._user)
        for p in self._parameters:
            p.require_dense(self._user)
        self.history = history
        self._flat = flat = Flat(self._parameters)
        names = ("point", "gradient", "direction", "next_point", "next_gradient")
        self._x, self._g, self._d, self._next_x, self._next_g = map(flat.vector, names)
        self._steps, self._changes = flat.vector("steps", history), flat.vector("changes", history)
        self._numbers, self._products = (
            make_field((), dtypes.f64, history, None, f"optim_{what}", None, False, False)
            for what in ("numbers", "products")
        )
        self._pairs: list[tuple[int, float]] = []  # Rows, the oldest first, with 1 / (s · y).
        self._scale = 1.0

    @property
    def parameters(self) -> list[Any]:
        """The fields and arrays that the method changes."""
        return [p.value for p in self._parameters]

    def step(self, function: Any) -> Result:
        """Does one iteration: computes a direction, and searches along it.

        Args:
            function: a tape with a loss, or a function that runs one and returns the loss.
        """
        return self.minimize(function, max_iterations=1)

    def minimize(
        self, function: Any, max_iterations: int = 100, gtol: float = 1e-5, ftol: float = 0.0
    ) -> Result:
        """Iterates until a tolerance is reached; the parameters hold the best point then.

        Args:
            function: a tape with a loss, which is replayed, or a function that runs a tape and
                returns the loss.
            max_iterations: the most iterations.
            gtol: stops where no component of the gradient is larger.
            ftol: stops where an iteration lowers the loss by less, relative to the loss.

        Raises:
            TaiAutodiffError: the loss or its gradient is not finite at the start, a tape records,
                or the loss is a parameter.
        """
        check_outside(f"{self._user}.minimize()")
        objective = Objective(function, self._user, self._parameters)
        gtol = check_number(self._user, "gtol", gtol, 0.0)
        ftol = check_number(self._user, "ftol", ftol, 0.0)
        k, v = get_kernels(), get_vectors()
        noise = 1e-14 if self._flat.dtype is dtypes.f64 else 1e-6
        self._flat.gather(self._x, "value")
        loss = objective.evaluate()
        self._flat.gather(self._g, "grad")
        size = v.largest(self._g)
        if not (math.isfinite(loss) and math.isfinite(v.dot(self._g, self._g))):
            found = filter(None, (p.first_not_finite() for p in self._parameters))
            refuse_start(self._user, loss, next(found, ""))
        reason, iterations = "iterations", 0
        while True:
            if size <= gtol:
                reason = "gradient"
            if reason != "iterations" or iterations >= max_iterations:
                break
            slope = self._find_direction()
            if not slope < 0:
                self._forget()
                slope = self._find_direction()
            first = 1.0 if self._pairs else min(1.0, 1.0 / math.sqrt(v.dot(self._g, self._g)))
            start = Trial(0.0, loss, slope)
            last = start
            taken = start
            if slope < 0 and math.isfinite(slope):
                last = taken = start

                def move(step: float) -> Trial:
                    nonlocal last
                    last = self._try(objective, step)
                    return last

                taken = search(move, start, first, noise)
            if taken.step == 0:
                if self._pairs:
                    self._forget()
                    self._flat.scatter(self._x, "value")
                    continue
                reason = "line search"
                self._flat.scatter(self._x, "value")
                if last.step != 0:
                    objective.evaluate()
                break
            if last is not taken:
                self._try(objective, taken.step)
            iterations += 1
            self._remember()
            k.combine(self._x, self._next_x, 1.0, self._next_x, 0.0)
            k.combine(self._g, self._next_g, 1.0, self._next_g, 0.0)
            if loss - taken.loss < ftol * abs(loss):
                reason = "loss"
            loss, size = taken.loss, v.largest(self._g)
        return Result(loss, size, iterations, objective.evaluations, reason)

    def _find_direction(self) -> float:
        """Computes the search direction -H g by the two-loop recursion over the stored pairs, and
        its product with the gradient.
        """
        k, v = get_kernels(), get_vectors()
        k.combine(self._d, self._g, -1.0, self._g, 0.0)
        for row, rho in reversed(self._pairs):
            k.project(self._numbers, self._steps, row, self._d, rho)
            k.subtract_row(self._d, self._changes, row, self._numbers)
        if self._pairs:
            k.combine(self._d, self._d, self._scale, self._d, 0.0)
        for row, rho in self._pairs:
            k.project(self._products, self._changes, row, self._d, rho)
            k.correct(self._d, self._steps, row, self._numbers, self._products)
        return v.dot(self._d, self._g)

    def _try(self, objective: Objective, step: float) -> Trial:
        """Moves the parameters to a point along the direction, and evaluates the loss there."""
        k, v = get_kernels(), get_vectors()
        k.combine(self._next_x, self._x, 1.0, self._d, step)
        self._flat.scatter(self._next_x, "value")
        loss = objective.evaluate()
        self._flat.gather(self._next_g, "grad")
        slope = v.dot(self._next_g, self._d)
        if not math.isfinite(v.dot(self._next_g, self._next_g)) or not math.isfinite(
            v.largest(self._next_x)
        ):
            slope = math.nan
        return Trial(step, loss, slope)

    def _remember(self) -> None:
        """Stores the step and the change of the gradient as a pair, if the loss has positive
        curvature along the step.
        """
        k = get_kernels()
        used = {row for row, _ in self._pairs}
        row = next((r for r in range(self.history) if r not in used), None)
        if row is None:
            row = self._pairs.pop(0)[0]
        k.set_row(self._steps, row, self._next_x, self._x)
        k.set_row(self._changes, row, self._next_g, self._g)
        curvature = k.row_product(self._steps, row, self._changes)
        square = k.row_product(self._changes, row, self._changes)
        if curvature > 1e-10 * square and math.isfinite(square) and 0 < curvature < math.inf:
            rho, scale = 1 / curvature, curvature / square
            if math.isfinite(rho) and math.isfinite(scale):
                self._pairs.append((row, rho))
                self._scale = scale

    def _forget(self) -> None:
        self._pairs = []

    # State

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TaiRuntimeTypeError(
            f"{self._user} cannot be copied or pickled: its memory belongs to the program",
            "pickle its state_dict(), and load_state_dict(…) into a new one",
        )

    def state_dict(self) -> dict[str, Any]:
        """The state of the optimiser, which is the stored steps: numbers and NumPy arrays, which
        can be pickled.
        """
        rows = [row for row, _ in self._pairs]
        return {
            "kind": "LBFGS", "size": self._flat.size, "scale": self._scale,
            "products": [rho for _, rho in self._pairs],
            "steps": self._steps.to_numpy()[rows], "changes": self._changes.to_numpy()[rows],
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from the state of another optimiser with parameters of the same size.

        Raises:
            TaiRuntimeTypeError: the state is that of another kind, or of another size.
        """
        check_kind(self, state)
        if state["size"] != self._flat.size:
            raise TaiRuntimeTypeError(
                f"{self._user}: the state belongs to {state['size']} numbers, but the parameters "
                f"have {self._flat.size}"
            )
        products = state["products"][-self.history :]
        count = len(products)
        for field, name in ((self._steps, "steps"), (self._changes, "changes")):
            rows = np.zeros((self.history, self._flat.size), self._flat.dtype.numpy)
            rows[:count] = state[name][len(state[name]) - count :]
            field.from_numpy(rows)
        self._pairs, self._scale = list(enumerate(products)), state["scale"]
