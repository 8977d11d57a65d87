"""Kernels of the optimisers.

Steps look at all gradients first: if one is NaN or infinite, nothing changes. The decision is
a number on the device, so no step waits for the host.
"""

# Annotations are evaluated in this file, because they are arguments of `make_steps`.

import functools
from typing import Any

from ..base.dtypes import cast, f64, i32
from ..launch.kernels import func, kernel
from ..values.ops import abs, grouped, max, sqrt, static
from ..values.types import ndarray, template

# The positions in the array of counts of an optimiser.
FOUND, SEEN, IS_BAD, STEPS, SKIPPED, KEPT = range(6)
COUNTS = 6


@functools.cache
def get_kernels() -> Any:
    @func
    def is_finite(value, largest):
        # Comparisons with NaN are false, so NaN counts as not finite, also under fast_math.
        result = True
        if static(hasattr(value, "n")):
            for c in static(range(value.n)):
                for d in static(range(value.m)):
                    if static(value.m == 1):
                        result = result and cast(abs(value[c]), f64) <= largest
                    else:
                        result = result and cast(abs(value[c, d]), f64) <= largest
        else:
            result = cast(abs(value), f64) <= largest
        return result

    @func
    def adam(x, g, m, s, at, counts, factors, dtype, beta1, beta2, rate, epsilon, largest):
        # `s` keeps the root of the second moment, since the second moment could overflow or vanish.
        second = cast(factors[1], dtype)
        gradient = g[at]
        # 1 - beta is computed in f64, because in f32 it would lose digits for a beta near 1.
        mean = m[at] * cast(beta1, dtype) + gradient * cast(1 - beta1, dtype)
        scale = max(max(abs(gradient), s[at]), cast(1e-30, dtype))
        a = s[at] / scale
        b = gradient / scale
        root = sqrt(a * a * cast(beta2, dtype) + b * b * cast(1 - beta2, dtype)) * scale
        step = mean / (root / second + cast(epsilon, dtype)) * cast(rate / factors[0], dtype)
        value = cast(cast(x[at], dtype) - step, x.dtype)
        if is_finite(value, largest) and is_finite(root, largest):
            x[at] = value
            m[at] = mean
            s[at] = root
        else:
            counts[KEPT] += 1

    @func
    def sgd(
        x, g, m, at, counts, dtype, momentum, rate, nesterov: template(), has_memory: template(),
        largest,
    ):  # fmt: skip
        gradient = g[at]
        direction = gradient
        if static(has_memory):
            mean = m[at] * momentum + gradient
            direction = mean
            if static(nesterov):
                direction = gradient + mean * momentum
            value = cast(cast(x[at], dtype) - direction * rate, x.dtype)
            if is_finite(value, largest) and is_finite(mean, largest):
                x[at] = value
                m[at] = mean
            else:
                counts[KEPT] += 1
        else:
            value = cast(cast(x[at], dtype) - direction * rate, x.dtype)
            if is_finite(value, largest):
                x[at] = value
            else:
                counts[KEPT] += 1

    @func
    def index_of(x, at, offset):
        result = 0
        for d in static(range(len(offset))):
            result = result * x.shape[d] + (at[d] - offset[d])
        return result

    def make_steps(data):
        """Makes kernels on parameters: on fields for `template`, on arrays for `ndarray`."""

        class Steps:
            @staticmethod
            @kernel
            def count(g: data(), counts: template(), largest: f64):
                for at in grouped(g):
                    if not is_finite(g[at], largest):
                        counts[FOUND] += 1

            @staticmethod
            @kernel
            def adam(
                x: data(), g: data(), m: data(), s: data(), counts: template(),
                factors: template(), beta1: f64, beta2: f64, rate: f64, epsilon: f64,
                largest: f64,
            ):  # fmt: skip
                for at in grouped(x):
                    if counts[IS_BAD] == 0:
                        adam(
                            x, g, m, s, at, counts, factors, m.dtype, beta1, beta2, rate, epsilon,
                            largest,
                        )  # fmt: skip

            @staticmethod
            @kernel
            def sgd(
                x: data(), g: data(), m: data(), counts: template(), momentum: f64,
                rate: f64, nesterov: template(), has_memory: template(), largest: f64,
            ):  # fmt: skip
                for at in grouped(x):
                    if counts[IS_BAD] == 0:
                        sgd(
                            x, g, m, at, counts, g.dtype, cast(momentum, g.dtype),
                            cast(rate, g.dtype), nesterov, has_memory, largest,
                        )  # fmt: skip

        return Steps

    class Kernels:
        of_fields, of_arrays = make_steps(template), make_steps(ndarray)

        @staticmethod
        @kernel
        def advance(counts: template(), factors: template(), beta1: f64, beta2: f64):
            # Computes the bias corrections of the step that follows.
            if counts[FOUND] != counts[SEEN]:
                counts[SEEN] = counts[FOUND]
                counts[IS_BAD] = 1
                counts[SKIPPED] += 1
            else:
                counts[IS_BAD] = 0
                counts[STEPS] += 1
                factors[0] = 1 - beta1 ** cast(counts[STEPS], f64)
                factors[1] = sqrt(1 - beta2 ** cast(counts[STEPS], f64))

        # One vector of all parameters

        @staticmethod
        @kernel
        def gather(
            flat: template(), start: i32, x: template(), offset: template(), inner: template()
        ):
            for at in grouped(x):
                if static(len(inner) > 0):
                    first = start + index_of(x, at, offset) * (x.n * x.m)
                    for c in static(range(x.n)):
                        for d in static(range(x.m)):
                            if static(len(inner) == 1):
                                flat[first + c] = cast(x[at][c], flat.dtype)
                            else:
                                flat[first + c * x.m + d] = cast(x[at][c, d], flat.dtype)
                else:
                    flat[start + index_of(x, at, offset)] = cast(x[at], flat.dtype)

        @staticmethod
        @kernel
        def scatter(
            flat: template(), start: i32, x: template(), offset: template(), inner: template()
        ):
            for at in grouped(x):
                if static(len(inner) > 0):
                    first = start + index_of(x, at, offset) * (x.n * x.m)
                    for c in static(range(x.n)):
                        for d in static(range(x.m)):
                            if static(len(inner) == 1):
                                x[at][c] = cast(flat[first + c], x.dtype)
                            else:
                                x[at][c, d] = cast(flat[first + c * x.m + d], x.dtype)
                else:
                    x[at] = cast(flat[start + index_of(x, at, offset)], x.dtype)

        @staticmethod
        @kernel
        def gather_array(flat: template(), start: i32, x: ndarray()):
            for i in range(x.shape[0]):
                flat[start + i] = cast(x[i], flat.dtype)

        @staticmethod
        @kernel
        def scatter_array(flat: template(), start: i32, x: ndarray()):
            for i in range(x.shape[0]):
                x[i] = cast(flat[start + i], x.dtype)

        @staticmethod
        @kernel
        def combine(target: template(), a: template(), alpha: f64, b: template(), beta: f64):
            # target = alpha a + beta b
            for i in target:
                target[i] = cast(cast(a[i], f64) * alpha + cast(b[i], f64) * beta, target.dtype)

        # Kernels for the pairs of vectors of L-BFGS. The numbers that they compute stay on the
        # device.

        @staticmethod
        @kernel
        def set_row(rows: template(), row: i32, a: template(), b: template()):
            for i in a:
                rows[row, i] = a[i] - b[i]

        @staticmethod
        @kernel
        def row_product(rows: template(), row: i32, others: template()) -> f64:
            total = cast(0.0, f64)
            for i in range(rows.shape[1]):
                total += cast(rows[row, i], f64) * cast(others[row, i], f64)
            return total

        @staticmethod
        @kernel
        def project(numbers: template(), rows: template(), row: i32, q: template(), rho: f64):
            # numbers[row] = rho rows[row] · q
            numbers[row] = 0.0
            for i in q:
                numbers[row] += cast(rows[row, i], f64) * cast(q[i], f64) * rho

        @staticmethod
        @kernel
        def subtract_row(q: template(), rows: template(), row: i32, numbers: template()):
            for i in q:
                q[i] = cast(q[i] - rows[row, i] * numbers[row], q.dtype)

        @staticmethod
        @kernel
        def correct(
            q: template(), rows: template(), row: i32, numbers: template(), products: template()
        ):
            for i in q:
                q[i] = cast(q[i] + rows[row, i] * (numbers[row] - products[row]), q.dtype)

    return Kernels
