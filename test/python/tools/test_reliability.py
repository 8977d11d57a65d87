"""The bars of reliability in their short form; see test/reliability/README.md."""

import argparse
import contextlib
import io
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import needed

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted((ROOT / "test/reliability").glob("r[0-9]*_*.py"))
BARS = [path for path in SCRIPTS if "Bar(" in path.read_text()]
SHORT = [path for path in BARS if "apart=True" not in path.read_text()]


@pytest.mark.parametrize("script", SHORT, ids=lambda path: path.stem)
def test_bar(script):
    environment = os.environ | {"PYTHONPATH": str(needed.PACKAGE)}
    command = [sys.executable, script, "--short"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200)
    assert result.returncode == 0, result.stdout + result.stderr
    name = script.stem.split("_")[0].upper()
    assert re.search(rf"^{name} .+: .+; .+ \(bar .+\)$", result.stdout, re.MULTILINE), result.stdout


@pytest.mark.parametrize("program, kind", [("while True: pass", "late"), ("input()", "hang")])
def test_a_tool_ends_with_the_time_of_the_run(program, kind):
    """One that computes may be slow on this machine; one that waits would wait for ever."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r1_text_mutants as r1

    reader, writer = os.pipe()
    command = [sys.executable, "-c", program]
    ended = r1.run_limited(command, seconds=100, left=1, stdin=reader, stdout=subprocess.DEVNULL)
    os.close(reader), os.close(writer)
    assert ended[0] == kind


PLANTED = """#!/bin/sh
# A tool that dies of one text and never ends with another.
for last; do case $last in *.mlir) file=$last;; esac; done
grep -q CRASH "$file" && kill -SEGV $$
grep -q HANG "$file" && while :; do :; done
exit 1
"""


@pytest.mark.parametrize("risky", ["", "array<index: 1>"])
def test_the_mutants_that_crash_and_hang_are_found_in_a_batch(tmp_path, monkeypatch, risky):
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r1_text_mutants as r1

    monkeypatch.setattr(r1, "SECONDS", 1)
    tool = tmp_path / "tool"
    tool.write_text(PLANTED)
    tool.chmod(0o755)
    texts = [f"text {number}" for number in range(20)]
    texts[7] = f"CRASH {risky}"
    texts[12] = f"HANG {risky}"
    found = r1.judge_batch(tool, "", texts, tmp_path, lambda: 1000.0)
    assert {text: outcome.kind for text, outcome in found} == {
        texts[7]: f"signal {signal.SIGSEGV}",
        texts[12]: "hang",
    }


DIES_OF_AN_INDEX = """#!/bin/sh
# A tool that cannot read one text, dies of another afterwards, and of a third by a pass.
for last; do case $last in *.mlir) file=$last;; esac; done
grep -q 'array<index' "$file" && kill -SEGV $$
grep -q AFTERWARDS "$file" && kill -SEGV $$
case "$*" in *--pass*) grep -q PASS "$file" && kill -SEGV $$;; esac
exit 1
"""


def test_a_crash_of_the_parser_is_known_without_names_of_functions(tmp_path):
    """A crash without passes is one of the parser, and disappears if the text cannot be parsed."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r1_text_mutants as r1

    tool = tmp_path / "tool"
    tool.write_text(DIES_OF_AN_INDEX)
    tool.chmod(0o755)
    texts = ["array< index: 1>", "array<index: 1>", "array<index: 1> AFTERWARDS", "PASS array<i64>",
             "PASS array<index: 1>"]  # fmt: skip
    found = r1.judge_batch(tool, "--pass", texts, tmp_path, lambda: 1000.0)
    assert {text: bool(outcome.known) for text, outcome in found} == {
        "array<index: 1>": True,
        "array<index: 1> AFTERWARDS": False,
        "PASS array<i64>": False,
        "PASS array<index: 1>": False,
    }


def test_generic_forms_stand_where_their_texts_stood():
    """A text that no parser takes stays as it is."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import bars
    import r1_text_mutants as r1

    tool = bars.build_folder() / "bin/tai-opt"
    texts = ["func.func @one() { return }", "not a module", "func.func @two() { return }", "%"]
    forms = r1.generic_forms(tool, texts)
    assert [forms[1], forms[3]] == ["not a module", "%"]
    for form, name in ((forms[0], "one"), (forms[2], "two")):
        assert '"func.func"' in form and f'"{name}"' in form


@pytest.mark.parametrize("seed", [12493, 15820])
def test_sums_of_narrow_floats_in_modules_are_exact(monkeypatch, seed):
    """300 times one is 300 in f32, and 256 in bf16 where each sum is rounded."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r3_modules as r3

    monkeypatch.setenv("TAI_CUDA_EMULATION", "")
    row = r3.Judge(["interpreter", "O0", "emulated"]).judge(seed)
    assert row["kind"] == "same", row["detail"]


def test_a_module_that_differs_and_one_that_ends_its_process_are_found(monkeypatch):
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r3_modules as r3

    monkeypatch.setenv("TAI_CUDA_EMULATION", "")
    judge = r3.Judge(["interpreter", "O0"])
    seed = next(s for s in range(100) if judge.judge(s)["kind"] == "same")
    run = judge.contexts["O0"].run

    def flip_last_bit(module, inputs):
        found = run(module, inputs)
        values = next(array for array in found.values() if array.size)
        values.view(np.uint8).flat[0] ^= 1
        return found

    judge.contexts["O0"].run = flip_last_bit
    assert judge.judge(seed)["kind"] == "MISMATCH"

    worker = r3.Worker(argparse.Namespace(configurations=["interpreter"]))
    worker.give(seed)
    worker.process.kill()
    worker.process.wait()
    answer = worker.answer(limit=60)
    while answer["kind"] != "CRASH":  # it may have answered before it was killed
        answer = worker.answer(limit=60)
    assert "ended with -9" in answer["detail"]
    worker.end()


def end_of_a_worker(seed, folder):
    """In the place of a program: one ends its process, one never ends."""
    if seed in (3, 5):
        signal.raise_signal(signal.SIGSEGV if seed == 3 else signal.SIGPROF)
    return {"seed": seed, "kind": "agree", "reason": "", "detail": ""}


def test_programs_that_end_their_process_are_found(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "test/fuzz"))
    import workers

    rows = workers.judge_all(end_of_a_worker, list(range(8)), 2, None)
    assert sorted(row["seed"] for row in rows) == list(range(8))
    assert {row["seed"]: row["reason"] for row in rows if row["kind"] == "FAIL"} == {
        3: f"the process died ({-signal.SIGSEGV})",
        5: "timeout",
    }


@pytest.fixture
def cold_kernels():
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import cold_kernels

    return cold_kernels


def test_harm_done_by_a_kill_is_found(cold_kernels, tmp_path, monkeypatch):
    import r6_kills as r6

    entries = cold_kernels.entries

    def damage_first(cache):
        found = entries(cache)
        if found:
            found[0].write_bytes(b"half of it")
        return found

    assert r6.judge(0, tmp_path / "a", 1e9, False, Counter()) == []
    monkeypatch.setattr(cold_kernels, "entries", damage_first)
    problems = r6.judge(0, tmp_path / "b", 1e9, False, Counter())
    assert any("says" in problem for problem in problems)
    monkeypatch.setattr(cold_kernels, "entries", entries)
    monkeypatch.setattr(cold_kernels, "expected", lambda first, count: [])
    problems = r6.judge(0, tmp_path / "a", 1e9, True, Counter())
    assert len([one for one in problems if "wrong numbers" in one]) == 2


def test_a_damaged_entry_that_is_used_is_found(cold_kernels, tmp_path):
    """One that is whole in its place, of which the run says nothing."""
    import r8_damaged_entries as r8

    cold_kernels.run(0, 2, tmp_path)
    assert [one.split(":")[0] for one in r8.judge(tmp_path, 2, damaged=1)] == [
        "1 damaged, 0 compiled",
        "0 warnings",
    ]
    cold_kernels.entries(tmp_path)[0].write_bytes(b"cut")
    assert r8.judge(tmp_path, 2, damaged=1) == []


@pytest.fixture
def soak():
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import soak

    return soak


def make_row(soak, met, cases, commit, version="v"):
    row = dict.fromkeys(soak.COLUMNS, "")
    return row | {"met": met, "cases": cases, "commit": commit, "version": version}


def test_cases_of_runs_add_up_until_one_misses(soak):
    first = make_row(soak, "yes", "292 modules", "a")
    soak.add_up(first, None, 0, adds=True)
    second = make_row(soak, "yes", "1000 modules (3 large)", "b")
    soak.add_up(second, first, 292, adds=True)
    assert (second["total"], second["next"], second["commit"]) == ("1292", "1292", "a b")
    assert soak.show_cases(second) == "1292 modules, in 2 runs"
    assert soak.show(second, 1292).startswith("met") and soak.show(second, 1293).startswith("no ")
    # The same commit is named once; other cases do not count.
    third = make_row(soak, "yes", "8 modules", "b")
    soak.add_up(third, second, 1292, adds=True)
    assert (third["total"], third["commit"], third["runs"]) == ("1300", "a b", "3")
    changed = make_row(soak, "yes", "8 modules", "c", "w")
    soak.add_up(changed, third, 1300, adds=True)
    assert (changed["total"], changed["commit"], changed["runs"]) == ("8", "c", "1")
    # The seed that missed is drawn again by the next run, which begins the count anew.
    missed = make_row(soak, "no", "70 modules", "c")
    soak.add_up(missed, third, 1300, adds=True)
    assert (missed["total"], missed["next"]) == ("0", "1300")
    assert soak.show(missed, 20).startswith("**missed**")
    mended = make_row(soak, "yes", "70 modules", "d")
    soak.add_up(mended, missed, 1300, adds=True)
    assert (mended["total"], mended["next"], mended["commit"]) == ("70", "1370", "d")


def test_cases_that_are_the_same_each_time_do_not_add_up(soak):
    row = make_row(soak, "yes", "215 kernels", "b")
    soak.add_up(row, make_row(soak, "yes", "215 kernels", "a"), 0, adds=False)
    assert (row["total"], row["commit"], soak.show_cases(row)) == ("", "b", "215 kernels")


def test_a_version_is_that_of_the_code(soak, tmp_path, monkeypatch):
    """A bar whose scripts only read otherwise keeps its count."""
    monkeypatch.setattr(soak, "FOLDER", tmp_path)
    script, helper = tmp_path / "r99_x.py", tmp_path / "helper.py"

    def version(text, more):
        script.write_text(text)
        helper.write_text(more)
        return soak.version(script)

    first = version("import helper\nhelper.go(1)\n", "def go(n):\n    return n\n")
    comments = '"""What it does."""\nimport helper  # here\n\nhelper.go( 1 )\n'
    assert version(comments, 'def go(n):\n    """Goes."""\n    return n\n') == first
    assert version("import helper\nhelper.go(2)\n", "def go(n):\n    return n\n") != first
    assert version("import helper\nhelper.go(1)\n", "def go(n):\n    return -n\n") != first


def test_what_a_script_has_printed_is_kept(soak, tmp_path, monkeypatch):
    """A run of long ago, or elsewhere."""
    monkeypatch.setattr(soak, "RESULTS", {"cpu": tmp_path / "cpu.csv", "gpu": tmp_path / "gpu.csv"})
    monkeypatch.setattr(soak, "PAGE", tmp_path / "page.md")
    only = {"R3": soak.scripts()["R3"]}
    monkeypatch.setattr(soak, "scripts", lambda: only)
    log = tmp_path / "log"
    log.write_text("seed 3: slow\nR3 random modules: 500 modules; 0 mismatches (bar 0)\n")
    for seed, commit in ((700, "1a2b"), (1200, "3c4d")):
        command = ["soak.py", "--lines", str(log), "--seed", str(seed), "--commit", commit]
        monkeypatch.setattr(sys, "argv", command)
        assert soak.main() == 0
    assert "1000 modules, in 2 runs" in soak.PAGE.read_text()
    row = soak.read_rows("cpu")["R3"]
    assert (row["next"], row["commit"]) == ("1700", "1a2b 3c4d")


def test_lines_of_the_tests_are_counted():
    """R13 takes its numbers from what run_tests.py prints."""
    sys.path[:0] = [str(ROOT / "test/reliability"), str(ROOT / "scripts")]
    import r13_sanitizers as r13

    import run_tests

    done = run_tests.Result("gtest", passed=7)
    done.fail("One.case")
    done.skipped.append("Two.case: no reason given")
    with io.StringIO() as text, contextlib.redirect_stdout(text):
        done.close(1)
        run_tests.Result("reports", passed=1).close(0)
        counted = [r13.count_line(line) for line in text.getvalue().splitlines()]
    assert [one for one in counted if one] == [("gtest", 7, 1), ("reports", 1, 0)]


def test_a_process_that_computes_is_not_idle(soak):
    import bars

    program = [sys.executable, "-c", "print(flush=True)\nwhile True: pass"]
    with subprocess.Popen(program, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert not bars.is_idle(process.pid)
        process.kill()
    reader, writer = os.pipe()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=reader) as process:
        while not bars.is_idle(process.pid):
            pass
        process.kill()
    os.close(reader), os.close(writer)


def test_the_page_is_that_of_the_scripts(soak):
    """docs/reliability.md is generated from the scripts and from the kept results of their runs."""
    short = {name for name, path in soak.scripts().items() if path in SHORT}
    assert set(soak.SECONDS) == short and len(soak.scripts()) == len(BARS)
    assert sum(soak.SECONDS.values()) <= 90 * 60
    page = soak.PAGE.read_text()
    assert soak.without_ages(soak.make_page()) == soak.without_ages(page)


def git(folder, *words, **more):
    names = {f"GIT_{who}_{what}": "someone@example.org"
             for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}  # fmt: skip
    command = [needed.program("git"), "-C", str(folder), *words]
    done = subprocess.run(command, env=os.environ | names, capture_output=True, text=True, **more)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def measured(tmp_path):
    """A checkout of 206 commits with a table of rows, and all its commits from the last on."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import measured_commits

    git(tmp_path, "init", "-q")
    tree = git(tmp_path, "write-tree")
    commits = []
    for number in range(206):
        parents = ["-p", commits[0]] if commits else []
        commits.insert(0, git(tmp_path, "commit-tree", tree, *parents, "-m", str(number)))
    git(tmp_path, "update-ref", "HEAD", commits[0])
    alone = git(tmp_path, "commit-tree", tree, "-m", "of a branch that is gone")
    table = tmp_path / "benchmarks/results/reliability-cpu.csv"
    table.parent.mkdir(parents=True)
    lines = ["bar,commit", f"R1,{commits[200][:9]}", f"R2,{commits[3][:9]} {commits[201][:9]}",
             f"R3,{alone[:9]}", "R4,", "R5,0123456"]  # fmt: skip
    table.write_text("\n".join(lines) + "\n")
    return measured_commits, tmp_path, commits


def test_rows_say_that_they_are_old_or_that_their_commit_is_gone(measured):
    module, folder, commits = measured
    assert module.why_unknown(folder) == ""
    assert module.old(folder) == [("R2", 201)]
    assert module.age(commits[200], folder) == 200 and module.age(commits[0], folder) == 0
    found = module.problems(folder)
    assert [re.search(r": (R\d): (no commit|the history of HEAD has no commit)", line).groups()
            for line in found] == [("R3", "the history of HEAD has no commit"),
                                   ("R4", "no commit"),
                                   ("R5", "the history of HEAD has no commit")]  # fmt: skip


def test_a_shallow_clone_and_a_tree_without_git_give_their_reason(measured, capsys, monkeypatch):
    module, folder, _ = measured
    import lint

    git(folder, "clone", "-q", "--depth=1", f"file://{folder}", str(folder / "shallow"))
    assert "shallow" in module.why_unknown(folder / "shallow")
    assert "no checkout" in module.why_unknown(Path("/"))
    monkeypatch.setattr(module, "ROOT", folder / "shallow")
    monkeypatch.setattr(module.why_unknown, "__defaults__", (folder / "shallow",))
    assert lint.commits_of_results(False) == ""
    assert "not checked: the clone is shallow" in capsys.readouterr().out


def test_the_page_marks_old_rows(soak, monkeypatch):
    ages = {"a": 200, "b": 201, "c": None}
    monkeypatch.setattr(soak.measured_commits, "age", lambda commit, root=None: ages[commit])
    assert [soak.show_age(one) for one in (["a"], ["a", "b"], ["a", "c"], [])] == [
        "200", "**old: 201**", "not known", "not known",
    ]  # fmt: skip
    row = "| R1 | met | abc | {} |"
    for age in ("200", "**old: 201**", "not known", "200; **old: 3000**"):
        assert soak.without_ages(row.format(age)) == "| R1 | met | abc |"
    assert soak.without_ages("| R1 | a miss |") == "| R1 | a miss |"


def test_reports_of_compute_sanitizer_are_counted(tmp_path):
    """R14 reads the lines of the stage `sanitize`; a tool without a result is a miss."""
    sys.path[:0] = [str(ROOT / "test/reliability"), str(ROOT / "scripts")]
    import r14_compute_sanitizer as r14

    import test_gpu

    assert tuple(test_gpu.TOOLS) == r14.TOOLS

    def line(tool, reports, is_late=False):
        part = test_gpu.Sanitized(
            "", [] if is_late else [reports], ["Invalid read"] * reports if is_late else [],
            20, Counter(passed=12), [], is_late,
        )  # fmt: skip
        return test_gpu.report_tool(argparse.Namespace(out=tmp_path), tool, [part])[0]

    clean = [r14.read_tool(line(tool, 0)) for tool in r14.TOOLS]
    assert r14.judge(clean) == (
        "48 tests passed (memcheck 12, racecheck 12, initcheck 12, synccheck 12)",
        "0 reports, 0 tests failed", True,
    )  # fmt: skip
    assert not r14.judge(clean[:3])[2] and "no result of synccheck" in r14.judge(clean[:3])[1]
    for found in (r14.read_tool(line("memcheck", 2)), r14.read_tool(line("memcheck", 2, True))):
        cases, seen, met = r14.judge([found, *clean[1:]])
        assert not met and seen.startswith("2 reports")
    assert r14.judge([])[2] is False and r14.read_tool("- a step: clean") is None
