"""Ways to call things in kernels that programs for Taichi use."""

import numpy as np
import tai as ti


def test_methods_of_matrices_called_through_the_class():
    out = ti.field(ti.f32, shape=5)

    @ti.kernel
    def kernel():
        v = ti.Vector([3.0, 4.0])
        n = ti.Vector.normalized(v, 1.0)
        out[0] = n[0]
        out[1] = ti.Vector.norm(v)
        out[2] = ti.Vector.dot(v, n)
        m = ti.Matrix([[1.0, 2.0], [3.0, 4.0]])
        out[3] = ti.Matrix.transpose(m)[0, 1]
        out[4] = ti.Matrix.determinant(m)

    kernel()
    np.testing.assert_allclose(out.to_numpy(), [0.5, 5, 25 / 6, 3, -2], rtol=1e-6)


def test_targets_that_are_not_here_fall_back(capsys, monkeypatch):
    for name in ("TI_ARCH", "TAI_CUDA_EMULATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TAI_CUDA_DRIVER", "libno-such-driver.so.1")
    for arch, more in ((ti.gpu, {}), (ti.cuda, {"enable_fallback": True})):
        ti.init(arch=arch, default_fp=ti.f32, device_memory_GB=1.0, **more)
        x = ti.field(ti.f32, shape=2)
        x.fill(3)
        assert x[1] == 3
        assert "falling back to arch=cpu: no CUDA driver" in capsys.readouterr().err
