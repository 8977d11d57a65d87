"""All arguments of functions of one f32: the script, on a sample, and its judgement."""

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


def test_blocks_reach_all_arguments(monkeypatch):
    """The arguments of all blocks, of a function whose results are its arguments."""
    monkeypatch.setattr(exhaustive, "BLOCKS", 16)
    monkeypatch.setitem(exhaustive.FUNCTIONS, "copy", lambda x: x)
    evaluator = object.__new__(exhaustive.Evaluator)
    evaluator.arch, evaluator.results = "cpu", np.empty(1 << 14, np.float32)
    met = []

    def results_of(_name, _mode, first, stride):
        bits = (first + stride * np.arange(1 << 14, dtype=np.uint64)).astype(np.uint32)
        met.append(bits)
        return bits.view(np.float32)

    evaluator.results_of = results_of
    stride = 1 << 10
    rows = [exhaustive.Row("copy", "default", stride=stride)]
    blocks = list(exhaustive.missing(rows, ["copy"], ["default"]))
    for name, modes, number in blocks:
        (part,) = evaluator.block(name, modes, number, stride)
        rows[0].add(part)
    assert rows[0].arguments() == (1 << 32) // stride == len(np.unique(np.concatenate(met)))
    assert (rows[0].ulp, rows[0].wrong, rows[0].misrounded) == (0, 0, 0)
    assert not list(exhaustive.missing(rows, ["copy"], ["default"]))


def test_a_row_takes_results_in():
    row = exhaustive.Row("exp", "default")
    bits = np.array([1.0, 2.0, 200.0, np.nan], np.float32).view(np.uint32)
    exact = np.exp(bits.view(np.float32).astype(np.float64))
    with np.errstate(over="ignore"):
        found = exact.astype(np.float32)
    row.compare(bits, exact, found, True)
    assert 0 < row.ulp < 0.5 and (row.wrong, row.misrounded) == (0, 0)
    found[1] = np.nextafter(found[1], np.float32(0))
    found[2] = 1.0
    row.compare(bits, exact, found, False)
    assert 0.5 < row.ulp < 1.5 and (row.wrong, row.misrounded) == (1, 1)
    assert np.uint32(row.at).view(np.float32) == 2.0


def test_the_nearest_number_by_many_digits():
    pytest.importorskip("mpmath")
    # exp(2^-24) is 2^-49 above the middle of two f32.
    for name, argument in (("exp", 2.0**-24), ("rsqrt", 3.0), ("cbrt", -5.0), ("erfc", 0.5)):
        exact = exhaustive.FUNCTIONS[name](np.float64(argument))
        nearest = np.float32(exact)
        assert exhaustive.is_nearest(name, argument, float(nearest))
        other = np.nextafter(nearest, np.float32(2 * exact))
        assert not exhaustive.is_nearest(name, argument, float(other))
    assert not exhaustive.is_nearest("exp", 2.0**-24, 1.0)


def test_a_sample_of_all_functions():
    """Each function of a table in the accurate mode, at 16 arguments of each block."""
    evaluator = exhaustive.Evaluator("cpu")
    for name in exhaustive.FUNCTIONS:
        for number in (60, 63, 64, 66, 127, 190, 255):
            (row,) = evaluator.block(name, ("accurate",), number, 1 << 12)
            assert row.ulp <= 1 and row.wrong == 0, (name, number)


def test_a_run_goes_on_where_another_ended(tmp_path, capsys, monkeypatch):
    path = tmp_path / "rows.json"
    row = exhaustive.Row("floor", "default", "cpu", "a machine", 1 << 16, done=(1 << 256) - 3)
    exhaustive.save([row], path)
    words = ["exhaustive.py", "floor", "--modes", "default", "--jobs", "1", "--out", str(path)]
    monkeypatch.setattr(sys, "argv", [*words, "--stride", str(1 << 16)])
    assert exhaustive.main() == 0
    assert "| `floor` | 0 | 1/65536 |" in capsys.readouterr().out
    (row,) = exhaustive.load(path)
    assert row.done == (1 << 256) - 1 and row.machine == "a machine"
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        exhaustive.main()
    assert "has stride 65536 of cpu" in capsys.readouterr().err


def test_the_table(tmp_path, capsys, monkeypatch):
    rows = [
        exhaustive.Row("exp", "default", "cpu", "C", 1, 0.5, 0x3FC00000, 0, 0, (1 << 256) - 1),
        exhaustive.Row("exp", "fast", "cpu", "C", 1, 2.5, 0x3FC00000, 0, 1 << 30, (1 << 256) - 1),
        exhaustive.Row("exp", "fast", "cuda", "G", 1, 0.5, 0x3FC00000, 0, 0, (1 << 128) - 1),
    ]
    path = tmp_path / "rows.json"
    exhaustive.save(rows, path)
    monkeypatch.setattr(sys, "argv", ["exhaustive.py", "--rows", str(path)])
    assert exhaustive.main() == 0
    out = capsys.readouterr().out
    assert "C:\n\n| function | default | fast | arguments |" in out
    assert "| `exp` | 0.5 at 1.5 | 2.5 at 1.5, 25 % | all |" in out
    assert "G:\n\n| function | fast | arguments |" in out and "| `exp` | 0.5 at 1.5 | 1/2 |" in out
    rows[0].wrong = 2
    exhaustive.save(rows, path)
    assert exhaustive.main() == 1
    assert "0.5 at 1.5, **2 wrong**" in capsys.readouterr().out


def test_strides_that_are_none(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["exhaustive.py", "--stride", "3"])
    with pytest.raises(SystemExit):
        exhaustive.main()
    assert "--stride is a power of two" in capsys.readouterr().err
