"""R16: processes that are forked or spawned, and 32 threads, run kernels and tapes.

Each has fields, kernels and tapes of its own, and gets the losses and gradients of a run without
threads, bit for bit.
"""

import multiprocessing
import os
import threading

import numpy as np
import tai as ti
from bars import Bar

THREADS = 32
STEPS, N = 5, 24


class Problem:
    def __init__(self, number):
        x = self.x = ti.field(ti.f64, shape=(STEPS + 1, N), needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        self.number = number
        k = 0.1 + 0.01 * number

        @ti.kernel
        def step(t: ti.i32):
            for i in range(N):
                x[t + 1, i] = x[t, i] + k * ti.sin(x[t, i])

        @ti.kernel
        def measure():
            for i in range(N):
                loss[None] += x[STEPS, i] ** 2

        self.step, self.measure = step, measure

    def solve(self, options):
        """The losses and gradients of a few steps of descent, as bytes."""
        state = 1.0 + self.number * 0.1 + np.arange(N) / N
        answer = b""
        for _ in range(3):
            values = np.zeros((STEPS + 1, N))
            values[0] = state
            self.x.from_numpy(values)
            with ti.ad.Tape(self.loss, **options):
                for t in range(STEPS):
                    self.step(t)
                self.measure()
            gradient = self.x.grad.to_numpy()
            answer += np.float64(self.loss[None]).tobytes() + gradient.tobytes()
            state = state - 0.01 * gradient[0]
        return answer


OPTIONS = [{}, {"checkpoint": "periodic"}, {"checkpoint": 2}]


def solve_alone(number):
    """In a process of its own."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False)
    return Problem(number).solve(OPTIONS[number % len(OPTIONS)])


def run_threads(problems, expected):
    wrong = []

    def work(number):
        try:
            if problems[number].solve(OPTIONS[number % len(OPTIONS)]) != expected[number]:
                wrong.append(f"thread {number} got other numbers")
        except BaseException as error:  # noqa: BLE001
            wrong.append(f"thread {number}: {error}")

    threads = [threading.Thread(target=work, args=(n,)) for n in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return wrong


def fork_one(problem, expected):
    """A child that goes on with the program of its parent."""
    child = os.fork()
    if child == 0:
        good = False
        try:
            good = problem.solve({}) == expected
        finally:
            os._exit(0 if good else 1)
    return [] if os.waitpid(child, 0)[1] == 0 else ["a forked child failed"]


def main():
    bar = Bar(
        "R16", "threads, forks and spawned processes", full=20, short=1, adds=True,
        target="32 threads, a fork and spawned processes: the numbers of one thread",
        miss="a thread, child or process that gets other numbers, or an error",
    )  # fmt: skip
    args = bar.parse()
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, deterministic=True)
    problems = [Problem(number) for number in range(THREADS)]
    expected = [p.solve(OPTIONS[n % len(OPTIONS)]) for n, p in enumerate(problems)]
    plain = problems[0].solve({})
    wrong = []
    count = 0
    while count < args.count and bar.left() > 0:
        count += 1
        wrong += run_threads(problems, expected)
        wrong += fork_one(problems[0], plain)
    # Where each is compiled by its own thread, while others sweep.
    fresh = [Problem(number) for number in range(THREADS)]
    wrong += run_threads(fresh, expected)
    processes = 1 if args.short else 4
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        spawned = pool.map(solve_alone, range(processes))
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False)
    for number, answer in enumerate(spawned):
        if answer != Problem(number).solve(OPTIONS[number % len(OPTIONS)]):
            wrong.append(f"spawned process {number} got other numbers")
    for line in wrong[:5]:
        print(f"  {line}")
    bar.report(
        f"{count} times {THREADS} threads and a fork, {processes} spawned",
        f"{len(wrong)} wrong", met=not wrong,
    )  # fmt: skip


if __name__ == "__main__":
    main()
