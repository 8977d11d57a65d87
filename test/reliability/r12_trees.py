"""R12: objects that a program makes and drops leave nothing behind.

Trees of fields, with and without kernels and tapes, tapes, kernels that are defined again, arrays,
threads and whole programs are made and dropped. Memory must stay as it is after the first tenth,
and the last rounds must take as long as the first ones: time of the processor, beside that of other
work at the same moment, since whatever else the machine does changes both. The least of many rounds
counts: one of some microseconds that begins on caches which another program has used takes three
times as long, and work that is longer does not.
"""

import gc
import itertools
import threading
import time

import numpy as np
import tai as ti
from bars import Bar, resident

MOST_GROWTH = 1.0  # % of the resident memory
MOST_SLOWING = 1.2

bar = Bar(
    "R12", "trees, kernels, tapes and programs that go", full=10_000, short=300,
    target="10,000 trees, 1,000 programs: memory within 1 %, the last rounds as fast as the first",
    miss="memory that grows by more than 1 % after the first tenth, or rounds that get slower",
    archs=("cpu", "emulated", "cuda"),
)  # fmt: skip
bar.parser.add_argument("-v", "--verbose", action="store_true", help="a line for each part")
args = bar.parse()


def begin():
    ti.init(cpu_max_num_threads=1, offline_cache=False)


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


def other_work():
    """Work that does not use tai."""
    table = {}
    for i in range(1000):
        table[str(i)] = [i] * 20
    return table


def time_of(work):
    start = time.thread_time()
    work()
    return time.thread_time() - start


def measure(part, rounds, seconds):
    """Growth in % since the first tenth, and by how much the least of the last tenth is slower than
    that of the first.

    Ends after so many seconds, and after thirty rounds at least. Gives the share that was run, too.
    """
    begin()
    Fields.make()
    # In memory before that is looked at: lists of 10,000 times are 1 % of it.
    own, other = np.ones(rounds), np.ones(rounds)
    for _ in range(max(10, rounds // 10)):
        part()
    gc.collect()
    before = resident()
    number = 0
    end = time.monotonic() + seconds
    while number < rounds and (number < 30 or time.monotonic() < end):
        own[number], other[number] = time_of(part), time_of(other_work)
        number += 1
    gc.collect()
    growth = 100.0 * (resident() - before) / before
    tenth = max(5, number // 10)
    ratios = [own[piece].min() / other[piece].min()
              for piece in (slice(tenth), slice(number - tenth, number))]  # fmt: skip
    slowing = ratios[1] / ratios[0]
    if args.verbose:
        print(
            f"  {part.__name__}: {number} rounds of {1000 * own[:number].mean():.2f} ms, "
            f"RSS {growth:+.2f} %, {slowing:.2f} times"
        )
    return growth, slowing, -number / rounds


def main():
    results = []
    for number, (part, share) in enumerate(PARTS):
        seconds = bar.left() / (len(PARTS) - number)
        results.append(measure(part, max(30, int(args.count * share)), seconds))
    growth, slowing, share = (max(column) for column in zip(*results, strict=True))
    # In a short run pools still fill, and times are those of a machine that does more than this.
    most = 3 * MOST_GROWTH if args.short else MOST_GROWTH
    met = growth <= most and (args.short or slowing <= MOST_SLOWING)
    bar.report(
        f"{int(-share * args.count)} rounds on {args.arch}",
        f"RSS {growth:+.1f} %, last tenth {slowing:.2f} times the first",
        met=met, bar=f"{most:.0f} %, {MOST_SLOWING}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
