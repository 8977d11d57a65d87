"""A `ti.init` that is refused leaves the program as it was: its fields, kernels and options."""

import os
import subprocess
import sys

import numpy as np
import pytest
import tai as ti


@ti.kernel
def total(x: ti.template()) -> ti.f32:
    s = 0.0
    for i in x:
        s += x[i]
    return s


REFUSED = {
    "misspelt": {"debg": True},
    "value": {"opt_level": 17},
    "kind": {"kernel_profiler": "perhaps"},
    "default_fp": {"default_fp": ti.i32},
    "default_ip": {"default_ip": "f32"},
    "choice": {"bounds": "sometimes"},
    "together": {"math": "strict", "fast_math": True},
    "threads": {"cpu_max_num_threads": -3},
    "target": {"arch": "cuba"},
    "extension": {"require": ti.extension.quant},
    "excluded": {"exclude": [ti.cpu, ti.cuda]},
    "skip": {"skip": "all,-nothing-of-that-name"},
    "cpu": {"target_cpu": "z80"},
}


@pytest.mark.parametrize("options", REFUSED.values(), ids=REFUSED)
def test_fields_live_on(options):
    ti.init(arch=ti.cpu, default_fp=ti.f64, random_seed=7)
    x = ti.field(float, shape=5)
    x.from_numpy(np.arange(5.0))
    assert total(x) == 10
    with pytest.raises(ti.TaiError):
        ti.init(**{"arch": ti.cpu, **options})
    assert x.dtype is ti.f64 and list(x.to_numpy()) == [0, 1, 2, 3, 4]
    x[1] = 2.0
    assert total(x) == 11
    # The options hold for fields that are made later, too.
    y = ti.field(float, shape=3)
    y.fill(2)
    assert y.dtype is ti.f64 and total(y) == 6
    ti.init(arch=ti.cpu)
    with pytest.raises(ti.TaiError):
        x.to_numpy()


def test_device_that_is_not_there():
    """In a process of its own, where no driver is found."""
    script = """if True:
        import tai as ti
        ti.init(arch=ti.cpu)
        x = ti.field(ti.f32, shape=4)
        x.fill(3)
        try:
            ti.init(arch=ti.cuda)
        except ti.TaiError as error:
            print("refused", "cuda" in str(error).lower())
        print(x.to_numpy().tolist())
    """
    here = {k: v for k, v in os.environ.items() if k not in ("TI_ARCH", "TAI_CUDA_EMULATION")}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=120,
        env={**here, "CUDA_VISIBLE_DEVICES": "", "LD_LIBRARY_PATH": ""},
    )  # fmt: skip
    assert done.stdout.splitlines() == ["refused True", "[3.0, 3.0, 3.0, 3.0]"], done.stderr


def test_tape_that_is_open_still_refuses():
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    y = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        y[None] = 3 * x[None]

    with ti.ad.Tape(y):
        run()
        with pytest.raises(ti.TaiRuntimeError, match="inside a ti.ad.Tape"):
            ti.init(arch=ti.cpu)
    assert x.grad[None] == 3
