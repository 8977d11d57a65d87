"""Times an example on tai, or unchanged on taichi or quadrants under the name tai.

    python benchmarks/programs/measure.py taichi CACHE OUT examples/wave.py [--iterations 6 …]

The examples use Taichi's API; the few names of tai that their main functions need beside it are
added to the other module here. Prints lines of JSON with milliseconds and losses: one per
iteration of a peer, in case the process is killed, and one for all iterations.
"""

from __future__ import annotations

import argparse
import csv
import functools
import importlib
import importlib.util
import json
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any


class Progress:
    """In the place of `tai.tools.Progress`: no bar, but a line of JSON for each iteration."""

    stream: Any = sys.stdout
    seconds = float("inf")  # no iteration begins later, but the second one

    def __init__(self, items, title):
        self.items = items

    def note(self, text):
        loss, time_each = text.removeprefix("loss ").removesuffix(" ms").split(", ")
        tell(self.stream, {"ms": [float(time_each)], "losses": [float(loss)]})

    def __iter__(self):
        begin = time.monotonic()
        for number, item in enumerate(self.items):
            if number > 1 and time.monotonic() - begin > self.seconds:
                return
            yield item


def tell(stream: Any, found: dict) -> None:
    print(json.dumps(found), file=stream, flush=True)


def adapt(module: Any, cache: Path, threads: int) -> None:
    """Gives another module the names that the frame of the examples takes from tai, and its own
    defaults."""
    begin = module.init

    @functools.wraps(begin)
    def init(deterministic=False, fast_math=False, **given):
        more = {"cpu_max_num_threads": threads} if threads else {}
        begin(
            **given, **more, log_level=module.ERROR, offline_cache=True,
            offline_cache_file_path=str(cache),
        )  # fmt: skip

    class Tape(module.ad.Tape):
        def __init__(self, loss=None, checkpoint=None, memory_budget=None):
            super().__init__(loss)

        def stats(self):
            return SimpleNamespace(peak_bytes=0, recomputed=0)

    module.init = init
    module.ad.Tape = Tape
    module.ad.complex_kernel = module.ad.grad_replaced
    module.ad.complex_kernel_grad = module.ad.grad_for
    module.TaiError = module.TaiRuntimeError = RuntimeError
    module.tools.Progress = Progress
    sys.modules["tai"] = module


def load(peer: str, cache: Path, threads: int) -> Any:
    """The module that programs get under the name tai."""
    module = importlib.import_module(peer)
    if peer != "tai":
        adapt(module, cache, threads)
        return module
    module.init = functools.partial(
        module.init, offline_cache_file_path=str(cache),
        **({"cpu_max_num_threads": threads} if threads else {}),
    )  # fmt: skip
    return module


def run(
    program: Path, options: list[str], folder: Path, before: str, call: str, count: int
) -> dict:
    """Runs the whole program, or, with `call`, an expression of it as often as asked for."""
    sys.argv = [str(program), *options, "--no-picture", "--out", str(folder)]
    sys.path.insert(0, str(program.parent))
    name = "program" if call else "__main__"
    spec = importlib.util.spec_from_file_location(name, program)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if call:
        exec(before, module.__dict__)
        seconds, losses = [], []
        begin = time.monotonic()
        for number in range(count):
            if number > 1 and time.monotonic() - begin > Progress.seconds:
                break
            start = time.perf_counter()
            value = eval(call, module.__dict__)
            seconds.append(time.perf_counter() - start)
            first = value[0] if isinstance(value, tuple) else value
            losses.append(float(first.mean() if hasattr(first, "mean") else first))
            tell(Progress.stream, {"ms": [1e3 * seconds[-1]], "losses": losses[-1:]})
    else:
        with (folder / f"{program.stem}.losses.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        losses = [float(row["loss"]) for row in rows]
        seconds = [float(row["seconds"]) for row in rows]
    return {"ms": [1e3 * value for value in seconds], "losses": losses, "whole": True}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peer", choices=["tai", "taichi", "quadrants"])
    parser.add_argument("cache", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("program", type=Path)
    parser.add_argument("--threads", type=int, default=0, help="0: all")
    parser.add_argument("--processor", action="store_true", help="processor time, not the clock's")
    parser.add_argument("--before", default="", help="statements of the program, not timed")
    parser.add_argument("--call", default="", help="an expression of the program, in place of all")
    parser.add_argument("--count", type=int, default=5, help="how often")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of all iterations")
    args, options = parser.parse_known_args()
    for folder in (args.cache, args.out):
        folder.mkdir(parents=True, exist_ok=True)
    # Only the result may reach standard output.
    Progress.stream, Progress.seconds = os.fdopen(os.dup(1), "w"), args.seconds
    os.dup2(2, 1)
    load(args.peer, args.cache.resolve(), args.threads)
    if args.processor:
        time.perf_counter = time.process_time
    program = args.program.resolve()
    found = run(program, options, args.out.resolve(), args.before, args.call, args.count)
    tell(Progress.stream, found)


if __name__ == "__main__":
    main()
