"""GMRES: the least residual of the Krylov space, for any A, begun again after some steps."""

from __future__ import annotations

import math
from typing import Any

from .operators import scratch
from .system import Method, Progress, System

# If a cycle of GMRES reduces the residual by less than this share, the solver stops.
_LEAST_GAIN = 1e-3


def generalized_minimal_residuals(restart: int) -> Method:
    """GMRES(restart), with the preconditioner on the right: the residual is that of A x = b."""

    def run(system: System, residual: float, limit: int) -> Progress:
        x = system.x
        elements = math.prod(x.shape) * math.prod(x.element_shape)
        size = max(1, min(restart, system.limit, elements))
        basis = scratch(x, "basis", rows=size + 1)
        done = 0
        while done < limit:
            last = residual
            steps, reason = _cycle(system, residual, min(size, limit - done), basis)
            done += steps
            residual = system.compute_residual()
            if residual <= system.tolerance:
                return Progress(done, residual, "")
            if reason:
                return Progress(done, residual, reason)
            if not residual < (1 - _LEAST_GAIN) * last:
                return Progress(done, residual, "stagnates")
        return Progress(done, residual, "")

    return Method(run, monotone=True)


def _cycle(system: System, residual: float, size: int, basis: Any) -> tuple[int, str]:
    """Runs a cycle of GMRES: improves x by the best point of a Krylov space of up to `size`
    dimensions.

    The residual is in `system.r`. Returns the number of products, and why it cannot go on.
    """
    k, x, q, v = system.kernels, system.x, system.q, system.p
    epsilon = 2.0**-52 if x.dtype.name == "f64" else 2.0**-23
    step = v if system.precondition is None else scratch(x, "preconditioned")
    norm = residual * system.norm
    goal = system.tolerance * system.norm
    k.set_row(basis, 0, system.r, 1 / norm)
    # The data of the least-squares problem: the triangular factor by columns, the rotations, and
    # the right-hand side.
    columns: list[list[float]] = []
    rotations: list[tuple[float, float]] = []
    right = [norm]
    reason = ""
    for j in range(size):
        k.take_row(v, basis, j)
        if system.precondition is not None:
            system.precondition(v, step)
        system.apply(step, q)
        before = math.sqrt(k.dot(q, q))
        if not math.isfinite(before):
            reason = "diverges"
            break
        if system.precondition is None:
            system.note_norm(before)
        column = [0.0] * (j + 2)
        after = before
        # The vector is orthogonalised twice where much cancels, so that the basis stays orthogonal.
        for _ in range(2):
            start = after
            for i in range(j + 1):
                part = k.dot_row(basis, i, q)
                k.add_row(q, basis, i, -part)
                column[i] += part
            after = math.sqrt(k.dot(q, q))
            if after > 0.5 * start:
                break
        ended = after <= 10 * epsilon * before
        column[j + 1] = 0.0 if ended else after
        for i, (cosine, sine) in enumerate(rotations):
            a, b = column[i], column[i + 1]
            column[i], column[i + 1] = cosine * a + sine * b, cosine * b - sine * a
        length = math.hypot(column[j], column[j + 1])
        if length <= 10 * epsilon * before:
            # The operator maps the space into a smaller one, so the method cannot go on.
            reason = "breakdown"
            break
        cosine, sine = column[j] / length, column[j + 1] / length
        rotations.append((cosine, sine))
        column[j] = length
        columns.append(column)
        right.append(-sine * right[j])
        right[j] *= cosine
        if ended or abs(right[j + 1]) <= goal:
            break
        k.set_row(basis, j + 1, q, 1 / after)
    count = len(columns)
    weights = right[:count]
    for i in reversed(range(count)):
        weights[i] -= sum(columns[j][i] * weights[j] for j in range(i + 1, count))
        weights[i] /= columns[i][i]
    if count:
        q.fill(0)
        for i, weight in enumerate(weights):
            k.add_row(q, basis, i, weight)
        if system.precondition is not None:
            system.precondition(q, step)
            k.add(x, step, 1.0)
        else:
            k.add(x, q, 1.0)
    return max(count, 1), reason
