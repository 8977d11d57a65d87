"""The table of examples on tai and its peers: the runs, and the entries about them."""

import argparse
import importlib.util
import io
import json
import sys
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


def loaded(name):
    """A script of the benchmark, under a name that no other one has."""
    path = ROOT / "benchmarks/programs" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"benchmark_programs_{name}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


measure, programs = loaded("measure"), loaded("run")
TOI = next(p for p in programs.PROGRAMS if p.name == "rigid_body_toi")
SPRINGS = programs.PROGRAMS[0]


def arguments(out, **more):
    given = {"arch": "cpu", "cache": out, "iterations": 3, "processor": True, "limit": 200}
    given |= {"seconds": 60, "fill": False, "peers_venv": out / "none"}
    return argparse.Namespace(**given | more)


def peer_that(folder, *does):
    """An interpreter in the place of a peer's that does something else."""
    path = folder / "venv/bin/python"
    path.parent.mkdir(parents=True)
    path.write_text("\n".join(["#!/bin/sh", *does, ""]))
    path.chmod(0o755)
    return folder / "venv"


@pytest.mark.parametrize("program", [SPRINGS, TOI], ids=lambda p: p.name)
def test_an_example_on_tai(tmp_path, program):
    row = programs.measured(program, "tai", arguments(tmp_path), tmp_path / "run")
    assert row["ms"] > 0 and row["first_s"] > 0 and row["iterations"] == 3
    first = 0.0090264 if program is SPRINGS else 0.237109
    assert row["first_loss"] == pytest.approx(first, rel=1e-4)


def test_peers_that_are_not_there(tmp_path):
    for found in (
        programs.measured(SPRINGS, "taichi", arguments(tmp_path), tmp_path),
        programs.scene(programs.PROGRAMS[2], "warp", arguments(tmp_path, processor=False)),
    ):
        assert found == {"reason": "missing: run benchmarks/setup_peers.py"}


def test_an_example_that_fails(tmp_path):
    wrong = SPRINGS._replace(options="--steps none")
    reason = programs.measured(wrong, "tai", arguments(tmp_path), tmp_path)["reason"]
    assert reason.startswith("mass_spring_simple: argument --steps: 'none' is not a whole number")
    wrong = TOI._replace(call="bounce(1 / 0)")
    reason = programs.measured(wrong, "tai", arguments(tmp_path), tmp_path)["reason"]
    assert reason == "ZeroDivisionError: division by zero"


LINE = """echo '{"ms": [%s], "losses": [0.5]}'"""


@pytest.mark.parametrize(
    "does, expected",
    [
        # A system that does not finish is reported with the iterations it has done.
        (
            [LINE % 9000, LINE % 7, LINE % 8, "exec sleep 60"],
            {"ms": 7.5, "iterations": 3, "first_s": 9.0, "note": "3 iterations in 1 s"},
        ),
        (
            [LINE % 9000, "exec sleep 60"],
            {"reason": "longer than 1 s, of which the first iteration took 9 s"},
        ),
        (["exec sleep 60"], {"reason": "longer than 1 s"}),
        ([LINE % 9, LINE % 7, "kill -11 $$"], {"reason": "ended by signal 11"}),
        (["echo 'AnError: no' >&2", "echo bye >&2", "exit 1"], {"reason": "AnError: no"}),
        (["exit 3"], {"reason": "no word, exit status 3"}),
        (["echo hello"], {"reason": "no times"}),
    ],
    ids=["three", "one", "none", "signal", "error", "silent", "empty"],
)  # fmt: skip
def test_a_peer_that_does_not_get_to_the_end(tmp_path, does, expected):
    venv = peer_that(tmp_path, *does)
    args = arguments(tmp_path, limit=1 if "sleep" in does[-1] else 60, peers_venv=venv)
    row = programs.measured(SPRINGS, "taichi", args, tmp_path)
    assert expected.items() <= row.items()
    assert ("ms" in row) == ("reason" not in row)


def test_scenes_of_other_peers(tmp_path):
    program = next(p for p in programs.PROGRAMS if p.units > 1)
    times = [
        f'echo \'{{"phase": "{phase}", "ms": {ms}, "n": 5}}\''
        for phase, ms in (("forward", 1), ("backward", 3))
    ]
    args = arguments(tmp_path, processor=False, peers_venv=peer_that(tmp_path, *times))
    row = programs.scene(program, "jax", args)
    assert row == {"ms": 4.0 * program.units, "iterations": 5, "note": program.note}
    fails = ["""echo '{"phase": "failed", "reason": "no such op"}'""", "exit 1"]
    args.peers_venv = peer_that(tmp_path / "other", *fails)
    assert programs.scene(program, "warp", args) == {"reason": "no such op"}
    args.processor = True
    assert programs.scene(program, "jax", args) == {"reason": "wall time only"}


def test_each_process_has_its_share(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(programs.time, "monotonic", lambda: now[0])
    clock = programs.Clock(argparse.Namespace(timeout=90, minutes=10), 40)
    assert clock.limit("jax") == pytest.approx(60)  # four times a fortieth
    now[0] = 590.0
    assert clock.limit("jax") == pytest.approx(10)  # all that is left
    now[0] = 598.0
    # The rows without a peer are short, and say something by themselves.
    assert clock.limit("jax") == 0 and clock.limit("tai") == 90
    assert programs.Clock(argparse.Namespace(timeout=90, minutes=0), 40).limit("jax") == 90


def test_the_whole_table(tmp_path, monkeypatch, capsys):
    """With a peer that computes the same, and one for which there is no time."""
    now = [0.0]
    monkeypatch.setattr(programs.time, "monotonic", lambda: now[0])

    def measured(program, peer, args, folder):
        now[0] += 59.0 if peer == "taichi" else 0.0
        return {"ms": 1.0 if peer == "tai" else 3.0, "first_loss": 0.5, "second_loss": 0.4}

    monkeypatch.setattr(programs, "measured", measured)
    words = ["run.py", "--only", "wave", "--rounds", 1, "--minutes", 1, "--out", tmp_path]
    words += ["--peers", "taichi", "quadrants", "--peers-venv", tmp_path / "none"]
    monkeypatch.setattr(sys, "argv", list(map(str, words)))
    assert programs.main() == 0
    text = (tmp_path / "programs.md").read_text()
    assert "| wave | 1 | 3 (3.00) | not run | 3.00 |" in text
    assert "- wave, quadrants: not run: the 1 minutes were over" in text
    assert "Peers: taichi, quadrants." in text and text in capsys.readouterr().out
    lines = (tmp_path / "programs.csv").read_text().splitlines()
    assert lines[1].startswith("wave,tai,0,1.0,") and len(lines) == 4


def test_what_is_wrong_does_not_count(tmp_path):
    ours = {"ms": 1.0, "first_loss": 0.5, "second_loss": 0.4}
    other = programs.judged({**ours, "ms": 0.1, "second_loss": 0.3}, ours, SPRINGS)
    assert other["reason"] == "wrong: the second loss is 0.3, tai's 0.4"
    slower = programs.judged({**ours, "ms": 1.5}, ours, SPRINGS)
    assert "reason" not in slower
    rows = [
        {"program": SPRINGS.title, "peer": peer, **row}
        for peer, row in (("tai", ours), ("taichi", other), ("quadrants", slower))
    ]
    # The faster of two rounds counts.
    rows.append({**rows[2], "ms": 2.5})
    text = programs.table(rows, [SPRINGS], ["taichi", "quadrants"])
    assert "| mass_spring_simple | 1 | wrong | 1.5 (1.50) | 1.50 **below 2** |" in text
    assert "- mass_spring_simple, taichi: wrong: the second loss is 0.3, tai's 0.4" in text


def test_a_module_in_the_place_of_tai(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tai", None)
    given = {}
    module = types.ModuleType("peer")
    module.init = lambda **options: given.update(options)
    module.ERROR = "error"
    module.tools = types.SimpleNamespace()
    recorded = []
    module.ad = types.SimpleNamespace(
        Tape=type("Tape", (), {"__init__": lambda self, loss: recorded.append(loss)}),
        grad_replaced=len, grad_for=abs,
    )  # fmt: skip
    measure.adapt(module, tmp_path, threads=1)
    assert sys.modules["tai"] is module
    module.init(deterministic=False, fast_math=False, random_seed=3)
    assert given["random_seed"] == 3 and given["cpu_max_num_threads"] == 1
    # Its own defaults, where tai's differ.
    assert "fast_math" not in given and "deterministic" not in given
    assert module.ad.Tape("loss", checkpoint="periodic").stats().peak_bytes == 0
    assert recorded == ["loss"] and module.ad.complex_kernel is len
    bar = module.tools.Progress(range(5), "bar")
    assert list(bar) == [0, 1, 2, 3, 4]
    bar.seconds = -1.0
    # No time is left, but what compiles must not be all.
    assert list(bar) == [0, 1]
    bar.stream = io.StringIO()
    bar.note("loss 0.25, 12.5 ms")
    assert json.loads(bar.stream.getvalue()) == {"ms": [12.5], "losses": [0.25]}


def test_scenes_and_examples_are_there():
    for program in programs.PROGRAMS:
        assert (ROOT / "examples" / f"{program.name}.py").is_file()
