"""Programs on 1, 2 and 3 processes against the same programs on one process without a mesh."""

from __future__ import annotations

import numpy as np
import pytest

import rank_pipes
import rank_scenes


@pytest.mark.parametrize("fp", ["f32", "f64"])
@pytest.mark.parametrize("ranks", [1, 2, 3])
@pytest.mark.parametrize("scene", ["wave", "heat", "scatter"])
def test_ranks_give_values_and_gradients_of_one_process(scene, ranks, fp):
    whole = rank_scenes.run(None, scene, fp)
    for result in rank_pipes.run_ranks(rank_scenes.run, ranks, scene, fp):
        assert not isinstance(result, str), result
        for name, value in whole.items():
            scale = max(1.0, np.abs(value).max())
            error = np.abs(np.asarray(result[name]) - value).max() / scale
            assert error <= (1e-12 if fp == "f64" else 1e-6), (name, error)
