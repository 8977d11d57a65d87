"""`ti.eig` of 2×2 matrices against NumPy, and its gradients against differences."""

import numpy as np
import pytest
import tai as ti

CASES = {
    "real": [[1.0, 2.0], [0.5, -1.0]],
    "leaning the other way": [[-1.0, 2.0], [0.5, 3.0]],
    "symmetric": [[2.0, 1.0], [1.0, 2.0]],
    "complex": [[0.3, -2.0], [1.5, 0.7]],
    "rotation": [[0.0, -1.0], [1.0, 0.0]],
    "upper": [[1.0, 3.0], [0.0, 2.0]],
    "lower": [[4.0, 0.0], [3.0, 2.0]],
    "diagonal": [[1.0, 0.0], [0.0, 2.0]],
    "large": [[1e150, 2e150], [5e149, -1e150]],
    "cancelling": [[1.0, 1e-9], [1e-9, 2.0]],
    "identity": [[3.0, 0.0], [0.0, 3.0]],
    "one eigenvector": [[1.0, 1.0], [0.0, 1.0]],
    "the other eigenvector": [[1.0, 0.0], [1.0, 1.0]],
    "zero": [[0.0, 0.0], [0.0, 0.0]],
}


def decompose(matrices, dt=ti.f64):
    """Complex eigenvalues and eigenvectors (columns) of each matrix."""
    n = len(matrices)
    a = ti.Matrix.field(2, 2, dt, shape=n)
    values, vectors = ti.Matrix.field(2, 2, dt, shape=n), ti.Matrix.field(4, 2, dt, shape=n)
    a.from_numpy(np.array(matrices, np.float64 if dt is ti.f64 else np.float32))

    @ti.kernel
    def run():
        for i in a:
            values[i], vectors[i] = ti.eig(a[i])

    run()
    w, v = values.to_numpy(), vectors.to_numpy()
    return w[..., 0] + 1j * w[..., 1], v[:, 0::2] + 1j * v[:, 1::2]


@pytest.mark.parametrize("dt, tolerance", [(ti.f64, 1e-14), (ti.f32, 1e-6)], ids=["f64", "f32"])
def test_cases_and_random_matrices(dt, tolerance):
    ti.init()
    rng = np.random.default_rng(0)
    named = [m for name, m in CASES.items() if name != "large" or dt is ti.f64]
    matrices = np.concatenate([named, rng.standard_normal((500, 2, 2))])
    values, vectors = decompose(matrices, dt)
    a = matrices.astype(np.float64 if dt is ti.f64 else np.float32).astype(complex)
    scale = np.linalg.norm(a, axis=(1, 2))[:, None, None] + np.finfo(float).tiny
    residue = (a @ vectors - vectors * values[:, None, :]) / scale
    assert np.abs(residue).max() < 4 * tolerance
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, rtol=tolerance)
    expected = np.linalg.eigvals(matrices)
    for found, known in zip(values, expected, strict=True):
        # NumPy may list a complex pair in the other order.
        size = np.abs(known).max() + np.finfo(float).tiny
        distance = min(np.abs(found - known).max(), np.abs(found - known[::-1]).max())
        assert distance <= 8 * tolerance * size
    reals = values.imag[:, 0] == 0
    assert (values.real[reals, 0] >= values.real[reals, 1]).all()
    assert (values.imag[~reals, 0] > 0).all()


def test_vectors_of_equal_values():
    ti.init()
    names = ["identity", "one eigenvector", "the other eigenvector", "zero"]
    _, vectors = decompose([CASES[name] for name in names])
    expected = [[[1, 0], [0, 1]], [[1, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [0, 1]]]
    assert np.array_equal(vectors, expected)


@pytest.mark.parametrize("name", ["real", "leaning the other way", "complex", "upper", "lower"])
def test_gradients_agree_with_differences(name):
    ti.init(default_fp=ti.f64)
    matrix = np.array(CASES[name])
    a = ti.Matrix.field(2, 2, ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def weigh():
        values, vectors = ti.eig(a[None])
        for i in ti.static(range(2)):
            for j in ti.static(range(2)):
                loss[None] += (1.0 + i + 3.0 * j) * values[i, j]
        for i in ti.static(range(4)):
            for j in ti.static(range(2)):
                loss[None] += ti.sin(1.0 + i + 5.0 * j) * vectors[i, j]

    def value(m):
        a.from_numpy(m)
        loss[None] = 0.0
        weigh()
        return loss[None]

    value(matrix)
    loss[None] = 0.0
    with ti.ad.Tape(loss):
        weigh()
    found = a.grad.to_numpy()
    for i in range(2):
        for j in range(2):
            step = np.zeros((2, 2))
            # Not below an entry of zero, where the branch of the vectors changes.
            step[i, j] = 1e-6
            difference = (value(matrix + step) - value(matrix - step)) / 2e-6
            assert found[i, j] == pytest.approx(difference, rel=1e-7, abs=1e-8)


def test_three_by_three_is_refused():
    ti.init()
    a = ti.Matrix.field(3, 3, ti.f32, shape=())

    @ti.kernel
    def run() -> ti.f32:
        values, vectors = ti.eig(a[None])
        return values[0, 0] + vectors[0, 0]

    with pytest.raises(ti.TaiTypeError, match="ti.eig takes a 2×2 matrix, but got a 3×3 matrix"):
        run()
