"""Checkpoints that ranks write, loaded on other numbers of ranks, and failures of one rank."""

from __future__ import annotations

import os

import numpy as np
import pytest
import tai as ti

import rank_pipes
import rank_scenes

N = 12


def fields(transport):
    rank_scenes.begin(transport, ti.f32)
    x, count, total = ti.field(ti.f32), ti.field(ti.i16), ti.field(ti.f64)
    v, apart, half = ti.Vector.field(2, ti.f64), ti.Vector.field(2, ti.f32), ti.field(ti.bf16)
    rank_scenes.root(transport, ti.j).dense(ti.ij, (2, N)).place(x, v, half)
    rank_scenes.root(transport, ti.j).dense(ti.j, N).place(count)
    rank_scenes.root(transport, ti.j).dense(ti.j, N).place(apart.get_scalar_field(0))
    rank_scenes.root(transport, ti.j).dense(ti.j, N).place(apart.get_scalar_field(1))
    ti.root.place(total)
    ti.root.lazy_grad()
    return {"x": x, "count": count, "total": total, "v": v, "apart": apart, "half": half}


def numbers(transport):
    """The fields, with numbers that a kernel has computed on the rows of each rank alone."""
    found = fields(transport)
    x, count, total, v, apart, half = found.values()

    @ti.kernel
    def start():
        for i, j in x:
            x[i, j] = 0.5 * i + j
            x.grad[i, j] = -x[i, j]
            v[i, j] = ti.Vector([i - j, 2.0 * j])
            half[i, j] = 3 * j
        for j in count:
            count[j] = 2 * j
            total[None] += j
            apart[j] = ti.Vector([1.0 * j, -j])

    start()
    return found


def shown(found):
    return {name: field.to_numpy() for name, field in found.items()} | {
        "x.grad": found["x"].grad.to_numpy()
    }


def save(transport, path):
    found = numbers(transport)
    for _ in range(2):  # The files of the second one replace those of the first one.
        names = ti.checkpoint.save(path, found, gradients=True)
    assert sorted(names)[:3] == ["apart", "apart.grad", "count"]
    return shown(found)


def load(transport, path):
    found = fields(transport)
    ti.checkpoint.load(path, found)
    return shown(found)


def in_one_process(run, *given):
    try:
        return run(None, *given)
    finally:
        ti.init(arch=ti.cpu)


@pytest.mark.parametrize("suffix", [".npz", ".safetensors"])
@pytest.mark.parametrize("writers, readers", [(2, 3), (3, 2), (2, 0), (0, 2), (4, 1), (1, 4)])
def test_a_checkpoint_moves_to_another_number_of_ranks(writers, readers, suffix, tmp_path):
    if suffix == ".safetensors":
        pytest.importorskip("safetensors", reason="the format needs the package of that name")
    path = str(tmp_path / f"run{suffix}")
    expected = in_one_process(lambda _: shown(numbers(None)))

    def on(ranks, run):
        return rank_pipes.run_ranks(run, ranks, path) if ranks else [in_one_process(run, path)]

    for result in on(writers, save) + on(readers, load):
        assert not isinstance(result, str), result
        for name, array in expected.items():
            assert np.array_equal(result[name], array), name
    assert len(list(tmp_path.iterdir())) == (writers + 1 if writers > 1 else 1)


def break_off(transport, path):
    """Rank 1 cannot write the second checkpoint."""
    found = numbers(transport)
    ti.checkpoint.save(path, found)
    before = shown(found)
    found["x"].fill(7)
    if transport.rank == 1:

        def refuse(*_, **__):
            raise OSError("no space left")

        np.savez = refuse
    try:
        ti.checkpoint.save(path, found)
    except (ti.TaiError, OSError) as error:
        message = str(error)
    ti.checkpoint.load(path, found)
    after = shown(found)
    return message, all(np.array_equal(before[name], after[name]) for name in before)


def test_a_checkpoint_that_one_rank_cannot_write_leaves_the_former_one(tmp_path):
    results = rank_pipes.run_ranks(break_off, 3, str(tmp_path / "run.npz"))
    for rank, (message, is_same) in enumerate(results):
        assert is_same and message.startswith("" if rank == 1 else "rank 1 of 3: no space left")
    assert len(list(tmp_path.iterdir())) == 4


def lose(transport, path):
    """Rank 1 does not find a file of the checkpoint, or has other fields."""
    found = numbers(transport)
    ti.checkpoint.save(path, found)
    found["x"].fill(7)
    messages = []
    given = path if transport.rank != 1 else path + "2"
    others = found if transport.rank != 1 else {"x": found["x"]}
    for at, things in ((given, found), (path, others)):
        try:
            ti.checkpoint.load(at, things)
        except (ti.TaiError, OSError) as error:
            messages.append(str(error))
    return messages, found["x"][1, 3]


def test_a_checkpoint_that_one_rank_cannot_load_changes_no_rank(tmp_path):
    results = rank_pipes.run_ranks(lose, 2, str(tmp_path / "run.npz"))
    for (first, second), value in results:
        assert "No such file" in first and "which is no field here" in second and value == 7


def test_a_file_of_a_rank_that_is_missing_is_named(tmp_path):
    path = tmp_path / "run.npz"
    rank_pipes.run_ranks(save, 2, str(path))
    (gone,) = tmp_path.glob("run.*.1.npz")
    os.unlink(gone)
    found = fields(None)
    with pytest.raises(ti.TaiRuntimeError, match=f"has no file '{gone}'"):
        ti.checkpoint.load(path, found)
    ti.init(arch=ti.cpu)
