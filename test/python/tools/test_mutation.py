"""The scripts that measure tests: mutants of Python and C++, and what tests run."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / name) for name in ("test/mutation", "test/reliability", "scripts")]

import cpp_mutants  # noqa: E402
import cpp_tests  # noqa: E402
import mutate  # noqa: E402
import page_tables  # noqa: E402
import python_mutants  # noqa: E402

import measure_coverage  # noqa: E402

PACKAGE = '''
import ti

LIMIT = 3


@ti.kernel
def ignored(x):
    return x < 1


def f(a: "0 < 1", b=True):
    """0 < 1"""
    if a < LIMIT and not b:
        a.c = 7
        print(f"{a + 1}")
    elif a:
        raise ValueError("é" * 3)
    pairs = zip(a, b, strict=False)
    return "é" if a is None else [a + 1, a == 2]
'''


def test_python_mutants_are_single_changes_of_code_that_python_runs(tmp_path):
    (tmp_path / "one.py").write_text(PACKAGE)
    found = python_mutants.mutants(tmp_path)
    changes = {(one.before, one.after) for one in found}
    assert changes >= {
        ("a < LIMIT", "(a <= LIMIT)"), ("a < LIMIT and not b", "(a < LIMIT or not b)"),
        ("not b", "(b)"), ("a.c = 7", "pass"), ("7", "8"), ("a", "(not a)"), ("2", "3"),
        ("a is None", "(a is not None)"), ("a + 1", "(a - 1)"), ("a == 2", "(a != 2)"),
        ('print(f"{a + 1}")', "pass"),
    }  # fmt: skip
    # Kernels, annotations, texts, errors and assertions of lengths are not mutated.
    assert "False" not in {b for b, _ in changes}
    assert not any("x < 1" in b or "0 < 1" in b or b in ("LIMIT", "3") for b, _ in changes)
    for one in found:
        text = one.apply(PACKAGE.encode()).decode()
        ast.parse(text)
        assert text != PACKAGE and one.name.startswith(f"one.py:{one.line}: {one.kind}: ")


def test_a_python_mutant_runs_the_tests_of_its_line(tmp_path):
    """One is killed, one never ends, one survives; the file is as before each time."""
    package = tmp_path / "tai"
    package.mkdir()
    text = "def f(a):\n    while a < 3:\n        a += 1\n    return a\n\n\ndef g():\n    return 1\n"
    (package / "one.py").write_text(text)
    (package / "__init__.py").touch()
    tests = tmp_path / "test/python"
    tests.mkdir(parents=True)
    (tests / "test_one.py").write_text(
        "from tai.one import f\n\n\ndef test_f():\n    assert f(0) == 3\n\n\n"
        "def test_weak():\n    assert f(7)\n"
    )

    class Lines(python_mutants.Tests):
        def __init__(self, *names):
            self.root, self.seconds, self.counts = tmp_path, {}, dict.fromkeys(names, 1)
            self.files = {"test_one": "test/python/test_one.py"}
            self.lines = {"one.py": {k: list(names) for k in range(1, 5)}}

    both = Lines("test_one.test_weak", "test_one.test_f")
    found = {(one.before, one.after): one for one in python_mutants.mutants(tmp_path / "tai")}

    def judge(change, lines, budget=5.0):
        row = python_mutants.judge(found[change], lines, package, tmp_path, budget)
        assert (package / "one.py").read_text() == text
        return row["outcome"]

    assert judge(("a < 3", "(a <= 3)"), both) == "killed"
    assert judge(("a < 3", "(a <= 3)"), Lines("test_one.test_weak")) == "survived"
    assert judge(("a += 1", "pass"), Lines("test_one.test_f"), budget=-11.9) == "timeout"
    assert judge(("3", "4"), both) == "killed"
    other = python_mutants.Mutant("one.py", 8, "constant", text.index("1\n", 60), 61, "1", "2")
    assert python_mutants.judge(other, both, package, tmp_path, 5)["outcome"] == (
        "not run by any test"
    )


def test_seconds_of_tests_are_added_up():
    log = ("0.50s call     test/python/ad/test_a.py::test_one[1]\n"
           "0.25s setup    test/python/ad/test_a.py::test_one[2]\n"
           "2.00s call     test/python/ad/test_b.py::TestC::test_two\n")  # fmt: skip
    assert python_mutants.read_seconds(log) == {"test_a.test_one": 0.75, "test_b.TestC.test_two": 2}


SOURCE = """\
int count;
static void note(int n) { count += n; }
enum { Three = 3 };
bool both(bool a, bool b) { return a && b; }
bool either(bool a, bool b) { return a || b; }
bool below(int a, int b) { return a < b; }
int sum(int a, long b) {
  constexpr int four = 3 + 1;
  switch (a) {
  case Three: return a + 1;
  case 4: return four;
  }
  if (a)
    note(2);
  else
    note(3);
  for (int k = 0; k != 2; ++k) {
    if (k == 1)
      continue;
    note(int(b));
  }
  return a == 7 ? 1 : count;
}
"""
MAIN = """
#include <cstdio>
int main() {
  int bits = both(true, true) + 2 * both(true, false) + 4 * either(true, false)
             + 8 * either(false, false) + 16 * below(1, 2) + 32 * below(2, 2);
  std::printf("%d %d %d %d", bits, sum(0, 5), sum(1, 5), sum(3, 5));
}
"""


@pytest.mark.skipif(
    not importlib.util.find_spec("clang") or not Path(cpp_mutants.LIBCLANG).exists(),
    reason="needs libclang and its Python module (pip install libclang==18.1.1)",
)
def test_one_build_holds_all_cpp_mutants(tmp_path):
    """Without a mutant it is the program; each kind changes it; reached mutants are noted."""
    for tree in ("tree", "copy"):
        (tmp_path / tree / "lib/AD").mkdir(parents=True)
    source = tmp_path / "tree/lib/AD/one.cpp"
    source.write_text(SOURCE)
    build = tmp_path / "tree/build"
    build.mkdir()
    command = {"file": str(source), "command": f"clang++-22 -std=c++17 -o x.o -c {source}",
               "directory": str(build)}  # fmt: skip
    (build / "compile_commands.json").write_text(json.dumps([command]))
    copy = tmp_path / "copy"
    found = cpp_mutants.mutate_sources(tmp_path / "tree", build, copy, ["AD"])
    assert cpp_mutants.read_mutants(copy) == found
    text = (copy / "lib/AD/one.cpp").read_text()
    assert "constexpr int four = 3 + 1;" in text and "case 4:" in text and "Three = 3" in text
    (copy / "main.cpp").write_text(text + MAIN)
    program = copy / "main"
    sources = [copy / "main.cpp", copy / "lib/AD/TaiMutant.cpp"]
    subprocess.run(["clang++-22", "-std=c++17", *sources, "-o", program], check=True)

    def run(**variables):
        done = subprocess.run([program], env=os.environ | variables, capture_output=True, text=True)
        return done.stdout

    plain = run()
    assert plain == "21 8 15 4"
    kinds = {one.kind for one in found}
    assert kinds >= {"and or", "comparison", "statement", "condition", "arithmetic", "constant"}
    changed = {one.number for one in found if run(TAI_MUTANT=str(one.number)) != plain}
    for kind in kinds:
        assert changed & {one.number for one in found if one.kind == kind}, kind
    seen = copy / "seen"
    seen.write_bytes(bytes(len(found)))
    assert run(TAI_MUTANT_SEEN=str(seen)) == plain
    reached = set(cpp_mutants.numbers_in(seen.read_bytes()))
    assert changed <= reached


def test_quick_tests_of_a_cpp_mutant_run_first(tmp_path):
    notes = tmp_path / "reach.jsonl"
    rows = [("lit", "slow", 9.0, True, [1]), ("lit", "quick", 0.1, True, [1, 2]),
            ("lit", "broken", 0.1, False, [1, 3]), ("gtest", "A.b", 0.1, True, [1])]  # fmt: skip
    keys = ("kind", "test", "seconds", "passed", "numbers")
    notes.write_text("".join(json.dumps(dict(zip(keys, row, strict=True))) + "\n" for row in rows))
    reached = cpp_tests.Reached([notes, tmp_path / "none"])
    assert [test.name for test in reached.choose(1, "lit", 20)] == ["quick", "slow"]
    assert [test.name for test in reached.choose(1, "lit", 5)] == ["quick"]
    assert [test.name for test in reached.choose(1, "gtest", 5)] == ["A.b"]
    # A test that fails without a mutant says nothing about one.
    assert reached.choose(3, "lit", 5) == []


def test_explained_survivors_count_wherever_their_line_is(tmp_path, monkeypatch):
    import soak

    monkeypatch.setattr(mutate, "TABLE", tmp_path / "mutants.csv")
    monkeypatch.setattr(mutate, "SURVIVORS", tmp_path / "survivors.csv")
    monkeypatch.setattr(soak, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(soak, "RESULTS", {"cpu": tmp_path / "cpu.csv", "gpu": tmp_path / "gpu.csv"})
    monkeypatch.setattr(soak, "scripts", dict)
    (tmp_path / "survivors.csv").write_text("mutant,reason\na.py: comparison: x -> y,the same\n")
    results = tmp_path / "results.jsonl"
    outcomes = [("a.py:7: comparison: x -> y", "survived"),
                ("a.py:8: comparison: z -> y", "killed"),
                ("b.py:1: constant: 1 -> 2", "timeout"), ("b.py:2: constant: 1 -> 2", "survived"),
                ("c.py:3: negation: not x -> x", "not run by any test")]  # fmt: skip
    with results.open("w") as file:
        for name, outcome in outcomes:
            row = {"name": name, "outcome": outcome, "part": "python/tai", "all": 90, "seed": 4}
            file.write(json.dumps(row) + "\n")
    monkeypatch.setattr(sys, "argv", ["mutate.py", "table", str(results), "--commit", "0123456"])
    assert mutate.main() == 0
    (row,) = page_tables.read(mutate.TABLE)
    numbers = ("killed", "explained", "survived", "not_run")
    assert [row[name] for name in numbers] == ["2", "1", "1", "1"]
    assert "| python/tai | 5 of 90, seed 4 | 60.0 % | 2 | 1 | 1 | 1 |" in soak.PAGE.read_text()


def test_every_explained_survivor_names_a_file_and_gives_a_reason():
    for name, reason in mutate.explanations().items():
        file = name.partition(":")[0]
        assert (ROOT / file).exists() or (ROOT / "python/tai" / file).exists(), name
        assert len(reason) > 10, name


def test_counts_of_clang_are_added_up_by_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(measure_coverage, "ROOT", tmp_path)
    files = []
    for name, lines, branches in (("AD/Reverse/a.cpp", (10, 9), (4, 3)),
                                  ("ADdition/b.cpp", (5, 5), (0, 0))):  # fmt: skip
        path = tmp_path / "lib" / name
        path.parent.mkdir(parents=True)
        path.write_text("\n  if (a && b)\n")
        summary = {key: {"count": value[0], "covered": value[1]}
                   for key, value in (("lines", lines), ("branches", branches))}  # fmt: skip
        regions = [[2, 7, 2, 8, 3, 2, 0, 0, 4], [2, 12, 2, 13, 3, 0, 0, 0, 4]]
        files.append({"filename": str(path), "summary": summary,
                      "branches": regions if "AD/" in name else []})  # fmt: skip
    counts = measure_coverage.read_cpp({"files": files}, [])
    assert counts["lib"] == {"lines": 15, "lines_run": 14, "branches": 4, "branches_run": 3}
    assert counts["lib/AD"] == {"lines": 10, "lines_run": 9, "branches": 4, "branches_run": 3}
    assert set(measure_coverage.read_cpp({"files": files}, ["AD"])) == {"lib/{AD}", "lib/AD"}
    assert measure_coverage.uncovered({"files": files}) == [
        "lib/AD/Reverse/a.cpp:2:12: never false: if (a && b)"
    ]


def test_the_names_that_are_left_out_exist():
    for name in measure_coverage.LEFT_OUT:
        assert (ROOT / "test/python" / name).exists()
    for name in measure_coverage.FOLDERS:
        assert (ROOT / "lib" / name).is_dir()
