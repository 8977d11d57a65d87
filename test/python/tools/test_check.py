"""`make check`: its parts have something of every room."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))
import run_tests  # noqa: E402

# Rooms without lit tests: unit tests run whole, and test/python has tests of the other three.
OTHERS = {"python", "unit", "fuzz", "mutation", "reliability"}


def test_lit_tests_of_each_folder():
    chosen = run_tests.sample_of_lit()
    parts = {path: path.relative_to(ROOT / "test").parts for path in (ROOT / "test").rglob("*.*")}
    there = {
        path.parent
        for path, words in parts.items()
        if path.suffix in (".mlir", ".test") and not (OTHERS | {"Inputs"}) & set(words)
    }
    assert len(there) > 15
    assert there == {path.parent for path in chosen}
    assert len(chosen) < 120


def test_every_room_has_a_part():
    rooms = {path.name for path in (ROOT / "test").iterdir() if path.is_dir()}
    rooms -= {"__pycache__"}
    assert OTHERS < rooms
    lit = {path.relative_to(ROOT / "test").parts[0] for path in run_tests.sample_of_lit()}
    assert lit == rooms - OTHERS
    files = {path.name: path.read_text() for path in (ROOT / "test/python").rglob("test_*.py")}
    for room, name in (
        ("fuzz", "test_random_kernels.py"),
        ("mutation", "test_mutation.py"),
        ("reliability", "test_reliability.py"),
    ):
        assert f'"{room}"' in files[name] or f"test/{room}" in files[name]


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
