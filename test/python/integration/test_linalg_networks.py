"""Networks in linalg on tensors, as torch-mlir emits them, trained through a kernel that simulates.

The networks are differentiated and lowered by one pipeline of a stock mlir-opt with the plugin.
"""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
BUILD = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build"))
LLVM = Path("/usr/lib/llvm-22/bin")
PLUGIN = BUILD / "lib/TaiPlugin.so"
pytestmark = pytest.mark.skipif(
    not PLUGIN.exists() or not (LLVM / "mlir-opt").exists(),
    reason="this machine has no plugin of the build or no mlir-opt",
)

sys.path.insert(0, str(ROOT / "test/AD/Foreign/Inputs"))
import check_foreign  # noqa: E402

PERCEPTRON = """
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (j)>
func.func @f(%x: tensor<8x3xf32>, %w1: tensor<3x6xf32>, %b1: tensor<6xf32>,
             %w2: tensor<6x2xf32>) -> tensor<8x2xf32> attributes {tai.differentiate} {
  %zero = arith.constant 0.000000e+00 : f32
  %0 = tensor.empty() : tensor<8x6xf32>
  %1 = linalg.fill ins(%zero : f32) outs(%0 : tensor<8x6xf32>) -> tensor<8x6xf32>
  %2 = linalg.matmul ins(%x, %w1 : tensor<8x3xf32>, tensor<3x6xf32>)
    outs(%1 : tensor<8x6xf32>) -> tensor<8x6xf32>
  %3 = linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel"]}
    ins(%2, %b1 : tensor<8x6xf32>, tensor<6xf32>) outs(%0 : tensor<8x6xf32>) {
  ^bb0(%a: f32, %b: f32, %o: f32):
    %s = arith.addf %a, %b : f32
    linalg.yield %s : f32
  } -> tensor<8x6xf32>
  %4 = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel", "parallel"]}
    ins(%3 : tensor<8x6xf32>) outs(%0 : tensor<8x6xf32>) {
  ^bb0(%a: f32, %o: f32):
    %p = arith.cmpf ugt, %a, %zero : f32
    %r = arith.select %p, %a, %zero : f32
    linalg.yield %r : f32
  } -> tensor<8x6xf32>
  %5 = tensor.empty() : tensor<8x2xf32>
  %6 = linalg.fill ins(%zero : f32) outs(%5 : tensor<8x2xf32>) -> tensor<8x2xf32>
  %7 = linalg.matmul ins(%4, %w2 : tensor<8x6xf32>, tensor<6x2xf32>)
    outs(%6 : tensor<8x2xf32>) -> tensor<8x2xf32>
  return %7 : tensor<8x2xf32>
}
"""

CONVOLUTIONS = """
#id = affine_map<(n, c, i, j) -> (n, c, i, j)>
#channel = affine_map<(n, c, i, j) -> (c)>
#pooled = affine_map<(n, c, i, j) -> (n, c)>
func.func @f(%x: tensor<8x1x6x6xf32>, %w1: tensor<3x1x3x3xf32>, %b1: tensor<3xf32>,
             %w2: tensor<2x3x3x3xf32>) -> tensor<8x2xf32> attributes {tai.differentiate} {
  %zero = arith.constant 0.000000e+00 : f32
  %quarter = arith.constant 2.500000e-01 : f32
  %0 = tensor.empty() : tensor<8x3x4x4xf32>
  %1 = linalg.fill ins(%zero : f32) outs(%0 : tensor<8x3x4x4xf32>) -> tensor<8x3x4x4xf32>
  %2 = linalg.conv_2d_nchw_fchw
    {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>}
    ins(%x, %w1 : tensor<8x1x6x6xf32>, tensor<3x1x3x3xf32>)
    outs(%1 : tensor<8x3x4x4xf32>) -> tensor<8x3x4x4xf32>
  %3 = linalg.generic {indexing_maps = [#id, #channel, #id],
      iterator_types = ["parallel", "parallel", "parallel", "parallel"]}
    ins(%2, %b1 : tensor<8x3x4x4xf32>, tensor<3xf32>) outs(%0 : tensor<8x3x4x4xf32>) {
  ^bb0(%a: f32, %b: f32, %o: f32):
    %s = arith.addf %a, %b : f32
    %t = math.tanh %s : f32
    linalg.yield %t : f32
  } -> tensor<8x3x4x4xf32>
  %4 = tensor.empty() : tensor<8x2x2x2xf32>
  %5 = linalg.fill ins(%zero : f32) outs(%4 : tensor<8x2x2x2xf32>) -> tensor<8x2x2x2xf32>
  %6 = linalg.conv_2d_nchw_fchw
    {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>}
    ins(%3, %w2 : tensor<8x3x4x4xf32>, tensor<2x3x3x3xf32>)
    outs(%5 : tensor<8x2x2x2xf32>) -> tensor<8x2x2x2xf32>
  %7 = tensor.empty() : tensor<8x2xf32>
  %8 = linalg.fill ins(%zero : f32) outs(%7 : tensor<8x2xf32>) -> tensor<8x2xf32>
  %9 = linalg.generic {indexing_maps = [#id, #pooled],
      iterator_types = ["parallel", "parallel", "reduction", "reduction"]}
    ins(%6 : tensor<8x2x2x2xf32>) outs(%8 : tensor<8x2xf32>) {
  ^bb0(%a: f32, %o: f32):
    %m = arith.mulf %a, %quarter : f32
    %s = arith.addf %m, %o : f32
    linalg.yield %s : f32
  } -> tensor<8x2xf32>
  return %9 : tensor<8x2xf32>
}
"""


class Network:
    """A function of the inputs and weights, and its gradient by the weights."""

    def __init__(self, text, folder):
        made = subprocess.run(
            [
                LLVM / "mlir-opt",
                f"--load-dialect-plugin={PLUGIN}",
                f"--load-pass-plugin={PLUGIN}",
                "--pass-pipeline=builtin.module(tai-autodiff)",
            ],
            input=text,
            capture_output=True,
            text=True,
        )
        assert made.returncode == 0, made.stderr
        signature = check_foreign.signature(text, "f")
        self.inputs, self.results = (
            [check_foreign.Type(t) for t in part] for part in signature[:2]
        )
        tools = SimpleNamespace(
            mlir_opt=LLVM / "mlir-opt",
            translate=LLVM / "mlir-translate",
            clang=LLVM / "clang",
            llvm_lib=os.path.realpath(LLVM / "../lib"),
        )
        self.library = check_foreign.lower(tools, made.stdout, folder, "network")

    def __call__(self, values):
        given = [v.copy() for v in values]
        return check_foreign.call(self.library, "f", self.inputs, self.results, given)[0]

    def gradient(self, values, seed):
        given = [v.copy() for v in [*values, seed]]
        return check_foreign.call(
            self.library, "f_grad", self.inputs + self.results, self.inputs, given
        )


@pytest.mark.parametrize(
    "text, rate",
    [(PERCEPTRON, 0.01), (CONVOLUTIONS, 0.001)],
    ids=["perceptron", "convolutions"],
)
def test_trains_through_a_simulation(text, rate, tmp_path):
    network = Network(text, tmp_path)
    force = ti.field(ti.f32, shape=(8, 2), needs_grad=True)
    target = ti.field(ti.f32, shape=(8, 2))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def simulate():
        for i, k in force:
            position = 0.0
            velocity = 0.0
            for _ in range(10):
                velocity += 0.2 * (force[i, k] - 0.1 * velocity)
                position += 0.2 * velocity
            loss[None] += (position - target[i, k]) ** 2

    rng = np.random.default_rng(3)
    values = [rng.uniform(-0.5, 0.5, t.shape).astype(np.float32) for t in network.inputs]
    features = values[0].reshape(8, -1)
    mean = features.mean(axis=1)
    target.from_numpy(np.stack([3 * mean, 1 - mean], 1))

    def run(values):
        force.from_numpy(network(values))
        loss[None] = 0
        with ti.ad.Tape(loss):
            simulate()
        return loss[None]

    first = run(values)
    gradient = network.gradient(values, force.grad.to_numpy())
    direction = [rng.uniform(-1, 1, v.shape).astype(np.float32) for v in values]
    h = 1e-3
    ends = [run([v + s * h * d for v, d in zip(values, direction)]) for s in (1, -1)]
    slope = sum(float(np.sum(g * d)) for g, d in zip(gradient, direction))
    assert slope == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=2e-2, abs=2e-3)

    for _ in range(200):
        run(values)
        gradient = network.gradient(values, force.grad.to_numpy())
        for v, g in zip(values[1:], gradient[1:]):
            v -= rate * g
    assert run(values) < 0.2 * first
