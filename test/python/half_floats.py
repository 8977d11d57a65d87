"""Rounding to 16 bits, and scatters that round once."""

import numpy as np
import tai as ti


def nearest(values, dt):
    """As f16, or bf16 by the upper half of f32 (ties aside), in f32."""
    if dt == ti.f16:
        return np.asarray(values).astype(np.float16).astype(np.float32)
    bits = np.asarray(values).astype(np.float32).view(np.uint32)
    return ((bits + np.uint32(0x8000)) & np.uint32(0xFFFF0000)).view(np.float32)


def check_scatters(dt, cells, n):
    """The elements are scalars, vectors and members of structs, with 1/64 as each term."""
    x, at = ti.field(dt, n), ti.field(ti.i32, n)
    plain, pairs = ti.field(dt, cells), ti.Vector.field(2, dt, cells)
    mixed = ti.Struct.field({"left": dt, "right": ti.f32}, shape=cells)
    where = np.random.default_rng(cells).integers(0, cells, n).astype(np.int32)
    at.from_numpy(where)
    x.fill(1 / 64)
    plain.fill(2)

    @ti.kernel
    def scatter():
        for i in x:
            plain[at[i]] += x[i]
            pairs[at[i]] -= ti.Vector([x[i], 2 * x[i]])
            mixed[at[i]].left += x[i]

    scatter()
    sums = np.bincount(where, minlength=cells) / 64
    np.testing.assert_array_equal(plain.to_numpy().astype(np.float32), nearest(sums + 2, dt))
    found = pairs.to_numpy().astype(np.float32)
    np.testing.assert_array_equal(found[:, 0], nearest(-sums, dt))
    np.testing.assert_array_equal(found[:, 1], nearest(-2 * sums, dt))
    np.testing.assert_array_equal(mixed.left.to_numpy().astype(np.float32), nearest(sums, dt))
    assert not mixed.right.to_numpy().any()
