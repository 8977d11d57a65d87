"""Values after a `while` that ends by `break`: those of the iteration that ends it."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True, params=[0, 3])
def level(request):
    ti.init(arch=ti.cpu, default_fp=ti.f64, opt_level=request.param, offline_cache=False)


def test_the_value_that_decides_on_the_exit():
    found = ti.field(ti.i32, 200)

    @ti.kernel
    def divide():
        for n in range(2, 200):
            i = 2
            while i * i <= n:
                if n % i == 0:
                    break
                i += 1
            found[n] = i

    divide()
    for n in range(2, 200):
        i = 2
        while i * i <= n and n % i != 0:
            i += 1
        assert found[n] == i


def test_values_on_both_sides_of_the_exit():
    out = ti.Vector.field(4, ti.i32, shape=50)

    @ti.kernel
    def run():
        for n in out:
            a, b, c, steps = n, 1, 0, 0
            while steps < 12:
                a = a * 3 + 1
                if a % 7 == 2:
                    b += 100
                    break
                b, c = c + a, b
                if b % 5 == 3:
                    break
                steps += 1
            out[n] = [a, b, c, steps]

    run()
    for n in range(50):
        a, b, c, steps = n, 1, 0, 0
        while steps < 12:
            a = a * 3 + 1
            if a % 7 == 2:
                b += 100
                break
            b, c = c + a, b
            if b % 5 == 3:
                break
            steps += 1
        assert list(out[n]) == [a, b, c, steps]


def test_elements_behind_the_exit_are_not_read():
    table = ti.field(ti.i32, 64)
    table.from_numpy(np.arange(1, 65, dtype=np.int32))

    @ti.kernel
    def walk(last: ti.i32) -> ti.i32:
        i, hops = 0, 0
        while True:
            if i >= last:
                break
            i = table[i]
            hops += 1
        return i * 100 + hops

    assert [walk(n) for n in (0, 5, 64)] == [0, 505, 6464]


def test_a_search_in_a_function():
    table = ti.field(ti.i32, 64)
    table.from_numpy(np.arange(0, 128, 2, dtype=np.int32))
    found = ti.field(ti.i32, 140)

    @ti.func
    def find(v) -> ti.i32:
        j = 0
        while j < 64:
            if table[j] >= v:
                return j
            j += 1
        return -j

    @ti.kernel
    def search():
        for v in found:
            found[v] = find(v)

    search()
    v = np.arange(140)
    np.testing.assert_array_equal(found.to_numpy(), np.where(v <= 126, (v + 1) // 2, -64))


def test_gradient():
    x = ti.field(ti.f64, 20, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    x.from_numpy(np.linspace(0.3, 2.1, 20))

    @ti.kernel
    def grow():
        for i in x:
            y, k = x[i], 0
            while k < 12:
                if y * y > 5:
                    break
                y = y * 1.3 + x[i]
                k += 1
            loss[None] += y * (k + 1)

    with ti.ad.Tape(loss):
        grow()
    expected = []
    for v in np.linspace(0.3, 2.1, 20):
        y, slope, k = v, 1.0, 0
        while k < 12 and y * y <= 5:
            y, slope, k = y * 1.3 + v, slope * 1.3 + 1, k + 1
        expected.append(slope * (k + 1))
    np.testing.assert_allclose(x.grad.to_numpy(), expected)
