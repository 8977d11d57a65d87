"""Programs on several processes against the same programs on one process without a mesh."""

from __future__ import annotations

import numpy as np
import pytest
import tai as ti

import rank_pipes
import rank_scenes


def check(scene, ranks, fp):
    whole = rank_scenes.run(None, scene, fp)
    for result in rank_pipes.run_ranks(rank_scenes.run, ranks, scene, fp):
        assert not isinstance(result, str), result
        for name, value in whole.items():
            scale = max(1.0, np.abs(value).max())
            error = np.abs(np.asarray(result[name]) - value).max() / scale
            assert error <= (1e-12 if fp == "f64" else 1e-6), (name, error)


@pytest.mark.parametrize("fp", ["f32", "f64"])
@pytest.mark.parametrize("ranks", [1, 2, 3])
@pytest.mark.parametrize("scene", ["wave", "heat", "scatter"])
def test_ranks_give_values_and_gradients_of_one_process(scene, ranks, fp):
    check(scene, ranks, fp)


@pytest.mark.parametrize("ranks", [2, 3, 4])
@pytest.mark.parametrize("scene", ["forward", "peak", "host"])
def test_ranks_give_derivatives_of_one_process(scene, ranks):
    check(scene, ranks, "f64")


def test_gradients_are_checked_on_one_process():
    (result,) = rank_pipes.run_ranks(rank_scenes.checked, 1, ti.f64)
    assert result == {"function": True, "tape": None}
    for result in rank_pipes.run_ranks(rank_scenes.checked, 2, ti.f64):
        for name in ("function", "tape"):
            assert "gradients are checked on one process" in result[name], result


def test_deterministic_ranks_give_the_bits_of_one_process():
    # 84,084 numbers: neither the rows nor the numbers of a rank are whole blocks of a sum.
    n = 12012
    whole = rank_scenes.fixed(None, 2, n)
    ti.init(arch=ti.cpu)
    for ranks in (1, 2, 3, 4):
        for result in rank_pipes.run_ranks(rank_scenes.fixed, ranks, 1, n):
            assert not isinstance(result, str), result
            for name, bits in whole.items():
                assert result[name] == bits, (ranks, name)


@pytest.mark.parametrize(
    ("rows", "ranks", "made"),
    [(24, 2, {"fetch": 5}), (24, 4, {"fetch": 5}), (8, 4, {"fetch": 5}),
     # The interior of four rows is too small a part of the field.
     (4, 4, {"fetch": 4, "clear": 1, "collect": 1})],
)  # fmt: skip
def test_gradients_of_stencils_are_gathered_from_halos(rows, ranks, made):
    whole = rank_scenes.stencil(None, rows, 2, False)
    for result in rank_pipes.run_ranks(rank_scenes.stencil, ranks, rows, 2, False):
        assert not isinstance(result, str), result
        assert result["made"] == made
        for name in ("loss", "gradient", "v"):
            scale = max(1.0, np.abs(whole[name]).max())
            assert np.abs(np.asarray(result[name]) - whole[name]).max() / scale <= 1e-6, name


@pytest.mark.parametrize("threads", [1, 2])
def test_deterministic_gradients_of_stencils_have_the_bits_of_one_process(threads):
    whole = rank_scenes.stencil(None, 24, threads, True)
    for result in rank_pipes.run_ranks(rank_scenes.stencil, 2, 24, threads, True):
        assert not isinstance(result, str), result
        for name in ("loss", "gradient", "v"):
            assert np.array_equal(result[name], whole[name]), name


@pytest.mark.parametrize("ranks", [2, 3])
def test_halos_that_are_current_are_not_fetched_again(ranks):
    whole = rank_scenes.reuse(None, ti.f64)
    ti.init(arch=ti.cpu)
    made = {
        "first": (1, 0), "same": (0, 1), "wider": (1, 0), "narrower": (0, 1), "change": (0, 0),
        "changed": (1, 0), "written": (1, 0), "filled": (1, 0), "copied": (1, 0), "step": (1, 0),
        "step again": (0, 1), "other step": (1, 0),
    }  # fmt: skip
    for result in rank_pipes.run_ranks(rank_scenes.reuse, ranks, ti.f64):
        assert not isinstance(result, str), result
        assert {name: (fetched, out) for name, fetched, out, _ in result["steps"]} == made
        for ours, theirs in zip(result["steps"], whole["steps"], strict=True):
            assert ours[0] == theirs[0] and ours[3] == theirs[3], ours[0]
        for name in ("u", "gradient"):
            assert np.array_equal(result[name], whole[name]), name
