"""A decomposition by an iterative solver, with a gradient written by hand.

The forward pass takes 3x3 matrices apart, M = U S V*, by as many Jacobi sweeps as asked for.
Differentiating the iterations would be slow and inexact; the derivative of their limit has a closed
form. `complex_kernel` wraps the solver, and `complex_kernel_grad` gives it that derivative.
Gradient descent then deforms the matrices until their rotations U V* and their stretches S are the
wanted ones.

    python examples/svd_gradient.py
    python examples/svd_gradient.py --matrices 64 --sweeps 8 --iterations 200
"""

from typing import Any

import numpy as np
import tai as ti

import studio

EPSILON = 1e-10

parser = studio.options(__doc__, "svd_gradient", iterations=400, rate=0.05)
parser.add_argument("--matrices", type=studio.at_least(1), default=16, help="how many (16)")
text = "Jacobi sweeps of the forward solver (6)"
parser.add_argument("--sweeps", type=studio.at_least(1), default=6, help=text)
parser.set_defaults(double=True)
args = parser.parse_args()
studio.start(args)

n = args.matrices
M = ti.Matrix.field(3, 3, ti.f64, shape=n, needs_grad=True)
U = ti.Matrix.field(3, 3, ti.f64, shape=n, needs_grad=True)
V = ti.Matrix.field(3, 3, ti.f64, shape=n, needs_grad=True)
sigma = ti.Vector.field(3, ti.f64, shape=n, needs_grad=True)
wanted_rotation = ti.Matrix.field(3, 3, ti.f64, shape=n)
wanted_sigma = ti.Vector.field(3, ti.f64, shape=n)
loss = ti.field(ti.f64, shape=(), needs_grad=True)


@ti.kernel
def iterative_svd(sweeps: ti.i32):
    """One-sided Jacobi: rotations from the right make the columns of M orthogonal."""
    for i in range(n):
        b = M[i]
        v = ti.Matrix.identity(ti.f64, 3)
        for _ in range(sweeps):
            for p, q in ti.static(((0, 1), (0, 2), (1, 2))):
                x = ti.Vector([b[0, p], b[1, p], b[2, p]])
                y = ti.Vector([b[0, q], b[1, q], b[2, q]])
                across = x.dot(y)
                if across != 0:
                    zeta = (y.dot(y) - x.dot(x)) / (2 * across)
                    t = 1 / (abs(zeta) + ti.sqrt(1 + zeta * zeta))
                    t = t if zeta > 0 else -t
                    c = 1 / ti.sqrt(1 + t * t)
                    s = c * t
                    for r in ti.static(range(3)):
                        b_p, v_p = b[r, p], v[r, p]
                        b[r, p] = c * b_p - s * b[r, q]
                        b[r, q] = s * b_p + c * b[r, q]
                        v[r, p] = c * v_p - s * v[r, q]
                        v[r, q] = s * v_p + c * v[r, q]
        for k in ti.static(range(3)):
            length = ti.Vector([b[0, k], b[1, k], b[2, k]]).norm()
            sigma[i][k] = length
            for r in ti.static(range(3)):
                U[i][r, k] = b[r, k] / length
                V[i][r, k] = v[r, k]


@ti.func
def quotient(a: Any, b: Any):
    """a / b; where b vanishes the factors turn freely, and no derivative comes from there."""
    result = 0.0
    if abs(b) > EPSILON:
        result = a / b
    return result


@ti.kernel
def svd_gradient():
    """The adjoint of M = U S V*.

    U turns by W and V by X, both skew. For i < j, with P = U* dM V,
        W_ij + X_ij = (P_ij + P_ji) / (s_j - s_i),  W_ij - X_ij = (P_ij - P_ji) / (s_j + s_i),
    and dS is the diagonal of P.
    """
    for i in range(n):
        gu = U[i].transpose() @ U.grad[i]
        gv = V[i].transpose() @ V.grad[i]
        inner = ti.Matrix.zero(ti.f64, 3, 3)
        for k in ti.static(range(3)):
            inner[k, k] = sigma.grad[i][k]
        for j, k in ti.static(((0, 1), (0, 2), (1, 2))):
            w, x = gu[j, k] - gu[k, j], gv[j, k] - gv[k, j]
            even = quotient(0.5 * (w + x), sigma[i][k] - sigma[i][j])
            odd = quotient(0.5 * (w - x), sigma[i][k] + sigma[i][j])
            inner[j, k], inner[k, j] = even + odd, even - odd
        M.grad[i] += U[i] @ inner @ V[i].transpose()


@ti.ad.complex_kernel
def svd_forward(sweeps: int):
    iterative_svd(sweeps)


@ti.ad.complex_kernel_grad(svd_forward)
def svd_backward(sweeps: int):
    svd_gradient()


@ti.kernel
def compute_loss():
    for i in range(n):
        rotation = U[i] @ V[i].transpose() - wanted_rotation[i]
        stretch = sigma[i].sum() - wanted_sigma[i].sum()
        volume = sigma[i][0] * sigma[i][1] * sigma[i][2]
        wanted = wanted_sigma[i][0] * wanted_sigma[i][1] * wanted_sigma[i][2]
        loss[None] += rotation.norm_sqr() + stretch**2 + (volume - wanted) ** 2


def forward():
    loss[None] = 0.0
    svd_forward(args.sweeps)
    compute_loss()


def turn(generator: np.random.Generator):
    """A random rotation that is not far from the identity."""
    a = generator.standard_normal((n, 3, 3))
    u, _, vt = np.linalg.svd(np.eye(3) + 0.2 * (a - np.swapaxes(a, 1, 2)))
    return u @ vt


def main():
    generator = np.random.default_rng(args.seed + 1)
    M.from_numpy(np.eye(3) + 0.1 * generator.standard_normal((n, 3, 3)))
    wanted_rotation.from_numpy(turn(generator))
    wanted_sigma.from_numpy(generator.uniform(0.8, 1.5, (n, 3)))

    # The slope along a random direction, by the gradient and by differences.
    direction, start, step = generator.standard_normal((n, 3, 3)), M.to_numpy(), 1e-5
    with ti.ad.Tape(loss):
        forward()
    slope = float((M.grad.to_numpy() * direction).sum())
    sides: list[float] = []
    for side in (1, -1):
        M.from_numpy(start + side * step * direction)
        forward()
        sides.append(loss[None])
    M.from_numpy(start)
    difference = (sides[0] - sides[1]) / (2 * step)
    print(f"slope   {slope:.9f} by the gradient, {difference:.9f} by differences")

    def iteration(_: int):
        with ti.ad.Tape(loss):
            forward()
        M.from_numpy(M.to_numpy() - args.rate * M.grad.to_numpy())
        return loss[None]

    losses = studio.optimise(args, iteration, M=M)
    studio.plot_losses(args, losses, log=True)


if __name__ == "__main__":
    main()
