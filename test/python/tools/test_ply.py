"""Files that `ti.tools.PLYWriter` writes, read back by their format."""

import numpy as np
import pytest
import tai as ti

TYPES = {"float": "f4", "double": "f8", "int": "i4", "uchar": "u1"}


def read(path):
    """The vertices and faces of a PLY file, as structured arrays."""
    content = path.read_bytes()
    head, body = content.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[0] == "ply" and lines[2].startswith("comment ")
    elements, current = [], None
    for line in lines[3:]:
        words = line.split()
        if words[0] == "element":
            current = (words[1], int(words[2]), [])
            elements.append(current)
        elif words[1] == "list":
            current[2].append("corners")
        else:
            current[2].append((words[2], TYPES[words[1]]))
    form = lines[1].split()[1]
    found = {}
    rows = body.decode().splitlines() if form == "ascii" else None
    for name, count, properties in elements:
        if form == "ascii":
            found[name] = [list(map(float, row.split())) for row in rows[:count]]
            rows = rows[count:]
            continue
        corners = body[0]
        kinds = [p for p in properties if p != "corners"]
        if "corners" in properties:
            kinds = [("n", "u1"), *((f"v{i}", "<i4") for i in range(corners)), *kinds]
        kind = np.dtype([(n, k if k[0] in "<u" else "<" + k) for n, k in kinds])
        found[name] = np.frombuffer(body[: count * kind.itemsize], kind)
        body = body[count * kind.itemsize :]
    assert not body if form != "ascii" else not rows
    return found


def test_points_with_channels(tmp_path):
    ti.init(offline_cache=False)
    points = np.random.default_rng(0).random((10, 3), np.float32)
    mass = ti.field(ti.f64, shape=10)
    mass.fill(2)
    writer = ti.tools.PLYWriter(num_vertices=10)
    writer.add_vertex_pos(points[:, 0], points[:, 1], points[:, 2])
    writer.add_vertex_color(points[:, 0], points[:, 1], points[:, 2])
    writer.add_vertex_id()
    writer.add_vertex_channel("mass", "double", mass)
    writer.export(tmp_path / "a.ply")
    vertices = read(tmp_path / "a.ply")["vertex"]
    assert np.array_equal(vertices["y"], points[:, 1])
    assert np.array_equal(vertices["blue"], points[:, 2])
    assert vertices["id"].tolist() == list(range(10)) and vertices["mass"].tolist() == [2] * 10
    writer.export_ascii(tmp_path / "b.ply")
    rows = np.array(read(tmp_path / "b.ply")["vertex"])
    assert np.allclose(rows[:, :3], points) and np.all(rows[:, -1] == 2)
    writer.export_frame(3, str(tmp_path / "c.ply"))
    writer.export_frame_ascii(12, str(tmp_path / "d"))
    assert {p.name for p in tmp_path.iterdir()} == {
        "a.ply", "b.ply", "c_000003.ply", "d_000012.ply"
    }  # fmt: skip


@pytest.mark.parametrize("kind, corners, count", [("tri", 3, 2), ("quad", 4, 2), ("tet", 3, 8)])
def test_faces(tmp_path, kind, corners, count):
    writer = ti.tools.PLYWriter(num_vertices=5, num_faces=2, face_type=kind)
    writer.add_vertex_pos(np.arange(5), np.zeros(5), np.ones(5))
    size = 3 if kind == "tri" else 4
    indices = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])[:, :size]
    writer.add_faces(indices)
    writer.add_face_id()
    writer.export(tmp_path / "a.ply")
    faces = read(tmp_path / "a.ply")["face"]
    assert len(faces) == count and np.all(faces["n"] == corners)
    assert faces["id"].tolist() == np.repeat([0, 1], count // 2).tolist()
    if kind != "tet":
        found = np.stack([faces[f"v{i}"] for i in range(corners)], axis=1)
        assert np.array_equal(found, indices)


def test_what_does_not_fit(tmp_path):
    writer = ti.tools.PLYWriter(num_vertices=4, num_faces=1)
    for call, message in [
        (lambda: writer.add_vertex_pos([1], [2], [3]), "needs 4 numbers"),
        (lambda: writer.add_vertex_channel("a", "float128", [0] * 4), "is one of char"),
        (lambda: writer.add_faces([0, 1]), "need 3 whole numbers"),
        (lambda: writer.add_faces([0, 1, 4]), "none of the 4 vertices"),
        (lambda: writer.export(tmp_path / "a.ply"), "no channel 'x'"),
        (lambda: ti.tools.PLYWriter(0), "at least 1 vertex"),
        (lambda: ti.tools.PLYWriter(3, face_type="hex"), "one of 'tri'"),
    ]:
        with pytest.raises(ti.TaichiRuntimeTypeError, match=message):
            call()
    assert not list(tmp_path.iterdir())
