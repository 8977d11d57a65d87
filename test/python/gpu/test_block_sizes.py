"""Blocks of several sizes are tried on a GPU: results stay, and so does deterministic mode."""

import numpy as np
import pytest
import tai as ti

COUNT = 1 << 20


@pytest.mark.parametrize("deterministic", [False, True])
def test_results_while_sizes_are_tried(deterministic):
    ti.init(deterministic=deterministic)
    x = ti.field(ti.f32, COUNT, needs_grad=True)
    total = ti.field(ti.i64, ())

    @ti.kernel
    def step(t: ti.i32):
        for i in x:
            x[i] += ti.cast((i + t) & 15, ti.f32)
            total[None] += i & 1

    expected = np.zeros(COUNT)
    for t in range(24):
        step(t)
        expected += (np.arange(COUNT) + t) & 15
    np.testing.assert_array_equal(x.to_numpy(), expected)
    assert total[None] == 24 * COUNT // 2
