"""A program for `torchrun` whose rank 1 hangs or ends: rank_program.py hang|end FOLDER TIMEOUT.

Each rank writes its process id to a file of the folder.
"""

import os
import sys
import threading
from pathlib import Path

import tai as ti

deed, folder, timeout = sys.argv[1:4]
Path(folder, os.environ["RANK"]).write_text(str(os.getpid()))
ranks = int(os.environ["WORLD_SIZE"])
mesh = ti.mesh("x", ranks, timeout=float(timeout))
ti.init(arch=ti.cpu, mesh=mesh, offline_cache=False)

x, y = ti.field(float, name="x"), ti.field(float, name="y")
ti.root.shard(ti.i).dense(ti.i, 4 * ranks).place(x, y)


@ti.kernel
def blur():
    for i in x:
        y[i] = x[ti.max(i - 1, 0)] + x[ti.min(i + 1, 4 * ranks - 1)]


for step in range(10):
    x.fill(step)  # The halos are current no longer.
    blur()
    if mesh.rank == 1 and step == 2:
        if deed == "end":
            os._exit(3)
        threading.Event().wait()
