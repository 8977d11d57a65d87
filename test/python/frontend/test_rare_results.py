"""Refusals of results, files and tables that no other test meets."""

import numpy as np
import pytest
import tai as ti


def check(message, run):
    with pytest.raises(ti.TaiError, match=message):
        run()


def test_a_kernel_that_returns_something_else_than_it_says():
    @ti.dataclass
    class Pair:
        a: ti.f32
        b: ti.f32

    @ti.kernel
    def number() -> Pair:
        return 1.0

    @ti.kernel
    def three() -> tuple[ti.f32, ti.f32]:
        return 1.0, 2.0, 3.0

    @ti.kernel
    def one() -> tuple[ti.f32, ti.f32]:
        return 1.0

    check(r"the kernel returns a struct\(a=f32, b=f32\), but got something else", number)
    check("the kernel returns 2 values, but got 3 values", three)
    check("the kernel returns 2 values, but got one value", one)

    @ti.func
    def two(a) -> tuple[ti.f32, ti.f32]:
        return a

    @ti.kernel
    def caller(a: ti.f32) -> ti.f32:
        x, y = two(a)
        return x + y

    check("the function returns 2 values, but got one value", lambda: caller(1.0))


def test_checkpoints_of_other_shapes_and_types(tmp_path):
    path = tmp_path / "a.npz"
    x = ti.field(ti.f32, 4)
    x.fill(3)
    ti.checkpoint.save(path, x=x)
    check(r"'x' has shape \(4,\) in the checkpoint, but \(5,\) here",
          lambda: ti.checkpoint.load(path, x=ti.field(ti.f32, 5)))  # fmt: skip
    check("'x' holds float32 in the checkpoint, but i32 here",
          lambda: ti.checkpoint.load(path, x=ti.field(ti.i32, 4)))  # fmt: skip
    check(
        "is no field, array or object that holds some", lambda: ti.checkpoint.save(path, object())
    )
    x.fill(0)
    ti.checkpoint.load(path, x=x)
    assert x.to_numpy().tolist() == [3] * 4


def test_volumes_of_other_shapes(tmp_path):
    x = ti.field(ti.f32)
    ti.root.pointer(ti.ij, 4).dense(ti.ij, 4).place(x)
    check(r"coordinates of field 'x?.*' have shape \(n, 2\), but got \(1, 3\)",
          lambda: ti.volumes.read(x, [[1, 2, 3]]))  # fmt: skip
    check(r"values of field '.*' have shape \(2,\), but got \(3,\)",
          lambda: ti.volumes.write(x, [[1, 2], [3, 4]], np.ones(3)))  # fmt: skip
    check("no format of volumes has the suffix '.txt'",
          lambda: ti.volumes.save(tmp_path / "a.txt", x=x))  # fmt: skip
    assert not list(tmp_path.iterdir())
    ti.volumes.write(x, [[1, 2], [3, 4]], [5, 6])
    assert ti.volumes.read(x, [[3, 4], [0, 0], [1, 2]]).tolist() == [6, 0, 5]


def test_tables_of_points_without_parts(tmp_path):
    zeros = np.zeros(3)

    def save(writer):
        return lambda: writer.export(str(tmp_path / "a.ply"))

    writer = ti.tools.PLYWriter(num_vertices=3)
    check("the vertices have no channel 'x'", save(writer))
    writer.add_vertex_pos(zeros, zeros, zeros)
    save(writer)()
    twice = ti.tools.PLYWriter(num_vertices=3)
    twice.add_vertex_pos(zeros, zeros, zeros)
    twice.add_vertex_channel("x", "float", zeros)
    check("two channels have one name", save(twice))
    faces = ti.tools.PLYWriter(num_vertices=3, num_faces=1, face_type="tri")
    faces.add_vertex_pos(zeros, zeros, zeros)
    check("num_faces is given, but no faces", save(faces))


def test_entries_outside_of_a_matrix():
    builder = ti.linalg.SparseMatrixBuilder(2, 3, max_num_triplets=4)

    @ti.kernel
    def fill(a: ti.types.sparse_matrix_builder(), i: ti.i32, j: ti.i32):
        a[i, j] += 1.0

    fill(builder, 1, 2)
    assert builder.build().to_numpy().tolist() == [[0, 0, 0], [0, 0, 1]]
    for i, j in ((2, 0), (0, 3), (-1, 0), (0, -1)):
        builder = ti.linalg.SparseMatrixBuilder(2, 3, max_num_triplets=4)
        fill(builder, i, j)
        check(rf"a kernel added to \[{i}, {j}\] of a matrix of 2×3", builder.build)


def test_fields_of_structs_without_a_shape_and_a_profiler_that_is_off():
    pair = ti.types.struct(a=ti.f32)
    check("offset and order need a shape", lambda: pair.field(offset=1))
    check("the profiler is off", lambda: ti.profiler.print_kernel_profiler_info())


def test_grad_check_wants_f64():
    x, loss = (ti.field(ti.f32, s, needs_grad=True) for s in ((2,), ()))
    check("grad_check needs f64, but field '.*' is of type f32",
          lambda: ti.ad.Tape(loss, grad_check=[x]).__enter__())  # fmt: skip
