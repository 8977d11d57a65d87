"""Particles on several ranks against the same particles in one process."""

from __future__ import annotations

import numpy as np
import pytest
import tai as ti

import rank_particles
import rank_pipes


def check(scene, ranks, fp, moves, **options):
    whole = rank_particles.run(None, scene, fp, options)
    # Sums have another order on each number of ranks. The rounding of f32 in one process tells how
    # much that may change.
    exact = rank_particles.run(None, scene, "f64", options)
    rounding = {
        name: np.abs(value - exact[name]).max() / max(1.0, np.abs(value).max())
        for name, value in whole.items()
    }
    ti.init(arch=ti.cpu)
    found = rank_pipes.run_ranks(rank_particles.run, ranks, scene, fp, options)
    for result in found:
        assert not isinstance(result, str), result
        assert not moves or result.pop("moves") > 0
        for name, value in whole.items():
            if name == "moves":
                continue
            scale = max(1.0, np.abs(value).max())
            error = np.abs(np.asarray(result[name]) - value).max() / scale
            assert error <= (1e-12 if fp == "f64" else max(1e-6, rounding[name])), (name, error)


@pytest.mark.parametrize("fp", ["f32", "f64"])
@pytest.mark.parametrize("ranks", [2, 4])
@pytest.mark.parametrize("scene", ["mpm", "sph"])
def test_particles_of_ranks_move_as_those_of_one_process(scene, ranks, fp):
    check(scene, ranks, fp, moves=True)


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_data_choose_rows_of_all_ranks(ranks):
    check("everywhere", ranks, "f64", moves=False)


@pytest.mark.parametrize("ranks", [2, 3])
def test_particles_that_do_not_fit_are_an_error_on_all_ranks(ranks):
    for room, slots, row in rank_pipes.run_ranks(rank_particles.too_far, ranks):
        # The ranks that wait in the exchange report the reason, too.
        assert "4 particles leave rank 0 for rank 1, and there is room for 2" in room
        assert "rank 1 gets 2 particles and has 1 free slots" in slots
        assert "data choose row" in row and "rank_particles.py" in row
