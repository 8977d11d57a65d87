"""R12: what a program makes and throws away leaves nothing behind.

Trees of fields, with and without kernels and tapes, tapes, kernels that are defined again, arrays,
threads and whole programs are made and dropped. Memory must stay as it is after the first tenth,
and the last rounds must take as long as the first ones.

    python test/reliability/r12_trees.py [--short] [--count ROUNDS] [--arch cpu|cuda] [-v]
"""

import argparse
import gc
import itertools
import statistics
import sys
import threading
import time

import numpy as np
import tai as ti

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--short", action="store_true", help="a fifteenth of the rounds")
parser.add_argument("--count", type=int, default=None, help="rounds of the cheapest part (10000)")
parser.add_argument("--arch", default="cpu", choices=["cpu", "cuda"])
parser.add_argument("-v", "--verbose", action="store_true", help="a line for each part")
args = parser.parse_args()

MOST_GROWTH = 1.0  # % of the resident memory
MOST_SLOWING = 1.2
COUNT = args.count or (1000 if args.short else 10000)


def resident():
    """Bytes of this process that are in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def begin():
    ti.init(arch=getattr(ti, args.arch), cpu_max_num_threads=1, offline_cache=False)


@ti.kernel
def double(x: ti.template()):
    for i in x:
        x[i] *= 2.0


@ti.kernel
def add_up(x: ti.template(), loss: ti.template()):
    for i in x:
        loss[None] += x[i] * x[i]


@ti.kernel
def double_array(x: ti.types.ndarray()):
    for i in x:
        x[i] *= 2.0


sizes = itertools.count(10017)


def make_tree():
    x, loss = (ti.field(ti.f32, needs_grad=True) for _ in range(2))
    builder = ti.FieldsBuilder()
    builder.dense(ti.i, 16).place(x)
    builder.place(loss)
    return x, loss, builder.finalize()


def tree():
    x, _, made = make_tree()
    x[3] = 1.0
    made.destroy()


def tree_with_kernel():
    x, _, made = make_tree()
    double(x)
    made.destroy()


def tree_of_another_size():
    """Code that is new each time."""
    x = ti.field(ti.f32)
    builder = ti.FieldsBuilder()
    builder.dense(ti.i, next(sizes)).place(x)
    made = builder.finalize()
    double(x)
    made.destroy()


def tree_with_tape():
    x, loss, made = make_tree()
    with ti.ad.Tape(loss):
        add_up(x, loss)
    made.destroy()


class Fields:
    """Made once, for parts that need some."""

    x = loss = None

    @classmethod
    def make(cls):
        cls.x, cls.loss, _ = make_tree()


def tape():
    with ti.ad.Tape(Fields.loss):
        add_up(Fields.x, Fields.loss)


def defined_again():
    x = Fields.x

    @ti.kernel
    def triple():
        for i in x:
            x[i] *= 3.0

    triple()


def array():
    double_array(ti.ndarray(ti.f32, 16, needs_grad=True))
    double_array(np.ones(16, np.float32))


def thread():
    one = threading.Thread(target=double, args=(Fields.x,))
    one.start()
    one.join()


def program():
    begin()
    x = ti.field(ti.f32, shape=16)
    x[1] = 2.0
    ti.reset()


# Each with its share of the rounds.
PARTS = [(tree, 1.0), (tree_with_kernel, 0.1), (tree_of_another_size, 0.1),
         (tree_with_tape, 0.05), (tape, 1.0),
         (defined_again, 0.1), (array, 1.0), (thread, 0.3), (program, 0.1)]  # fmt: skip


def measure(part, rounds):
    """Growth in % since the first tenth, and how much slower the last tenth is than the first."""
    begin()
    Fields.make()
    for _ in range(max(10, rounds // 10)):
        part()
    gc.collect()
    before = resident()
    times = []
    for _ in range(rounds):
        start = time.thread_time()
        part()
        times.append(time.thread_time() - start)
    gc.collect()
    growth = 100.0 * (resident() - before) / before
    tenth = max(5, rounds // 10)
    slowing = statistics.median(times[-tenth:]) / statistics.median(times[:tenth])
    if args.verbose:
        print(f"  {part.__name__}: {rounds} rounds, RSS {growth:+.2f} %, {slowing:.2f} times")
    return growth, slowing


def main():
    results = [measure(part, max(30, int(COUNT * share))) for part, share in PARTS]
    growth, slowing = (max(column) for column in zip(*results, strict=True))
    print(f"R12 trees: {COUNT} rounds, RSS {growth:+.1f} % (bar {MOST_GROWTH:.0f} %), "
          f"last tenth {slowing:.2f} times the first (bar {MOST_SLOWING})")  # fmt: skip
    return int(growth > MOST_GROWTH or slowing > MOST_SLOWING)


if __name__ == "__main__":
    sys.exit(main())
