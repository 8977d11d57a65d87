"""Ranks that torchrun starts, and that end, hang or never arrive: all ranks end with a message."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="ranks communicate by torch.distributed, and torch is missing")

PROGRAM = Path(__file__).with_name("rank_program.py")
TORCHRUN = [sys.executable, "-m", "torch.distributed.run"]


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("deed", ["hang", "end"])
def test_a_lost_rank_ends_all_ranks(deed, tmp_path):
    command = [*TORCHRUN, "--standalone", "--nproc-per-node", "3", str(PROGRAM)]
    done = subprocess.run(
        [*command, deed, str(tmp_path), "5"], capture_output=True, text=True, timeout=120
    )
    assert done.returncode != 0
    # torchrun ends the others as soon as it sees that one has ended, maybe before they have told.
    if deed == "hang":
        assert "lost rank 1 in the exchange 'fetch' of field 'x' in the launch of" in done.stderr
        assert "rank_program.py" in done.stderr
    numbers = [int(path.read_text()) for path in tmp_path.iterdir()]
    assert len(numbers) == 3 and not any(is_running(number) for number in numbers)


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_that_waits_in_vain_ends(rank, tmp_path):
    place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port())}
    environment = {**os.environ, **place, "RANK": str(rank), "WORLD_SIZE": "2"}
    command = [sys.executable, str(PROGRAM), "end", str(tmp_path), "2"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode != 0
    assert f"rank {rank} of 2 waited 2 s for the mesh 'x', and " in done.stderr


def test_a_host_without_the_file_ends_the_other(tmp_path):
    hosts = [*TORCHRUN, "--nnodes", "2", "--nproc-per-node", "1", "--master-addr", "127.0.0.1"]
    hosts += ["--master-port", str(free_port()), "--node-rank"]
    missing = subprocess.Popen(
        [*hosts, "1", str(tmp_path / "none.py")], stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL
    )  # fmt: skip
    arguments = ["0", str(PROGRAM), "end", str(tmp_path), "3"]
    done = subprocess.run([*hosts, *arguments], capture_output=True, text=True, timeout=120)
    assert missing.wait(timeout=120) != 0 and done.returncode != 0
    assert "rank 0 of 2 waited 3 s for the mesh 'x', and no rank 1 arrived" in done.stderr


def test_a_restart_continues_from_the_last_checkpoint(tmp_path):
    program = str(PROGRAM.with_name("rank_restart.py"))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir(), killed.mkdir()
    subprocess.run([sys.executable, program, str(whole)], check=True, timeout=120)
    command = [*TORCHRUN, "--standalone", "--nproc-per-node", "3", "--max-restarts", "1", program]
    subprocess.run([*command, str(killed), "kill"], check=True, capture_output=True, timeout=120)
    assert (killed / "continued").read_text() == "4"
    assert (killed / "result.npy").read_bytes() == (whole / "result.npy").read_bytes()
