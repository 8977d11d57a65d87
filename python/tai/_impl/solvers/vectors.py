"""Kernels of the solvers: fields of numbers, vectors or matrices as vectors.

Sums are accumulated in f64, whatever the types of the fields.
"""

from __future__ import annotations

import functools
from typing import Any

from ..base.dtypes import cast, f64
from ..launch.kernels import func, kernel
from ..values.ops import abs, atomic_max, grouped, static
from ..values.types import template


@functools.cache
def get_kernels() -> Any:
    @func
    def product(a, b):
        result = cast(0.0, f64)
        if static(hasattr(a, "n")):
            for c in static(range(a.n)):
                for d in static(range(a.m)):
                    if static(a.m == 1):
                        result += cast(a[c], f64) * cast(b[c], f64)
                    else:
                        result += cast(a[c, d], f64) * cast(b[c, d], f64)
        else:
            result = cast(a, f64) * cast(b, f64)
        return result

    @func
    def greatest(a):
        result = cast(0.0, f64)
        if static(hasattr(a, "n")):
            result = cast(abs(a).max(), f64)
        else:
            result = cast(abs(a), f64)
        return result

    class Kernels:
        @staticmethod
        @kernel
        def dot(a: template(), b: template()) -> f64:
            total = cast(0.0, f64)
            for at in grouped(a):
                total += product(a[at], b[at])
            return total

        @staticmethod
        @kernel
        def largest(a: template()) -> f64:
            found = cast(0.0, f64)
            for at in grouped(a):
                atomic_max(found, greatest(a[at]))
            return found

        @staticmethod
        @kernel
        def scale(target: template(), source: template(), factor: f64):
            for at in grouped(target):
                target[at] = cast(source[at] * factor, target.dtype)

        @staticmethod
        @kernel
        def copy(target: template(), source: template()):
            for at in grouped(target):
                target[at] = source[at]

        @staticmethod
        @kernel
        def add(target: template(), source: template(), factor: f64):
            for at in grouped(target):
                target[at] = cast(target[at] + source[at] * factor, target.dtype)

        @staticmethod
        @kernel
        def subtract(r: template(), b: template(), q: template(), factor: f64) -> f64:
            # r = factor b - q; the square of its norm.
            total = cast(0.0, f64)
            for at in grouped(r):
                value = cast(b[at] * factor - q[at], r.dtype)
                r[at] = value
                total += product(value, value)
            return total

        @staticmethod
        @kernel
        def advance(
            x: template(), p: template(), alpha: f64, r: template(), q: template(), beta: f64
        ) -> f64:
            # x += alpha p; r -= beta q; the square of the norm of r.
            total = cast(0.0, f64)
            for at in grouped(r):
                x[at] = cast(x[at] + p[at] * alpha, x.dtype)
                value = cast(r[at] - q[at] * beta, r.dtype)
                r[at] = value
                total += product(value, value)
            return total

        @staticmethod
        @kernel
        def turn(p: template(), r: template(), beta: f64, q: template(), omega: f64):
            # p = r + beta (p - omega q)
            for at in grouped(p):
                p[at] = cast(r[at] + (p[at] - q[at] * omega) * beta, p.dtype)

        @staticmethod
        @kernel
        def sweep(x: template(), r: template(), diagonal: template(), omega: f64):
            # x += omega r / diagonal
            for at in grouped(x):
                x[at] = cast(x[at] + r[at] / diagonal[at] * omega, x.dtype)

    return Kernels
