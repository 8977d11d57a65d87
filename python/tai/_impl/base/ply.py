"""Files of points and polygons in the PLY format, as Blender, Houdini and MeshLab read them."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from .files import replacing_name

# The names of PLY for types of numbers, and those of NumPy.
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
}  # fmt: skip

_CORNERS = {"tri": 3, "quad": 4, "tet": 4}


class PLYWriter:
    """Collects the vertices and faces of a scene, and writes them to PLY files.

    ```python
    writer = ti.tools.PLYWriter(num_vertices=n)
    writer.add_vertex_pos(p[:, 0], p[:, 1], p[:, 2])
    writer.export_frame(frame, "liquid.ply")  # liquid_000012.ply
    ```

    Args:
        num_vertices: how many there are; each channel has as many numbers.
        num_faces: how many polygons `add_faces` gives.
        face_type: `"tri"`, `"quad"`, or `"tet"` for tetrahedra, each of which gives four triangles.
        comment: a line of the file.
    """

    def __init__(
        self, num_vertices: int, num_faces: int = 0, face_type: str = "tri",
        comment: str = "created by PLYWriter",
    ):  # fmt: skip
        if num_vertices < 1:
            raise TaiRuntimeTypeError(f"a PLY file has at least 1 vertex, but got {num_vertices}")
        if face_type not in _CORNERS:
            raise TaiRuntimeTypeError(
                f"face_type is one of 'tri', 'quad' and 'tet', but got {face_type!r}"
            )
        if "\n" in comment:
            raise TaiRuntimeTypeError("the comment of a PLY file is one line")
        self.num_vertices, self.num_faces, self.face_type = num_vertices, num_faces, face_type
        self.comment = comment
        # The names, types and numbers of the vertex channels, in order.
        self._vertices: list[tuple[str, str, np.ndarray]] = []
        self._of_faces: list[tuple[str, str, np.ndarray]] = []
        self._corners: np.ndarray | None = None

    def _channel(self, name: str, kind: str, data: Any, count: int, what: str) -> Any:
        if kind not in _TYPES:
            raise TaiRuntimeTypeError(
                f"the type of channel '{name}' is one of {', '.join(_TYPES)}, but got {kind!r}"
            )
        if hasattr(data, "to_numpy"):
            data = data.to_numpy()
        array = np.asarray(data)
        if array.size != count or array.dtype.kind not in "buif":
            raise TaiRuntimeTypeError(
                f"channel '{name}' needs {count} numbers, one for each {what}, but got an array of "
                f"{array.size} of type {array.dtype}"
            )
        return name, kind, array.ravel().astype(_TYPES[kind])

    def add_vertex_channel(self, key: str, data_type: str, data: Any) -> None:
        """Adds a channel with a number for each vertex.

        Args:
            key: its name in the file.
            data_type: `"float"`, `"double"`, `"int"`, `"uint"`, `"uchar"`, ….
            data: an array or a field.
        """
        self._vertices.append(self._channel(key, data_type, data, self.num_vertices, "vertex"))

    def _add_vertex(self, names: str, kind: str, *arrays: Any) -> None:
        for name, array in zip(names.split(), arrays, strict=True):
            self.add_vertex_channel(name, kind, array)

    def add_vertex_pos(self, x: Any, y: Any, z: Any) -> None:
        """Adds the positions of the vertices."""
        self._add_vertex("x y z", "float", x, y, z)

    def add_vertex_normal(self, nx: Any, ny: Any, nz: Any) -> None:
        """Adds normal vectors."""
        self._add_vertex("nx ny nz", "float", nx, ny, nz)

    def add_vertex_color(self, r: Any, g: Any, b: Any) -> None:
        """Adds colours of the vertices, from 0 to 1."""
        self._add_vertex("red green blue", "float", r, g, b)

    def add_vertex_alpha(self, alpha: Any) -> None:
        """Adds opacities of the vertices, from 0 to 1."""
        self._add_vertex("Alpha", "float", alpha)

    def add_vertex_rgba(self, r: Any, g: Any, b: Any, a: Any) -> None:
        """Adds colours and opacities of the vertices, from 0 to 1."""
        self._add_vertex("red green blue Alpha", "float", r, g, b, a)

    def add_vertex_id(self) -> None:
        """Adds the numbers of the vertices as a channel."""
        self._add_vertex("id", "int", np.arange(self.num_vertices))

    def add_vertex_piece(self, piece: Any) -> None:
        """Adds a channel with the number of the piece that each vertex belongs to."""
        self._add_vertex("piece", "int", piece)

    def add_faces(self, indices: Any) -> None:
        """Gives the corners of all faces, as numbers of vertices: 3 each, or 4."""
        if hasattr(indices, "to_numpy"):
            indices = indices.to_numpy()
        corners = _CORNERS[self.face_type]
        array = np.asarray(indices)
        if array.size != corners * self.num_faces or array.dtype.kind not in "iu":
            raise TaiRuntimeTypeError(
                f"{self.num_faces} faces need {corners * self.num_faces} whole numbers, but got "
                f"{array.size} of type {array.dtype}",
                "give num_faces to ti.tools.PLYWriter",
            )
        array = array.reshape(self.num_faces, corners)
        if array.size and not 0 <= array.min() <= array.max() < self.num_vertices:
            raise TaiRuntimeTypeError(
                f"a corner of a face is none of the {self.num_vertices} vertices"
            )
        if self.face_type == "tet":
            array = array[:, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
        self._corners = array

    def add_face_channel(self, key: str, data_type: str, data: Any) -> None:
        """Adds a channel with a number for each face."""
        name, kind, array = self._channel(key, data_type, data, self.num_faces, "face")
        if self.face_type == "tet":
            array = np.repeat(array, 4)
        self._of_faces.append((name, kind, array))

    def add_face_id(self) -> None:
        """Adds the numbers of the faces as a channel."""
        self.add_face_channel("id", "int", np.arange(self.num_faces))

    def add_face_piece(self, piece: Any) -> None:
        """Adds a channel with the number of the piece that each face belongs to."""
        self.add_face_channel("piece", "int", piece)

    def _header(self, form: str) -> str:
        lines = ["ply", f"format {form} 1.0", f"comment {self.comment}"]
        lines.append(f"element vertex {self.num_vertices}")
        lines += [f"property {kind} {name}" for name, kind, _ in self._vertices]
        if self._corners is not None:
            lines.append(f"element face {len(self._corners)}")
            lines.append("property list uchar int vertex_indices")
            lines += [f"property {kind} {name}" for name, kind, _ in self._of_faces]
        return "\n".join([*lines, "end_header", ""])

    def _tables(self) -> list[np.ndarray]:
        names = [name for name, _, _ in self._vertices]
        for needed in ("x", "y", "z"):
            if needed not in names:
                raise TaiRuntimeTypeError(
                    f"the vertices have no channel '{needed}'", "writer.add_vertex_pos(x, y, z)"
                )
        if len(set(names)) < len(names):
            raise TaiRuntimeTypeError(f"two channels have one name: {', '.join(names)}")
        if self.num_faces and self._corners is None:
            raise TaiRuntimeTypeError("num_faces is given, but no faces", "writer.add_faces(…)")
        tables = [self._table(self._vertices, self.num_vertices)]
        if self._corners is not None:
            count, corners = self._corners.shape
            sizes = ("corners", "uchar", np.full(count, corners, "u1"))
            points = [(f"v{i}", "int", self._corners[:, i].astype("i4")) for i in range(corners)]
            tables.append(self._table([sizes, *points, *self._of_faces], count))
        return tables

    def _table(self, channels: list[tuple[str, str, np.ndarray]], count: int) -> np.ndarray:
        table = np.empty(count, [(name, _TYPES[kind]) for name, kind, _ in channels])
        for name, _, array in channels:
            table[name] = array
        return table

    def export(self, path: str) -> None:
        """Writes the scene to a PLY file of binary numbers."""
        tables = self._tables()
        with replacing_name(path) as name, open(name, "wb") as file:
            file.write(self._header(f"binary_{sys.byteorder}_endian").encode())
            for table in tables:
                file.write(table.tobytes())

    def export_ascii(self, path: str) -> None:
        """Writes the scene to a PLY text file."""
        tables = self._tables()
        with replacing_name(path) as name, open(name, "w", encoding="utf-8") as file:
            file.write(self._header("ascii"))
            for table in tables:
                file.writelines(" ".join(map(str, row)) + "\n" for row in table.tolist())

    def _name_of(self, series_num: int, path: str) -> str:
        return f"{path.removesuffix('.ply')}_{series_num:06d}.ply"

    def export_frame(self, series_num: int, path: str) -> None:
        """Writes the PLY file of frame `series_num`: `a.ply` becomes `a_000012.ply`."""
        self.export(self._name_of(series_num, path))

    def export_frame_ascii(self, series_num: int, path: str) -> None:
        """Writes frame `series_num` as a PLY text file."""
        self.export_ascii(self._name_of(series_num, path))
