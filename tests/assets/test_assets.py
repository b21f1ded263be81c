"""The meshes and scenes that tools/scenes/ makes: the same bytes again, sound triangles, the geometry they promise."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.run_seed import chosen

from lidarscene import catalog
from lidarscene.scene.street.layout import EAVES_M

ROOT = Path(__file__).parents[2]
MESHES, SCENES = ROOT / "assets" / "meshes", ROOT / "scenes"
CATALOGUE = ROOT / "src" / "lidarscene" / "catalog" / "materials"

STATURES = {"pedestrian": 1.75, "man_tall": 1.86, "man_old": 1.72, "woman": 1.63, "woman_short": 1.54}
STATURES |= {"child_12": 1.50, "child_7": 1.22, "child_4": 1.03}
# Fewest and most triangles, size (x, y, z) in metres and how far it may be off.
EXPECTED = {
    "car": ((15_000, 30_000), (4.4, 2.1, 1.47), 0.06),
    **{name: ((2_000, 5_500), (0.18 * height, 0.34 * height, height), 0.06) for name, height in STATURES.items()},
    "man_rucksack": ((2_000, 5_500), (0.49, 0.56, 1.75), 0.02),
    "woman_bag": ((2_000, 5_500), (0.35, 0.57, 1.63), 0.02),
    "woman_old": ((2_000, 5_500), (0.34, 0.61, 1.57), 0.02),
    "woman_pram": ((2_000, 5_500), (0.31, 0.53, 1.72), 0.02),
    "pram": ((2_000, 5_500), (0.98, 0.60, 1.07), 0.01),
    "wheelchair_user": ((2_000, 5_500), (1.00, 0.69, 1.32), 0.01),
    "tree": ((8_000, 15_000), (4.9, 5.0, 6.5), 0.6),
    "conifer": ((4_000, 9_000), (4.8, 5.1, 10.5), 0.4),
    "poplar": ((4_000, 9_000), (2.1, 2.1, 11.0), 0.2),
    "birch": ((3_000, 9_000), (3.2, 3.2, 8.2), 0.2),
    "bush": ((1_000, 4_000), (1.6, 1.6, 1.5), 0.1),
    "juniper": ((2_000, 3_000), (0.7, 0.7, 1.9), 0.1),
    "hedge": ((2_000, 4_000), (0.7, 2.05, 1.35), 0.1),
    "house": ((3_000, 8_000), (10.6, 10.5, 13.0), 0.15),
    "house_terrace": ((1_000, 4_000), (9.9, 6.7, 9.7), 0.1),
    "house_villa": ((1_000, 6_000), (11.7, 12.9, 10.5), 0.1),
    "house_bungalow": ((1_000, 4_000), (9.9, 13.9, 6.0), 0.1),
    "house_gable": ((1_000, 4_000), (11.2, 9.2, 10.5), 0.1),
    "house_canal": ((1_000, 4_000), (11.7, 6.6, 16.5), 0.1),
    "house_mansard": ((4_000, 12_000), (12.6, 14.6, 17.5), 0.1),
    "house_shop": ((1_000, 4_000), (10.9, 9.5, 13.1), 0.1),
    "house_flats": ((4_000, 12_000), (12.3, 17.0, 13.8), 0.1),
    "house_tower": ((8_000, 18_000), (15.3, 18.0, 19.0), 0.1),
    "house_office": ((4_000, 12_000), (13.5, 20.1, 16.2), 0.1),
    "house_hall": ((1_000, 4_000), (16.5, 22.0, 6.7), 0.1),
    "house_garages": ((1_000, 4_000), (6.2, 12.0, 2.85), 0.1),
    "kerb": ((50, 500), (2.0, 0.15, 0.12), 0.002),
    "sign": ((200, 2_000), (0.08, 0.60, 2.88), 0.01),
    "sign_triangle": ((100, 500), (0.08, 0.90, 3.07), 0.01),
    "sign_yield": ((100, 500), (0.08, 0.90, 2.88), 0.01),
    "sign_stop": ((100, 500), (0.08, 0.90, 3.00), 0.01),
    "sign_square": ((100, 500), (0.08, 0.60, 2.88), 0.01),
    "sign_diamond": ((100, 500), (0.08, 0.85, 2.97), 0.01),
    "lamp_post": ((400, 2_000), (1.86, 0.32, 7.96), 0.02),
    "bollard": ((300, 1_000), (0.15, 0.15, 0.895), 0.005),
    "fence": ((100, 500), (0.09, 2.0, 1.10), 0.005),
    "dustbin": ((100, 500), (0.78, 0.58, 1.07), 0.005),
    "container": ((100, 500), (1.07, 1.37, 1.41), 0.005),
    "cone": ((200, 500), (0.31, 0.31, 0.75), 0.005),
    "barrier": ((50, 500), (0.80, 2.0, 1.175), 0.005),
    "cabinet": ((50, 500), (0.35, 1.0, 1.21), 0.005),
    "parking_meter": ((100, 500), (0.18, 0.20, 1.45), 0.005),
    "letter_box": ((50, 500), (0.53, 0.51, 1.27), 0.005),
    "gatepost": ((20, 500), (0.46, 0.46, 1.46), 0.005),
    "power_pole": ((100, 500), (0.29, 1.8, 8.52), 0.01),
    "traffic_light": ((400, 1_000), (0.50, 0.30, 3.27), 0.005),
    "guard_rail": ((50, 500), (0.145, 3.99, 0.75), 0.005),
}
NAMES = (*EXPECTED, *catalog.vehicles())
SAMPLES = ("hatchback_428", "pickup_533", "bus_1195", "articulated_1650", "motorcyclist_211", "cyclist_182")
SCENE_NAMES = sorted(path.stem for path in SCENES.glob("*.toml"))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with everything made afresh."""
    folder = tmp_path_factory.mktemp("made")
    for script in ("make_assets.py", "make_scenes.py"):
        command = [sys.executable, "-B", str(ROOT / "tools" / "scenes" / script), "--out", str(folder)]
        subprocess.run(command, check=True, capture_output=True, text=True)
    return folder


def parts_of(name):
    """Part name -> (points, faces) as the file has them."""
    scene = trimesh.load_scene(MESHES / f"{name}.glb", process=False)
    return {part: (np.asarray(g.vertices, float), np.asarray(g.faces)) for part, g in scene.geometry.items()}


def materials_of(name):
    """Names of the materials of a mesh's parts."""
    scene = trimesh.load_scene(MESHES / f"{name}.glb", process=False)
    return {geometry.visual.material.name for geometry in scene.geometry.values()}


def scene_of(name):
    return tomllib.loads((SCENES / f"{name}.toml").read_text(encoding="utf-8"))


def soup(name, *, panes=False):
    """(m, 3, 3) corners of all triangles of a mesh, with or without its panes, which are single surfaces."""
    parts = parts_of(name).items()
    return np.concatenate([points[faces] for part, (points, faces) in parts if panes or part != "glass"])


def first_hits(corners, origin, directions):
    """(range, cosine with the normal) of the first triangle that each ray meets; inf where none."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(u, v)
    found = []
    for start, way in zip(origin, directions, strict=True):
        across = np.cross(way, v)
        scale = np.einsum("ij,ij->i", u, across)
        scale = np.where(scale == 0, np.inf, scale)
        shift = start - a
        b1 = np.einsum("ij,ij->i", shift, across) / scale
        turned = np.cross(shift, u)
        b2 = turned @ way / scale
        t = np.einsum("ij,ij->i", v, turned) / scale
        t = np.where((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t > 1e-9), t, np.inf)
        i = int(np.argmin(t))
        found.append((t[i], normal[i] @ way / np.linalg.norm(normal[i])))
    return np.array(found).T


def test_the_list_here_is_the_list_on_disk():
    assert {path.stem for path in MESHES.glob("*")} == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_mesh_made_again_has_the_same_bytes(made, name):
    assert (made / f"{name}.glb").read_bytes() == (MESHES / f"{name}.glb").read_bytes()


@pytest.mark.parametrize("name", SCENE_NAMES)
def test_a_scene_made_again_has_the_same_bytes(made, name):
    assert (made / f"{name}.toml").read_bytes() == (SCENES / f"{name}.toml").read_bytes()


@pytest.mark.parametrize("name", EXPECTED)
def test_parts_triangles_and_size(name):
    (fewest, most), size_m, off_m = EXPECTED[name]
    parts = parts_of(name)
    assert materials_of(name) - {"paint"} == set(catalog.shipped_meshes()[name]["materials"])
    assert fewest <= sum(len(faces) for _, faces in parts.values()) <= most
    points = np.concatenate([points for points, _ in parts.values()])
    np.testing.assert_allclose(np.ptp(points, axis=0), size_m, atol=off_m)
    assert -0.05 < points[:, 2].min() < 0.01, "it should stand on z = 0"
    assert (MESHES / f"{name}.glb").stat().st_size < 1.5e6


@pytest.mark.parametrize("name", [name for name, mesh in catalog.shipped_meshes().items() if "plot_m" in mesh])
def test_a_house_is_in_its_plot(name):
    width_m, front_m, reach_m = catalog.shipped_meshes()[name]["plot_m"]
    points = np.concatenate([points for points, _ in parts_of(name).values()])
    assert np.ptp(points[:, 1]) == pytest.approx(width_m, abs=0.05)
    assert np.abs(points[:, 1]).max() <= 0.5 * width_m + 0.01
    assert front_m < points[:, 0].max() <= reach_m + 0.01
    assert points[:, 0].max() > reach_m - 0.1
    assert points[:, 0].min() >= -front_m - EAVES_M


@pytest.mark.parametrize("name", NAMES)
def test_materials_carry_the_names_of_their_parts(name):
    scene = trimesh.load_scene(MESHES / f"{name}.glb", process=False)
    for part, geometry in scene.geometry.items():
        # Mirrors of the car have three materials, cranks of bicycles that of other parts.
        assert geometry.visual.material.name == part or part.partition("_")[0] in ("mirrors", "cranks")
    assert set(scene.graph.nodes_geometry) == set(scene.geometry)
    for node in scene.graph.nodes_geometry:
        np.testing.assert_array_equal(scene.graph[node][0][:3, :3], [[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # y up
        np.testing.assert_array_equal(scene.graph[node][0][:, 3], [0, 0, 0, 1])


@pytest.mark.parametrize("name", chosen(40, NAMES))
def test_no_triangle_is_degenerate(name):
    for part, (points, faces) in parts_of(name).items():
        assert np.isfinite(points).all(), part
        corners = points[faces]
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.linalg.norm(area, axis=1).min() > 1e-8, part
        assert faces.min() >= 0, part
        assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces), f"{part}: a triangle twice"


@pytest.mark.parametrize(
    ("name", "share"),
    [("car", 0.02), ("pedestrian", 0.01), ("kerb", 0.0), ("sign", 0.02), *((name, 0.02) for name in SAMPLES)],
)
def test_surfaces_look_outwards(name, share):
    """A ray from around and above first hits a front face; one part wound the wrong way fails this."""
    corners = soup(name, panes=name in SAMPLES)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    i = np.arange(220)
    share_of = np.stack([(0.5 + i * g) % 1 for g in (0.8191725, 0.6710436, 0.5497005)], axis=1)
    height, turn = 0.9 * ((i * 0.7548777) % 1), 2 * np.pi * ((i * 0.5698403) % 1)
    flat = np.sqrt(1 - height**2)
    around = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    origin = (low + high) / 2 + 3 * np.linalg.norm(high - low) * around
    ways = low + (high - low) * share_of - origin
    range_m, cosine = first_hits(corners, origin, ways / np.linalg.norm(ways, axis=1, keepdims=True))
    hit = np.isfinite(range_m)
    assert hit.sum() > 25
    assert np.mean(cosine[hit] > 0) <= share


def test_the_car_is_closed_from_below_and_its_glass_can_be_seen_through():
    corners = soup("car")
    x, y = np.meshgrid(np.linspace(-1.9, 1.9, 9), np.linspace(-0.45, 0.45, 4))
    origin = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)], axis=1)
    range_m, _ = first_hits(corners, origin, np.broadcast_to([0.0, 0.0, 1.0], origin.shape))
    assert range_m.max() < 1.45, "something below 0.45 m over every point of the underside"
    window = np.array([[-0.6, 3.0, 1.15]])
    range_m, _ = first_hits(corners, window, np.array([[0.0, -1.0, 0.0]]))
    assert range_m[0] > 2.6, "the side window is an opening in the paint"


@pytest.mark.parametrize("name", SCENE_NAMES)
def test_scenes_name_only_what_there_is(name):
    scene = scene_of(name)
    known = {path.stem for path in CATALOGUE.glob("*.toml")} | set(scene.get("materials", {}))
    assert scene["name"] == name
    bodies = scene.get("bodies", [])
    assert bodies or "street" in scene
    names = [body["name"] for body in bodies]
    assert len(set(names)) == len(names)
    for body in bodies:
        used = set(body.get("materials", {}).values())
        used |= {body["material"]} if "material" in body else set()
        assert used <= known, body["name"]
        assert ("mesh" in body) != ("primitive" in body), body["name"]
        if "mesh" in body:
            assert set(body["materials"]) == materials_of(Path(body["mesh"]).stem), body["name"]


def test_the_street_has_200k_triangles_and_cars_of_four_colours():
    total, paints = 0, set()
    for body in scene_of("street")["bodies"]:
        if "mesh" in body:
            faces = sum(len(faces) for _, faces in parts_of(Path(body["mesh"]).stem).values())
            total += faces * len(body["instances"])
            paints |= {body["materials"]["paint"]} if "paint" in body["materials"] else set()
    assert total >= 200_000
    assert len(paints) >= 4


# ---- the range scene: Table 1's conditions, to the last digit ----


def test_range_conditions_are_those_of_table_1():
    scene = scene_of("range")
    assert scene["sun"]["illuminance_klux"] == 100
    assert scene["sky"]["diffuse_share"] == 0
    assert scene["air"] == {"transmittance": 0.98}


def test_the_source_package_has_what_the_tests_read() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packed = project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert {"/assets", "/scenes", "/src", "/tests", "/docs", "/tools", "/benchmarks", "/Makefile"} <= set(packed)
