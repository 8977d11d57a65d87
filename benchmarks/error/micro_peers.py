"""The micro-kernels in jax, torch and warp, each in its own idiom."""

import numpy as np

import harness
import micro


def make(name: str, data, system: str) -> harness.Program | None:
    return {"jax": _jax, "torch": _torch, "warp": _warp}[system](name, data)


def _jax(name, data):
    import jax.numpy as jnp

    from peers import peer_jax

    inputs = {key: jnp.asarray(array, dtype=peer_jax.REAL) for key, array in data.inputs.items()}
    values = None
    if isinstance(data, micro.Sum):
        loss = jnp.sum
    elif isinstance(data, micro.Scatter):
        cell, scale = jnp.asarray(data.cell), len(data.cell)

        def loss(x):
            return (jnp.zeros(data.cells, x.dtype).at[cell].add(x) ** 2).sum() / scale

    elif isinstance(data, micro.Stencil):

        def loss(u):
            around = sum(jnp.roll(u, s, axis) for axis in range(3) for s in (1, -1))
            return (inputs["w"] * (around - 6 * u) ** 2).sum()

    elif isinstance(data, micro.Map):
        values = {"exp": jnp.exp, "sin": jnp.sin, "pow": lambda x: x**2.75}[name]

        def loss(x):
            return (inputs["w"] * values(x)).sum()

    else:

        def loss(matrices):
            u, _, vh = jnp.linalg.svd(matrices)
            return (inputs["W"] * (u @ vh)).sum()

    key = next(iter(inputs))
    program = peer_jax.JaxProgram(loss, np.asarray(inputs[key]))
    if values is not None:
        program.values = lambda: np.asarray(values(program.argument))
    return program


def _torch(name, data):
    import torch

    from peers import peer_torch

    leaves = {key: peer_torch.tensor(array) for key, array in data.inputs.items()}
    first = next(iter(leaves))
    leaf = leaves[first].requires_grad_(True)
    values = None
    if isinstance(data, micro.Sum):
        loss = torch.sum
    elif isinstance(data, micro.Scatter):
        cell = torch.tensor(data.cell.astype(np.int64))

        def loss(x):
            return (torch.zeros(data.cells).index_add(0, cell, x) ** 2).sum() / len(cell)

    elif isinstance(data, micro.Stencil):

        def loss(u):
            around = sum(torch.roll(u, s, axis) for axis in range(3) for s in (1, -1))
            return (leaves["w"] * (around - 6 * u) ** 2).sum()

    elif isinstance(data, micro.Map):
        values = {"exp": torch.exp, "sin": torch.sin, "pow": lambda x: x**2.75}[name]

        def loss(x):
            return (leaves["w"] * values(x)).sum()

    else:

        def loss(matrices):
            u, _, vh = torch.linalg.svd(matrices)
            return (leaves["W"] * (u @ vh)).sum()

    program = peer_torch.TorchProgram(loss, [leaf])
    if values is not None:
        program.values = lambda: values(leaf).detach().cpu().numpy()
    return program


def _warp(name, data):
    import warp as wp

    from peers.peer_warp import WarpProgram

    def array(numbers, grad=False):
        return wp.array(numbers.astype(np.float32), dtype=float, requires_grad=grad)

    loss = wp.zeros(1, dtype=float, requires_grad=True)
    if isinstance(data, micro.Sum):
        x = array(data.inputs["x"], True)

        @wp.kernel
        def add(x: wp.array(dtype=float), loss: wp.array(dtype=float)):
            wp.atomic_add(loss, 0, x[wp.tid()])

        def forward():
            wp.launch(add, x.size, [x, loss])

        clear, unknown, out = [], x, None
    elif isinstance(data, micro.Scatter):
        x, cell = array(data.inputs["x"], True), wp.array(data.cell, dtype=int)
        out = wp.zeros(data.cells, dtype=float, requires_grad=True)
        scale = wp.constant(float(len(data.cell)))

        @wp.kernel
        def scatter(x: wp.array(dtype=float), cell: wp.array(dtype=int), o: wp.array(dtype=float)):
            wp.atomic_add(o, cell[wp.tid()], x[wp.tid()])

        @wp.kernel
        def measure(out: wp.array(dtype=float), loss: wp.array(dtype=float)):
            value = out[wp.tid()]
            wp.atomic_add(loss, 0, value * value / scale)

        def forward():
            wp.launch(scatter, x.size, [x, cell, out])
            wp.launch(measure, out.size, [out, loss])

        clear, unknown = [out], x
    elif isinstance(data, micro.Stencil):
        n = wp.constant(data.n)
        u, w = array(data.inputs["u"], True), array(data.inputs["w"])
        out = wp.zeros(u.shape, dtype=float, requires_grad=True)

        @wp.kernel
        def apply(u: wp.array3d(dtype=float), out: wp.array3d(dtype=float)):
            i, j, k = wp.tid()
            around = u[(i + 1) % n, j, k] + u[(i + n - 1) % n, j, k]
            around += u[i, (j + 1) % n, k] + u[i, (j + n - 1) % n, k]
            around += u[i, j, (k + 1) % n] + u[i, j, (k + n - 1) % n]
            out[i, j, k] = around - 6.0 * u[i, j, k]

        @wp.kernel
        def weigh(
            w: wp.array3d(dtype=float), out: wp.array3d(dtype=float), loss: wp.array(dtype=float)
        ):
            i, j, k = wp.tid()
            value = out[i, j, k]
            wp.atomic_add(loss, 0, w[i, j, k] * value * value)

        def forward():
            wp.launch(apply, u.shape, [u, out])
            wp.launch(weigh, u.shape, [w, out, loss])

        clear, unknown = [], u
    elif isinstance(data, micro.Map):
        x, w = array(data.inputs["x"], True), array(data.inputs["w"])
        out = wp.zeros(x.size, dtype=float, requires_grad=True)
        kind = wp.constant(["exp", "sin", "pow"].index(name))

        @wp.kernel
        def evaluate(x: wp.array(dtype=float), out: wp.array(dtype=float)):
            i = wp.tid()
            if wp.static(kind == 0):
                out[i] = wp.exp(x[i])
            elif wp.static(kind == 1):
                out[i] = wp.sin(x[i])
            else:
                out[i] = wp.pow(x[i], 2.75)

        @wp.kernel
        def total(
            w: wp.array(dtype=float), out: wp.array(dtype=float), loss: wp.array(dtype=float)
        ):
            wp.atomic_add(loss, 0, w[wp.tid()] * out[wp.tid()])

        def forward():
            wp.launch(evaluate, x.size, [x, out])
            wp.launch(total, x.size, [w, out, loss])

        clear, unknown = [], x
    else:
        return None  # svd3 is there, but its adjoint has no polar form

    program = WarpProgram(wp, loss, [(unknown, lambda a: a)], forward, clear)
    if isinstance(data, micro.Map):
        program.values = out.numpy
    return program
