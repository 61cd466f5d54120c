"""glTF and GLB: the vertices of a scene, and the file again with these vertices moved.

POSITION is replaced in place, and NORMAL and TANGENT are turned with the whole scene and with the
surface. Every other value of the file stays, except the bounds that glTF states of POSITION.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from ..geometry.normals import rigid_turn, same_places, turned_normals
from ..geometry.points import require_vertices
from .checked import Checked, kind
from .gltf_scene import (
    COMPONENTS,
    MAGIC,
    WHOLE_SCENE,
    WIDTHS,
    document_of,
    entry,
    glb_of,
    memory_of,
    objects_of,
    places_of,
    scene_text,
    whole,
)
from .guard import reading
from .movable import MovableFile
from .paint import Paint, Pictures, Texture
from .reading import plain, read_bytes, require_memory
from .similarity import Similarity, similarity_of

# What stands for 1 in colours and texture coordinates of whole numbers.
_FULL = {"u1": 255.0, "u2": 65535.0}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco", "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
    "EXT_mesh_gpu_instancing": "GPU instancing",
}  # fmt: skip
# Extensions that a file may require: they change neither where vertices are nor which faces join
# them. Quantised vertices are refused where they are met.
_HARMLESS = re.compile(
    r"(KHR_materials_|KHR_texture_|EXT_texture_|MSFT_texture_|KHR_lights_|EXT_lights_|"
    r"KHR_mesh_quantization$|KHR_xmp|KHR_animation_|EXT_mesh_features$|"
    r"EXT_structural_metadata$)"
)
_LONGEST_NAME = 255  # bytes in the name of a file
_DATA = "data:"


@dataclass(frozen=True, eq=False)
class _Part:
    """The vertices of one node that are in one accessor."""

    node: int
    accessor: int
    matrix: Array  # to the world
    first: int  # its first vertex among all
    count: int


@dataclass(frozen=True, eq=False)
class _Primitive:
    """A primitive of a part: its triangles as vertices of the part, and accessors of directions."""

    part: _Part
    triangles: Indices
    attributes: dict[str, Any]  # names of values of the vertices -> accessors
    material: Any  # its number, or None

    def directions(self) -> list[_Directions]:
        """The normals and the tangents, where there are some."""
        matrix = self.part.matrix[:3, :3]
        # A node may shear its mesh: normals go by the inverse of the transpose.
        both = [
            _Directions("NORMAL", self.attributes.get("NORMAL"), "VEC3", np.linalg.inv(matrix).T),
            _Directions("TANGENT", self.attributes.get("TANGENT"), "VEC4", matrix),
        ]
        return [directions for directions in both if directions.accessor is not None]


class _Directions(NamedTuple):
    """Directions of vertices: attribute, accessor and its type, and matrix [3, 3] to the world."""

    name: str
    accessor: Any
    form: str
    to_world: Array

    def of_node(self, turn: Array) -> Array:
        """The matrix [3, 3] that does in the node what the rotation ``turn`` does in the world."""
        matrix: Array = np.linalg.inv(self.to_world) @ turn @ self.to_world
        return matrix

    def turned(self, directions: Array, turn: Array) -> Array:
        """``directions`` [N, 3] in the node, turned in the world by ``turn``; lengths stay."""
        if np.array_equal(turn, np.eye(3)):
            return directions
        with np.errstate(all="ignore"):
            turned = directions @ self.of_node(turn).T
            lengths = np.linalg.norm(directions, axis=1), np.linalg.norm(turned, axis=1)
            return np.asarray(turned * (lengths[0] / np.maximum(lengths[1], 1e-300))[:, None])


class GltfFile(Checked, MovableFile):
    """The meshes of a scene. Raises InputError if the file is damaged or holds no vertex.

    Attributes
    ----------
    kinds : types of the coordinates, as in a PLY file.
    """

    kinds = ("f4", "f4", "f4")

    def __init__(self, data: bytes, path: Path) -> None:
        self.data, self.path = data, path
        self.suffix = ".glb" if data[:4] == MAGIC else ".gltf"
        self._text, binary = scene_text(data, path)
        self._document = document_of(self._text, path)
        self._parts: list[_Part] = []
        self._primitives: list[_Primitive] = []
        self._attributes: set[str] = set()  # of all primitives
        with reading(self, WHOLE_SCENE):
            self._refuse_compression()
            self._buffers = self._read_buffers(binary)
            stored_bytes = sum(map(len, self._buffers))
            require_memory(path, memory_of(self, self._document, stored_bytes))
            self._accessors = objects_of(self, self._document, "accessors")
            self._views = objects_of(self, self._document, "bufferViews")
            self._fill_sparse()
            self._collect()
        if not self._parts:
            raise InputError(f"{path}: holds no mesh, expected a scene with one")

    def _refuse_compression(self) -> None:
        for key in ("extensionsUsed", "extensionsRequired"):
            for extension in map(str, self._document.get(key, [])):
                if name := _COMPRESSED.get(extension):
                    raise InputError(
                        f"{self.path}: its meshes use {name}, which tso does not read; export it "
                        "without compression and instances (gltf-transform copy, or Blender)"
                    )
                if key == "extensionsRequired" and not _HARMLESS.match(extension):
                    raise InputError(
                        f"{self.path}: requires the extension {plain(extension)}, which tso does "
                        "not know, expected a scene without it; export it without this extension"
                    )

    def _read_buffers(self, binary: bytes) -> list[bytes]:
        """The bytes of all buffers; ``binary`` is of the first one that names no other place."""
        buffers: list[bytes] = []
        uris: set[str] = set()
        for number, buffer in enumerate(objects_of(self, self._document, "buffers")):
            self.place = f"buffers[{number}]."
            if (uri := buffer.get("uri")) is None:
                buffers.append(binary)
                binary = b""
            elif uri in uris:
                raise self.error("uri", plain(uri), "a file or data of its own for each buffer")
            else:
                uris.add(uri)
                buffers.append(self._buffer(uri))
        self.place = ""
        return buffers

    def _buffer(self, uri: str) -> bytes:
        if uri[: len(_DATA)].lower() == _DATA:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        name = unquote(uri)
        parts = Path(name.replace("\\", "/")).parts
        outside = "://" in name or ".." in parts or not parts or Path(*parts).is_absolute()
        outside = outside or not name.isprintable()
        if outside or max(len(part.encode("utf-8", "replace")) for part in parts) > _LONGEST_NAME:
            raise self.error("uri", plain(name), "a file in the same folder")
        return read_bytes(
            self.path.parent / Path(*parts), f"the buffer that {self.path.name} names"
        )

    def _fill_sparse(self) -> None:
        """Store the values of sparse accessors whole, each in a buffer of its own."""
        sparse = [number for number, a in enumerate(self._accessors) if "sparse" in a]
        for number in sparse:
            self.place, accessor = f"accessors[{number}].", self._accessors[number]
            few, form = accessor.pop("sparse"), accessor["type"]
            dtype = np.dtype(COMPONENTS[accessor["componentType"]])
            values = np.zeros((whole(accessor["count"]), WIDTHS[form]), dtype)
            if "bufferView" in accessor:
                values[:] = self._values(number, (form,))
            places, new = (
                self._of_layout(self._layout_of({**few[key], **common}, (common["type"],)))
                for key, common in (
                    ("indices", {"count": few["count"], "type": "SCALAR"}),
                    (
                        "values",
                        {**accessor, "count": few["count"], "byteOffset": 0, **few["values"]},
                    ),
                )
            )
            values[places[:, 0]] = new
            data = values.tobytes()
            inline = f"{_DATA}application/octet-stream;base64,{base64.b64encode(data).decode()}"
            length = {"byteLength": len(data)}
            self._document["buffers"].append({"uri": inline, **length})
            self._views.append({"buffer": len(self._buffers), **length})
            self._buffers.append(data)
            accessor |= {"bufferView": len(self._views) - 1, "byteOffset": 0}
        if sparse:
            self._text = json.dumps(self._document)
        self.place = ""

    def _collect(self) -> None:
        nodes = objects_of(self, self._document, "nodes")
        meshes = objects_of(self, self._document, "meshes")
        places = places_of(self, nodes)
        # Nodes that stand alike show the same vertices.
        part_of: dict[tuple[bytes, int], _Part] = {}
        total = 0
        for number in self._shown(nodes):
            self.place = f"nodes[{number}]."
            index = nodes[number].get("mesh")
            if index is None:
                continue
            mesh = entry(meshes, index)
            if "skin" in nodes[number]:
                raise InputError(
                    f"{self.path}: a mesh is moved by a skeleton (skin), expected a static mesh; "
                    "apply the pose before you export it"
                )
            self.place = f"meshes[{index}]."
            for primitive in objects_of(self, mesh, "primitives"):
                attributes = primitive["attributes"]
                key = places[number].tobytes(), attributes["POSITION"]
                self._attributes |= attributes.keys()
                for name in ("NORMAL", "TANGENT"):
                    if name in attributes:
                        self._layout(attributes[name], ("VEC3", "VEC4"))
                if "targets" in primitive:
                    raise InputError(
                        f"{self.path}: a mesh has morph targets, expected none; apply the shape "
                        "before you export it"
                    )
                if key not in part_of:
                    count = len(self._positions(key[1]))
                    part_of[key] = _Part(number, key[1], places[number], total, count)
                    total += count
                self._primitives.append(self._primitive(part_of[key], primitive, attributes))
        self.place = ""
        self._parts = list(part_of.values())

    def _shown(self, nodes: list[dict[str, Any]]) -> list[int]:
        """The nodes of the default scene, in the order of the file."""
        scenes = objects_of(self, self._document, "scenes")
        index = self._document.get("scene", 0)
        if index not in range(len(scenes)):
            return list(range(len(nodes)))
        self.place = f"scenes[{index}]."
        open_, reached = list(scenes[index].get("nodes", [])), set()
        while open_:
            number = open_.pop()
            node = entry(nodes, number)
            if number not in reached:
                reached.add(number)
                open_ += node.get("children", [])
        return sorted(reached)

    def _primitive(
        self, part: _Part, primitive: dict[str, Any], attributes: dict[str, Any]
    ) -> _Primitive:
        if "indices" in primitive:
            indices = self._values(primitive["indices"], ("SCALAR",)).ravel().astype(np.int64)
        else:
            indices = np.arange(part.count)
        require_vertices(indices, part.count, str(self.path))
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            triangles = indices[: len(indices) // 3 * 3].reshape(-1, 3)
        elif mode == _STRIP and len(indices) > 2:
            triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], 1)
            triangles[1::2, :2] = triangles[1::2, 1::-1]
        elif mode == _FAN and len(indices) > 2:
            first = np.full(len(indices) - 2, indices[0])
            triangles = np.stack([first, indices[1:-1], indices[2:]], 1)
        else:
            triangles = np.empty((0, 3), np.int64)  # points and lines
        if np.linalg.det(part.matrix[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]  # a mirror turns faces inside out
        return _Primitive(part, triangles, attributes, primitive.get("material"))

    def _positions(self, accessor: Any) -> Array:
        values = self._values(accessor, ("VEC3",))
        if values.dtype != np.dtype("<f4"):
            raise InputError(
                f"{self.path}: its vertices are quantised (KHR_mesh_quantization), which tso does "
                "not read; export them as float (gltf-transform dequantize, or Blender)"
            )
        return _as_double(values)

    def _values(
        self,
        accessor: Any,
        types: tuple[str, ...],
        buffers: Sequence[bytes | bytearray] | None = None,
    ) -> NDArray[Any]:
        """The values [N, C] of an accessor, a view into the file's buffer or one of ``buffers``."""
        return self._of_layout(self._layout(accessor, types), buffers)

    def _of_layout(
        self,
        layout: tuple[int, int, np.dtype[Any], int, int, int],
        buffers: Sequence[bytes | bytearray] | None = None,
    ) -> NDArray[Any]:
        buffer, offset, dtype, count, width, stride = layout
        data = (self._buffers if buffers is None else buffers)[buffer]
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _layout(
        self, number: Any, types: tuple[str, ...]
    ) -> tuple[int, int, np.dtype[Any], int, int, int]:
        """Buffer, offset, type, count, width and stride of an accessor."""
        outer, self.place = self.place, f"accessors[{kind(number)}]."
        try:
            with reading(self, WHOLE_SCENE):
                return self._layout_of(entry(self._accessors, number), types)
        finally:
            self.place = outer

    def _layout_of(
        self, accessor: dict[str, Any], types: tuple[str, ...]
    ) -> tuple[int, int, np.dtype[Any], int, int, int]:
        form, component = accessor["type"], accessor["componentType"]
        if form not in types:
            raise self.error("type", plain(str(form)), " or ".join(types))
        if component not in COMPONENTS:
            raise self.error("componentType", kind(component), f"one of {[*COMPONENTS]}")
        dtype, width = np.dtype(COMPONENTS[component]), WIDTHS[form]
        view = entry(self._views, accessor["bufferView"])
        buffer, begin, stride, length = (
            whole(view.get(key, 0)) for key in ("buffer", "byteOffset", "byteStride", "byteLength")
        )
        offset, count = (whole(accessor.get(key, 0)) for key in ("byteOffset", "count"))
        stride = stride or width * dtype.itemsize
        end = offset + (count - 1) * stride + width * dtype.itemsize if count else offset
        size = len(entry(self._buffers, buffer))
        if begin + length > size:
            raise self.error(
                "bufferView",
                f"bytes {begin:.15g} to {begin + length:.15g} of buffer {buffer}",
                f"a part of its {size:,} bytes; the buffer ends early or the scene is damaged",
            )
        if count == 0 or end > length:
            raise self.error("count", f"{count:.15g}", "1 or more, as many as its view holds")
        return buffer, begin + offset, dtype, count, width, stride

    def read(self) -> Array:
        """The vertices [V, 3] of all parts, in the world."""
        parts = []
        for part in self._parts:
            local = self._positions(part.accessor)
            parts.append(local @ part.matrix[:3, :3].T + part.matrix[:3, 3])
        return np.concatenate(parts)

    def read_faces(self) -> Indices | None:
        """Triangles [F, 3]; None if there are none."""
        faces = [primitive.triangles + primitive.part.first for primitive in self._primitives]
        joined = np.concatenate(faces) if faces else np.empty((0, 3), np.int64)
        return joined if len(joined) else None

    def read_colours(self) -> Array | None:
        """Red, green and blue [V, 3] in [0, 1]; None unless all vertices have a colour.

        A texture is multiplied with these colours: then they do not say what is seen.
        """
        values = None if self._document.get("textures") else self._of_vertices("COLOR_0", 3, 4)
        if values is None:
            return None
        colours = np.concatenate([_as_shares(v[:, :3]) for _, v in values])
        return colours if ((colours >= 0.0) & (colours <= 1.0)).all() else None

    def read_paint(self, pictures: Pictures) -> Paint:
        """The base colours of the materials, times the colours of the vertices."""
        from .gltf_paint import Materials

        materials = Materials(self._document, self._bytes_of_view, pictures)
        corners, textures, first = [], [], 0
        for primitive in self._primitives:
            coat = materials.coat(primitive.material)
            faces = first + np.arange(len(primitive.triangles))
            first += len(faces)
            tint = np.tile(coat.factor, (primitive.part.count, 1))
            if (accessor := primitive.attributes.get("COLOR_0")) is not None:
                tint *= _as_shares(self._values(accessor, ("VEC3", "VEC4"))[:, :3])
            corners.append(tint[primitive.triangles])
            if coat.picture is not None and len(faces):
                accessor = primitive.attributes.get(f"TEXCOORD_{coat.coordinates}")
                if accessor is None:
                    pictures.miss(coat.name, "has no coordinates on the mesh")
                    continue
                coordinates = _as_shares(self._values(accessor, ("VEC2",)))
                if len(coordinates) < primitive.part.count or not np.isfinite(coordinates).all():
                    pictures.miss(coat.name, "has no coordinates at some of the vertices")
                    continue
                at = coat.placed(coordinates)[primitive.triangles]
                textures.append(Texture(coat.picture, faces, at, wraps=coat.wraps))
        return Paint.of_parts(corners, textures)

    def _bytes_of_view(self, number: int) -> bytes:
        view = self._views[number]
        begin = view.get("byteOffset", 0)
        return self._buffers[view.get("buffer", 0)][begin : begin + view["byteLength"]]

    def read_normals(self) -> Array | None:
        """The normal of each vertex [V, 3] in the world; None unless all vertices have one."""
        values = self._of_vertices("NORMAL", 3)
        if values is None:
            return None
        # A node may shear its mesh: normals go by the inverse of the transpose.
        with np.errstate(all="ignore"):
            turned = [_as_double(v) @ np.linalg.pinv(part.matrix[:3, :3]) for part, v in values]
            normals = np.concatenate(turned)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        return normals if np.isfinite(normals).all() else None

    def _of_vertices(self, name: str, *widths: int) -> list[tuple[_Part, NDArray[Any]]] | None:
        """Each part and its values [V, C] of an attribute; None unless all vertices have one."""
        values_of: dict[int, tuple[_Part, NDArray[Any]]] = {}
        for primitive in self._primitives:
            accessor = primitive.attributes.get(name)
            if accessor is None:
                return None
            values = self._values(accessor, tuple(f"VEC{width}" for width in widths))
            if len(values) != primitive.part.count:
                return None
            values_of[primitive.part.first] = primitive.part, values
        return [values_of[part.first] for part in self._parts]

    @property
    def contents(self) -> list[str]:
        """What the scene holds besides vertices and faces."""
        names = self._attributes
        parts = {
            "textures": self._document.get("textures"),
            "materials": self._document.get("materials"),
            "texture coordinates": "TEXCOORD_0" in names,
            "colours": "COLOR_0" in names,
            "normals": "NORMAL" in names,
        }
        return [name for name, there in parts.items() if there]

    def files_named(self, data: bytes) -> list[str]:
        """The pictures and buffers that ``data`` names, a scene as `with_points` gives it."""
        document = document_of(scene_text(data, self.path)[0], self.path)
        entries = [
            entry for key in ("images", "buffers") for entry in objects_of(self, document, key)
        ]
        names = [entry["uri"] for entry in entries if isinstance(entry.get("uri"), str)]
        return [unquote(name) for name in names if name[: len(_DATA)].lower() != _DATA]

    def require_movable(self) -> None:
        """Raise InputError if two nodes share vertices, which could not move apart."""
        accessors = [self._layout(part.accessor, ("VEC3",))[:2] for part in self._parts]
        if len(set(accessors)) < len(accessors):
            twice = next(place for place in accessors if accessors.count(place) > 1)
            nodes = self._document["nodes"]
            names = [
                plain(str(nodes[part.node].get("name", part.node)))
                for part, place in zip(self._parts, accessors, strict=True) if place == twice
            ]  # fmt: skip
            raise InputError(
                f"{self.path}: the nodes {' and '.join(names[:2])} share one mesh, so they cannot "
                "move apart; give each a mesh of its own (in Blender: Object, Relations, Make "
                "Single User)"
            )
        for part in self._parts:
            sides = np.linalg.svd(part.matrix[:3, :3], compute_uv=False)
            if not sides[-1] > 1e-9 * sides[0]:
                raise InputError(
                    f"{self.path}: a node scales its mesh to a plane, expected a scale > 0"
                )

    def left_behind(self, matrix: Array) -> list[str]:
        """Which directions are wrong once ``matrix`` [4, 4] moved the whole scene.

        They are not stored as float, or several nodes share them.
        """
        move = similarity_of(matrix)
        with reading(self, "nodes with a scale > 0"):
            return [] if move is None else sorted(set(self._fixed(move).values()))

    def _fixed(self, move: Similarity) -> dict[tuple[int, int], str]:
        """Buffer and offset of directions that cannot turn with ``move`` -> what they are."""
        fixed: dict[tuple[int, int], str] = {}
        if not move.turns:
            return fixed
        positions = {self._layout(part.accessor, ("VEC3",))[:2] for part in self._parts}
        turns: dict[tuple[int, int], Array] = {}
        for primitive in self._primitives:
            for directions in primitive.directions():
                layout = self._layout(directions.accessor, (directions.form,))
                place, turn = layout[:2], directions.of_node(move.turn)
                fits = layout[2] == np.dtype("<f4") and layout[3] == primitive.part.count
                # Nodes that stand differently turn differently.
                alike = np.allclose(turns.setdefault(place, turn), turn, rtol=0.0, atol=1e-6)
                if not fits or not alike or place in positions:
                    fixed[place] = f"{directions.name.lower()}s"
        return fixed

    def with_points(self, points: Array, matrix: Array | None = None) -> bytes:
        """The file with its vertices moved to ``points`` [V, 3] of the world.

        ``matrix`` [4, 4] moved the whole scene before: normals and tangents turn along with it.
        """
        move = similarity_of(matrix)
        self.require_movable()
        buffers = [bytearray(buffer) for buffer in self._buffers]
        bounds: dict[int, tuple[list[float], list[float]]] = {}
        before = self.read()
        if move is None and np.array_equal(before, points):
            return self.data
        for part in self._parts:
            span = slice(part.first, part.first + part.count)
            moved = (before[span] != points[span]).any(1)
            inverse = np.linalg.inv(part.matrix[:3, :3])
            local = (points[span] - part.matrix[:3, 3]) @ inverse.T
            target = self._values(part.accessor, ("VEC3",), buffers)
            with np.errstate(all="ignore"):  # a coordinate too large is an error of the caller
                target[moved] = local[moved]
            bounds[part.accessor] = target.min(0).tolist(), target.max(0).tolist()
        self._turn_directions(buffers, before, points, move)
        return self._assembled(buffers, bounds)

    def _turn_directions(
        self, buffers: list[bytearray], before: Array, after: Array, move: Similarity | None
    ) -> None:
        """Turn normals and tangents of vertices that went from ``before`` to ``after`` [V, 3]."""
        # No bytes turn twice, and none that are vertices too.
        turned = {self._layout(part.accessor, ("VEC3",))[:2] for part in self._parts}
        turned |= set() if move is None else self._fixed(move).keys()
        for primitive in self._primitives:
            part = primitive.part
            span = slice(part.first, part.first + part.count)
            for directions in primitive.directions():
                place = self._layout(directions.accessor, (directions.form,))[:2]
                if place in turned:
                    continue
                turned.add(place)
                target = self._values(directions.accessor, (directions.form,), buffers)
                if target.dtype != np.dtype("<f4") or len(target) != part.count:
                    continue
                old = _as_double(target[:, :3])
                new = self._turned(directions, part, old, before[span], after[span], move)
                changed = (new != old).any(1)
                with np.errstate(all="ignore"):
                    target[changed, :3] = new[changed]

    def _turned(
        self,
        stored: _Directions,
        part: _Part,
        directions: Array,
        before: Array,
        after: Array,
        move: Similarity | None,
    ) -> Array:
        """``directions`` [N, 3] of a part after its vertices went from ``before`` to ``after``.

        They turn with ``move``, and further with the part or with the faces around them. A part
        that moves as a whole turns them exactly.
        """
        turn = np.eye(3) if move is None else move.turn
        along = stored.turned(directions, turn)
        moved = before if move is None else move.apply(before)
        if move is not None and move.accounts_for(before, after, self.kinds):
            return along
        further = rigid_turn(moved, after)
        if further is not None:
            return stored.turned(directions, further @ turn)
        faces = np.concatenate([
            primitive.triangles for primitive in self._primitives
            if primitive.part is part and primitive.attributes.get(stored.name) == stored.accessor
        ])  # fmt: skip
        inverse = np.linalg.inv(part.matrix[:3, :3])
        was, start, end = (
            (points - part.matrix[:3, 3]) @ inverse.T for points in (before, moved, after)
        )
        # Copies of a vertex along a seam of the texture have the same normal: one group.
        group = same_places(np.c_[np.round(was, 9), np.round(directions, 6)])
        firsts = np.unique(group, return_index=True)[1]
        return turned_normals(along[firsts], group[faces], faces, start, end)[group]

    def _assembled(
        self, buffers: list[bytearray], bounds: dict[int, tuple[list[float], list[float]]]
    ) -> bytes:
        document = document_of(self._text, self.path)
        for number, (low, high) in bounds.items():
            accessor = document["accessors"][number]
            accessor.update({k: v for k, v in (("min", low), ("max", high)) if k in accessor})
        documents = document.get("buffers", [])
        for number, buffer in enumerate(documents):
            if "uri" in buffer and buffers[number] != self._buffers[number]:
                inline = base64.b64encode(buffers[number]).decode()
                buffer["uri"] = f"{_DATA}application/octet-stream;base64,{inline}"
        if self.suffix == ".gltf":
            return (json.dumps(document, indent=2) + "\n").encode()
        text = json.dumps(document, separators=(",", ":"))
        length = struct.unpack_from("<I", self.data, 12)[0]
        rest = self.data[20 + length :]  # the binary chunk, and any others
        binary_buffer = next((i for i, buffer in enumerate(documents) if "uri" not in buffer), None)
        if binary_buffer is not None and rest:
            binary = bytes(buffers[binary_buffer])
            rest = rest[:8] + binary + rest[8 + len(binary) :]
        return glb_of(self.data, text, rest)


def _as_shares(values: NDArray[Any]) -> Array:
    """``values`` as double; whole numbers as shares of the largest that they can be."""
    return _as_double(values) / _FULL.get(values.dtype.str[1:], 1.0)


def _as_double(values: NDArray[Any]) -> Array:
    with np.errstate(invalid="ignore"):  # signalling NaN
        return values.astype(np.float64)
