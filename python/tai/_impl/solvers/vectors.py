"""Kernels of the solvers: fields of numbers, vectors or matrices as vectors.

Sums are accumulated in f64, whatever the types of the fields.
"""

from __future__ import annotations

import functools
from typing import Any

from ..base.dtypes import cast, f64, i32
from ..launch.kernels import func, kernel
from ..values.matrix import Vector
from ..values.ops import abs, atomic_max, grouped, select, sin, static, zero
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

    @func
    def in_row(row, at):
        return Vector([row, *[at[d] for d in static(range(at.n))]])

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
            # Computes r = factor b - q and the square of the norm of r.
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
            # Computes p = r + beta (p - omega q).
            for at in grouped(p):
                p[at] = cast(r[at] + (p[at] - q[at] * omega) * beta, p.dtype)

        @staticmethod
        @kernel
        def orthogonalize(q: template(), older: template(), factor: f64, v: template()) -> f64:
            # Computes q -= factor older, and the product of q with v.
            total = cast(0.0, f64)
            for at in grouped(q):
                value = cast(q[at] - older[at] * factor, q.dtype)
                q[at] = value
                total += product(v[at], value)
            return total

        @staticmethod
        @kernel
        def shift(q: template(), newer: template(), factor: f64, older: template()) -> f64:
            # older = newer; newer = q - factor newer; the square of its norm.
            total = cast(0.0, f64)
            for at in grouped(q):
                last = newer[at]
                value = cast(q[at] - last * factor, q.dtype)
                older[at] = last
                newer[at] = value
                total += product(value, value)
            return total

        @staticmethod
        @kernel
        def step_minres(
            x: template(), v: template(), last: template(), w: template(), epsilon: f64,
            delta: f64, inverse: f64, phi: f64,
        ):  # fmt: skip
            # last, w = w, (v - epsilon last - delta w) inverse; x += phi w
            for at in grouped(x):
                new = cast((v[at] - last[at] * epsilon - w[at] * delta) * inverse, w.dtype)
                last[at] = w[at]
                w[at] = new
                x[at] = cast(x[at] + new * phi, x.dtype)

        @staticmethod
        @kernel
        def dot_row(rows: template(), row: i32, q: template()) -> f64:
            total = cast(0.0, f64)
            for at in grouped(q):
                total += product(rows[in_row(row, at)], q[at])
            return total

        @staticmethod
        @kernel
        def add_row(q: template(), rows: template(), row: i32, factor: f64):
            for at in grouped(q):
                q[at] = cast(q[at] + rows[in_row(row, at)] * factor, q.dtype)

        @staticmethod
        @kernel
        def set_row(rows: template(), row: i32, q: template(), factor: f64):
            for at in grouped(q):
                rows[in_row(row, at)] = cast(q[at] * factor, q.dtype)

        @staticmethod
        @kernel
        def take_row(q: template(), rows: template(), row: i32):
            for at in grouped(q):
                q[at] = rows[in_row(row, at)]

        @staticmethod
        @kernel
        def make_noise(u: template()):
            # Fills u with numbers of [-1, 1] that depend on the position alone.
            for at in grouped(u):
                phase = cast(0.5, f64)
                for d in static(range(at.n)):
                    phase = sin(12.9898 * phase + 78.233 * (at[d] + 1)) * 43758.5453
                u[at] = zero(u[at])
                if static(hasattr(u[at], "n")):
                    for c in static(range(u[at].n)):
                        for e in static(range(u[at].m)):
                            value = cast(sin(phase + 3.7 * c + 1.3 * e), u.dtype)
                            if static(u[at].m == 1):
                                u[at][c] = value
                            else:
                                u[at][c, e] = value
                else:
                    u[at] = cast(sin(phase), u.dtype)

        @staticmethod
        @kernel
        def divide(z: template(), r: template(), diagonal: template()):
            # Where the diagonal is zero, the element is taken as it is.
            for at in grouped(z):
                z[at] = select(diagonal[at] == 0, r[at], r[at] / diagonal[at])

        @staticmethod
        @kernel
        def multiply(z: template(), blocks: template(), r: template(), transposed: template()):
            for at in grouped(z):
                if static(transposed):
                    z[at] = blocks[at].transpose() @ r[at]
                else:
                    z[at] = blocks[at] @ r[at]

        @staticmethod
        @kernel
        def sweep(x: template(), r: template(), diagonal: template(), omega: f64):
            # Computes x += omega r / diagonal.
            for at in grouped(x):
                x[at] = cast(x[at] + r[at] / diagonal[at] * omega, x.dtype)

    return Kernels
