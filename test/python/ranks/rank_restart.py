"""A program that continues from its last checkpoint: rank_restart.py FOLDER [kill].

With `kill`, the last rank is killed in its first life.
"""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import tai as ti

N, STEPS = 12, 7
folder = Path(sys.argv[1])
ranks = int(os.environ.get("WORLD_SIZE", "1"))
mesh = ti.mesh("x", ranks, timeout=20)
ti.init(arch=ti.cpu, default_fp=ti.f64, mesh=mesh, offline_cache=False)

x, y, now = ti.field(float, name="x"), ti.field(float, name="y"), ti.field(int)
ti.root.shard(ti.i).dense(ti.i, N).place(x, y)
ti.root.place(now)


@ti.kernel
def step():
    for i in x:
        y[i] = 0.5 * x[i] + 0.25 * (x[ti.max(i - 1, 0)] + x[ti.min(i + 1, N - 1)])
    for i in x:
        x[i] = y[i]


if (folder / "run.npz").exists():
    ti.checkpoint.load(folder / "run.npz", x=x, now=now)
    if mesh.rank == 0:
        (folder / "continued").write_text(str(now[None]))
else:
    x.from_numpy(np.arange(N) ** 2.0)
while now[None] < STEPS:
    step()
    now[None] += 1
    if now[None] % 2 == 0:
        ti.checkpoint.save(folder / "run.npz", x=x, now=now)
    is_first = os.environ.get("TORCHELASTIC_RESTART_COUNT") == "0"
    if "kill" in sys.argv and is_first and mesh.rank == ranks - 1 and now[None] == 5:
        os.kill(os.getpid(), signal.SIGKILL)
result = x.to_numpy()
if mesh.rank == 0:
    np.save(folder / "result.npy", result)
