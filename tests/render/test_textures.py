"""Textures: what is read of them, and what a picture shows of them."""

import json
import re
import socket
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import EpsImagePlugin, Image
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from tso_cli.io.images import read_image
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.io.paint import Paint, Texture
from tso_cli.render.folder import render_folder
from tso_cli.render.normalise import normalise
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.variation import paint, warp

from .conftest import look_at

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
RED, GREEN, BLUE = (200, 0, 0), (0, 200, 0), (0, 0, 200)
CHECKS = np.random.default_rng(0).integers(0, 256, (6, 4, 3), dtype=np.uint8)


def filled(colour):
    return Image.fromarray(np.full((2, 2, 3), colour, np.uint8))


def square(material, uv=CORNERS, z=0.0):
    """A unit square across the z axis, the texture upright on it."""
    vertices = np.column_stack([CORNERS - 0.5, np.full(4, z)])
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, [[0, 1, 2], [2, 3, 0]], process=False, visual=visual)


def saved(path, pixels=CHECKS, uv=CORNERS):
    """The square with a texture, in the format of the suffix."""
    image = Image.fromarray(pixels)
    if path.suffix == ".glb":
        square(PBRMaterial(baseColorTexture=image), uv).export(path)
    else:
        square(SimpleMaterial(image=image, diffuse=[90, 60, 30]), uv).export(path)
    return path


def edited(path, change):
    """A .glb file with another header."""
    content = path.read_bytes()
    end = 20 + int.from_bytes(content[12:16], "little")
    header = json.loads(content[20:end])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    total = (20 + len(text) + len(content) - end).to_bytes(4, "little")
    path.write_bytes(
        content[:8] + total + len(text).to_bytes(4, "little") + b"JSON" + text + content[end:]
    )
    return path


def unlit(mesh, size=60):
    """The front of a mesh whose texture fills it: colours without the light, [size, size, 3]."""
    camera = look_at(0.0, 0.0, 2.0, (size, size), 1.6 * size)
    white = replace(mesh, paint=Paint(np.ones((len(mesh.faces), 3, 3), np.float32)))
    image, light = (
        render_view(RayScene(each), camera).image.astype(float) for each in (mesh, white)
    )
    return image / light[..., :1] * 255.0


def corner_colours(mesh):
    """The colour [F, 3] of the first corner of each face, of 0 to 255."""
    faces = np.arange(len(mesh.faces))
    return np.rint(255.0 * mesh.paint.at(faces, np.eye(3)[np.zeros_like(faces)])).astype(int)


def parts(folder, materials, faces):
    """An .obj of two faces that share two vertices, and its materials."""
    (folder / "a.mtl").write_text(materials)
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nvt 0 0\nvt 1 0\nvt 0 1\n"
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{vertices}{faces}")
    return folder / "a.obj"


def texels(pixels, uv):
    """The colour at texture coordinates ``uv`` [..., 2], v up, and if uv is well inside a texel."""
    height, width = pixels.shape[:2]
    across, down = (uv[..., 0] % 1) * width, ((1 - uv[..., 1]) % 1) * height
    inner = (np.abs(across % 1 - 0.5) < 0.4) & (np.abs(down % 1 - 0.5) < 0.4)
    return pixels[down.astype(int) % height, across.astype(int) % width], inner


@pytest.mark.parametrize(
    ("name", "repeats", "shift"),
    [("a.glb", 1.0, 0.0), ("a.obj", 1.0, 0.0), ("a.glb", 3.0, -1.2)],
    ids=["glb", "obj", "repeated beyond the border"],
)
def test_a_pixel_shows_the_texel_that_its_rays_hit(tmp_path, name, repeats, shift):
    size = 60 if repeats == 1.0 else 120
    colours = unlit(read_mesh(saved(tmp_path / name, uv=repeats * CORNERS + shift)), size)
    along = (np.arange(size) - (size - 1) / 2) / (1.6 * size) * 2.0
    xy = np.stack(np.meshgrid(along, -along), axis=-1)  # of the pixels, in the plane z = 0
    expected, inner = texels(CHECKS, repeats * (xy + 0.5) + shift)
    inner &= (np.abs(xy) < 0.48).all(axis=-1)
    assert inner.sum() > 800
    np.testing.assert_allclose(colours[inner], expected[inner], atol=2.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_texture_coordinates_have_the_colour_of_the_pixel_they_fall_into(height, width, seed):
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    texture = Texture(pixels, np.array([7]), rng.uniform(-4, 4, (1, 3, 2)))
    shares = rng.dirichlet(np.ones(3), 50)
    colours = texture.at(np.zeros(50, dtype=np.int64), shares[:, 1:])
    np.testing.assert_array_equal(colours, texels(pixels, shares @ texture.corners[0])[0])


def test_texture_coordinates_just_below_the_border_stay_in_the_picture():
    texture = Texture(CHECKS, np.array([0]), np.full((1, 3, 2), -1e-20))
    np.testing.assert_array_equal(texture.at(np.array([0]), np.zeros((1, 2))), CHECKS[:1, -1])


def test_the_base_colour_of_a_glb_multiplies_its_texture_and_kd_of_an_obj_does_not(tmp_path):
    material = PBRMaterial(
        baseColorTexture=filled((200, 200, 200)), baseColorFactor=[0.5, 1.0, 0.2, 1.0]
    )
    square(material).export(tmp_path / "a.glb")
    colours = corner_colours(read_mesh(tmp_path / "a.glb"))
    np.testing.assert_allclose(colours, [[100, 200, 40]] * 2, atol=1)
    # Writers put anything there: trimesh a grey.
    mesh = read_mesh(saved(tmp_path / "a.obj"))
    np.testing.assert_array_equal(mesh.paint.textures[0].pixels, CHECKS)
    assert (mesh.paint.corners == 1.0).all()


def test_each_part_of_a_scene_has_its_texture_wherever_it_stands(tmp_path):
    scene = trimesh.Scene()
    red, green = (PBRMaterial(baseColorTexture=filled(c), name=str(c)) for c in (RED, GREEN))
    plain = trimesh.Trimesh(
        square(red).vertices, square(red).faces, process=False, face_colors=[*BLUE, 255]
    )

    def moved(x, scale=1.0):
        matrix = np.diag([scale, 1.0, 1.0, 1.0])
        matrix[0, 3] = x
        return matrix

    scene.add_geometry(square(red), geom_name="red", transform=moved(-3))
    scene.add_geometry(square(green), transform=moved(-1))
    scene.add_geometry(plain, transform=moved(1))
    scene.graph.update(frame_to="again", matrix=moved(3, -1.0), geometry="red")
    scene.export(tmp_path / "a.glb")
    camera = look_at(0.0, 0.0, 8.0, (80, 40), 80.0)
    image = render_view(RayScene(read_mesh(tmp_path / "a.glb")), camera).image
    pixels, _ = camera.project(np.array([[-3.0, 0.1, 0], [-1, 0.1, 0], [1, 0.1, 0], [3, 0.1, 0]]))
    for (u, v), expected in zip(np.rint(pixels).astype(int), (RED, GREEN, BLUE, RED), strict=True):
        assert image[v, u].argmax() == np.argmax(expected)
        assert np.sort(image[v, u])[:2].max() == 0


def test_materials_of_an_obj_have_their_textures_or_their_plain_colour(tmp_path):
    (tmp_path / "maps").mkdir()
    filled(RED).save(tmp_path / "maps" / "red.png")
    materials = "newmtl one\nmap_Kd maps\\red.png\nnewmtl two\nKd 0 1 0\n"
    mesh = read_mesh(
        parts(tmp_path, materials, "usemtl two\nf 2/1 3/2 4/3\nusemtl one\nf 1/1 2/2 3/3\n")
    )
    (texture,) = mesh.paint.textures
    assert texture.pixels[0, 0].tolist() == list(RED)
    assert mesh.vertices[mesh.faces[texture.faces]].max() == 1
    assert corner_colours(mesh).tolist() == [[0, 255, 0], list(RED)]


def test_options_of_a_texture_are_ignored(tmp_path):
    path, material = saved(tmp_path / "a.obj"), tmp_path / "material.mtl"
    material.write_text(material.read_text().replace("map_Kd ", "map_Kd -s 2 2 1 "))
    np.testing.assert_array_equal(read_mesh(path).paint.textures[0].pixels, CHECKS)


def test_grey_palette_and_transparent_textures_are_read_as_colours(tmp_path):
    saved(tmp_path / "a.obj")
    grey = np.array([[0, 90], [180, 255]], np.uint8)
    arrays = (
        Image.fromarray(grey).convert("P"),
        grey,
        np.dstack([grey] * 4),
        grey.astype(np.uint16) * 257,
    )
    for image in (arrays[0], *map(Image.fromarray, arrays[1:])):
        image.save(tmp_path / "material_0.png")
        np.testing.assert_array_equal(
            read_mesh(tmp_path / "a.obj").paint.textures[0].pixels, np.dstack([grey] * 3)
        )


def test_a_normalised_or_warped_mesh_keeps_its_texture_and_a_painted_one_does_not(tmp_path):
    mesh = read_mesh(saved(tmp_path / "a.glb"))
    mesh = Mesh(np.vstack([[9, 9, 9], mesh.vertices]), mesh.faces + 1, mesh.paint)
    textured, plain = (unlit(normalise(each)) for each in (mesh, replace(mesh, paint=None)))
    assert np.abs(textured - plain).max() > 50
    assert warp(normalise(mesh), np.random.default_rng(0)).paint is mesh.paint
    assert paint(mesh, np.random.default_rng(0)).paint.textures == ()


# Pictures that several materials name


def test_materials_of_different_colours_share_the_picture_of_a_glb(tmp_path):
    scene = trimesh.Scene()
    for tint in ([1.0, 0.5, 0.0, 1.0], [0.0, 0.5, 1.0, 1.0]):
        white = filled((200, 200, 200))
        scene.add_geometry(square(PBRMaterial(baseColorFactor=tint, baseColorTexture=white)))
    scene.export(tmp_path / "a.glb")
    mesh = read_mesh(tmp_path / "a.glb")
    first, second = mesh.paint.textures
    assert first.pixels is second.pixels
    colours = np.unique(corner_colours(mesh), axis=0)
    np.testing.assert_allclose(colours, [[0, 100, 200], [200, 100, 0]], atol=1)


def test_a_file_that_several_materials_of_an_obj_name_is_decoded_once(tmp_path):
    filled(RED).save(tmp_path / "red.png")
    materials = "newmtl one\nmap_Kd red.png\nnewmtl two\nmap_Kd ./red.png\n"
    path = parts(tmp_path, materials, "usemtl one\nf 1/1 2/1 3/1\nusemtl two\nf 2/1 3/1 4/1\n")
    first, second = read_mesh(path).paint.textures
    assert first.pixels is second.pixels


def glossy(folder, own):
    """A mesh whose material has a picture for specular and glossiness."""

    def change(header):
        stated = {"diffuseTexture": {"index": 0}, "diffuseFactor": [1.0, 0.5, 1.0, 1.0]}
        extensions = {"KHR_materials_pbrSpecularGlossiness": stated}
        header["materials"] = [{"extensions": extensions, **own}]

    return read_mesh(edited(saved(folder / "a.glb"), change))


def test_the_diffuse_picture_of_a_glossy_material_stands_for_its_base_colour(tmp_path):
    paint = glossy(tmp_path, {}).paint
    np.testing.assert_array_equal(paint.textures[0].pixels, CHECKS)
    np.testing.assert_allclose(paint.corners[0], [[1.0, 0.5, 1.0]] * 3)


def test_the_base_colour_of_a_glossy_material_comes_first_if_it_has_one(tmp_path):
    mesh = glossy(tmp_path, {"pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 1.0, 1.0]}})
    assert mesh.paint.textures == ()
    assert corner_colours(mesh)[0].tolist() == [0, 0, 255]


# Textures that cannot be used


def warned(path):
    """The mesh, and the one-line warning that reading it gives."""
    with pytest.warns(UserWarning, match="the material's colour is used") as caught:
        mesh = read_mesh(path)
    (message,) = [str(warning.message) for warning in caught]
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return mesh, message


PROGRAM = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n(x) run\n"
URIS = {
    "glb, missing": "wood.png",
    "glb, on the web": "http://localhost/wood.png",
    "glb, inline": "data:;base64,aGVsbG8=",
}
# What the warning says.
BROKEN = {
    "obj, missing": "the texture 'material_0.png' is not in this folder or below",
    "obj, no picture": "the texture 'material_0.png' cannot be decoded",
    "obj, a program": "the texture 'material_0.png' cannot be decoded",
    "obj, elsewhere": "the texture '../material_0.png' is not in this folder or below",
    "obj, without coordinates": "has no coordinates on the mesh",
    "glb, no picture": "the texture 'wood' cannot be decoded",
    "glb, missing": "the texture 'wood.png' is not in this folder",
    "glb, on the web": "the texture 'http://localhost/wood.png' is not in this folder",
    "glb, inline": "cannot be decoded",
}


def broken(kind, folder):
    """A mesh whose texture cannot be used."""
    path = saved(folder / ("a.obj" if kind.startswith("obj") else "a.glb"))
    if kind == "obj, missing":
        (folder / "material_0.png").unlink()
    elif kind in ("obj, no picture", "obj, a program"):
        (folder / "material_0.png").write_bytes(PROGRAM if "program" in kind else b"hello")
    elif kind == "obj, elsewhere":
        (folder / "inner").mkdir()
        material = (folder / "material.mtl").read_text()
        (folder / "inner" / "material.mtl").write_text(material.replace("map_Kd ", "map_Kd ../"))
        return path.rename(folder / "inner" / "a.obj")
    elif kind == "obj, without coordinates":
        text = re.sub(r"^vt.*\n", "", path.read_text(), flags=re.MULTILINE)
        path.write_text(re.sub(r"(\d)/\S*", r"\1", text))
    elif kind == "glb, no picture":
        # The first view holds indices.
        edited(path, lambda header: header["images"][0].update(bufferView=0, name="wood"))
    else:
        edited(path, lambda header: header.update(images=[{"uri": URIS[kind], "name": "wood"}]))
    return path


@pytest.mark.parametrize("kind", BROKEN)
def test_a_texture_that_cannot_be_used_gives_one_warning_and_the_colour_of_the_material(
    tmp_path, kind, monkeypatch
):
    def refuse(*_, **__):
        raise AssertionError("a connection was opened")

    path, programs = broken(kind, tmp_path), []
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *_, **__: programs.append("a program was run")
    )
    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    mesh, message = warned(path)
    assert BROKEN[kind] in message
    assert programs == []
    assert mesh.paint is None or mesh.paint.textures == ()
    if kind.startswith("obj"):
        assert np.abs(corner_colours(mesh).astype(int) - [90, 60, 30]).max() <= 1


def test_a_texture_beside_the_folder_of_the_mesh_is_read_where_the_folder_above_is_rendered(
    tmp_path,
):
    """As ShapeNetCore v2 has them: ID/models/model_normalized.obj, ID/images/texture0.png."""
    source, output = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    path = broken("obj, elsewhere", source)
    assert read_mesh(path, within=source).paint.textures
    assert not warned(path)[0].paint.textures
    assert render_folder(source, output, RenderSettings(views=1, size=(32, 32))).written == [
        "inner/a"
    ]
    colours = read_image(output / "inner" / "a" / "000.png")[..., :3]
    assert len(np.unique(colours.reshape(-1, 3), axis=0)) > 2
    assert np.ptp(colours.astype(int), axis=2).max() > 50


def test_a_link_out_of_the_folder_is_not_followed(tmp_path):
    path = broken("obj, elsewhere", tmp_path)
    (path.parent / "material_0.png").symlink_to(tmp_path / "material_0.png")
    assert "is not in this folder" in warned(path)[1]


def test_a_texture_beside_a_glb_is_read(tmp_path):
    path = broken("glb, missing", tmp_path)
    Image.fromarray(CHECKS).save(tmp_path / "wood.png")
    np.testing.assert_array_equal(read_mesh(path).paint.textures[0].pixels, CHECKS)


def test_several_textures_that_are_missing_are_counted_in_one_line(tmp_path):
    materials = "newmtl one\nmap_Kd 1.png\nnewmtl two\nmap_Kd 2.png\n"
    path = parts(tmp_path, materials, "usemtl one\nf 1/1 2/1 3/1\nusemtl two\nf 2/1 3/1 4/1\n")
    assert (
        "'1.png' is not in this folder or below, the material's colour is used (2 in all)"
        in warned(path)[1]
    )


@pytest.mark.filterwarnings("error")
def test_reading_without_textures_gives_no_warning_nor_does_evaluation(tmp_path, tso):
    path = broken("obj, missing", tmp_path)
    assert read_mesh(path, textures=False).paint is None
    assert tso("eval", path, path).code == 0


def test_a_missing_texture_is_warned_of_once_for_a_mesh_and_its_copies(tmp_path):
    (tmp_path / "in").mkdir()
    broken("obj, missing", tmp_path / "in")
    settings = RenderSettings(views=1, size=(16, 16), samples=60, points=20, copies=2)
    with pytest.warns(UserWarning, match="material_0.png") as caught:
        summary = render_folder(tmp_path / "in", tmp_path / "out", settings)
    assert summary.written == ["a", "a~0001", "a~0002"]
    assert len(caught) == 1
