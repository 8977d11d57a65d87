"""The programs of benchmarks/zoo, small: their gradients against differences of their losses."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

ZOO = Path(__file__).resolve().parents[3] / "benchmarks" / "zoo"
SMALL = {
    "adi": {"n": 9, "steps": 2},
    "cloth": {"n": 8, "steps": 2, "sweeps": 1},
    "fem_cg": {"n": 7, "rounds": 4},
    "lbm": {"n": 10, "steps": 3},
    "nbody": {"n": 33, "steps": 3},
    "neural_field": {"n": 9, "width": 5},
    "ray_marcher": {"n": 11, "marches": 6, "balls": 2},
    "shallow_water": {"n": 10, "steps": 4},
    "sph": {"n": 60, "steps": 3, "cells": 6},
}


@pytest.fixture
def zoo(monkeypatch):
    monkeypatch.syspath_prepend(str(ZOO))

    def make(name):
        # Another test may have left a module of this name.
        sys.modules.pop(name, None)
        return importlib.import_module(name).make(**SMALL[name])

    yield make
    for name in SMALL:
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", SMALL)
def test_gradients_are_slopes(name, zoo):
    ti.init(cpu_max_num_threads=2)
    iterate, loss, unknown = zoo(name)
    iterate()
    values, slopes = unknown.to_numpy(), unknown.grad.to_numpy()
    size = np.linalg.norm(slopes)
    assert np.isfinite(size) and size > 0
    # Along the gradient itself the loss changes most: its slope there is the norm.
    way = slopes / size

    def loss_at(step):
        unknown.from_numpy((values + step * way).astype(np.float32))
        iterate()
        return float(loss[None])

    found = []
    for step in (1e-1, 3e-2, 1e-2):
        found.append((loss_at(step) - loss_at(-step)) / (2 * step))
    assert min(abs(slope - size) for slope in found) < 0.02 * size, (found, size)


def test_all_programs_are_here():
    programs = {path.stem for path in ZOO.glob("*.py")} - {"first_iterations", "regress"}
    assert programs == set(SMALL)


def test_comparison_of_builds(monkeypatch):
    """A row is as slow as its best round, a part that got slower is seen, and so is a failure."""
    monkeypatch.syspath_prepend(str(ZOO))
    compare = importlib.import_module("regress").compare
    base = [{"forward": 1.0, "adjoint": 4.0}, {"forward": 2.0, "adjoint": 5.0}]
    new = [{"forward": 1.5, "adjoint": 8.0}, {"forward": 2.0, "adjoint": 7.5}]
    assert compare(base, new) == [("forward", 1.0, 1.5, 1.0), ("adjoint", 4.0, 7.5, 1.5)]
    assert compare(base, [new[0], None])[0][-1] == float("inf")
    assert compare([None, base[1]], new) == []
