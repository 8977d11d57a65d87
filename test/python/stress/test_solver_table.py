"""The table of solvers on forty matrices: small ones again, with the outcomes of the page."""

import csv
import sys
import warnings
from pathlib import Path

import pytest
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "benchmarks" / "error"))

import linear_solvers  # noqa: E402

MOST_ROWS = 20


def small_matrices():
    for number, (name, (_, matrix)) in enumerate(linear_solvers.make_matrices().items()):
        if len(matrix) <= MOST_ROWS:
            yield number, name


def test_the_table_has_all_matrices_by_all_methods():
    with linear_solvers.TABLE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = list(linear_solvers.make_matrices())
    assert len(names) == 40 and len(rows) == 200
    assert list(dict.fromkeys(row["matrix"] for row in rows)) == names
    assert not [row for row in rows if linear_solvers.is_silently_wrong(row)]


@pytest.mark.parametrize("number, name", list(small_matrices()))
def test_a_matrix_of_the_table_again(number, name):
    ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=1)
    kind, matrix = linear_solvers.make_matrices()[name]
    with linear_solvers.TABLE.open(newline="") as file:
        expected = [row for row in csv.DictReader(file) if row["matrix"] == name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ti.linalg.TaiConvergenceWarning)
        rows = linear_solvers.measure(name, kind, linear_solvers.Reference(kind, matrix, number))
    assert not [row for row in rows if linear_solvers.is_silently_wrong(row)]
    for row, known in zip(rows, expected, strict=True):
        outcome = [str(row[key]) for key in ("method", "status", "adjoint")]
        assert outcome == [known[key] for key in ("method", "status", "adjoint")]
