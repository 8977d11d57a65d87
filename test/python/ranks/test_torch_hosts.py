"""Two network namespaces that stand for two hosts, with a cable between them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="ranks communicate by torch.distributed, and torch is missing")

HERE = Path(__file__).parent
TORCHRUN = [sys.executable, "-m", "torch.distributed.run"]


def ip(*words):
    return subprocess.run(["ip", *words], capture_output=True, text=True).returncode == 0


@pytest.fixture
def hosts():
    """The names of two namespaces and of their interfaces."""
    names = [f"tai{os.getpid()}{side}" for side in "ab"]
    ends = [f"v{os.getpid()}{side}" for side in "ab"]
    try:
        made = bool(shutil.which("ip")) and all(ip("netns", "add", name) for name in names)
        made = made and ip("link", "add", ends[0], "type", "veth", "peer", "name", ends[1])
        for number, (name, end) in enumerate(zip(names, ends, strict=True), 1):
            made = made and ip("link", "set", end, "netns", name)
            made = made and ip("-n", name, "address", "add", f"10.77.0.{number}/24", "dev", end)
            made = made and ip("-n", name, "link", "set", end, "up")
            made = made and ip("-n", name, "link", "set", "lo", "up")
        if not made:
            pytest.skip("no right to make network namespaces")
        yield list(zip(names, ends, strict=True))
    finally:
        for name in names:
            ip("netns", "delete", name)


def start(hosts, per_host, *program):
    """The processes of torchrun on each host."""
    common = ["--nnodes", "2", "--nproc-per-node", str(per_host), "--master-addr", "10.77.0.1"]
    processes = []
    for number, (name, end) in enumerate(hosts):
        command = ["ip", "netns", "exec", name, *TORCHRUN, *common, "--master-port", "29517"]
        command += ["--node-rank", str(number), *map(str, program)]
        processes.append(
            subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                env={**os.environ, "GLOO_SOCKET_IFNAME": end},
            )
        )  # fmt: skip
    return processes


def test_two_hosts_give_the_result_of_one_process(hosts, tmp_path):
    program = HERE / "rank_restart.py"
    whole, divided = tmp_path / "whole", tmp_path / "divided"
    whole.mkdir(), divided.mkdir()
    subprocess.run([sys.executable, str(program), str(whole)], check=True, timeout=120)
    for process in start(hosts, 2, program, divided):
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    assert (divided / "result.npy").read_bytes() == (whole / "result.npy").read_bytes()


def test_a_rank_that_hangs_ends_both_hosts(hosts, tmp_path):
    texts = []
    for process in start(hosts, 1, HERE / "rank_program.py", "hang", tmp_path, 5):
        texts.append(process.communicate(timeout=400)[1])
        assert process.returncode != 0
    assert "lost rank 1 in the exchange 'fetch' of field 'x'" in texts[0]
