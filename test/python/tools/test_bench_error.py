"""The benchmark of run time against error: one kernel in two modes, and its gates."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks" / "error"))

import compare
import gates
import modes
import page
import rows as table
import solve_to

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "benchmarks" / "error"
SECONDS = 200


def start(script, *options):
    environment = os.environ | {"PYTHONPATH": str(ROOT / "python")}
    command = [sys.executable, str(FOLDER / script), *map(str, options)]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=SECONDS
    )  # fmt: skip


def measured(folder, *options):
    """A small run; `(rows by mode, printed output)`."""
    out = folder / "rows.csv"
    done = start(
        "run.py", "--size", "tiny", "--scenes", "sin", "--systems", "tai", "--modes", "f64;f32",
        "--budget", "0.1", "--runs", "5", "--out", out, "--work", folder / "work", *options,
    )  # fmt: skip
    assert out.is_file(), done.stdout + done.stderr
    with out.open(newline="") as stream:
        return list(csv.DictReader(stream)), done


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("error")
    return folder, *measured(folder)


def test_columns_and_order(run):
    _, rows, _ = run
    by_mode = {row["mode"]: row for row in rows}
    assert set(by_mode) == {"f64", "f32"}
    f32, f64 = by_mode["f32"], by_mode["f64"]
    for row in rows:
        assert row["status"] == "ok", row["reason"]
        assert float(row["p10"]) <= float(row["ms"]) <= float(row["p90"])
        assert float(row["least"]) > 0 and float(row["peak_mb"]) > 1
        assert row["distinct"] == "1" and row["runs"] == "20" and row["nan_count"] == "0"
        assert row["launches"] == "2"
    # Numbers of f32 against 80 bits: half an ulp and a bit of each type.
    assert 2e-9 < float(f32["grad_rel"]) < 2e-7 and float(f64["grad_rel"]) < 1e-15
    assert float(f64["loss_rel"]) < float(f32["loss_rel"])
    assert 0.3 < float(f32["max_ulp"]) < 4 and float(f64["max_ulp"]) < 4


def test_the_page_says_what_was_measured(run):
    folder, rows, _ = run
    text = (folder / "work" / "accuracy.md").read_text()
    for row in rows:
        of_scene = (folder / "work" / "accuracy" / "sin.md").read_text()
        assert f"| tai, {row['mode']} | {float(row['ms']):.3g} |" in of_scene
    assert "No peer was measured." in of_scene
    assert "| f32 strict | not measured | |" in text
    assert "No peer was measured." in text
    assert "| finite in, finite out | 2 (2) |" in text
    assert "[sin](accuracy/sin.md)" in text
    questions = [line for line in text.splitlines() if line.startswith("## ")]
    assert len(questions) == 4
    assert len(text.splitlines()) <= 150
    picture = folder / "work" / "accuracy-cpu-1-tiny.png"
    assert picture.read_bytes().startswith(b"\x89PNG") or "no pictures" in text


def test_a_run_goes_on_where_it_stopped(run, tmp_path):
    """Rows that are there are kept, a row that failed is measured again, a cut one is dropped."""
    _, rows, _ = run
    out = tmp_path / "rows.csv"
    marked = [dict(rows[0], ms="123", p10="123", p90="123"), dict(rows[1], status="failed")]
    with out.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(marked)
        stream.write("sin,tiny,tai,f32 str")
    again, _ = measured(tmp_path, "--resume")
    assert {(row["mode"], row["status"]) for row in again} == {("f64", "ok"), ("f32", "ok")}
    assert [row["ms"] for row in again if row["mode"] == rows[0]["mode"]] == ["123"]
    assert [row["ms"] for row in again if row["mode"] == rows[1]["mode"]] != ["123"]


def test_a_mode_that_is_missing_loses_no_other(tmp_path):
    """A system that the build or the machine lacks stands in the table with its reason."""
    rows, done = measured(tmp_path, "--systems", "tai,jax", "--peers", tmp_path / "nowhere")
    found = {(row["system"], row["mode"]): row for row in rows}
    assert found["jax", "f32"]["status"] == "missing"
    assert "no environment of peers" in found["jax", "f32"]["reason"]
    assert found["tai", "f32"]["status"] == "ok"


def test_rows_of_a_card_from_two_machines(run):
    """One table for a card; what modes cost is compared on one machine alone."""
    (base, *_) = table.read(run[0] / "rows.csv")
    base |= {"arch": "cuda", "threads": "all"}
    found = []
    several = ["f32", "f64", "f64 compensated"]
    for cores, ms, names in ((16, 1.0, several), (32, 5.0, ["f32", "f16 storage"])):
        for name in names:
            machine = f"A processor, {cores} cores, H200"
            found.append(dict(base, mode=name, ms=ms, least=ms, machine=machine))
    ((where, group),) = page.merged(page.groups_of(found)).items()
    assert where[1] == "H200"
    times = {row["mode"]: row["ms"] for row in group}
    assert times == {"f32": 1.0, "f64": 1.0, "f64 compensated": 1.0, "f16 storage": 5.0}
    outcome = {gate.name: gate.found for gate in gates.judge(found)}
    assert len(outcome["compensated sums cost at most 30 %"]) == 1


def peer_row(row, **more):
    return dict(row, system="jax", mode="f64") | more


def test_a_peer_is_dominated_but_for_noise(run):
    """At least as fast, and as exact: errors below a floor, and a few per cent, are equal."""
    (base, *_) = table.read(run[0] / "rows.csv")
    ours = [base | {"ms": 1.0, "p10": 0.9, "p90": 1.1, "loss_rel": 0.0, "grad_rel": 9e-16}]
    same = {"ms": 1.0, "p10": 0.9, "p90": 1.1, "loss_rel": 0.0}
    assert page.is_matched(peer_row(base, **same, grad_rel=0.0), ours)
    ours[0]["grad_rel"] = 1.04e-7
    assert page.is_matched(peer_row(base, **same, grad_rel=1e-7), ours)
    assert not page.is_matched(peer_row(base, **same, grad_rel=0.9e-7), ours)
    assert not page.is_matched(peer_row(base, **same, grad_rel=1e-7) | {"ms": 0.9}, ours)
    text = page.loss_of(ours)(peer_row(base, **same, grad_rel=1e-7) | {"ms": 0.5, "p90": 0.6})
    assert text.endswith("takes 2.00 times as long)")


def test_the_fastest_mode_is_faster_than_the_spread(run):
    (base, *_) = table.read(run[0] / "rows.csv")
    row = base | {"loss_rel": 0.0, "grad_rel": 1e-8, "p10": 0.9, "p90": 1.1}
    group = [row | {"mode": "f32 ftz", "ms": 0.98}, row | {"mode": "f32", "ms": 1.0}]
    assert page.fastest(group, 1e-4)["mode"] == "f32"
    group[0] |= {"ms": 0.5, "p10": 0.4, "p90": 0.6}
    assert page.fastest(group, 1e-4)["mode"] == "f32 ftz"
    assert page.fastest(group, 1e-9) is None


def test_losses_of_range_are_in_no_average(run):
    (base, *_) = table.read(run[0] / "rows.csv")
    found = [base | {"mode": "f32", "grad_rel": 1e-7, "loss_rel": 0.0},
             base | {"mode": "f16 storage", "grad_rel": 1e35, "loss_rel": 0.0}]  # fmt: skip
    lines = page.prices(page.groups_of(found))
    (line,) = [line for line in lines if line.startswith("| f16 storage")]
    assert "overflow in 1" in line and "e+35" not in line


# Two builds


def side(ms, error, count=5, **more):
    rows = [{"status": "ok", "ms": ms * (1 + 0.001 * k), "loss_rel": 0.0, "grad_rel": error}
            for k in range(count)]  # fmt: skip
    return [row | more for row in rows]


@pytest.mark.parametrize(
    "base, new, outcome",
    [
        (side(1, 1e-7), side(1.04, 1e-7), "ok"),
        (side(1, 1e-7), side(1.06, 1e-7), "FAILS"),
        (side(1, 1e-7), side(0.5, 3e-7), "ok"),
        (side(1, 1e-7), side(0.5, 3.3e-7), "FAILS"),
        (side(1, 1e-17), side(1, 9e-16), "ok"),
        (side(1, 1e-7), side(1, float("nan")), "FAILS"),
        (side(1, 1e-7), side(1, 1e-7, status="failed", reason="why"), "FAILS"),
        (side(1, 1e-7, 1), side(2, 1e-7, 1), "not judged"),
    ],
)
def test_two_builds_are_judged(base, new, outcome):
    assert compare.judge(base, new)[0] == outcome


def test_a_slow_build_within_the_spread_is_none():
    """A median that is greater by chance: the quartiles overlap."""
    base = [row for ms in (1.0, 1.3, 1.0, 1.3, 1.0) for row in side(ms, 1e-7, 1)]
    new = [row for ms in (1.2, 1.0, 1.2, 1.2, 1.0) for row in side(ms, 1e-7, 1)]
    assert compare.judge(base, new)[0] == "ok"


def test_a_build_against_itself():
    done = start("compare.py", ROOT, "--scenes", "sin", "--modes", "f32", "--size", "tiny",
                 "--rounds", "2")  # fmt: skip
    assert "sin, f32: error" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize(
    "options, text",
    [
        (["nowhere"], "is no checkout of tai"),
        ([ROOT, "--scenes", "sinus"], "unknown scene 'sinus'"),
        ([ROOT, "--modes", "f31"], "unknown mode 'f31'"),
    ],
)
def test_two_builds_of_nothing(options, text):
    done = start("compare.py", *options)
    assert done.returncode == 2 and text in done.stderr


# An error that is asked for


@pytest.mark.parametrize(
    "change, outcome",
    [
        ({}, "in the band"),
        ({"true": 1.01e-4}, "FAILS: more error than asked"),
        ({"iterations": 21}, "FAILS: iterations"),
        ({"ratio": 1.21}, "FAILS: slower than the best"),
        ({"true": 4e-6}, "no cheaper mode"),
        ({"true": 4e-6, "modes": {"steps": 4}}, "FAILS: room is left"),
        ({"refused": "why"}, "refused"),
    ],
)
def test_choices_are_judged(change, outcome):
    row = {"true": 5e-5, "asked": 1e-4, "iterations": 20, "ratio": 1.2, "modes": {}}
    assert solve_to.verdict(row | change) == outcome


def test_choices_of_nothing():
    done = start("solve_to.py", "--scenes", "wavy")
    assert done.returncode == 2 and "unknown scene 'wavy'" in done.stderr


# Gates


def good_rows(rows):
    """A table in which every bar is kept, made of one measured row."""
    base = dict(rows[0], status="ok", reason="", size="full")
    found = []
    for scene in ("sum_ill", "one_cell", "exp"):
        for mode in modes.TAI:
            wide = mode.bits == 64
            row = dict(base, scene=scene, mode=mode.name, max_ulp="0.5")
            row |= {"loss_rel": 1e-15 if wide else 1e-8, "grad_rel": 1e-16 if wide else 1e-8}
            row |= {"ms": 2 if wide else 1, "least": 2 if wide else 1}
            found.append(row)
    return found


def judged(folder, rows):
    path = folder / "judged.csv"
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return gates.main([str(path)])


def test_gates_that_are_kept(run, tmp_path, capsys):
    status = judged(tmp_path, good_rows(run[1]))
    text = capsys.readouterr().out
    assert status == 0, text
    assert "FAILS" not in text and "not judged" not in text


@pytest.mark.parametrize(
    "scene, mode, column, value, gate",
    [
        ("exp", "f32 unguarded", "least", 0.9, "guards cost at most 2 %"),
        ("exp", "f32 compensated", "least", 1.4, "compensated sums cost at most 30 %"),
        ("one_cell", "f32 deterministic", "least", 1.6, "deterministic costs at most"),
        ("exp", "f32 deterministic", "least", 3.1, "deterministic costs at most"),
        ("exp", "f32", "least", 2.1, "f64 is never as fast as f32"),
        ("sum_ill", "f32", "loss_rel", 3e-4, "f32 sum at condition 1e6"),
        ("sum_ill", "f32 compensated", "loss_rel", 2e-7, "compensated f32 sum"),
        ("one_cell", "f32", "loss_rel", 2e-5, "f32 numbers into one cell"),
        ("one_cell", "f32 compensated", "loss_rel", 2e-7, "compensated f32 numbers"),
        ("one_cell", "f64", "loss_rel", 2e-13, "f64 numbers into one cell"),
        ("exp", "f32 accurate", "max_ulp", 1.2, "accurate maps"),
        ("exp", "f32 deterministic", "distinct", 2, "deterministic: one result"),
        ("exp", "f32", "nan_count", 1, "finite in, finite out"),
        ("exp", "f32", "status", "failed", "no scene fails"),
        ("sum_ill", "f32", "loss_rel", "nan", "f32 sum at condition 1e6"),
    ],
)
def test_gates_that_are_not(run, tmp_path, capsys, scene, mode, column, value, gate):
    rows = good_rows(run[1])
    for row in rows:
        if (row["scene"], row["mode"]) == (scene, mode):
            row[column] = value
    assert judged(tmp_path, rows) == 1
    text = capsys.readouterr().out
    failing = [line for line in text.splitlines() if line.startswith("FAILS")]
    assert any(gate in line for line in failing), text


def test_a_mode_on_no_front_is_named(run, tmp_path, capsys):
    rows = good_rows(run[1])
    for row in rows:
        if row["mode"] == "f32 ftz":
            row["ms"] = 1.5
    assert judged(tmp_path, rows) == 1
    assert "f32 ftz is on none" in capsys.readouterr().out


def test_gates_of_nothing_are_not_kept(run, tmp_path, capsys):
    """A bar that nothing was measured for does not pass."""
    rows = [row for row in good_rows(run[1]) if row["mode"] != "f32 compensated"]
    assert judged(tmp_path, rows) == 1
    assert "not judged compensated f32 sum at condition 1e6" in capsys.readouterr().out


def test_a_table_that_is_none(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("scene,mode\nexp,f32\n")
    done = start("gates.py", path)
    assert done.returncode == 2 and "has no column" in done.stderr


def test_the_reference_has_all_its_digits():
    """f64 against numbers of 50 digits, where kernels are Python functions."""
    done = start("exact.py", "--scenes", "wave,electric,scatter,polar")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("f64 is off by") == 4
