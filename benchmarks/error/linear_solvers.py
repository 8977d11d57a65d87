"""Forty matrices by all solvers: status, backward error, and errors of the gradients.

    python benchmarks/error/linear_solvers.py [--quick] [--write]

The reference is SciPy's: dense factorisations in f64 with refinement in extended precision, and
pseudo-inverses of singular matrices. Errors are norms of differences by norms of references: of
x, and of the gradient of Σ w x by b and by the entries of A. With --write, the table goes to
benchmarks/results/linear-solvers.csv and docs/reports/linear-solvers.md.
"""

from __future__ import annotations

import argparse
import csv
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
import tai as ti

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "benchmarks" / "results" / "linear-solvers.csv"
PAGE = ROOT / "docs" / "reports" / "linear-solvers.md"
METHODS = ["cg", "minres", "bicgstab", "gmres", "solve"]
COLUMNS = ["matrix", "kind", "n", "condition", "method", "status", "iterations", "residual",
           "backward_error", "true_backward_error", "adjoint", "x_error", "b_grad_error",
           "entries_grad_error"]  # fmt: skip


def tridiagonal(n: int, diagonal: float = 2.0, wind: float = 0.0) -> np.ndarray:
    lower, upper = np.eye(n, k=-1), np.eye(n, k=1)
    return diagonal * np.eye(n) - (1 + wind) * lower - (1 - wind) * upper


def neumann(n: int) -> np.ndarray:
    matrix = tridiagonal(n)
    matrix[0, 0] = matrix[-1, -1] = 1
    return matrix


def with_spectrum(values: np.ndarray, seed: int) -> np.ndarray:
    """A symmetric matrix of random eigenvectors."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(values),) * 2))
    matrix = (q * values) @ q.T
    return (matrix + matrix.T) / 2


def with_singular_values(values: np.ndarray, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    u, _ = np.linalg.qr(generator.normal(size=(len(values),) * 2))
    v, _ = np.linalg.qr(generator.normal(size=(len(values),) * 2))
    return (u * values) @ v


def laplace(n: int, periodic: bool = False) -> np.ndarray:
    """Five points on n×n cells."""
    line = np.eye(n, k=1) + np.eye(n, k=-1)
    if periodic:
        line[0, -1] += 1
        line[-1, 0] += 1
    return 4 * np.eye(n * n) - np.kron(line, np.eye(n)) - np.kron(np.eye(n), line)


def scaled(matrix: np.ndarray, decades: float, seed: int) -> np.ndarray:
    scale = 10.0 ** np.random.default_rng(seed).uniform(-decades / 2, decades / 2, len(matrix))
    return scale[:, None] * matrix * scale


def scattered(n: int, seed: int) -> np.ndarray:
    """A few entries in each row, and a diagonal that outweighs them."""
    generator = np.random.default_rng(seed)
    matrix = sparse.random_array((n, n), density=4 / n, rng=generator).toarray() - 0.3 * np.eye(n)
    return matrix + np.diag(1 + np.abs(matrix).sum(axis=1))


def make_matrices() -> dict[str, tuple[str, np.ndarray]]:
    """Forty matrices with their kinds, by name."""
    spread = lambda n, decades: 10.0 ** np.linspace(0, -decades, n)  # noqa: E731
    signs = lambda n: np.where(np.arange(n) % 2, -1.0, 1.0)  # noqa: E731
    skew = lambda n: np.eye(n, k=1) - np.eye(n, k=-1)  # noqa: E731
    spd, wrong, indefinite = "positive definite", "not symmetric", "indefinite"
    singular, ill = "singular, consistent", "ill-conditioned"
    return {
        "one": (spd, np.array([[3.0]])),
        "minus one": (indefinite, np.array([[-3.0]])),
        "identity 100": (spd, np.eye(100)),
        "two": (spd, np.array([[2.0, 1.0], [1.0, 3.0]])),
        "row of cells 50": (spd, tridiagonal(50)),
        "row of cells 300": (spd, tridiagonal(300)),
        "row of cells 2000": (spd, tridiagonal(2000, 2.01)),
        "five points 12": (spd, laplace(12)),
        "five points 30": (spd, laplace(30)),
        "random 80": (spd, with_spectrum(spread(80, 2), 1)),
        "random 200": (spd, with_spectrum(spread(200, 3), 2)),
        "scattered symmetric 500": (spd, scattered(500, 3) + scattered(500, 3).T),
        "decades 6": (ill, with_spectrum(spread(60, 6), 4)),
        "decades 9": (ill, with_spectrum(spread(60, 9), 5)),
        "decades 12": (ill, with_spectrum(spread(60, 12), 6)),
        "Hilbert 8": (ill, scipy.linalg.hilbert(8)),
        "scales of 6 decades": (ill, scaled(tridiagonal(100, 2.1), 6, 7)),
        "scales of 12 decades": (ill, scaled(tridiagonal(100, 2.1), 12, 8)),
        "not symmetric, decades 6": (ill, with_singular_values(spread(60, 6), 9)),
        "not symmetric, decades 12": (ill, with_singular_values(spread(60, 12), 10)),
        "shifted cells 50": (indefinite, tridiagonal(50, 1.3)),
        "shifted cells 1000": (indefinite, tridiagonal(1000, 0.5)),
        "shifted five points 20": (indefinite, laplace(20) - 1.0 * np.eye(400)),
        "both signs 100": (indefinite, with_spectrum(spread(100, 2) * signs(100), 11)),
        "saddle point 60": (indefinite, saddle(40, 20, 12)),
        "wind 40": (wrong, tridiagonal(40, 2.0, 0.5)),
        "wind 500": (wrong, tridiagonal(500, 2.3, 0.7)),
        "strong wind 100": (wrong, tridiagonal(100, 2.0, 5.0)),
        "scattered 100": (wrong, scattered(100, 13)),
        "scattered 2000": (wrong, scattered(2000, 14)),
        "triangular 50": (wrong, np.tril(tridiagonal(50, 3.0))),
        "random gauss 60": (wrong, np.random.default_rng(15).normal(size=(60, 60))),
        "rotation 2": ("skew", skew(2)),
        "skew 40": ("skew", skew(40)),
        "skew 200": ("skew", skew(200)),
        "shifted skew 100": ("skew", 0.1 * np.eye(100) + skew(100)),
        "cyclic shift 20": (wrong, np.roll(np.eye(20), 1, axis=0)),
        "closed row 50": (singular, neumann(50)),
        "periodic five points 16": (singular, laplace(16, periodic=True)),
        "rank 20 of 40": (singular, with_spectrum(np.r_[spread(20, 1), np.zeros(20)], 16)),
    }


def saddle(n: int, m: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    a, b = np.diag(generator.uniform(1, 2, n)), generator.normal(size=(m, n))
    return np.block([[a, b.T], [b, np.zeros((m, m))]])


class Reference:
    """The exact solution and gradients of a system whose right-hand side is in its range."""

    def __init__(self, kind: str, matrix: np.ndarray, seed: int):
        generator = np.random.default_rng(seed)
        self.matrix, self.is_singular = matrix, kind.startswith("singular")
        x, self.w = generator.normal(size=(2, len(matrix)))
        self.b = matrix @ x
        self.norm = np.linalg.norm(matrix, 2)
        values = np.linalg.svd(matrix, compute_uv=False)
        least = values[values > 1e-13 * values[0]][-1] if self.is_singular else values[-1]
        self.condition = values[0] / least
        self.x, self.adjoint = self._solve(matrix, self.b), self._solve(matrix.T, self.w)

    def _solve(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        if self.is_singular:
            return np.linalg.pinv(matrix, 1e-12) @ right
        factors = scipy.linalg.lu_factor(matrix)
        wide, x = matrix.astype(np.longdouble), scipy.linalg.lu_solve(factors, right)
        x = x.astype(np.longdouble)
        for _ in range(8):
            rest = right - wide @ x
            x = x + scipy.linalg.lu_solve(factors, rest.astype(np.float64))
        return x.astype(np.float64)

    def backward_error(self, x: np.ndarray) -> float:
        rest = np.linalg.norm(self.b - self.matrix @ x)
        return rest / (self.norm * np.linalg.norm(x) + np.linalg.norm(self.b))


def difference(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def measure(name: str, kind: str, reference: Reference) -> list[dict[str, Any]]:
    """A row for each method."""
    matrix = reference.matrix
    n, at = len(matrix), np.nonzero(matrix)
    A = ti.linalg.AssembledMatrix(*at, matrix.shape, ti.f64, needs_grad=True)
    A.values.from_numpy(matrix[at])
    b, x = (ti.field(ti.f64, shape=n, needs_grad=True, name=letter) for letter in "bx")
    w = ti.field(ti.f64, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    b.from_numpy(reference.b)
    w.from_numpy(reference.w)

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += w[i] * x[i]

    rows = []
    for method in METHODS:
        x.fill(0)
        options: dict[str, Any] = {}
        if method != "solve":
            options = {"tol": 1e-10, "max_iterations": 1000}
        if method == "gmres":
            options["restart"] = 50
        with ti.ad.Tape(loss):
            info = getattr(ti.linalg, method)(A, b, x, **options)
            sum_up()
        found = x.to_numpy()
        entries = -(reference.adjoint[at[0]] * reference.x[at[1]])
        rows.append({
            "matrix": name, "kind": kind, "n": n, "condition": f"{reference.condition:.1e}",
            "method": method, "status": info.status, "iterations": info.iterations,
            "residual": f"{info.residual:.1e}", "backward_error": f"{info.backward_error:.1e}",
            "true_backward_error": f"{reference.backward_error(found):.1e}",
            "adjoint": info.adjoint.status,
            "x_error": f"{difference(found, reference.x):.1e}",
            "b_grad_error": f"{difference(b.grad.to_numpy(), reference.adjoint):.1e}",
            "entries_grad_error": f"{difference(A.values.grad.to_numpy(), entries):.1e}",
        })  # fmt: skip
    return rows


def write_page(rows: list[dict[str, Any]]) -> None:
    """The page: for each matrix and method, the status and the greatest error of a gradient."""
    names = [*dict.fromkeys(row["matrix"] for row in rows)]
    by = {(row["matrix"], row["method"]): row for row in rows}
    lines = [
        "# Solvers on forty matrices",
        "",
        "Made by `python benchmarks/error/linear_solvers.py --write`; all numbers are in",
        "[linear-solvers.csv](../../benchmarks/results/linear-solvers.csv). Each cell has the",
        "status of the solve (and of its adjoint, if that differs), the reported backward error,",
        "and the greater of the relative errors of the gradients by b and by the entries of A,",
        "against dense factorisations of SciPy that are refined in extended precision. `tol` is",
        "1e-10, the limit 1,000 iterations, `restart` of GMRES 50; there is no preconditioner. A",
        "gradient inherits the condition: 1e-10 times the condition number is to be expected.",
        "",
        "| matrix | kind | n | condition | " + " | ".join(METHODS) + " |",
        "|---|---|---|---|" + "---|" * len(METHODS),
    ]
    for name in names:
        first = by[name, METHODS[0]]
        cells = []
        for method in METHODS:
            row = by[name, method]
            status = row["status"]
            if row["adjoint"] != status:
                status += f" / {row['adjoint']}"
            error = max(float(row["b_grad_error"]), float(row["entries_grad_error"]))
            cells.append(f"{status}, {row['backward_error']}, {error:.1e}")
        lines.append(f"| {name} | {first['kind']} | {first['n']} | {first['condition']} | "
                     + " | ".join(cells) + " |")  # fmt: skip
    silent = [row for row in rows if is_silently_wrong(row)]
    lines += [
        "",
        f"{sum(r['status'] == 'converged' for r in rows)} of {len(rows)} solves converged. "
        f"{len(silent)} solves report convergence, forward and in reverse, with a gradient "
        "that is off by more than the condition number times 1e-9.",
        "",
    ]
    PAGE.write_text("\n".join(lines))


def is_silently_wrong(row: dict[str, Any]) -> bool:
    error = max(float(row["b_grad_error"]), float(row["entries_grad_error"]))
    converged = row["status"] == row["adjoint"] == "converged"
    return converged and not error <= 1e-9 * float(row["condition"]) + 1e-9


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="matrices of up to 100 rows")
    parser.add_argument("--write", action="store_true", help="write the table and the page")
    options = parser.parse_args()
    warnings.simplefilter("ignore", ti.linalg.TaiConvergenceWarning)
    # One thread: the systems are small, and the order of sums is the same each time.
    ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=1)
    rows = []
    for number, (name, (kind, matrix)) in enumerate(make_matrices().items()):
        if options.quick and len(matrix) > 100:
            continue
        made = measure(name, kind, Reference(kind, matrix, number))
        rows += made
        for row in made:
            print(", ".join(str(row[column]) for column in COLUMNS), flush=True)
    if options.write:
        with TABLE.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        write_page(rows)
    wrong = [row for row in rows if is_silently_wrong(row)]
    for row in wrong:
        print(f"silently wrong: {row}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
