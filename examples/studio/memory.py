"""State with a slot for each time, or updated in place: the options, and the cost of each."""

import argparse
import subprocess
import sys
import tempfile

import tai as ti

STATES = {
    "slots": "each time has its own slot",
    "saved": "updates in place, the tape saves what is overwritten",
    "recomputed": "updates in place, the tape keeps snapshots and runs steps again",
}
_tapes: list[ti.ad.Tape] = []  # the last one


def add_states(parser: argparse.ArgumentParser) -> None:
    """Adds `--state`; `args.in_place` says whether there is a single slot."""
    text = "; ".join(f"{name}: {what}" for name, what in STATES.items())
    choices = [*STATES, "compare"]
    parser.add_argument("--state", choices=choices, default="slots", help=text)


def tape(args: argparse.Namespace, loss: ti.Field) -> ti.ad.Tape:
    """The tape for one iteration."""
    recomputed = args.state == "recomputed"
    _tapes[:] = [ti.ad.Tape(loss, checkpoint="periodic" if recomputed else None)]
    return _tapes[0]


def report_memory(args: argparse.Namespace, *state: ti.Field) -> None:
    """Prints the memory of the state's fields, their gradients and the tape."""
    fields = 2 * sum(field.to_numpy().nbytes for field in state)
    kept = _tapes[0].stats().peak_bytes if _tapes else 0
    again = _tapes[0].stats().recomputed if _tapes else 0
    text = f", {again} launches run again" if again else ""
    print(f"memory   {_size(fields)} of state, {_size(kept)} of tape{text}")


def _size(count: float) -> str:
    for unit in ("B", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.4g} {unit}"
        count /= 1024
    return f"{count:.4g} GiB"


def compare(arguments: list[str]) -> None:
    """Runs the program in each way, and prints the time and memory of each."""
    place = arguments.index("compare") if "compare" in arguments else None
    if place is None:
        arguments = [a for a in arguments if not a.startswith("--state")]
    else:
        arguments = arguments[: place - 1] + arguments[place + 1 :]
    with tempfile.TemporaryDirectory() as folder:
        for state, what in STATES.items():
            command = [sys.executable, sys.argv[0], *arguments, "--state", state]
            command += ["--no-picture", "--out", folder]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
            if done.returncode:
                sys.exit(done.returncode)
            print(f"{state}: {what}")
            for line in done.stdout.splitlines():
                if line.split(" ")[0] in ("loss", "time", "memory"):
                    print(f"  {line}")
    sys.exit(0)
