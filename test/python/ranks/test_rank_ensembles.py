"""Losses over many scenes that ranks share."""

from __future__ import annotations

import numpy as np
import pytest
import tai as ti

import rank_ensembles
import rank_pipes


@pytest.mark.parametrize("ranks", [1, 2, 4])
def test_ranks_share_scenes_and_give_the_bits_of_one_process(ranks):
    whole = rank_ensembles.spread(None, 3)
    ti.init(arch=ti.cpu)
    assert sum(whole["scenes"]) == 50 and len(whole["scenes"]) == 1
    for result in rank_pipes.run_ranks(rank_ensembles.spread, ranks, 3):
        assert not isinstance(result, str), result
        assert sum(result["scenes"]) == 50 and len(result["scenes"]) == ranks
        assert result["loss"] == whole["loss"]
        assert np.array_equal(result["gradient"], whole["gradient"])
        assert np.array_equal(result["left"], whole["left"])


def test_a_slow_rank_gets_fewer_scenes():
    first, second = rank_pipes.run_ranks(rank_ensembles.slow, 2)
    assert first == second == [9, 1]


def test_ranks_take_turns_where_the_transport_cannot_count():
    for scenes in rank_pipes.run_ranks(rank_ensembles.turns, 2):
        assert scenes == [6, 4]


def test_a_scene_that_fails_is_an_error_on_all_ranks():
    for text in rank_pipes.run_ranks(rank_ensembles.failing, 2):
        assert "scenes 4 to 5: no such scene" in text


def test_ensembles_have_scenes_and_fields_with_gradients():
    ti.init(arch=ti.cpu)
    x = ti.field(float, shape=())
    with pytest.raises(ti.TaiRuntimeTypeError, match="scenes is a number of scenes, but got 0"):
        ti.ensemble(lambda first, last: 0, 0, [])
    with pytest.raises(ti.TaiAutodiffError, match="field 'x' has no gradient"):
        ti.ensemble(lambda first, last: 0, 1, [x])
    with pytest.raises(ti.TaiRuntimeTypeError, match="wrt is a list of fields, but has 3"):
        ti.ensemble(lambda first, last: 0, 1, [3])
