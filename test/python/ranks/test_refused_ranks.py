"""Meshes, layouts and kernels that are refused, and ranks that end or run another program."""

from __future__ import annotations

import numpy as np
import pytest
import tai as ti

import rank_pipes
import rank_scenes


class Silent:
    """A transport to ranks that never answer."""

    def __init__(self, rank, size):
        self.rank, self.size = rank, size

    def all_gather(self, array):
        return [array] * self.size


@pytest.fixture
def mesh():
    ti.init(arch=ti.cpu, mesh=ti.mesh("x", 2, Silent(0, 2)))
    yield
    ti.init(arch=ti.cpu)


def test_a_mesh_has_as_many_ranks_as_processes():
    with pytest.raises(ti.TaiRuntimeError, match="mesh 'x' has 3 ranks, but 2 processes run"):
        ti.init(arch=ti.cpu, mesh=ti.mesh("x", 3, Silent(0, 2)))


def test_a_mesh_runs_on_the_cpu():
    with pytest.raises(ti.TaiRuntimeError, match="a mesh runs on the CPU"):
        ti.init(arch=ti.python, mesh=ti.mesh("x", 2, Silent(0, 2)))


def test_a_mesh_is_made_by_mesh():
    with pytest.raises(ti.TaiRuntimeTypeError, match="mesh is made by ti.mesh, but got 4"):
        ti.init(arch=ti.cpu, mesh=4)
    with pytest.raises(ti.TaiRuntimeTypeError, match="a mesh has a name and a number of processes"):
        ti.mesh("x", 0)


def test_a_shard_needs_a_mesh():
    ti.init(arch=ti.cpu)
    with pytest.raises(ti.TaiRuntimeError, match="the program has no mesh"):
        ti.root.shard(ti.i)


def test_ranks_divide_the_extent(mesh):
    with pytest.raises(ti.TaiRuntimeError, match="2 ranks of the mesh do not divide the extent 7"):
        ti.root.shard(ti.i).dense(ti.ij, (7, 8))


def test_levels_around_a_shard_are_dense(mesh):
    with pytest.raises(ti.TaiRuntimeError, match="a pointer level cannot stand below a shard"):
        ti.root.shard(ti.i).pointer(ti.i, 8)
    with pytest.raises(ti.TaiRuntimeError, match="a shard cannot stand below a bitmasked level"):
        ti.root.bitmasked(ti.j, 8).shard(ti.i)
    with pytest.raises(ti.TaiRuntimeError, match="a level above the shard divides axis i"):
        ti.root.dense(ti.i, 8).shard(ti.i)
    with pytest.raises(ti.TaiRuntimeError, match="two levels below a shard divide its axis i"):
        ti.root.shard(ti.i).dense(ti.i, 8).dense(ti.i, 2)
    with pytest.raises(ti.TaiRuntimeTypeError, match="a shard has one axis"):
        ti.root.shard(ti.ij)


def test_refused_accesses_name_their_line(mesh):
    x, y, total = (ti.field(float, name=name) for name in ("x", "y", "total"))
    ti.root.shard(ti.i).dense(ti.i, 8).place(x, y)
    ti.root.place(total)

    @ti.kernel
    def wraps():
        for i in x:
            y[i] = x[(i + 1) % 8]

    @ti.kernel
    def serial() -> float:
        return x[3]

    @ti.kernel
    def stores():
        for i in x:
            total[None] = x[i]

    @ti.kernel
    def draws():
        for i in x:
            x[i] = ti.random()

    for kernel, message, line in (
        (wraps, "it reaches 7 rows of 'x' beyond its own, and a rank has 4", "(i + 1) % 8"),
        (serial, "outside of a parallel loop, it accesses 'x', which is sharded", "return x"),
        (stores, "writes to 'total', of which each rank has a copy", "total[None] ="),
        (draws, "random numbers depend on the number of the iteration", "ti.random"),
    ):
        with pytest.raises(ti.TaiError, match="cannot run on several ranks") as caught:
            kernel()
        assert message in caught.value.message
        with open(__file__) as source:
            assert line in source.read().splitlines()[caught.value.lineno - 1]


def test_explain_tells_what_ranks_exchange(mesh):
    x, y, total = (ti.field(float, needs_grad=True, name=name) for name in ("x", "y", "total"))
    ti.root.shard(ti.i).dense(ti.i, 8).place(x, y, x.grad, y.grad)
    ti.root.place(total, total.grad)

    @ti.kernel
    def blur():
        for i in range(2, 7):
            y[i] = x[i - 2] + x[i + 1]
            total[None] += x[i]

    text = blur.explain()
    assert "fetches 2 rows before and 1 row behind those of the rank of x (line " in text
    assert "all-reduces total (sum) (line " in text
    assert "gradient at test_refused_ranks.py:" in text
    # The gradient of a row is gathered from the rows that read it.
    assert "fetches 1 row before and 2 rows behind those of the rank of y_grad (line " in text


def test_explain_tells_why_ranks_gather(mesh):
    ti.init(arch=ti.cpu, mesh=ti.mesh("x", 2, Silent(0, 2)), deterministic=True)
    x, total = ti.field(float, name="x"), ti.field(float, name="total")
    ti.root.shard(ti.i).dense(ti.i, 8).place(x)
    ti.root.place(total)

    @ti.kernel
    def add():
        for i in x:
            total[None] += x[i]

    why = "gathers all rows of x, because the order of a sum is to be that of one process (line "
    assert why in add.explain()


def test_the_memory_of_a_sharded_field_is_not_shared(mesh):
    x = ti.field(float)
    ti.root.shard(ti.i).dense(ti.i, 8).place(x)
    with pytest.raises(BufferError, match="processes have parts of it"):
        np.from_dlpack(x)


def test_a_timeout_is_a_time():
    with pytest.raises(ti.TaiRuntimeTypeError, match="timeout is a number of seconds, but got 0"):
        ti.mesh("x", 2, timeout=0)


def test_each_rank_refuses_a_mesh_of_another_size():
    for result in rank_pipes.run_ranks(rank_scenes.refused, 2, 3, 6):
        assert "mesh 'x' has 3 ranks, but 2 processes run" in result


def test_each_rank_refuses_rows_that_do_not_divide():
    for result in rank_pipes.run_ranks(rank_scenes.refused, 2, 2, 7):
        assert "the 2 ranks of the mesh do not divide the extent 7" in result


def test_ranks_that_start_differently_report_it():
    for result in rank_pipes.run_ranks(rank_scenes.versions, 2):
        assert f"tai {ti.__version__}" in result and "mesh 'y'" in result


def test_ranks_with_different_programs_report_it():
    for result in rank_pipes.run_ranks(rank_scenes.different, 2):
        assert "run different programs" in result and "rank_scenes.py" in result


def test_ranks_that_launch_different_kernels_report_it():
    for result in rank_pipes.run_ranks(rank_scenes.astray, 2):
        # The messages have different plans, or even different lengths.
        assert "in the exchange 'fetch' of field 'x'" in result and "it sends" in result


def test_a_collective_call_on_one_rank_is_an_error():
    first, second = rank_pipes.run_ranks(rank_scenes.alone, 2)
    assert "in reading an element of field 'x'" in first
    assert "in the exchange 'fetch' of field 'x' in the launch of kernel 'blur'" in second


def test_a_failure_in_the_last_loop_of_a_launch_is_told():
    (checked, waited), (failed, later) = rank_pipes.run_ranks(rank_scenes.failing, 2)
    assert checked == "no error" and "row nine" in failed
    assert "lost rank 1" in waited and "of kernel 'check' failed on rank 1: row nine" in waited
    assert "the ranks no longer communicate" in later


@pytest.mark.parametrize("ranks", [2, 3])
def test_a_rank_that_ends_ends_the_others(ranks):
    results = rank_pipes.run_ranks(rank_scenes.ending, ranks)
    assert results[1] == "ended with 3"
    for rank in {*range(ranks)} - {1}:
        where = "in the exchange 'fetch' of field 'x' in the launch of kernel 'blur"
        assert f"rank {rank} of {ranks} lost rank 1 {where}" in results[rank]
        assert "rank_scenes.py" in results[rank]


@pytest.mark.parametrize("ranks", [2, 4])
def test_a_rank_that_hangs_ends_the_others(ranks):
    *others, last = rank_pipes.run_ranks(rank_scenes.hanging, ranks)
    assert last == ("hung", "")
    for launch, later in others:
        assert f"rank {ranks - 2} of {ranks} lost rank {ranks - 1} in the exchange" in launch
        assert "rank_scenes.py" in launch
        assert "the ranks no longer communicate, since rank" in later
