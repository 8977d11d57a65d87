"""The kernels of `ti.algorithms`."""

from __future__ import annotations

import functools
from typing import Any

from ..base.dtypes import i32
from ..launch.kernels import kernel
from ..values.ops import loop_config, min, static, stop_grad
from ..values.types import template

BLOCK = 1024  # elements that one iteration adds up


@functools.cache
def kernels() -> Any:
    class Kernels:
        @staticmethod
        @kernel
        def merge(
            keys: template(), values: template(), has_values: template(), width: i32, gap: i32,
            count: i32,
        ):  # fmt: skip
            # A stage of Batcher's sorting network: compares numbers at a distance of `gap`, in
            # blocks of twice the width.
            first = gap % width
            for x in range(first, count - gap):
                is_lower = (x - first) // gap % 2 == 0
                if is_lower and x // (2 * width) == (x + gap) // (2 * width):
                    low, high = keys[x], keys[x + gap]
                    if high < low:
                        keys[x], keys[x + gap] = high, low
                        if static(has_values):
                            one, other = values[x], values[x + gap]
                            values[x], values[x + gap] = other, one

        @staticmethod
        @kernel
        def number(order: template(), count: i32):
            for i in range(count):
                order[i] = i

        @staticmethod
        @kernel
        def copy_numbers(source: template(), target: template(), count: i32):
            # The order of numbers has no derivative, so the numbers are copied without their
            # gradient.
            for i in range(count):
                target[i] = stop_grad(source[i])

        @staticmethod
        @kernel
        def copy(source: template(), target: template(), count: i32):
            for i in range(count):
                target[i] = source[i]

        @staticmethod
        @kernel
        def take(source: template(), order: template(), target: template(), count: i32):
            for i in range(count):
                target[i] = source[order[i]]

        @staticmethod
        @kernel
        def sum_blocks(x: template(), sums: template(), count: i32):
            for block in range((count + BLOCK - 1) // BLOCK):
                total = x[block * BLOCK]
                for i in range(block * BLOCK + 1, min((block + 1) * BLOCK, count)):
                    total += x[i]
                    x[i] = total
                sums[block] = total

        @staticmethod
        @kernel
        def sum_sums(sums: template(), blocks: i32):
            loop_config(serialize=True)
            for block in range(1, blocks):
                sums[block] += sums[block - 1]

        @staticmethod
        @kernel
        def add_sums(x: template(), sums: template(), count: i32):
            for i in range(BLOCK, count):
                x[i] += sums[i // BLOCK - 1]

    return Kernels
