"""PLY files: coordinates, colours and faces in; out with moved vertices, while every other byte stays as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .ply_body import BinaryBody, TextBody, layout
from .ply_header import Element, parse_header
from .reading import Integers, require_memory, shown

Points = NDArray[np.float64]
AXES = ("x", "y", "z")
COLOURS = ("red", "green", "blue")
CORNERS = ("vertex_indices", "vertex_index")
NORMALS = {"nx", "ny", "nz", "normal_x", "normal_y", "normal_z"}
ORIENTED = {"normals": NORMALS, "rotations": {"rot_0"}, "scales": {"scale_0"}}


class PlyFile:
    """A PLY file with the bytes ``data``, text or binary, with the vertex element anywhere among others.

    Raises InputError if it is not a PLY file, has no x, y, z, or its body is shorter or longer than the header says; or if
    there is no memory for ``bytes_a_vertex`` of each vertex.
    """

    def __init__(self, data: bytes, path: Path, bytes_a_vertex: int = 0) -> None:
        self.data, self.path = data, path
        self.header = parse_header(data, path)
        self.vertex = self._vertex()
        # A file that is cut short has fewer vertices than its header says; each takes three bytes or more.
        require_memory(path, bytes_a_vertex * min(self.vertex.count, len(data) // 3))
        self.kinds = [self.vertex.properties[axis].kind for axis in AXES]
        self._body = (
            BinaryBody(data, path, self.header.size, self.header.order)
            if self.header.order
            else TextBody(data, path, self.header.size, self.header.lines)
        )
        self._rows = {
            name: self._body.take_rows(element) for name, element in self.header.elements.items()
        }
        self._body.check_end()
        self._places = self._places_of(self.vertex, AXES)

    def _vertex(self) -> Element:
        vertex = self.header.elements.get("vertex")
        if vertex is None:
            raise InputError(
                f"{self.path}: has no vertex element (elements: {shown(', '.join(self.header.elements) or 'none')})"
            )
        for axis in AXES:
            if axis not in vertex.properties:
                names = shown(", ".join(vertex.properties) or "none")
                raise InputError(f"{self.path}: its vertices have no {axis} (properties: {names})")
            if vertex.properties[axis].length_kind:
                raise InputError(
                    f"{self.path}: {axis} of its vertices is a list, expected one number"
                )
        return vertex

    def _places_of(self, element: Element, names: tuple[str, ...]) -> Integers:
        """[N, names] places of values in the rows of ``element``."""
        places, _ = layout(self._body, element, self._rows[element.name], names)
        return np.stack([places[name] for name in names], axis=1)

    @property
    def oriented(self) -> str:
        """What no longer fits once the vertices move: normals, and of Gaussian splats rotations and scales; "" without any."""
        return ", ".join(
            name for name, of_it in ORIENTED.items() if not of_it.isdisjoint(self.vertex.properties)
        )

    def read(self) -> Points:
        """The coordinates [N, 3] of the vertices, in the file's order."""
        return self._body.columns(self._places, self.kinds)

    def read_colours(self) -> Points | None:
        """Red, green and blue [N, 3] in [0, 1], None where the file has none; InputError where floats lie outside."""
        kinds = [
            p.kind
            for name in COLOURS
            if (p := self.vertex.properties.get(name)) and not p.length_kind
        ]
        if len(kinds) < 3:
            return None
        full = [1.0 if kind[0] == "f" else float(np.iinfo(kind).max) for kind in kinds]
        colours = self._body.columns(self._places_of(self.vertex, COLOURS), kinds) / full
        if not (colours.min() >= 0.0 and colours.max() <= 1.0):
            span = f"{colours.min():g} to {colours.max():g}"
            raise InputError(
                f"{self.path}: its colours span {span} of their type's range, expected 0 to 1"
            )
        return colours

    def read_faces(self) -> Integers | None:
        """Triangles [F, 3], polygons as fans; None where the file has no faces, InputError for a vertex that is not there."""
        element = self.header.elements.get("face")
        lists = (
            [p for p in element.properties.values() if p.name in CORNERS and p.length_kind]
            if element
            else []
        )
        if element is None or not element.count or not lists:
            return None
        corners = lists[0]
        assert corners.length_kind is not None
        starts = self._places_of(element, (corners.name,))
        lengths = self._body.values(starts[:, 0], corners.length_kind)
        fans = [np.empty((0, 3), dtype=np.int64)]
        for length in np.unique(lengths[lengths >= 3]).astype(int).tolist():
            steps = self._body.width(corners.length_kind) + self._body.width(
                corners.kind
            ) * np.arange(length)
            polygons = self._body.values(starts[lengths == length] + steps, corners.kind)
            wrong = ~(
                (polygons >= 0) & (polygons < self.vertex.count) & (polygons == np.floor(polygons))
            )
            if wrong.any():
                last = self.vertex.count - 1
                raise InputError(
                    f"{self.path}: a face names vertex {polygons[wrong][0]:g}, expected 0 to {last}"
                )
            triangles = [polygons[:, [0, k, k + 1]] for k in range(1, length - 1)]
            fans.append(np.stack(triangles, axis=1).reshape(-1, 3).astype(np.int64))
        return np.concatenate(fans)

    def with_points(self, points: Points) -> bytes:
        """The file with its vertices moved to ``points`` [N, 3]; what is not a coordinate keeps its bytes.

        Integer coordinates become double. In text only numbers that change are rewritten, with the digits of their type, or of
        a double where the text holds more.
        """
        old = self.read()
        if np.array_equal(old, points):
            return self.data
        head = self.data[: self.header.size]
        integers = [
            self.vertex.properties[axis]
            for axis, kind in zip(AXES, self.kinds, strict=True)
            if kind[0] != "f"
        ]
        for begin, end in sorted((p.type_span for p in integers), reverse=True):
            head = head[:begin] + b"double" + head[end:]
        return head + self._body.moved(self._places, self.kinds, old, points)


def new_ply(points: Points, dtype: str, faces: NDArray[np.integer] | None = None) -> bytes:
    """A binary PLY file with ``points`` [N, 3] as "float32" or "float64", and ``faces`` [F, 3] if any."""
    kind = "float" if dtype == "float32" else "double"
    lines = [f"element vertex {len(points)}", *(f"property {kind} {axis}" for axis in AXES)]
    body = points.astype(np.dtype(dtype).newbyteorder("<")).tobytes()
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        polygons = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        polygons["count"], polygons["corners"] = 3, faces
        body += polygons.tobytes()
    return (
        "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()
        + body
    )
