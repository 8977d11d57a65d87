"""The benchmark of run time against error: one kernel in two modes, and its gates."""

import csv
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks" / "error"))

import compare
import gates
import modes
import needed
import page
import references
import rows as table
import solve_to

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "benchmarks" / "error"
SECONDS = 200
# Other benchmarks have a module `run`, too.
SPEC = importlib.util.spec_from_file_location("bench_error_run", FOLDER / "run.py")
bench = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(bench)


def start(script, *options):
    environment = os.environ | {"PYTHONPATH": str(needed.PACKAGE)}
    command = [sys.executable, str(FOLDER / script), *map(str, options)]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=SECONDS
    )  # fmt: skip


def measured(folder, *options):
    """A small run; `(rows by mode, printed output)`."""
    out = folder / "rows.csv"
    done = start(
        "run.py", "--size", "tiny", "--scenes", "sin", "--systems", "tai", "--modes", "f64;f32",
        "--rounds", "3", "--inputs", "4", "--slice", "1", "--out", out, "--work", folder / "work",
        "--no-page", *options,
    )  # fmt: skip
    assert out.is_file(), done.stdout + done.stderr
    with out.open(newline="") as stream:
        return list(csv.DictReader(stream)), done


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("error")
    return folder, *measured(folder)


@pytest.fixture
def base(run):
    """A measured row, of a clean commit."""
    row = table.read(run[0] / "rows.csv")[0]
    return row | {"git": "0123abcd", "machine": "AMD EPYC, 2 cores"}


def test_columns_and_order(run):
    _, rows, _ = run
    by_mode = {row["mode"]: row for row in rows}
    assert set(by_mode) == {"f64", "f32"}
    f32, f64 = by_mode["f32"], by_mode["f64"]
    for row in rows:
        assert row["status"] == "ok", row["reason"]
        assert float(row["q1"]) <= float(row["ms"]) <= float(row["q3"])
        assert float(row["error_low"]) <= float(row["error"]) <= float(row["error_high"])
        assert float(row["least"]) > 0 and float(row["peak_mb"]) > 1
        assert row["distinct"] == "1" and row["runs"] == "20" and row["nan_count"] == "0"
        assert row["launches"] == "2" and row["inputs"] == "5" and row["rounds"] == "3"
        assert 0 < float(row["reference_error"]) < 2e-16 and float(row["condition"]) > 0
    assert len({row["session"] for row in rows}) == 1
    # Numbers of f32 against 80 bits: half an ulp and a bit of each type.
    assert 2e-9 < float(f32["grad_rel"]) < 2e-7 and float(f64["grad_rel"]) < 1e-15
    assert float(f64["error_high"]) < float(f32["error_low"])
    assert 0.3 < float(f32["max_ulp"]) < 4 and float(f64["max_ulp"]) < 4


@pytest.mark.parametrize(
    "arguments",
    [
        ["--quick"],
        ["--scenes", "exp,wave"],
        ["--systems", "tai"],
        ["--modes", "f32"],
        ["--out", "x"],
    ],
)
def test_a_part_replaces_no_page(arguments, tmp_path):
    given = bench.parse([*arguments, "--work", str(tmp_path)])
    assert given.page == tmp_path / "page"


def test_the_whole_replaces_the_page(tmp_path):
    assert bench.parse(["--minutes", "8", "--work", str(tmp_path)]).page is None


def written(folder, rows):
    """The text that makes a page of rows, and its folder."""
    path = folder / "made.csv"
    table.write(path, rows)
    return page.make([path], folder / "page"), folder / "page"


def test_the_page_says_what_was_measured(run, tmp_path):
    rows = [row | {"git": "0123abcd"} for row in table.read(run[0] / "rows.csv")]
    said, folder = written(tmp_path, rows)
    assert said.startswith(str(folder / "accuracy.md")), said
    text = (folder / "accuracy.md").read_text()
    of_scene = (folder / "accuracy" / "sin.md").read_text()
    for row in rows:
        assert f"| tai, {row['mode']} | {row['ms']:.3g} | {row['q1']:.3g} – " in of_scene
    assert "No peer was measured." in of_scene and "error of the reference" in of_scene
    assert "| f32 strict | not measured | |" in text
    assert "No peer was measured." in text
    assert "| finite in, finite out | 2 (2) |" in text
    assert "[sin](accuracy/sin.md)" in text
    assert "5 inputs and 3 rounds. Errors of the references: at most 1e-15 in 1 of 1" in text
    questions = [line for line in text.splitlines() if line.startswith("## ")]
    assert len(questions) == 4
    assert len(text.splitlines()) <= 150
    picture = folder / "accuracy" / "sin.png"
    assert "no matplotlib" in said or picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "change, reason",
    [
        ({"git": "0123abcd-dirty"}, "a tree with changes"),
        ({"git": "9999aaaa"}, "rows are of 2 commits: 0123abcd, 9999aaaa"),
        ({"session": "another"}, "one thread"),
    ],
)
def test_a_page_of_mixed_rows_is_refused(base, tmp_path, change, reason):
    said, folder = written(tmp_path, [base, base | {"mode": "f32"} | change])
    expected = "are of 2 sessions" if "session" in change else reason
    assert said.startswith("no page: ") and expected in said
    assert not folder.exists()


def test_two_machines_and_places_make_a_page(base, tmp_path):
    other = {"arch": "cuda", "threads": "all", "machine": "Xeon, 16 cores, H200", "session": "b"}
    said, folder = written(tmp_path, [base, base | other])
    assert not said.startswith("no page")
    assert "## H200" in (folder / "accuracy" / "sin.md").read_text()


def test_a_mode_that_is_missing_loses_no_other(tmp_path):
    """A system that the build or the machine lacks stands in the table with its reason."""
    peers = tmp_path / "peers"
    (peers / "bin").mkdir(parents=True)
    (peers / "bin" / "python").write_text("#!/bin/sh\nexit 3\n")
    (peers / "bin" / "python").chmod(0o755)
    rows, done = measured(tmp_path, "--systems", "tai,jax", "--modes", "f32", "--peers", peers)
    found = {(row["system"], row["mode"]): row for row in rows}
    assert found["jax", "f32"]["status"] == "failed"
    assert "exit status 3" in found["jax", "f32"]["reason"]
    assert found["tai", "f32"]["status"] == "ok"


# A system that answers as measure.py does, and has a thread at work all the time.
RESTLESS = """#!{python}
import json, os, sys, threading, time
beats, parts = [], []

def work():
    while True:
        beats.append(time.monotonic())
        for _ in range(1000):
            pass

print(json.dumps(dict(status="ok", seconds=0.01, version="1", clock="wall")), flush=True)
for line in sys.stdin:
    begin, request = time.monotonic(), json.loads(line)["do"]
    if request == "warm":
        threading.Thread(target=work, daemon=True).start()
    if request == "time":
        while time.monotonic() - begin < 0.03:
            pass
        parts.append((begin, time.monotonic()))
    print(json.dumps(dict(ms=1.0, least=1.0, n=1)), flush=True)
with open(f"{folder}/{{os.getpid()}}.json", "w") as file:
    json.dump(dict(beats=list(beats), parts=parts), file)
"""


def test_nothing_else_runs_while_a_time_is_taken(tmp_path):
    peers = tmp_path / "peers"
    (peers / "bin").mkdir(parents=True)
    script = RESTLESS.format(python=sys.executable, folder=peers)
    (peers / "bin" / "python").write_text(script)
    (peers / "bin" / "python").chmod(0o755)
    rows, _ = measured(tmp_path, "--systems", "jax", "--peers", peers)
    assert [row["rounds"] for row in rows] == ["3", "3"]
    first, second = (json.loads(path.read_text()) for path in peers.glob("*.json"))
    for timed, other in ((first, second), (second, first)):
        assert len(timed["parts"]) == 3 and other["beats"]
        for begin, end in timed["parts"]:
            assert any(begin < beat < end for beat in timed["beats"])
            assert not [beat for beat in other["beats"] if begin < beat < end]


def test_a_run_without_time_says_so(tmp_path):
    rows, _ = measured(tmp_path, "--minutes", "0.01")
    assert {(row["status"], row["reason"]) for row in rows} == {("missing", "no time was left")}


def peer_row(row, **more):
    return dict(row, system="jax", mode="f64") | more


def timed(ms, spread=0.1):
    return {"ms": ms, "q1": ms - spread, "q3": ms + spread}


def wrong(error, low=None, high=None):
    found = {"error": error, "error_low": error if low is None else low}
    return found | {"error_high": error if high is None else high}


def test_a_peer_is_dominated_but_for_the_spread(base):
    """As fast, and as exact: errors below a floor are equal, and so is what spreads overlap in."""
    ours = [base | timed(1.0) | wrong(9e-16)]
    assert page.standing(peer_row(base) | timed(1.0) | wrong(0.0), ours) == "level"
    assert page.standing(peer_row(base) | timed(1.15) | wrong(0.0), ours) == "level"
    assert page.standing(peer_row(base) | timed(1.25) | wrong(0.0), ours) == "faster"
    assert page.standing(peer_row(base) | timed(0.75) | wrong(0.0), ours) == "lost"
    ours = [base | timed(1.0) | wrong(1e-7)]
    assert page.standing(peer_row(base) | timed(2.0) | wrong(0.9e-7), ours) == "lost"
    near = wrong(0.9e-7, 0.5e-7, 1.1e-7)
    assert page.standing(peer_row(base) | timed(2.0) | near, ours) == "faster"
    text = page.loss_of(ours)(peer_row(base) | timed(0.5) | wrong(1e-7))
    assert text == "jax f64 (f64 takes 2.00 (1.50 to 2.75) times as long)"
    assert page.counted(["faster", "level", "lost"]).startswith("2 of 3 modes of peers")


def test_fronts_are_beyond_the_spread(base):
    fast, exact = base | timed(1.0) | wrong(1e-3), base | timed(2.0) | wrong(1e-9)
    both = base | timed(2.05) | wrong(1e-3)
    assert table.front([fast, exact, both]) == [fast, exact]
    # Neither of two is better by more than the spread.
    near = base | timed(1.05) | wrong(1e-3)
    assert table.front([fast, near]) == [fast, near]


def test_the_fastest_mode_is_faster_than_the_spread(base):
    row = base | wrong(1e-8)
    group = [row | {"mode": "f32 ftz"} | timed(0.98), row | {"mode": "f32"} | timed(1.0)]
    assert page.fastest(group, 1e-4)["mode"] == "f32"
    group[0] |= timed(0.5)
    assert page.fastest(group, 1e-4)["mode"] == "f32 ftz"
    assert page.fastest(group, 1e-9) is None
    # An error of one input is one too many.
    group[0] |= wrong(1e-8, 1e-8, 2e-4)
    assert page.fastest(group, 1e-4)["mode"] == "f32"


def test_losses_of_range_are_in_no_average(base):
    found = [base | {"mode": "f32"} | wrong(1e-7), base | {"mode": "f16 storage"} | wrong(1e35),
             base | {"mode": "bf16 storage"} | wrong(float("inf"))]  # fmt: skip
    groups = page.groups_of(found)
    lines = page.prices(groups)
    for mode in ("f16 storage", "bf16 storage"):
        (line,) = [line for line in lines if line.startswith(f"| {mode}")]
        assert "overflow in 1" in line and "e+35" not in line and "inf" not in line
    text = "\n".join(page.table(*groups.values()))
    assert text.count("| overflow | overflow – overflow |") == 2
    assert all(row["mode"] == "f32" for row in page.marked(found))


# References


def test_inputs_are_an_ulp_off():
    numbers = np.array([1.0, -3.5, 0.0, 1e-30], np.float32)
    same = references.perturbed(numbers.astype(float), 0)
    moved = references.perturbed(numbers.astype(float), 3)
    np.testing.assert_array_equal(same, numbers)
    np.testing.assert_array_equal(moved, moved.astype(np.float32))
    np.testing.assert_array_equal(np.abs(moved - numbers) / np.spacing(np.abs(numbers)),
                                  [1, 1, 0, 1])  # fmt: skip
    assert not np.array_equal(moved, references.perturbed(numbers.astype(float), 4))


@pytest.mark.parametrize("scene", ["wave", "mass_spring", "smoke", "diffmpm"])
def test_shadows_agree_with_an_adjoint_by_hand(scene, tmp_path):
    """Two references of 80 bits that share no code."""
    done = start("references.py", "--scene", scene, "--size", "tiny", "--count", "2",
                 "--out", tmp_path, "--cache", tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    about = json.loads(done.stdout)
    assert about["error"] < 1.2e-16 and "from NumPy in 80 bits" in about["how"]
    known = references.Reference(tmp_path)
    assert known.numbers == [0, 1] and known.condition() > 0
    assert references.relative(known.load(1)["gradient"], known.load(0)["gradient"]) > 1e-12


# Two builds


def side(ms, error, count=5, **more):
    return {"times": [ms * (1 + 0.001 * k) for k in range(count)], "error": error} | more


@pytest.mark.parametrize(
    "base, new, outcome",
    [
        (side(1, 1e-7), side(1.04, 1e-7), "ok"),
        (side(1, 1e-7), side(1.06, 1e-7), "FAILS"),
        (side(1, 1e-7), side(0.5, 3e-7), "ok"),
        (side(1, 1e-7), side(0.5, 3.3e-7), "FAILS"),
        (side(1, 1e-17), side(1, 9e-16), "ok"),
        (side(1, 1e-7), side(1, float("inf")), "FAILS"),
        (side(1, 1e-7), side(1, None, failure={"reason": "why"}), "FAILS"),
        (side(1, 1e-7, 1), side(2, 1e-7, 1), "not judged"),
    ],
)
def test_two_builds_are_judged(base, new, outcome):
    assert compare.judge(base, new)[0] == outcome


def test_a_slow_build_within_the_spread_is_none():
    """A median that is greater by chance: the quartiles overlap."""
    base = {"times": [1.0, 1.3, 1.0, 1.3, 1.0], "error": 1e-7}
    new = {"times": [1.2, 1.0, 1.2, 1.2, 1.0], "error": 1e-7}
    assert compare.judge(base, new)[0] == "ok"


def test_a_build_against_itself():
    done = start("compare.py", ROOT, "--scenes", "sin", "--modes", "f32", "--size", "tiny",
                 "--rounds", "2")  # fmt: skip
    assert "sin, f32: error" in done.stdout, done.stdout + done.stderr


def test_two_builds_in_little_time():
    """A row that is begun is judged; the time of the others is up."""
    done = start("compare.py", ROOT, "--scenes", "sin,exp", "--modes", "f32", "--size", "tiny",
                 "--seconds", "0.5")  # fmt: skip
    assert "sin, f32: error" in done.stdout and "2 rounds" in done.stdout, done.stderr
    assert "not judged exp, f32: no time was left" in done.stdout


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
            row |= wrong(1e-15 if wide else 1e-8) | timed(2 if wide else 1)
            row["least"] = row["ms"]
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
            row |= timed(1.5)
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
