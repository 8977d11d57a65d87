"""Examples and scenes give the same losses and gradients however they run.

Each is compared with one reference: the CPU, one thread, no optimisation, launches one by one, no
recomputing. In f64 all others agree to 1e-10 of the largest number; deterministic ones are equal to
the last bit among each other. `make test-differential` takes larger sizes and all combinations.
"""

import itertools
import os

import numpy as np
import pytest

import differential
from differential import Configuration, Way

# Where the other half of the ways runs.
IS_GPU = os.environ.get("TI_ARCH") == "cuda" and os.environ.get("TAI_CUDA_EMULATION") != "1"
DEVICE = "cuda" if IS_GPU else "emulated"

BOUND = 1e-10
FLOOR = 1e-4

WAYS = [
    Way(Configuration("cpu", threads=3, level=0), checkpoint=2),
    Way(Configuration("cpu", threads=1, level=3)),
    Way(Configuration("cpu", threads=3, level=3), checkpoint="periodic", fused=True),
    Way(Configuration(DEVICE, threads=32, level=0), fused=True),
    Way(Configuration(DEVICE, threads=1, level=3), fused=True),
    Way(Configuration(DEVICE, threads=64, level=3), checkpoint=2),
]
ALL_WAYS = [
    Way(Configuration(arch, threads, level), checkpoint, fused)
    for arch, level, checkpoint, fused in itertools.product(
        ("cpu", DEVICE), (0, 3), (None, 2, "periodic"), (False, True)
    )
    for threads in ((1, 3) if arch == "cpu" else (1, 32, 96))
]
# Equal to the last bit.
DETERMINISTIC = [
    Way(Configuration("cpu", threads=1, level=3, deterministic=True)),
    Way(Configuration("cpu", threads=3, level=3, deterministic=True), fused=True),
    Way(Configuration("cpu", threads=3, level=3, deterministic=True), checkpoint=2),
]


def difference(found, expected):
    """Fields that differ, by name and in relation to the largest number.

    Numbers that are small beside other gradients may be remainders of a cancellation.
    """
    least = FLOOR * max(float(np.max(np.abs(v))) for n, v in expected.items() if "loss" not in n)
    assert found.keys() == expected.keys()
    errors = {}
    for name, reference in expected.items():
        value = found[name]
        assert value.shape == reference.shape
        assert np.isfinite(reference).all(), name
        scale = max(float(np.max(np.abs(reference))), least) or 1.0
        error = float(np.max(np.abs(value - reference))) / scale
        if not error <= BOUND:
            errors[name] = error
    return errors


@pytest.mark.parametrize("scene", differential.SCENES)
def test_scene(scene, tmp_path, request):
    is_long = request.config.getoption("--long")
    expected = differential.run(scene, differential.REFERENCE, tmp_path, is_long)
    assert any(np.any(value) for name, value in expected.items() if "loss" not in name)
    wrong = {}
    for way in ALL_WAYS if is_long else WAYS:
        try:
            if errors := difference(differential.run(scene, way, tmp_path, is_long), expected):
                wrong[str(way)] = errors
        except Exception as error:
            wrong[str(way)] = f"{type(error).__name__}: {error}"
    bits = None
    for way in DETERMINISTIC:
        found = differential.run(scene, way, tmp_path, is_long)
        if errors := difference(found, expected):
            wrong[str(way)] = errors
        bits = bits or found
        if not all(np.array_equal(value, bits[name]) for name, value in found.items()):
            wrong[f"{way}: bits"] = [n for n, v in found.items() if not np.array_equal(v, bits[n])]
    assert not wrong


def test_a_difference_is_seen():
    expected = {"loss": np.array(2.0), "x.grad": np.array([1.0, 1e-8]), "y.grad": np.array([1e-16])}
    found = {"loss": np.array(2.0), "x.grad": np.array([1.0, 2e-8]), "y.grad": np.array([1e-17])}
    assert list(difference(found, expected)) == ["x.grad"]
