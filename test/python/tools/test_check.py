"""`make check`: its parts have something of every room."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))
import run_tests  # noqa: E402


def test_lit_tests_of_each_folder():
    chosen = run_tests.sample_of_lit()
    others = {"python", "fuzz", "Inputs", "reliability", "unit"}
    found = {path.parent for path in (ROOT / "test").rglob("*.mlir")}
    found = {path for path in found if not others & set(path.relative_to(ROOT / "test").parts)}
    assert len(found) > 8
    assert found <= {path.parent for path in chosen}
    assert len(chosen) < 100


def test_one_test_of_each_file():
    rooms = ["test/python/fields", "test/python/optim"]
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", "--quick", *rooms]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    files = [line.split("::")[0] for line in done.stdout.splitlines() if "::" in line]
    there = [path for room in rooms for path in (ROOT / room).glob("test_*.py")]
    assert sorted(files) == sorted(str(path.relative_to(ROOT)) for path in there)


def test_no_two_files_have_one_name():
    """Test files are modules at the top: pytest would take the second one for the first."""
    names = [path.name for path in (ROOT / "test/python").rglob("test_*.py")]
    assert len(names) > 200
    assert [name for name in names if names.count(name) > 1] == []


def test_the_times_are_printed(capsys):
    result = run_tests.Result("kind", seconds=12.4)
    result.times = {f"test{n}": float(n) for n in range(20)}
    run_tests.print_times([result])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "time: kind 12 s"
    assert lines[1:3] == ["    19.0 s  kind: test19", "    18.0 s  kind: test18"]
    assert len(lines) == 11
