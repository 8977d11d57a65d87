"""Sparse matrices that kernels fill, their arithmetic, and solvers, against NumPy."""

import sys

import numpy as np
import pytest
import tai as ti

TYPES = {"f32": (ti.f32, np.float32, 2e-5), "f64": (ti.f64, np.float64, 1e-12)}


def laplacian(n, dtype=ti.f64, storage_format="col_major"):
    """Tridiagonal, positive definite; the diagonal is added in three parts."""
    builder = ti.linalg.SparseMatrixBuilder(
        n, n, max_num_triplets=5 * n, dtype=dtype, storage_format=storage_format
    )

    @ti.kernel
    def fill(A: ti.types.sparse_matrix_builder()):
        for i in range(n):
            A[i, i] += 1
            A[i, i] -= -1.0
            A[i, i] += 0.5 * (i % 3)
            if i > 0:
                A[i, i - 1] -= 1.0
            if i < n - 1:
                A[i, i + 1] += -1.0

    fill(builder)
    dense = np.diag(2.0 + 0.5 * (np.arange(n) % 3))
    dense -= np.eye(n, k=1) + np.eye(n, k=-1)
    return builder, dense


@pytest.mark.parametrize("storage_format", ["col_major", "row_major"])
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("n", [1, 2, 33, 1025])
def test_what_kernels_add(n, dtype, storage_format):
    ti.init()
    builder, dense = laplacian(n, TYPES[dtype][0], storage_format)
    matrix = builder.build()
    assert matrix.shape == (n, n) == (matrix.n, matrix.m) and matrix.dtype is TYPES[dtype][0]
    assert np.array_equal(matrix.to_numpy(), dense)
    assert matrix[0, 0] == dense[0, 0] and matrix[n - 1, n - 1] == dense[n - 1, n - 1]
    # It is empty again.
    assert not builder.build().to_numpy().any()


def test_many_threads_add_to_one_place():
    ti.init()
    n = 65537
    builder = ti.linalg.SparseMatrixBuilder(3, 2, max_num_triplets=n)

    @ti.kernel
    def fill(A: ti.types.sparse_matrix_builder(), n: ti.i32):
        for i in range(n):
            A[i % 3, (i // 3) % 2] += ti.cast(i % 7, ti.f32)

    fill(builder, n)
    i = np.arange(n)
    expected = np.zeros((3, 2))
    np.add.at(expected, (i % 3, (i // 3) % 2), i % 7)
    assert np.array_equal(builder.build().to_numpy(), expected)


def test_two_builders_a_function_and_two_launches():
    ti.init()
    a = ti.linalg.SparseMatrixBuilder(4, max_num_triplets=16, dtype=ti.f64)
    b = ti.linalg.SparseMatrixBuilder(4, 1, max_num_triplets=16, dtype=ti.f64)

    @ti.func
    def add(A, i, j, value):
        A[i, j] += value

    @ti.kernel
    def fill(
        A: ti.types.sparse_matrix_builder(), b: ti.types.sparse_matrix_builder(), scale: ti.f64
    ):
        for i in range(4):
            add(A, i, 3 - i, scale * i)
            b[i, 0] += 1.0

    fill(a, b, 1.0)
    fill(a, b, 10.0)
    assert np.array_equal(a.build().to_numpy(), np.fliplr(np.diag(11.0 * np.arange(4))))
    assert np.array_equal(b.build().to_numpy(), np.full((4, 1), 2.0))


def test_arithmetic():
    ti.init()
    builder, a = laplacian(5)
    one = builder.build()
    rng = np.random.default_rng(0)
    b = rng.integers(-3, 4, (5, 5)).astype(float)
    two = ti.linalg.SparseMatrix(5, 5, dtype=ti.f64)
    two.build_from_ndarray(np.array([(i, j, b[i, j]) for i in range(5) for j in range(5)]))
    two[1, 2] = b[1, 2] = 9.0
    pairs = [
        (one + two, a + b), (one - two, a - b), (one * two, a * b), (2 * one, 2 * a),
        (one * 0.5, 0.5 * a), (-one, -a), (one @ two, a @ b), (two.transpose(), b.T),
    ]  # fmt: skip
    for found, expected in pairs:
        assert isinstance(found, ti.linalg.SparseMatrix)
        np.testing.assert_allclose(found.to_numpy(), expected, rtol=1e-15)
    one += two
    assert np.array_equal(one.to_numpy(), a + b)
    with pytest.raises(ti.TaiRuntimeTypeError, match="of one size, but got 5×5 and 2×2"):
        one + ti.linalg.SparseMatrix(2)
    with pytest.raises(ti.TaiRuntimeTypeError, match="of 5×5 takes 5 rows, but got 4"):
        one @ np.ones(4)


def test_products_with_vectors():
    ti.init()
    builder, a = laplacian(6, ti.f32)
    matrix = builder.build()
    numbers = np.arange(6, dtype=np.float32)
    field, array = ti.field(ti.f32, shape=6), ti.ndarray(ti.f32, 6)
    field.from_numpy(numbers)
    array.from_numpy(numbers)
    for x in (numbers, field):
        assert np.array_equal(matrix @ x, a @ numbers)
    product = matrix @ array
    assert isinstance(product, ti.Ndarray) and np.array_equal(product.to_numpy(), a @ numbers)
    result = ti.field(ti.f32, shape=6)
    matrix.spmv(field, result)
    assert np.array_equal(result.to_numpy(), a @ numbers)


@pytest.mark.parametrize("solver_type", ["LLT", "LDLT", "LU"])
@pytest.mark.parametrize("ordering", ["AMD", "COLAMD"])
@pytest.mark.parametrize("dtype", TYPES)
def test_direct_solvers(dtype, solver_type, ordering):
    ti.init()
    dt, kind, tolerance = TYPES[dtype]
    builder, dense = laplacian(257, dt)
    matrix = builder.build()
    solver = ti.linalg.SparseSolver(dtype=dt, solver_type=solver_type, ordering=ordering)
    assert not solver.info()
    solver.analyze_pattern(matrix)
    solver.factorize(matrix)
    assert solver.info()
    b = np.random.default_rng(1).standard_normal(257).astype(kind)
    x = solver.solve(b)
    assert x.dtype == kind
    np.testing.assert_allclose(x, np.linalg.solve(dense, b), rtol=tolerance, atol=tolerance)
    array = ti.ndarray(dt, 257)
    array.from_numpy(b)
    assert np.array_equal(solver.solve(array).to_numpy(), x)


@pytest.mark.parametrize(
    "solver_type, matrix, reason",
    [
        ("LLT", [[1.0, 2.0], [2.0, 1.0]], "not positive definite"),
        ("LLT", [[1.0, 2.0], [0.0, 1.0]], "not symmetric"),
        ("LDLT", [[1.0, 2.0], [0.0, 1.0]], "not symmetric"),
        ("LU", [[1.0, 2.0], [2.0, 4.0]], "singular"),
    ],
)
def test_matrices_that_cannot_be_factorised(solver_type, matrix, reason):
    ti.init()
    a = ti.linalg.SparseMatrix(2, 2, dtype=ti.f64)
    a.build_from_ndarray([(i, j, matrix[i][j]) for i in range(2) for j in range(2)])
    solver = ti.linalg.SparseSolver(dtype=ti.f64, solver_type=solver_type)
    solver.compute(a)
    assert not solver.info()
    with pytest.raises(ti.TaiRuntimeError, match=f"nothing to solve with: .*{reason}"):
        solver.solve(np.ones(2))


def test_a_solver_without_a_matrix_says_so():
    solver = ti.linalg.SparseSolver(dtype=ti.f64)
    assert not solver.info()
    with pytest.raises(ti.TaiRuntimeError, match="nothing to solve with: nothing is factorised"):
        solver.solve(np.ones(2))


def test_conjugate_gradients_of_a_matrix():
    ti.init(default_fp=ti.f64)
    n = 64
    builder, dense = laplacian(n)
    matrix = builder.build()
    b = np.random.default_rng(2).standard_normal(n)
    expected = np.linalg.solve(dense, b)
    found, converged = ti.linalg.SparseCG(matrix, b, max_iter=500, atol=1e-10).solve()
    assert converged
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert not ti.linalg.SparseCG(matrix, b, max_iter=2, atol=1e-10).solve()[1]
    for wrong in (ti.linalg.SparseMatrix(2, 3), np.eye(2)):
        with pytest.raises(ti.TaiRuntimeTypeError, match="SparseCG takes a square sparse matrix"):
            ti.linalg.SparseCG(wrong, np.ones(2))


def test_printed_as_taichi_does(capsys):
    ti.init()
    builder, _ = laplacian(2)
    builder.print_triplets()
    assert capsys.readouterr().out.splitlines() == [
        "n=2, m=2, num_triplets=8 (max=10)", "[0, 0] = 0", "[0, 0] = 1", "[0, 0] = 1",
        "[1, 0] = -1", "[0, 1] = -1", "[1, 1] = 0.5", "[1, 1] = 1", "[1, 1] = 1",
    ]  # fmt: skip
    print(builder.build())
    assert capsys.readouterr().out.splitlines() == ["[  2,  -1]", "[ -1, 2.5]"]


def test_entries_that_do_not_fit():
    ti.init()
    builder = ti.linalg.SparseMatrixBuilder(2, 2, max_num_triplets=3)

    @ti.kernel
    def fill(A: ti.types.sparse_matrix_builder(), n: ti.i32, at: ti.i32):
        for _ in range(n):
            A[at, 0] += 1.0

    fill(builder, 5, 0)
    with pytest.raises(ti.TaiRuntimeError, match="added 5 entries to a builder of 3") as info:
        builder.build()
    assert "max_num_triplets=5" in str(info.value)
    other = ti.linalg.SparseMatrixBuilder(2, 2, max_num_triplets=3)
    fill(other, 1, 7)
    with pytest.raises(ti.TaiRuntimeError, match=r"added to \[7, 0\] of a matrix of 2×2"):
        other.build()


@pytest.mark.parametrize(
    "statement, reason",
    [
        ("A[0, 0] = 1.0", "cannot be set: a builder collects what is added"),
        ("A[0, 0] *= 2.0", "cannot be read"),
        ("x = A[0, 0]", "cannot be read"),
        ("A[0] += 1.0", "has 2 indices, but got 1"),
        ("A[0, 0.5] += 1.0", "the indices of a matrix are whole numbers"),
    ],
)
def test_statements_that_are_refused(tmp_path, monkeypatch, statement, reason):
    ti.init()
    (tmp_path / "refused.py").write_text(
        "import tai as ti\n\n\n@ti.kernel\ndef fill(A: ti.types.sparse_matrix_builder()):\n"
        f"    for i in range(2):\n        {statement}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    sys.modules.pop("refused", None)
    import refused

    with pytest.raises(ti.TaiCompilationError, match=reason) as info:
        refused.fill(ti.linalg.SparseMatrixBuilder(2, max_num_triplets=2))
    assert "refused.py:7" in str(info.value)


def test_wrong_arguments():
    ti.init()

    @ti.kernel
    def fill(A: ti.types.sparse_matrix_builder()):
        A[0, 0] += 1.0

    with pytest.raises(ti.TaiRuntimeTypeError, match="'A' of kernel 'fill' expects a sparse matr"):
        fill(np.zeros((2, 2)))
    for wrong in ({"num_rows": 0}, {"num_rows": 2}, {"num_rows": 2, "max_num_triplets": -1},
                  {"num_rows": 2, "max_num_triplets": 2**31 - 1},
                  {"num_rows": 2, "max_num_triplets": 1, "dtype": ti.i32},
                  {"num_rows": 2, "max_num_triplets": 1, "storage_format": "ELL"}):  # fmt: skip
        with pytest.raises(ti.TaiRuntimeTypeError):
            ti.linalg.SparseMatrixBuilder(**wrong)
    with pytest.raises(ti.TaiRuntimeTypeError, match="storage_format is 'col_major' or 'row_m"):
        ti.linalg.SparseMatrix(2, storage_format="ELL")
    with pytest.raises(ti.TaiRuntimeTypeError, match="there is no solver of type 'QR'"):
        ti.linalg.SparseSolver(solver_type="QR")
    with pytest.raises(ti.TaiRuntimeTypeError, match="square matrix, but got one of 2×3"):
        ti.linalg.SparseSolver().compute(ti.linalg.SparseMatrix(2, 3))


def test_without_scipy(monkeypatch):
    ti.init()
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    with pytest.raises(ti.TaiRuntimeError, match="sparse matrices need SciPy") as info:
        ti.linalg.SparseMatrixBuilder(2, max_num_triplets=2).build()
    assert "pip install scipy" in str(info.value)
