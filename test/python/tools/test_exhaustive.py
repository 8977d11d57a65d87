"""All arguments of functions of one f32: the script, on a sample, and its judgement."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import exhaustive  # noqa: E402


def test_errors_in_units_of_the_exact_result():
    exact = np.array([1.0, 1.0, 2.0**-149, 0.0, np.nan, 1e39, -1e39])
    found = np.array([1.0, 1 + 2.0**-23, 2.0**-148, 0.0, np.nan, np.inf, -np.inf], np.float32)
    off, wrong = exhaustive.errors(found, exact)
    np.testing.assert_array_equal(off, [0, 1, 1, 0, 0, 0, 0])
    assert not wrong.any()


@pytest.mark.parametrize(
    "found, exact",
    [(np.nan, 1.0), (np.inf, 1.0), (1.0, np.nan), (1.0, 1e39), (-np.inf, 1e39), (np.inf, np.nan)],
)
def test_infinity_and_nan_where_they_should_not_be(found, exact):
    off, wrong = exhaustive.errors(np.array([found], np.float32), np.array([exact]))
    assert wrong.all() and off[0] == 0


def test_pieces_reach_all_arguments():
    pieces = (1 << 32) // exhaustive.PIECE
    places = {number * exhaustive.STEP % pieces for number in range(pieces)}
    assert places == set(range(pieces))


def test_a_sample_of_all_functions(tmp_path):
    """Each function of a table in the accurate mode, at 256 arguments of each exponent or so."""
    piece = exhaustive._Piece
    for name in exhaustive.FUNCTIONS:
        ulp, _, wrong = piece(name, "accurate", "cpu").worst(5, 1 << 12)
        assert ulp <= 1 and wrong == 0, name


def test_the_table(tmp_path, capsys, monkeypatch):
    rows = [
        {"function": "exp", "mode": mode, "ulp": 0.5, "at": 1.5, "wrong": 0, "arguments": 2**26}
        for mode in ("default", "fast")
    ]
    path = tmp_path / "rows.json"
    path.write_text(json.dumps(rows))
    monkeypatch.setattr(sys, "argv", ["exhaustive.py", "--rows", str(path)])
    assert exhaustive.main() == 0
    assert "| `exp` | 0.5 (1.5) | 0.5 (1.5) | 1/64 |" in capsys.readouterr().out
    path.write_text(json.dumps([rows[0] | {"wrong": 2}, rows[1]]))
    assert exhaustive.main() == 1
    assert "0.5 (1.5), 2 wrong" in capsys.readouterr().out


def test_strides_that_are_none(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["exhaustive.py", "--stride", "3"])
    with pytest.raises(SystemExit):
        exhaustive.main()
    assert "--stride is a power of two" in capsys.readouterr().err
