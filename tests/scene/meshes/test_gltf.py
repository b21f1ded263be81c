"""glTF by what it means: a wall of 4 x 4 m at 10 m, said in each way that the format and its extensions have."""

import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.gltf import WALL, WALL_FACES, Gltf
from helpers.meshes import area_m2
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene import render
from lidarscene.errors import LidarSceneError, OptionWarning
from lidarscene.files.cache_folder import VARIABLE
from lidarscene.files.optional import is_installed
from lidarscene.rendering.import_report import import_report
from lidarscene.scene.meshes.reading import read_mesh

TURN = 0.5**0.5
"""Sine and cosine of half a right angle."""


def extent_m(path: Path) -> np.ndarray:
    """(2, 3) lowest and highest corner of all pieces, in the file's own axes."""
    corners = np.concatenate([piece.vertices_m[piece.faces.reshape(-1)] for piece in read_mesh(path)])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def assert_wall(path: Path) -> None:
    """One wall, where it is meant to be."""
    np.testing.assert_allclose(extent_m(path), [WALL.min(axis=0), WALL.max(axis=0)], atol=1e-4)
    assert sum(area_m2(piece.vertices_m, piece.faces) for piece in read_mesh(path)) == pytest.approx(16, rel=1e-4)


@pytest.mark.parametrize(
    "nodes",
    [
        [{"mesh": 0, "translation": [1, 2, 3], "rotation": [0, TURN, 0, TURN], "scale": [2, 3, -1]}],
        [{"mesh": 0, "matrix": [0, 0, -2, 0, 0, 1, 0, 0, 1, 0, 0, 0, 5, 6, 7, 1]}],
        [{"children": [1, 2], "rotation": [TURN, 0, 0, TURN]}, {"mesh": 0, "scale": [1, -2, 1]}, {"mesh": 0}],
    ],
)
@pytest.mark.parametrize("mode", [4, 5])
def test_nodes_and_strips_as_trimesh_reads_them(tmp_path: Path, nodes: list[dict[str, Any]], mode: int) -> None:
    file = Gltf()
    file.mesh(faces=WALL_FACES if mode == 4 else [0, 1, 3, 2], mode=mode)
    for node in nodes:
        file.add("nodes", **node)
    path = file.save(tmp_path / "a.glb")
    theirs = trimesh.load_scene(path).to_mesh()
    np.testing.assert_allclose(extent_m(path), theirs.bounds, atol=1e-5)
    assert sum(area_m2(piece.vertices_m, piece.faces) for piece in read_mesh(path)) == pytest.approx(theirs.area)


def test_fans_and_corners_without_indices(tmp_path: Path) -> None:
    file = Gltf()
    file.mesh(faces=None, mode=6)
    file.add("nodes", mesh=0)
    assert_wall(file.save(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    ("dtype", "normalized", "steps"), [("i2", False, 1000.0), ("u2", False, 1000.0), ("i2", True, 32767 / 12.5)]
)
def test_quantized_coordinates(tmp_path: Path, dtype: str, normalized: bool, steps: float) -> None:
    """Whole numbers, whose node scales them back; normalised ones are fractions of the largest."""
    shift = np.array([0, 2, 2]) if dtype == "u2" else np.zeros(3)
    file = Gltf()
    file.mesh(np.rint((WALL + shift) * steps), dtype=dtype, normalized=normalized)
    scale = 12.5 if normalized else 1 / steps
    file.add("nodes", mesh=0, scale=[scale] * 3, translation=(-shift).tolist())
    path = file.save(tmp_path / "a.glb", required=("KHR_mesh_quantization",))
    np.testing.assert_allclose(extent_m(path), [WALL.min(axis=0), WALL.max(axis=0)], atol=1e-3)


def test_instances_are_all_there(tmp_path: Path) -> None:
    """The second is turned by 90 degrees about y, so that it stands along x, scaled by two, and shifted."""
    file = Gltf()
    colours = file.numbers([[0.1] * 3, [0.2] * 3, [0.3] * 3, [0.4] * 3])
    file.mesh(WALL - [10, 0, 0], attributes={"COLOR_0": colours})
    rows = {
        "TRANSLATION": file.numbers([[10, 0, 0], [20, 0, 8]]),
        "ROTATION": file.numbers([[0, 0, 0, 1], [0, TURN, 0, TURN]]),
        "SCALE": file.numbers([[1, 1, 1], [2, 2, 2]]),
    }
    file.add("nodes", mesh=0, extensions={"EXT_mesh_gpu_instancing": {"attributes": rows}})
    path = file.save(tmp_path / "a.glb", required=("EXT_mesh_gpu_instancing",))
    (piece,) = read_mesh(path, "colour")
    np.testing.assert_allclose(piece.vertices_m[:4], WALL, atol=1e-5)
    np.testing.assert_allclose(np.ptp(piece.vertices_m[4:], axis=0), [8, 8, 0], atol=1e-5)
    np.testing.assert_allclose(piece.vertices_m[4:].mean(axis=0), [20, 0, 8], atol=1e-5)
    assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(16 + 64)
    assert piece.pattern is not None
    np.testing.assert_allclose(piece.pattern.values, [0.1, 0.2, 0.3, 0.4] * 2, rtol=1e-6)


def test_instances_of_unequal_attributes_are_refused(tmp_path: Path) -> None:
    file = Gltf()
    file.mesh()
    attributes = {"TRANSLATION": file.numbers(np.zeros((3, 3))), "SCALE": file.numbers(np.ones((2, 3)))}
    file.add("nodes", mesh=0, extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    with told("a.glb | EXT_mesh_gpu_instancing | rows | [2, 3]"):
        read_mesh(file.save(tmp_path / "a.glb"))


def test_an_image_that_is_not_there_is_named(tmp_path: Path) -> None:
    """Leaves are solid squares without it."""
    file = Gltf()
    texture = file.add("textures", source=file.add("images", uri="leaves%20of%20oak.png"))
    file.add("materials", alphaMode="MASK", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    file.mesh(material=0)
    file.add("nodes", mesh=0)
    path = file.save(tmp_path / "a.glb")
    with pytest.warns(OptionWarning, match=r"images that are not there, .*: leaves of oak.png"):
        report = import_report(path)
    assert report.left_out == ("image leaves of oak.png, which is not there",)


def test_an_image_that_cannot_be_decoded_is_named_once(tmp_path: Path) -> None:
    """Two materials share it. Its colours are left out, and the mesh is there."""
    file = Gltf()
    texture = file.add("textures", source=file.add("images", uri="data:image/png;base64,bm90IGEgcGljdHVyZQ=="))
    for number in range(2):
        file.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
        file.mesh(material=number)
        file.add("nodes", mesh=number)
    path = file.save(tmp_path / "a.glb")
    with pytest.warns(OptionWarning) as warned:
        assert read_mesh(path)
    expected = f"{path}: images[0] cannot be decoded; its colours and gaps are left out"
    assert [str(warning.message) for warning in warned] == [expected]


def test_joints_decide_where_a_skin_is(tmp_path: Path) -> None:
    """The mesh's node is 60 m behind. Two joints carry the wall: one its lower half, the other, a child of it, the
    upper half, 1 m higher. Each is bound where it has no effect but for its own shift.
    """
    file = Gltf()
    joints = file.numbers([[0, 1, 0, 0]] * 4, "u1")
    weights = file.numbers([[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]])
    file.mesh(WALL - [10, 0, 0], attributes={"JOINTS_0": joints, "WEIGHTS_0": weights})
    bound = np.stack([np.eye(4), np.eye(4)])
    bound[1, :3, 3] = [0, -2, 0]
    file.add("nodes", children=[1, 2])
    file.add("nodes", mesh=0, skin=0, translation=[-50, 0, 0])
    file.add("nodes", translation=[10, 0, 0], children=[3])
    file.add("nodes", translation=[0, 3, 0])
    file.add("skins", joints=[2, 3], inverseBindMatrices=file.numbers(bound.transpose(0, 2, 1)))
    (piece,) = read_mesh(file.save(tmp_path / "a.glb"))
    np.testing.assert_allclose(piece.vertices_m, WALL + np.array([[0, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 0]]))


def test_vertices_of_other_primitives_are_no_part_of_the_size(tmp_path: Path) -> None:
    """Two primitives share one list of vertices, a kilometre long: each has its own corners, image and gaps."""
    file = Gltf()
    far = WALL + np.array([0, 0, 1000])
    position = file.numbers(np.concatenate([far, WALL]))
    uv = file.numbers(np.arange(16).reshape(8, 2))
    masked = {"baseColorTexture": {"index": file.image(HALVES)}}
    file.add("materials", alphaMode="MASK", pbrMetallicRoughness=masked)
    corners = file.numbers(WALL_FACES + 4, "u2")
    attributes = {"POSITION": position, "TEXCOORD_0": uv}
    file.add("meshes", primitives=[{"attributes": attributes, "indices": corners, "material": 0}])
    file.add("nodes", mesh=0)
    path = file.save(tmp_path / "a.glb")
    assert_wall(path)
    assert import_report(path).size_m == pytest.approx((0, 4, 4))
    for pattern in (None, "colour"):
        [piece] = read_mesh(path, pattern)
        assert piece.cutout is not None
        np.testing.assert_array_equal(piece.cutout.uv, np.arange(8, 16).reshape(4, 2))
        assert pattern is None or (piece.pattern is not None and len(piece.pattern.uv) == len(piece.vertices_m) == 4)


def test_a_vertex_is_carried_by_the_mean_of_its_joints(tmp_path: Path) -> None:
    file = Gltf()
    weights = file.numbers([[64, 191, 0, 0]] * 4, "u1", normalized=True)
    file.skinned_wall(file.numbers([[0, 1, 0, 0]] * 4, "u2"), weights)
    (piece,) = read_mesh(file.save(tmp_path / "a.glb"))
    np.testing.assert_allclose(piece.vertices_m - WALL, [[64 / 255, 191 / 255, 0]] * 4, atol=1e-6)


def test_shapes_of_morph_targets_have_their_weights(tmp_path: Path) -> None:
    file = Gltf()
    targets = [{"POSITION": file.numbers(np.tile(shift, (4, 1)))} for shift in ([4, 0, 0], [0, 8, 0])]
    mesh = file.mesh(WALL - [1, 0, 0], targets=targets)
    file.content["meshes"][mesh]["weights"] = [0.25, 0.0]
    file.add("nodes", mesh=0)
    assert_wall(file.save(tmp_path / "a.glb"))


def test_what_is_hidden_is_not_there(tmp_path: Path) -> None:
    """What is below it neither: what is visible below something hidden is hidden too."""
    hidden, visible = ({"KHR_node_visibility": {"visible": seen}} for seen in (False, True))
    file = Gltf()
    file.mesh()
    file.content["scenes"] = [{"nodes": [0, 1]}]
    file.add("nodes", mesh=0, extensions=visible)
    file.add("nodes", mesh=0, extensions=hidden, translation=[5, 0, 0], children=[2])
    file.add("nodes", mesh=0, extensions=visible, translation=[50, 0, 0])
    assert_wall(file.save(tmp_path / "a.glb", required=("KHR_node_visibility",)))


HALVES = [[[255, 255, 255, 255], [0, 0, 0, 60]]]
"""An image that is there on its left and not on its right, by any cutoff above 60 of 255."""


def wall_of_halves(path: Path, **material: Any) -> Path:
    """A wall at 10 m with the image `HALVES`, its left side at z = -2, before a whole one twice as wide at 20 m."""
    file = Gltf()
    uv = file.numbers([[0, 1], [0, 0], [1, 0], [1, 1]])
    texture = {"baseColorTexture": {"index": file.image(HALVES)}, "baseColorFactor": [0.5, 0.5, 0.5, 1.0]}
    file.add("materials", name="leaves", pbrMetallicRoughness=texture, **material)
    file.add("materials", name="behind", pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1.0]})
    file.mesh(attributes={"TEXCOORD_0": uv}, material=0)
    file.mesh(WALL * [2, 2, 2], material=1)
    file.content["scenes"] = [{"nodes": [0, 1]}]
    file.add("nodes", mesh=0)
    file.add("nodes", mesh=1)
    return file.save(path)


ALONE = """
[sun]
illuminance_klux = 0
[sensor]
position_m = [0, 0, 0]
[[bodies]]
name = "wall"
mesh = "a.glb"
"""
RASTER = {"scanner.azimuth_step_deg": 0.5, "scanner.elevation_step_deg": 0.5, "scanner.elevation_fov_deg": 20}


@pytest.mark.parametrize(
    ("material", "keys", "near"),
    chosen(
        3,
        [
            ({"alphaMode": "MASK"}, "", (True, False)),
            ({"alphaMode": "MASK"}, 'material = "brick"\npattern = "colour"\n', (True, False)),
            ({"alphaMode": "MASK"}, "[bodies.motion]\nvelocity_m_s = [0, 0, 0.01]\n", (True, False)),
            ({"alphaMode": "MASK"}, 'materials = { leaves = "mirror_chrome" }\n', (None, None)),
            ({"alphaMode": "MASK", "alphaCutoff": 0.2}, "", (True, True)),
            ({"alphaMode": "OPAQUE"}, "", (True, True)),
        ],
    ),
)
def test_beams_go_through_what_a_mask_cuts_out(tmp_path, material, keys, near):
    """Where alpha is at least the cutoff, half of it without one, there is a wall, and elsewhere what is behind it.
    glTF's z = -2 is our y = 2, left of the sensor, where the image has its left side. A mirror has no gaps: nothing
    comes back from it.
    """
    wall_of_halves(tmp_path / "a.glb", **material)
    (tmp_path / "a.toml").write_text(ALONE + keys)
    cloud = render(tmp_path / "a.toml", overrides=RASTER)
    across, up = cloud["y"] / cloud["x"] * 10, cloud["z"] / cloud["x"] * 10
    inside = (np.abs(up) < 1.9) & (np.abs(across) > 0.1) & (np.abs(across) < 1.9)
    for is_near, side in zip(near, (across > 0, across < 0), strict=True):
        if is_near is None:
            assert (inside & side).sum() < 10
            continue
        assert (inside & side).sum() > 100
        np.testing.assert_allclose(cloud["x"][inside & side], 10.0 if is_near else 20.0, atol=0.5)


def test_what_a_mask_leaves_nothing_of_is_not_there(tmp_path: Path) -> None:
    file = Gltf()
    for alpha in (0.4, 0.6):
        factor = {"baseColorFactor": [0.5, 0.5, 0.5, alpha]}
        file.add("materials", pbrMetallicRoughness=factor, alphaMode="MASK")
    file.mesh(WALL * 2, material=0)
    file.mesh(material=1)
    file.content["scenes"] = [{"nodes": [0, 1]}]
    for mesh in range(2):
        file.add("nodes", mesh=mesh)
    assert_wall(file.save(tmp_path / "a.glb"))


def test_gaps_are_read_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cache has no images: a file with gaps must not come back from it solid."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    path = wall_of_halves(tmp_path / "a.glb", alphaMode="MASK")
    for _ in range(2):
        cutout = read_mesh(path)[0].cutout
        assert cutout is not None
        np.testing.assert_array_equal(cutout.solid, [[True, False]])


def test_an_image_is_where_its_transform_puts_it(tmp_path: Path) -> None:
    """The example of the extension's page: all of the wall shows the lower left quarter of the image, turned by 90
    degrees clockwise: its upper left corner is the quarter's lower left one, which is that of the image.
    """
    file = Gltf()
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5], "texCoord": 1}
    texture = {"index": file.image(HALVES), "extensions": {"KHR_texture_transform": transform}}
    file.add("materials", pbrMetallicRoughness={"baseColorTexture": texture})
    uv = {"TEXCOORD_0": file.numbers(np.zeros((4, 2))), "TEXCOORD_1": file.numbers([[0, 0], [1, 0], [1, 1], [0, 1]])}
    file.mesh(attributes=uv, material=0)
    file.add("nodes", mesh=0)
    (piece,) = read_mesh(file.save(tmp_path / "a.glb", required=("KHR_texture_transform",)), "colour")
    assert piece.pattern is not None
    assert piece.pattern.uv is not None
    np.testing.assert_allclose(piece.pattern.uv, [[0, 1], [0, 0.5], [0.5, 0.5], [0.5, 1]], atol=1e-6)


def test_a_grey_of_factor_image_and_vertices(tmp_path: Path) -> None:
    """The wall's colours are 0.2 at two corners and 0.6 at two, half of the image is white and half is black, and the
    factor is 0.5. Without any of them the wall has no colour.
    """
    file = Gltf()
    texture = {"index": file.image([[[255] * 3, [0] * 3]])}
    file.add("materials", pbrMetallicRoughness={"baseColorTexture": texture, "baseColorFactor": [0.5, 0.5, 0.5, 1]})
    colours = file.numbers([[0.2] * 3, [0.2] * 3, [0.6] * 3, [0.6] * 3])
    uv = file.numbers(np.zeros((4, 2)))
    for attributes, material in (
        ({"COLOR_0": colours}, {}),
        ({"TEXCOORD_0": uv}, {"material": 0}),
        ({"TEXCOORD_0": uv, "COLOR_0": colours}, {"material": 0}),
        ({}, {}),
    ):
        file.mesh(attributes=attributes, **material)
    file.content["scenes"] = [{"nodes": [0, 1, 2, 3]}]
    for mesh in range(4):
        file.add("nodes", mesh=mesh)
    greys = [piece.grey for piece in read_mesh(file.save(tmp_path / "a.glb"))]
    assert greys == [pytest.approx(0.4), pytest.approx(0.25), pytest.approx(0.1), None]


@pytest.mark.parametrize(
    ("extension", "named"),
    [
        ("EXT_nobody_knows", "export the file"),
        ("EXT_meshopt_compression", "`gltf-transform cp | a.glb | decoded.glb`"),
        ("KHR_texture_basisu", "`gltf-transform ktxdecompress | a.glb | decoded.glb`"),
    ],
)
def test_a_required_extension_is_honoured_or_refused_by_name(tmp_path: Path, extension: str, named: str) -> None:
    file = Gltf()
    file.mesh()
    file.add("nodes", mesh=0)
    with told(f"a.glb: | extensionsRequired | {extension} | {named}"):
        read_mesh(file.save(tmp_path / "a.glb", required=("KHR_mesh_quantization", extension)))


def test_an_optional_extension_is_a_warning_by_name(tmp_path: Path) -> None:
    """Each time, although the mesh itself comes from the cache."""
    file = Gltf()
    file.mesh()
    file.add("nodes", mesh=0)
    path = file.save(tmp_path / "a.glb", used=("KHR_mesh_quantization", "KHR_lights_punctual", "EXT_b"))
    for _ in range(2):
        with pytest.warns(OptionWarning, match=r"a\.glb: optional extensions that are left out: KHR_lights_.*, EXT_b$"):
            read_mesh(path)


def test_a_buffer_of_meshopt_is_named(tmp_path: Path) -> None:
    """Optional, but what it stands for is not there."""
    file = Gltf()
    file.mesh()
    file.add("nodes", mesh=0)
    for view in file.content["bufferViews"]:
        view |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0}}}
    file.content |= {"buffers": [{"byteLength": 4}] * 2, "extensionsUsed": ["EXT_meshopt_compression"]}
    (tmp_path / "a.gltf").write_text(json.dumps(file.content))
    with (
        pytest.warns(OptionWarning, match="EXT_meshopt_compression"),
        told("a.gltf | EXT_meshopt_compression | gltf-transform cp"),
    ):
        read_mesh(tmp_path / "a.gltf")


def draco_wall(path: Path, data: bytes) -> Path:
    """A wall that is there in Draco's bytes only, with the attribute POSITION of number 7."""
    file = Gltf()
    packed = {"bufferView": file.view(data), "attributes": {"POSITION": 7}}
    position = file.add("accessors", componentType=5126, count=4, type="VEC3")
    indices = file.add("accessors", componentType=5123, count=6, type="SCALAR")
    file.add(
        "meshes",
        primitives=[
            {
                "attributes": {"POSITION": position},
                "indices": indices,
                "extensions": {"KHR_draco_mesh_compression": packed},
            }
        ],
    )
    file.add("nodes", mesh=0)
    return file.save(path, required=("KHR_draco_mesh_compression",))


def stand_in() -> SimpleNamespace:
    """What DracoPy answers, by a file of numpy."""

    def decode(data: bytes) -> SimpleNamespace:
        with np.load(io.BytesIO(data)) as arrays:
            points, faces = arrays["points"], arrays["faces"]
        return SimpleNamespace(faces=faces, get_attribute_by_unique_id={7: {"data": points}}.__getitem__)

    return SimpleNamespace(decode=decode)


def test_draco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """DracoPy decodes it where it is installed, else by something that answers as it does."""
    if is_installed("DracoPy"):
        import DracoPy

        data = DracoPy.encode(
            WALL[[0, 0, 0, 0]],
            WALL_FACES.reshape(-1, 3),
            preserve_order=True,
            generic_attributes={7: WALL.astype("f4")},
        )
    else:
        buffer = io.BytesIO()
        np.savez(buffer, points=WALL, faces=WALL_FACES.reshape(-1, 3))
        data = buffer.getvalue()
        monkeypatch.setitem(sys.modules, "DracoPy", stand_in())
    assert_wall(draco_wall(tmp_path / "a.glb", data))


def test_draco_without_its_decoder_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with told("a.glb: | KHR_draco_mesh_compression | pip install DracoPy | gltf-transform cp", LidarSceneError):
        read_mesh(draco_wall(tmp_path / "a.glb", b"draco"))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"asset": {"version": "1.0"}}, "glTF 2 | 1.0"),
        ({"nodes": [{"mesh": 3}]}, "meshes | 1 | number 3"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "nodes | number 0"),
        ({"accessors": [{"componentType": 5126, "count": 1 << 40, "type": "VEC3"}] * 2}, "rows | bufferView"),
    ],
)
def test_what_is_no_gltf_is_one_line(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    file = Gltf()
    file.mesh()
    file.add("nodes", mesh=0)
    file.content |= change
    with told(f"a.glb | {named}"):
        read_mesh(file.save(tmp_path / "a.glb"))
