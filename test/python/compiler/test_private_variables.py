"""Variables from before a parallel loop that each iteration assigns before it reads them."""

import numpy as np
import pytest
import tai as ti

N = 3000


@pytest.fixture(params=[1, 2])
def arrays(request):
    return make_arrays(request.param)


@pytest.fixture
def shared_arrays():
    """With one thread, a loop behaves as if its iterations ran in order."""
    return make_arrays(2)


def make_arrays(threads):
    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, offline_cache=False)
    x, y = ti.field(ti.f32, N, needs_grad=True), ti.field(ti.f32, N, needs_grad=True)
    x.from_numpy(np.arange(N, dtype=np.float32))
    return x, y


def test_a_number_and_a_vector(arrays):
    x, y = arrays

    @ti.kernel
    def double():
        t, v = 0.0, ti.Vector([0.0, 0.0])
        for i in range(N):
            t = x[i] * 2
            v = ti.Vector([t, 1.0])
            v[1] += t
            y[i] = v.sum()

    double()
    np.testing.assert_array_equal(y.to_numpy(), 4 * np.arange(N) + 1)


def test_inner_loops_and_branches(arrays):
    x, y = arrays

    @ti.kernel
    def count() -> ti.f32:
        total, s, j = 0.0, 0.0, 0
        for i in x:
            s = 0.0
            for k in range(i % 7):
                s += k
            j = 0
            while True:
                if j >= i % 5:
                    break
                j += 1
            if i % 2 == 0:
                sign = 1
                s *= sign
            total += j
            y[i] = s
        for i in range(2):
            s = 1.0
            y[i] += s
        return total

    assert count() == sum(i % 5 for i in range(N))
    k = np.arange(N) % 7
    expected = k * (k - 1) / 2
    expected[:2] += 1
    np.testing.assert_array_equal(y.to_numpy(), expected)


def test_gradient(arrays):
    x, y = arrays
    loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def measure():
        t = 0.0
        for i in x:
            t = x[i]
            if i % 2 == 0:
                t = t * 3
            y[i] = t
        for i in x:
            t = y[i]
            loss[None] += t * t

    with ti.ad.Tape(loss):
        measure()
    i = np.arange(N)
    np.testing.assert_allclose(x.grad.to_numpy(), np.where(i % 2 == 0, 18, 2) * i)


def test_the_value_after_the_loop_is_shared(shared_arrays):
    x, y = shared_arrays

    @ti.kernel
    def last() -> ti.f32:
        t = 0.0
        for i in range(N):
            t = x[i]
            y[i] = t
        return t

    with pytest.raises(ti.TaiError, match="variable 't', which all iterations share"):
        last()
        ti.sync()


@pytest.mark.parametrize("form", ["branch", "loop", "component", "update"])
def test_values_of_earlier_iterations_are_shared(shared_arrays, form):
    x, y = shared_arrays

    @ti.kernel
    def run():
        t, v = 0.0, ti.Vector([0.0, 0.0])
        for i in range(N):
            if ti.static(form == "branch"):
                if i % 2 == 0:
                    t = x[i]
                y[i] = t
            elif ti.static(form == "loop"):
                for _ in range(i % 2):
                    t = x[i]
                y[i] = t
            elif ti.static(form == "component"):
                v[0] = x[i]
                y[i] = v[0] + v[1]
            else:
                y[i] = t
                t = x[i]

    with pytest.raises(ti.TaiError, match="which all iterations share"):
        run()
        ti.sync()


def test_a_variable_of_the_caller(shared_arrays):
    x, y = shared_arrays

    @ti.func
    def fill(t: ti.template()):
        for i in range(N):
            t = x[i]
            y[i] = t

    @ti.kernel
    def run() -> ti.f32:
        t = 0.0
        fill(t)
        return t

    with pytest.raises(ti.TaiError, match="which all iterations share"):
        run()
        ti.sync()
