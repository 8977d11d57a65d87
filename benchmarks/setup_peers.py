"""Create the private virtual environment that holds the peers of the benchmark.

The peers (taichi, quadrants, jax, torch, warp) are installed from PyPI into
``build/peers-venv``, never into the project's own environment. Each is installed by
itself, so one that has no wheel for this machine does not take the others with it;
``benchmarks/run.py`` reports such a peer as missing.

Taichi gets a pip call of its own because quadrants and taichi pin different
dependencies; pip may print a warning about that, the two packages do not share code.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Torch's default wheel carries CUDA libraries of several GB that this benchmark does not
# use, hence the CPU index.
PEERS: dict[str, list[str]] = {
    "numpy": ["numpy"],
    "taichi": ["taichi==1.7.4"],
    "quadrants": ["quadrants"],
    "jax": ["jax[cpu]"],
    "torch": ["torch", "--retries", "0", "--index-url", "https://download.pytorch.org/whl/cpu"],
    "warp": ["warp-lang"],
}


def peers_python(directory: Path) -> Path:
    """Path of the interpreter of the peers' environment."""
    return directory / "bin" / "python"


def create(directory: Path, names: list[str]) -> dict[str, bool]:
    """Install the peers `names` into `directory`; says for each whether that worked."""
    if not peers_python(directory).exists():
        venv.create(directory, with_pip=True)
    python = str(peers_python(directory))
    outcome = {}
    for name in names:
        base = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        done = subprocess.run(base + PEERS[name], check=False).returncode == 0
        if not done and name == "torch":
            # The CPU index may be out of reach where PyPI is not.
            done = subprocess.run([*base, "torch"], check=False).returncode == 0
        outcome[name] = done
        print(f"{name}: {'installed' if done else 'not installed'}", flush=True)
    return outcome


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--directory", type=Path, default=ROOT / "build" / "peers-venv")
    parser.add_argument("peers", nargs="*", help=f"of {', '.join(PEERS)}; default all")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.peers if name not in PEERS]
    if unknown:
        parser.error(f"unknown peer {unknown[0]!r}, known are {', '.join(PEERS)}")
    names = arguments.peers or list(PEERS)
    if "numpy" not in names:
        names.insert(0, "numpy")
    outcome = create(arguments.directory, names)
    return 0 if all(outcome.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
