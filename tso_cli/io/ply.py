"""PLY files: read coordinates, colours and faces; write the file again with moved vertices.

Normals and Gaussian splats turn with the whole file. Every other byte that is not a coordinate
stays as it is. The package plyfile (1.1.5) does not keep that: it writes the numbers of text anew
(0.10 becomes 0.100000001490116119), normalises headers, drops trailing bytes without a word, and
writes big-endian elements with lists in the wrong byte order. It is also two to twelve times slower
on text and on faces; on plain binary points it is faster.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Bits, Indices
from ..geometry.polygons import triangulated
from .movable import MovableFile, in_unit
from .ply_body import BinaryBody, Change, TextBody, layout
from .ply_header import Element, Property, parse_header
from .reading import require_memory, shown
from .similarity import Similarity, similarity_of
from .splats import moved_along

# Names of properties.
AXES = ("x", "y", "z")
COLOURS = ("red", "green", "blue")
CORNERS = ("vertex_indices", "vertex_index")
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
# What is wrong once the vertices have moved; rotations and scales belong to Gaussian splats.
STALE_AFTER_MOVING = {
    "normals": set().union(*NORMALS), "rotations": {"rot_0"}, "scales": {"scale_0"}
}  # fmt: skip
# What a rotation of the whole file changes of its vertices, and what a change of size changes.
TURNS = {
    "normals": re.compile("n[xyz]|normal_[xyz]"), "rotations": re.compile(r"rot_\d+"),
    "view-dependent colours": re.compile(r"f_rest_\d+"),
}  # fmt: skip
GROWS = {"scales": re.compile(r"scale_\d+")}
# Rows whose values change at once, which bounds the memory.
BLOCK = 1 << 16
# Of Gaussian splats: opacity before the logistic function, and the constant part of the colour.
OPACITY, CONSTANT_COLOUR = "opacity", ("f_dc_0", "f_dc_1", "f_dc_2")
# How far a point can be trusted, in [0, 1]: a property of the Stanford scans.
CONFIDENCE = "confidence"
# A splat of lower opacity cannot be seen; trainers leave many of them around an object.
LEAST_OPACITY = 0.05
# The value of the spherical harmonic of degree 0.
HARMONIC = 0.28209479177387814


class _Along(NamedTuple):
    """Properties that move along with the whole file, and their values [N, K] after the move."""

    element: Element
    names: tuple[str, ...]
    moved: Callable[[Array], Array]


class PlyFile(MovableFile):
    """A PLY file with the bytes ``data``, text or binary; the vertex element may be at any place.

    Raises InputError if ``data`` is not a PLY file, has no x, y, z, or has a body that is shorter
    or longer than the header says. Also raises InputError if there is no memory for
    ``bytes_per_vertex`` bytes for each vertex.
    """

    def __init__(self, data: bytes, path: Path, bytes_per_vertex: int = 0) -> None:
        self.data, self.path = data, path
        self.header = parse_header(data, path)
        self.vertex = self._vertex()
        # A truncated file has fewer vertices than its header says. A vertex takes 3 bytes or more.
        require_memory(path, bytes_per_vertex * min(self.vertex.count, len(data) // 3))
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

    suffix = ".ply"

    def _vertex(self) -> Element:
        vertex = self.header.elements.get("vertex")
        if vertex is not None and "packed_position" in vertex.properties:
            raise InputError(
                f"{self.path}: holds compressed splats (packed_position), expected x, y and z; "
                "export them as an uncompressed .ply"
            )
        if vertex is None:
            names = shown(", ".join(self.header.elements) or "none")
            raise InputError(
                f"{self.path}: has no vertex element (elements: {names}), expected one; "
                "rename the element of the points to vertex"
            )
        for axis in AXES:
            if axis not in vertex.properties:
                names = shown(", ".join(vertex.properties) or "none")
                raise InputError(
                    f"{self.path}: its vertices have no {axis} (properties: {names}), "
                    "expected x, y and z, in small letters"
                )
            if vertex.properties[axis].length_kind:
                raise InputError(
                    f"{self.path}: {axis} of its vertices is a list, expected one number"
                )
        return vertex

    def _places_of(
        self, element: Element, names: tuple[str, ...], rows: slice = slice(None)
    ) -> Indices:
        """The places [N, names] of the properties ``names`` in some ``rows`` of ``element``."""
        places, _ = layout(self._body, element, self._rows[element.name][rows], names)
        return np.stack([places[name] for name in names], axis=1)

    @property
    def stale_after_moving(self) -> list[str]:
        """What is wrong once vertices have moved one by one, such as "normals"."""
        return [
            name
            for name, properties in STALE_AFTER_MOVING.items()
            if not properties.isdisjoint(self.vertex.properties)
        ]

    def left_behind(self, matrix: Array) -> list[str]:
        """What is wrong once ``matrix`` [4, 4] moved the whole file.

        It is what this reader does not know, such as rotations of two numbers.
        """
        move = similarity_of(matrix)
        if move is None:
            return []
        affected = (TURNS if move.turns else {}) | (GROWS if move.size != 1.0 else {})
        along = {
            name
            for group in self._along(move)
            if group.element is self.vertex
            for name in group.names
        }
        names = [name for name in self.vertex.properties if name not in along]
        return [kind for kind, form in affected.items() if any(map(form.fullmatch, names))]

    def read(self) -> Array:
        """The coordinates [N, 3] of the vertices, in the file's order."""
        return self._body.columns(self._places, self.kinds)

    def read_colours(self) -> Array | None:
        """Red, green and blue [N, 3] in [0, 1]; None if the file has no colours.

        Raises InputError if colours of a floating-point type lie outside [0, 1].
        """
        kinds = [
            p.kind
            for name in COLOURS
            if (p := self.vertex.properties.get(name)) and not p.length_kind
        ]
        if len(kinds) < 3:
            return self._splat_colours()
        full = [1.0 if kind[0] == "f" else float(np.iinfo(kind).max) for kind in kinds]
        colours = self._body.columns(self._places_of(self.vertex, COLOURS), kinds) / full
        return in_unit(colours, self.path)

    def read_normals(self) -> Array | None:
        """The normals [N, 3] of the vertices; None if the file has none."""
        candidates = (self._floats(names) for names in NORMALS)
        return next((normals for normals in candidates if normals is not None), None)

    def files_named(self, data: bytes) -> list[str]:
        """The pictures that the header names, as MeshLab writes it."""
        lines = data[: self.header.size].splitlines()
        words = [line.split(maxsplit=2) for line in lines]
        return [
            row[2].decode("utf-8", "replace")
            for row in words
            if row[:2] == [b"comment", b"TextureFile"] and len(row) > 2
        ]

    @property
    def contents(self) -> list[str]:
        """What the file holds besides points and faces."""
        names, face = set(self.vertex.properties), self.header.elements.get("face")
        normals = set().union(*NORMALS)
        parts = {
            "colours": not names.isdisjoint(COLOURS),
            "colours of faces": face is not None and not face.properties.keys().isdisjoint(COLOURS),
            "normals": not names.isdisjoint(normals),
            "further properties": names - {*AXES, *COLOURS, *normals, "alpha"},
        }
        return [name for name, there in parts.items() if there]

    def _splat_colours(self) -> Array | None:
        values = self._floats(CONSTANT_COLOUR)
        return None if values is None else np.clip(0.5 + HARMONIC * values, 0.0, 1.0)

    def _floats(self, names: tuple[str, ...]) -> Array | None:
        """The properties ``names`` [N, K] of the vertices, if all are floating-point numbers."""
        properties = [self.vertex.properties.get(name) for name in names]
        kinds = [
            p.kind for p in properties if p is not None and not p.length_kind and p.kind[0] == "f"
        ]
        if len(kinds) < len(names):
            return None
        return self._body.columns(self._places_of(self.vertex, names), kinds)

    def read_faint(self) -> Bits | None:
        """[N], splats of an opacity under 5 %; None if the file has no splats.

        A file of splats has ``opacity`` and ``scale_0``.
        """
        opacity = self._floats((OPACITY,)) if "scale_0" in self.vertex.properties else None
        if opacity is None:
            return None
        # The logistic function of the stored number.
        return np.asarray(opacity[:, 0] < np.log(LEAST_OPACITY / (1.0 - LEAST_OPACITY)))

    def read_faces(self) -> Indices | None:
        """Triangles [F, 3] of all polygons; None if the file has no faces.

        Raises InputError if a face names a vertex that does not exist.
        """
        strips = self.header.elements.get("tristrips")
        if strips is not None and strips.count:
            warnings.warn(
                f"{self.path}: its triangle strips are not read, so its vertices are taken for a "
                "cloud; export triangles to refine its surface",
                stacklevel=4,
            )
        element = self.header.elements.get("face")
        if element is None or not element.count or _corners_of(element) is None:
            return None
        points, triangles = self.read(), [np.empty((0, 3), dtype=np.int64)]
        for _, _, _, polygons in self._polygons(element, 3):
            corners, lengths = polygons.ravel(), np.full(len(polygons), polygons.shape[1])
            triangles.append(corners[triangulated(points, corners, lengths)])
        return np.concatenate(triangles)

    def _polygons(
        self, element: Element, least: int
    ) -> Iterator[tuple[Indices, Indices, str, Indices]]:
        """For each number of corners, if it is the ``least`` or more, the faces that have it.

        Their rows [F], the places of their corners [F, K], the kind of a corner, and the vertices
        [F, K]. Raises InputError if a face names a vertex that does not exist.
        """
        corners = _corners_of(element)
        if corners is None:
            return
        assert corners.length_kind is not None
        starts = self._places_of(element, (corners.name,))
        lengths = self._body.values(starts[:, 0], corners.length_kind)
        for length in np.unique(lengths[lengths >= least]).astype(int).tolist():
            width, length_width = map(self._body.width, (corners.kind, corners.length_kind))
            rows = np.flatnonzero(lengths == length)
            places = starts[rows] + length_width + width * np.arange(length)
            polygons = self._body.values(places, corners.kind)
            exists = (polygons >= 0) & (polygons < self.vertex.count)
            wrong = ~(exists & (polygons == np.floor(polygons)))
            if wrong.any():
                last = self.vertex.count - 1
                raise InputError(
                    f"{self.path}: a face names vertex {polygons[wrong][0]:g}, expected 0 to {last}"
                )
            yield rows, places, corners.kind, polygons.astype(np.int64)

    def with_points(self, points: Array, matrix: Array | None = None) -> bytes:
        """The file with its vertices moved to ``points`` [N, 3]; all other bytes stay.

        ``matrix`` [4, 4] moved the whole file before: normals of vertices and faces, and Gaussian
        splats, move along with it.

        Integers that change become double. In a text file only the numbers that change are written
        again. They get the digits of their type; if the text has more digits than that, they get
        the digits of a double.
        """
        old, move = self.read(), similarity_of(matrix)
        if move is None and np.array_equal(old, points):
            return self.data
        along = [] if move is None else self._along(move)
        head = self.data[: self.header.size]
        changing = [(self.vertex, AXES), *((group.element, group.names) for group in along)]
        changing_properties = (
            element.properties[name] for element, names in changing for name in names
        )
        integers = [p for p in changing_properties if p.kind[0] != "f"]
        for begin, end in sorted((p.type_span for p in integers), reverse=True):
            head = head[:begin] + b"double" + head[end:]
        with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file
            return head + self._body.changed(self._changes(old, points, along))

    def with_confidence(self, values: Array) -> bytes:
        """The file with ``values`` [N] as the property `confidence` of its vertices.

        All other bytes stay. The property is a float after the others, unless the file has it.
        """
        scalars = [p for p in self.vertex.properties.values() if not p.length_kind]
        there = self.vertex.properties.get(CONFIDENCE)
        if there is not None and there.length_kind:
            raise InputError(
                f"{self.path}: {CONFIDENCE} of its vertices is a list, expected one number to "
                "replace; rename it"
            )
        last = there or scalars[-1]
        places, (begin, end) = self._places_of(self.vertex, (last.name,)), last.type_span
        if there is None:
            line = re.compile(rb"[^\r\n]*(\r\n|\r|\n)").match(self.data, end)
            assert line  # the header has an end
            begin = end = line.end()
            declared = b"property float " + CONFIDENCE.encode() + line[1]
            body = self._body.with_floats(places[:, 0], last.kind, values)
        else:
            declared = self.data[begin:end] if there.kind[0] == "f" else b"double"
            old = self._body.columns(places, [there.kind])
            body = self._body.changed([Change(places, [there.kind], old, values[:, None])])
        return self.data[:begin] + declared + self.data[end : self.header.size] + body

    def cropped(self, kept: Bits) -> bytes:
        """The file with the vertices ``kept`` [N] alone, and the faces that join no others.

        Raises InputError if the file has further elements, which may name vertices too.
        """
        further_elements = [
            name
            for name, element in self.header.elements.items()
            if element.count and name not in ("vertex", "face")
        ]
        if further_elements:
            raise InputError(
                f"{self.path}: holds {shown(', '.join(further_elements))} besides vertices "
                "and faces, which cannot be cropped; write another file, .xyz or .npy"
            )
        head, number = self.data[: self.header.size], np.cumsum(kept) - 1
        removed, corners = {"vertex": ~kept}, []
        for name, element in self.header.elements.items():
            if name == "face":
                removed[name] = np.zeros(element.count, bool)
                for face_rows, places, kind, polygons in self._polygons(element, 1):
                    whole = kept[polygons].all(1)
                    removed[name][face_rows[~whole]] = True
                    old, new = (v[whole].astype(float) for v in (polygons, number[polygons]))
                    corners.append(Change(places[whole], [kind], old, new))
        counts = {name: int(np.count_nonzero(~gone)) for name, gone in removed.items()}
        for name, count in counts.items():
            line = rb"([\r\n]element[ \t]+" + re.escape(name.encode()) + rb"[ \t]+)\d+"
            head = re.sub(line, rb"\g<1>%d" % count, head, count=1)
        rows = [self._rows[name][gone] for name, gone in removed.items()]
        ends = [
            layout(self._body, self.header.elements[name], starts)[1]
            for name, starts in zip(removed, rows, strict=True)
        ]
        return head + self._body.without(np.concatenate(rows), np.concatenate(ends), corners)

    def _changes(self, old: Array, points: Array, along: list[_Along]) -> Iterator[Change]:
        yield Change(self._places, self.kinds, old, points)
        for element, names, moved in along:
            kinds = [element.properties[name].kind for name in names]
            for first in range(0, len(self._rows[element.name]), BLOCK):
                places = self._places_of(element, names, slice(first, first + BLOCK))
                values = self._body.columns(places, kinds)
                yield Change(places, kinds, values, moved(values))

    def _along(self, move: Similarity) -> list[_Along]:
        """What ``move`` changes besides coordinates."""
        along = []
        for element in filter(None, map(self.header.elements.get, ("vertex", "face"))):
            scalars = {p.name for p in element.properties.values() if not p.length_kind}
            if move.turns:
                normals = [names for names in NORMALS if scalars.issuperset(names)]
                along += [_Along(element, names, move.turned) for names in normals]
            if element is self.vertex:
                along += [_Along(element, *group) for group in moved_along(scalars, move)]
        return along


def _corners_of(element: Element) -> Property | None:
    """The list of the vertices of each face."""
    lists = (p for p in element.properties.values() if p.name in CORNERS and p.length_kind)
    return next(lists, None)


def new_ply(
    points: Array,
    dtype: str,
    faces: NDArray[np.integer] | None = None,
    normals: Array | None = None,
    colours: Array | None = None,
) -> bytes:
    """A binary PLY file of ``points`` [N, 3] and ``faces`` [F, 3].

    ``dtype`` is the type of the coordinates, "float32" or "float64". The points may have
    ``normals`` [N, 3], and ``colours`` [N, 3] in [0, 1].
    """
    kind = "float" if dtype == "float32" else "double"
    lines = [f"element vertex {len(points)}", *(f"property {kind} {axis}" for axis in AXES)]
    columns = [points.astype(np.dtype(dtype).newbyteorder("<"))]
    if normals is not None:
        lines += [f"property float {name}" for name in NORMALS[0]]
        columns.append(normals.astype("<f4"))
    if colours is not None:
        lines += [f"property uchar {name}" for name in COLOURS]
        columns.append(np.rint(colours * 255.0).astype("u1"))
    if len(columns) == 1:
        body = columns[0].tobytes()
    else:
        rows = [np.ascontiguousarray(column).view("u1") for column in columns]
        body = np.concatenate(rows, 1).tobytes()
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        polygons = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        polygons["count"], polygons["corners"] = 3, faces
        body += polygons.tobytes()
    header = ["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]
    return "\n".join(header).encode() + body
