"""Colours of surfaces, from the pictures on them: glTF's base colours, and map_Kd of OBJ."""

import base64
import io
import json
import warnings
from urllib.parse import quote

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.corruption import assert_reads_or_refuses
from tests.fuzz import faces as read_faces
from tso_cli.cloud.cloud import Cloud
from tso_cli.io import paint
from tso_cli.io.clouds import read_cloud, write_cloud

SIDE = 8
PICTURE = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
# A square plate of two triangles, and the places of a picture at its corners: v is up.
PLATE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
PLACES = PLATE[:, :2]
# Points of both triangles: barycentric coordinates.
SHARES = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], 200)
FACES = np.arange(200) % 2


def png(pixels=PICTURE):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def inline(data):
    return f"data:application/octet-stream;base64,{base64.b64encode(data).decode()}"


def gltf(*parts, **more):
    """A scene of plates; a part is its material and the attributes of its vertices."""
    document = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "nodes": []}
    data, primitives = b"", []

    def accessor(values, kind, width):
        nonlocal data
        values = np.ascontiguousarray(values)
        component = {"f4": 5126, "u2": 5123, "u1": 5121}[values.dtype.str[1:]]
        view = {"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes}
        data += values.tobytes() + bytes(-values.nbytes % 4)
        document["bufferViews"].append(view)
        number = len(document["accessors"])
        document["accessors"].append({
            "bufferView": number, "componentType": component, "count": values.size // width,
            "type": kind, "normalized": component != 5126,
        })  # fmt: skip
        return number

    for material, attributes in parts:
        held = {"POSITION": PLATE.astype("f4")} | attributes
        attributes = {
            key: accessor(one, f"VEC{one.shape[1]}", one.shape[1]) for key, one in held.items()
        }
        indices = accessor(TRIANGLES.astype("u2"), "SCALAR", 1)
        primitives.append({"attributes": attributes, "indices": indices})
        if material is not None:
            primitives[-1]["material"] = material
    document |= {
        "meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}],
        "buffers": [{"uri": inline(data), "byteLength": len(data)}],
    }  # fmt: skip
    return document | more


def textured(uri=None, sampler=None, **base):
    """The materials of a scene: the picture on the first, a plain red on the second."""
    texture = {"source": 0} if sampler is None else {"source": 0, "sampler": 0}
    base = {"baseColorTexture": {"index": 0}} | base
    return {
        "materials": [
            {"pbrMetallicRoughness": base},
            {"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.1, 0.0, 1.0]}},
        ],
        "textures": [texture], "images": [{"uri": uri or inline(png())}],
        "samplers": [sampler] if sampler else [],
    }  # fmt: skip


def top_down(places=PLACES):
    """Texture coordinates as glTF has them: v is down."""
    return np.stack([places[:, 0], 1.0 - places[:, 1]], 1).astype("f4")


UV = {"TEXCOORD_0": top_down()}


def shown(places, wrap=lambda place: place % 1.0):
    """The colours [N, 3] of the picture at places with v up."""
    column, row = (np.minimum((wrap(one) * SIDE).astype(int), SIDE - 1) for one in places.T)
    return PICTURE[SIDE - 1 - row, column] / 255.0


def between(values):
    """``values`` of the corners of the plate at the points that are looked at."""
    return np.einsum("nk,nkc->nc", SHARES, values[TRIANGLES[FACES]])


def colours_of(path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_cloud(path).paint().at(FACES, SHARES)


def in_a_glb(folder, pixels):
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(pixels))
    visual = trimesh.visual.TextureVisuals(PLACES, material=material)
    mesh = trimesh.Trimesh(PLATE, TRIANGLES, process=False, visual=visual)
    mesh.export(folder / "plate.glb")
    return folder / "plate.glb"


def in_a_gltf(folder, pixels):
    path = folder / "plate.gltf"
    path.write_text(json.dumps(gltf((0, UV), **textured(inline(png(pixels))))))
    return path


def beside_a_gltf(folder, pixels):
    (folder / "pictures").mkdir()
    (folder / "pictures/my paint.png").write_bytes(png(pixels))
    document = gltf((0, UV), **textured(quote("pictures/my paint.png")))
    (folder / "plate.gltf").write_text(json.dumps(document))
    return folder / "plate.gltf"


OBJ = "mtllib plate.mtl\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in PLATE)
OBJ += "".join(f"vt {u} {v}\n" for u, v in PLACES)


def beside_an_obj(folder, pixels):
    (folder / "paint.png").write_bytes(png(pixels))
    (folder / "plate.mtl").write_text("newmtl a b\r\nKd 0.5 0.5 0.5\r\nmap_Kd -s 1 1 1 paint.png")
    (folder / "plate.obj").write_text(OBJ + "usemtl a b\nf -4/-4 -3/-3 -2/-2 -1/-1 # a quad\n")
    return folder / "plate.obj"


STORED = [in_a_glb, in_a_gltf, beside_a_gltf, beside_an_obj]


@pytest.mark.parametrize("store", STORED)
def test_points_between_vertices_have_the_colours_of_the_picture_there(tmp_path, store):
    found = colours_of(store(tmp_path, PICTURE))
    np.testing.assert_allclose(found, shown(between(PLACES)), atol=1e-6)


@pytest.mark.parametrize("store", STORED)
def test_a_plate_of_four_vertices_has_its_picture_at_its_control_points(tmp_path, store):
    cloud = read_cloud(store(tmp_path, PICTURE))
    body = Cloud(cloud.points, "plate", None, cloud.faces(), paint=cloud.paint()).controlled()
    expected = shown(body.control_points[:, :2])
    # Vertices are stored as float: beside an edge between pixels the other pixel may be seen.
    assert (np.abs(body.colours - expected).max(1) < 1e-6).mean() > 0.99


@pytest.mark.parametrize("store", STORED)
def test_paint_that_was_read_leaves_the_file_as_it_is(tmp_path, store):
    path = store(tmp_path, PICTURE)
    cloud = read_cloud(path)
    cloud.paint()
    write_cloud(tmp_path / f"same{path.suffix}", cloud.points, like=cloud)
    assert (tmp_path / f"same{path.suffix}").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("store", STORED)
def test_the_colours_of_a_large_picture_are_means(tmp_path, store, monkeypatch):
    monkeypatch.setattr(paint, "LONGEST_SIDE", SIDE)
    found = colours_of(store(tmp_path, PICTURE.repeat(2, 0).repeat(2, 1)))
    np.testing.assert_allclose(found, shown(between(PLACES)), atol=1e-6)


@pytest.mark.parametrize(
    ("code", "wrap"),
    [
        (10497, lambda place: place % 1.0),
        (33648, lambda place: 1.0 - np.abs(place % 2.0 - 1.0)),
        (33071, lambda place: np.clip(place, 0.0, 1.0)),
    ],
)
def test_outside_of_the_picture_its_sampler_says_what_is_seen(save, code, wrap):
    places = 4.0 * PLACES - 1.5
    sampler = {"wrapS": code, "wrapT": code}
    document = gltf((0, {"TEXCOORD_0": top_down(places)}), **textured(sampler=sampler))
    found = colours_of(save("plate.gltf", document))
    np.testing.assert_allclose(found, shown(between(places), wrap), atol=1e-6)


def test_factor_and_colours_of_vertices_multiply_the_picture(save):
    colours = np.random.default_rng(2).integers(0, 256, (4, 4), dtype=np.uint8)
    document = gltf((0, UV | {"COLOR_0": colours}), **textured(baseColorFactor=[0.5, 1, 0.25, 1]))
    expected = shown(between(PLACES)) * between(colours[:, :3] / 255.0) * [0.5, 1.0, 0.25]
    np.testing.assert_allclose(colours_of(save("plate.gltf", document)), expected, atol=1e-6)


def test_a_material_names_its_coordinates_and_may_scale_and_shift_them(save):
    other = (65535 * top_down()).round().astype("u2")
    base = {"baseColorTexture": {"index": 0, "texCoord": 1}}
    attributes = {"TEXCOORD_0": np.zeros((4, 2), "f4"), "TEXCOORD_1": other}
    found = colours_of(save("plate.gltf", gltf((0, attributes), **textured(**base))))
    np.testing.assert_allclose(found, shown(between(PLACES)), atol=1e-6)
    moved = {"scale": [0.5, 0.5], "offset": [0.25, 0.125], "texCoord": 1}
    base["baseColorTexture"] = {"index": 0, "extensions": {"KHR_texture_transform": moved}}
    found = colours_of(save("plate.gltf", gltf((0, attributes), **textured(**base))))
    # v is down in the file: its shift is counted from the top.
    places = PLACES * 0.5 + [0.25, 1.0 - 0.5 - 0.125]
    np.testing.assert_allclose(found, shown(between(places)), atol=1e-6)


def test_parts_without_a_picture_have_the_colours_of_their_materials(save):
    parts = [(1, {}), (0, UV), (None, {})]
    paint = read_cloud(save("plate.gltf", gltf(*parts, **textured()))).paint()
    plain, pictured, white = (paint.at(FACES + first, SHARES) for first in (0, 2, 4))
    np.testing.assert_allclose(plain, np.tile([0.9, 0.1, 0.0], (200, 1)), atol=1e-6)
    np.testing.assert_allclose(pictured, shown(between(PLACES)), atol=1e-6)
    np.testing.assert_allclose(white, 1.0, atol=1e-12)


def test_faces_of_an_obj_have_the_picture_or_the_colour_of_their_material(tmp_path):
    beside_an_obj(tmp_path, PICTURE)
    with (tmp_path / "plate.mtl").open("a") as file:
        file.write("\nnewmtl red\nKd 0.9 0.1 0\n")
    text = "f 1 2 3\nusemtl red\nf 1/1 2/2 3/3\nusemtl a b\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 1 2 3\n"
    (tmp_path / "plate.obj").write_text(OBJ + text)
    paint = read_cloud(tmp_path / "plate.obj").paint()
    np.testing.assert_allclose(paint.at(FACES + 2, SHARES), shown(between(PLACES)), atol=1e-6)
    for face, colour in ((0, 1.0), (1, [0.9, 0.1, 0.0]), (4, 0.5)):
        found = paint.at(np.full(200, face), SHARES)
        np.testing.assert_allclose(found, np.broadcast_to(colour, (200, 3)), atol=1e-6)


def test_colours_of_the_vertices_of_an_obj_come_before_those_of_materials(tmp_path):
    (tmp_path / "plate.mtl").write_text("newmtl red\nKd 0.9 0.1 0\n")
    vertices = "".join(f"v {x} {y} {z} {x} {y} 0.5\n" for x, y, z in PLATE)
    text = f"mtllib plate.mtl\n{vertices}f 1 2 3\nusemtl red\nf 1 3 4\n"
    (tmp_path / "plate.obj").write_text(text)
    cloud = read_cloud(tmp_path / "plate.obj")
    assert cloud.paint() is None
    assert cloud.colours()[2].tolist() == [1.0, 1.0, 0.5]


def test_a_mesh_of_one_colour_has_no_paint(save):
    assert read_cloud(save("plate.gltf", gltf((1, {}), (1, {}), **textured()))).paint() is None
    assert read_cloud(save("plain.gltf", gltf((None, {})))).paint() is None
    assert read_cloud(save("plate.ply", trimesh.Trimesh(PLATE, TRIANGLES).export(None, "ply"))
        ).paint() is None  # fmt: skip


ROTATED = {"index": 0, "extensions": {"KHR_texture_transform": {"rotation": 1.0}}}


@pytest.mark.parametrize(
    ("document", "says"),
    [
        (gltf((0, UV), **textured(inline(png()[:90]))), "the texture 'number 0' cannot be decoded"),
        (gltf((0, UV), **textured("lost.png")), "'lost.png' is not in this folder or below"),
        (gltf((0, UV), **textured("../out.png")), "'../out.png' is not in this folder or below"),
        (gltf((0, UV), **textured("http://a.b/c.png")), "'http://a.b/c.png' is not in this folder"),
        (gltf((0, {}), **textured()), "the texture 'number 0' has no coordinates on the mesh"),
        (
            gltf((0, {"TEXCOORD_0": np.full((4, 2), np.nan, "f4")}), **textured()),
            "at some of the vertices",
        ),
        (gltf((0, UV), **textured(baseColorTexture=ROTATED)), "a texture is rotated on its mesh"),
        (gltf((7, UV), **textured()), "the material 'number 7' cannot be read"),
    ],
)
def test_a_texture_that_cannot_be_used_is_said_and_gives_no_colours(save, tmp_path, document, says):
    (tmp_path.parent / "out.png").write_bytes(png())
    cloud = read_cloud(save("plate.gltf", document))
    with pytest.warns(UserWarning, match=r"plate\.gltf: its textures are not used: ") as caught:
        assert cloud.paint() is None
    assert says in str(caught[0].message)
    assert cloud.colours() is None


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("paint.png", "the texture 'paint.png' is not in this folder or below"),
        ("plate.mtl", "the material file 'plate.mtl' is not in this folder or below"),
    ],
)
def test_a_file_that_an_obj_names_and_lacks_is_said(tmp_path, name, says):
    cloud = read_cloud(beside_an_obj(tmp_path, PICTURE))
    (tmp_path / name).unlink()
    with pytest.warns(UserWarning, match=rf"plate\.obj: .* not used: {says}"):
        assert cloud.paint() is None


@pytest.mark.parametrize("store", STORED)
def test_damaged_files_are_read_without_paint_or_refused_in_one_line(tmp_path, store):
    path = store(tmp_path, PICTURE)
    read, refused = assert_reads_or_refuses(read_faces, path, 60)
    assert read + refused == 60


def test_a_damaged_picture_or_material_file_never_stops_the_work(tmp_path):
    path = beside_an_obj(tmp_path, PICTURE)
    for name in ("paint.png", "plate.mtl"):
        good = (tmp_path / name).read_bytes()

        def read(damaged, name=name):
            (tmp_path / name).write_bytes(damaged.read_bytes())
            read_faces(path)

        copy = tmp_path / f"copy{name}"
        copy.write_bytes(good)
        _, refused = assert_reads_or_refuses(read, copy, 40)
        assert refused == 0
        (tmp_path / name).write_bytes(good)
