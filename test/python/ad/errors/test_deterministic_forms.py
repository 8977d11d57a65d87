"""Deterministic gradients of kernels that sum nothing: right, and the same bits on any threads."""

import numpy as np
import pytest
import tai as ti

N = 20_000


def periodic(a, b):
    @ti.kernel
    def form(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
        m = a.shape[0]
        for i in range(m):
            b[i] = a[(i + 1) % m] * a[i] - a[(i - 1) % m]

    form(a, b)
    return form


def clamped(a, b):
    @ti.kernel
    def form(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
        m = a.shape[0]
        for i in range(m):
            b[i] = a[ti.min(i + 1, m - 1)] * a[i] - a[ti.max(i - 1, 0)]

    form(a, b)
    return form


def in_numpy(form, a, g):
    i = np.arange(len(a))
    if form is periodic:
        after, before = (i + 1) % len(a), (i - 1) % len(a)
    else:
        after, before = np.minimum(i + 1, len(a) - 1), np.maximum(i - 1, 0)
    found = np.zeros(len(a))
    np.add.at(found, after, g * a)
    np.add.at(found, i, g * a[after])
    np.add.at(found, before, -g)
    return found


def gradients(form, n, threads):
    ti.init(deterministic=True, cpu_max_num_threads=threads, offline_cache=False)
    a, b = (ti.ndarray(ti.f32, shape=n, needs_grad=True) for _ in range(2))
    point = np.random.default_rng(1).uniform(-1, 1, n).astype(np.float32)
    seed = np.random.default_rng(2).uniform(-1, 1, n).astype(np.float32)
    a.from_numpy(point)
    kernel = form(a, b)
    found = []
    for _ in range(3):
        a.grad.fill(0)
        b.grad.from_numpy(seed)
        kernel.grad(a, b)
        found.append(a.grad.to_numpy())
    return found, in_numpy(form, point.astype(float), seed.astype(float))


@pytest.mark.parametrize("n", [1, 2, 3, 5, N])
@pytest.mark.parametrize("form", [periodic, clamped])
def test_arrays_with_ends(form, n):
    one, exact = gradients(form, n, 1)
    two, _ = gradients(form, n, 2)
    for found in (*one[1:], *two):
        np.testing.assert_array_equal(found, one[0])
    np.testing.assert_allclose(one[0], exact, rtol=2e-6, atol=2e-6)


def strided_gradients(threads, deterministic):
    ti.init(deterministic=deterministic, cpu_max_num_threads=threads, offline_cache=False)
    x, y = (ti.field(ti.f32, shape=s, needs_grad=True) for s in (2 * N, N))

    @ti.kernel
    def pairs():
        for i in range(N):
            y[i] += x[2 * i] * x[2 * i + 1]

    point = np.random.default_rng(1).uniform(-1, 1, 2 * N).astype(np.float32)
    seed = np.random.default_rng(2).uniform(-1, 1, N).astype(np.float32)
    x.from_numpy(point)
    y.grad.from_numpy(seed)
    pairs.grad()
    exact = (point.reshape(N, 2)[:, ::-1] * seed[:, None]).ravel()
    return x.grad.to_numpy(), exact


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize("threads", [1, 2])
def test_elements_of_two_places(threads, deterministic):
    """The elements 2 i and 2 i + 1 belong to one iteration."""
    found, exact = strided_gradients(threads, deterministic)
    np.testing.assert_array_equal(found, exact)


@pytest.mark.parametrize("threads", [1, 2])
def test_places_that_iterations_share(threads):
    ti.init(deterministic=True, cpu_max_num_threads=threads, offline_cache=False)
    x, y = (ti.field(ti.f32, shape=s, needs_grad=True) for s in (2 * N + 2, N))

    @ti.kernel
    def overlap():
        for i in range(N):
            y[i] += x[2 * i] + x[2 * i + 2]

    y.grad.fill(1)
    overlap.grad()
    exact = np.zeros(2 * N + 2)
    exact[0 : 2 * N : 2] += 1
    exact[2 : 2 * N + 2 : 2] += 1
    np.testing.assert_array_equal(x.grad.to_numpy(), exact)
