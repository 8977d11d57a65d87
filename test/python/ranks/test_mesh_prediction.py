"""The predicted times of a schedule against times that a few lines of arithmetic give."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
sys.path.insert(0, str(SCRIPTS))
import predict_mesh  # noqa: E402
from predict_mesh import Link, Program, predict, table  # noqa: E402


def test_one_rank_exchanges_nothing():
    program = Program(rows=64, row_seconds=0.5, row_bytes=8, steps=3, reductions=2)
    assert predict(program, Link(9, 1), 1) == 96


def test_equal_ranks_compute_and_exchange_in_turn():
    program = Program(rows=64, row_seconds=0.5, row_bytes=8, halo=2, steps=3, reductions=1)
    # Three steps of 16 rows and a message of 16 bytes; a sum over 4 ranks is 4 messages.
    assert predict(program, Link(1, 4), 4) == 3 * (16 * 0.5 + 1 + 16 / 4) + 4 * (1 + 8 / 4)


def test_a_halo_of_several_ranks_takes_several_messages():
    program = Program(rows=8, row_seconds=1, row_bytes=4, halo=3, steps=1)
    assert predict(program, Link(1, 4), 8) == 1 + 3 * (1 + 1)


def test_neighbours_wait_for_a_slow_rank():
    program = Program(rows=8, row_seconds=1, row_bytes=0, steps=4, jitter=0.5)
    assert predict(program, Link(0, 1), 4) == 4 * 2 * 1.5


def test_without_costs_scaling_is_perfect():
    program = Program(rows=1024, row_seconds=1e-3, row_bytes=8)
    for ranks, _, strong, weak in table(program, Link(0, 1e30), 64):
        assert strong == pytest.approx(1) and weak == pytest.approx(1), ranks


def test_the_command_prints_a_table():
    command = [sys.executable, predict_mesh.__file__, "--rows", "256", "--row-seconds", "1e-4"]
    command += ["--row-bytes", "2048", "--latency", "1e-5", "--bandwidth", "1e9", "--ranks", "8"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines[0] == "a prediction, not a measurement"
    assert [line.split()[0] for line in lines[1:]] == ["ranks", "1", "2", "4", "8"]


@pytest.mark.parametrize("scene", predict_mesh.SCENES)
def test_scenes_are_predicted(scene):
    command = [sys.executable, predict_mesh.__file__, "--scene", scene, "--row-seconds", "1e-6"]
    command += ["--latency", "1e-5", "--bandwidth", "1e11"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines[-1].split()[0] == "1024"
