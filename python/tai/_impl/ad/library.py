"""Kernels of tai itself: differentiable copies, and sums of returned numbers.

They are defined on first use. The lower layers, which must not import kernels, reach them
through variables that are set here.
"""

from __future__ import annotations

import functools
from typing import Any

from ..base.dtypes import cast, f64, i32
from ..fields import copies
from ..launch.kernels import kernel
from ..tracking import tangents
from ..values.matrix import Vector
from ..values.ops import floor, grouped, ndrange, static
from ..values.types import ndarray, template


@functools.cache
def _copy_kernels() -> Any:
    class Kernels:
        @staticmethod
        @kernel
        def copy_number(target: template(), source: template(), dtype: template()):
            target[None] = cast(source[None], dtype)

        @staticmethod
        @kernel
        def copy_elements(
            target: template(), source: template(), dtype: template(),
            shift: template(), is_shifted: template(),
        ):  # fmt: skip
            for at in grouped(target):
                if static(is_shifted):
                    target[at] = cast(source[at + Vector(shift)], dtype)
                else:
                    target[at] = cast(source[at], dtype)

        @staticmethod
        @kernel
        def activate_by(
            target: template(), source: template(), dtype: template(),
            is_number: template(), shift: template(), is_shifted: template(),
        ):  # fmt: skip
            for at in grouped(source):
                value = cast(source[at], dtype)
                found = False
                if static(is_number):
                    found = value != 0
                else:
                    found = (value != 0).any()
                if found:
                    if static(is_shifted):
                        target[at + Vector(shift)] = value
                    else:
                        target[at] = value

        @staticmethod
        @kernel
        def fill_number(target: template(), value: f64):
            target[None] = cast(value, f64)

        @staticmethod
        @kernel
        def fill_elements(target: template(), value: f64):
            for at in grouped(target):
                target[at] = value

        @staticmethod
        @kernel
        def array_to_field(target: template(), source: ndarray(), offset: template()):
            for at in grouped(target):
                target[at] = source[at - Vector(offset)]

        @staticmethod
        @kernel
        def array_number(target: ndarray(), source: ndarray()):
            target[None] = cast(source[None], target.dtype)

        @staticmethod
        @kernel
        def array_elements(target: ndarray(), source: ndarray()):
            for at in grouped(ndrange(*target.shape)):
                target[at] = cast(source[at], target.dtype)

        @staticmethod
        @kernel
        def number_to_array(target: ndarray(), source: template()):
            target[None] = cast(source[None], target.dtype)

        @staticmethod
        @kernel
        def field_to_array(
            target: ndarray(), source: template(), shift: template(),
            is_shifted: template(),
        ):  # fmt: skip
            for at in grouped(ndrange(*target.shape)):
                if static(is_shifted):
                    target[at] = cast(source[at + Vector(shift)], target.dtype)
                else:
                    target[at] = cast(source[at], target.dtype)

    return Kernels


@functools.cache
def _combine_kernel() -> Any:
    @kernel
    def compute_in_python(
        name: template(), cells: template(), first: template(), second: template(),
        out: i32, at: i32, bt: i32, x: f64, y: f64,
    ):  # fmt: skip
        a, b = x, y
        if static(first is not None):
            a = first[at]
        if static(second is not None):
            b = second[bt]
        if static(name == "add"):
            cells[out] = a + b
        elif static(name == "sub"):
            cells[out] = a - b
        elif static(name == "mul"):
            cells[out] = a * b
        elif static(name == "truediv"):
            cells[out] = a / b
        elif static(name == "pow"):
            cells[out] = a**b
        elif static(name == "mod"):
            cells[out] = a - b * floor(a / b)
        elif static(name == "abs"):
            cells[out] = abs(a) + 0 * b

    return compute_in_python


copies.get_kernels = _copy_kernels
tangents.get_kernel = _combine_kernel
