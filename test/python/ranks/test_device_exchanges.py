"""Exchanges of GPUs: on an emulated one by gloo, and the watch on those that are not done."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from tai._impl.base import device_watch

PROGRAM = Path(__file__).with_name("rank_device.py")


class Event:
    def __init__(self, is_done=True):
        self.is_done = is_done

    def query(self):
        return self.is_done


class Broken:
    def query(self):
        raise RuntimeError("illegal address")


def watched(timeout=30.0):
    """A watch whose thread does not look, and the failures that it notes."""
    lost = []
    watch = device_watch.Watch(timeout, lambda *told: lost.append(told))
    watch._thread = threading.current_thread()
    return watch, lost


def test_exchanges_that_are_done_are_forgotten():
    watch, lost = watched()
    late = Event(False)
    watch.add(Event(), Event(), [(1, 7)], 7, "first")
    watch.add(Event(), late, [(1, 9)], 9, "second")
    assert watch.look() and [each.action for each in watch._queued] == ["second"]
    late.is_done = True
    assert watch.look() and not watch._queued and not lost


def test_an_exchange_that_does_not_end_is_lost():
    watch, lost = watched(timeout=0)
    waiting = Event(False)
    watch.add(waiting, Event(False), [(1, 7)], 7, "late")
    assert watch.look() and watch.look() and not lost  # The GPU has not reached it.
    waiting.is_done = True
    watch.look()
    assert not watch.look()
    assert lost == [("late", "no answer in 0 s", None)]


def test_an_exchange_after_a_failure_of_another_rank_is_soon_lost():
    watch, _ = watched(timeout=300)
    watch.hurry()
    assert watch._timeout <= 2


def test_a_message_of_another_exchange_is_a_failure_of_its_rank():
    watch, lost = watched()
    watch.add(Event(), Event(), [(1, 7), (3, 8)], 7, "fetch")
    assert not watch.look()
    assert lost == [("fetch", "it sends the rows of another exchange", 3)]


def test_a_failed_gpu_is_told():
    watch, lost = watched()
    watch.add(Event(), Broken(), [], 0, "fetch")
    assert not watch.look()
    assert lost == [("fetch", "the GPU has failed: illegal address", None)]


def test_the_thread_of_a_watch_looks():
    is_lost = threading.Event()
    watch = device_watch.Watch(0.0, lambda *told: is_lost.set())
    watch.add(Event(), Event(False), [], 0, "fetch")
    assert is_lost.wait(60)


def run(ranks, *options):
    pytest.importorskip("torch", reason="ranks communicate by torch.distributed")
    start = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks)]
    command = [sys.executable, *start, str(PROGRAM), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.parametrize("ranks", [2, 4])
def test_ranks_on_devices_give_the_gradients_of_one(ranks):
    done = run(ranks)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("rank ")]
    assert len(lines) == 10 * ranks and all(line[3] == "True" for line in lines), done.stdout


def test_a_device_that_fails_is_told_to_the_others():
    done = run(2, "--fail")
    assert done.returncode != 0 and "no error" not in done.stdout
    assert "row nine" in done.stderr
