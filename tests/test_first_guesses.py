"""What people try first: it works, or one line names the call that does it."""

import ast
import contextlib
import dataclasses
import inspect
import pickle
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.clouds import small_cloud
from helpers.mistakes import told
from helpers.sources import parse

import lidarscene
from lidarscene import Material, PointCloud, Rig, Scene, Sensor
from lidarscene.catalog import files
from lidarscene.files.arguments import FOREIGN_KEYWORDS
from lidarscene.formats.registry import OTHER_SUFFIXES
from lidarscene.maths.attributes import HintedAttributes

APD = lidarscene.load_sensor("apd-905")
NAMES: dict[str, Any] = {
    "lidarscene": lidarscene,
    "cloud": small_cloud(),
    "scene": lidarscene.load_scene("range"),
    "sensor": APD,
    "report": lidarscene.max_range(APD),
    "box": (np.eye(3), np.array([[0, 1, 2]])),
    "mesh": trimesh.creation.box(),
    "np": np,
}

ANSWERS = {
    "lidarscene.list_sensors()": "did you mean sensors[?]",
    "lidarscene.detection_range('apd-905')": "max_range",
    "lidarscene.render('range', yaw=30)": r"angles go in pose=\(x, y, z, yaw, pitch, roll\)",
    "lidarscene.budgt": "did you mean budget[?]",
    "lidarscene.Scene('empty')": "no scene 'empty' in the catalogue; it has car, ",
    "lidarscene.Material('gold')": "no material 'gold' in the catalogue; it has asphalt",
    "lidarscene.max_range('apd-905', 'sipm-905')": r"several go in one list: sensors=\['apd-905', 'sipm-905'\]",
    "lidarscene.compare('apd-905', 'sipm-905')": r"compare\('car', \['apd-905', ...\]\)",
    "lidarscene.load_sensor('apd-905', 'detector.gain=3')": r"at most 1 without a name \(sensor\), got 2",
    "lidarscene.Simulator('range', 'apd-905', device='cpu')": "LIDARSCENE_VARIANT=llvm_ad_mono",
    "lidarscene.fov('apd-905', gpu=1)": "LIDARSCENE_VARIANT=llvm_ad_mono",
    "cloud.boxes('range', class_='car')": 'b.class_name == "car"',
    "lidarscene.Pose(position_m=(1, 2))": r"Pose.position_m must have shape \(3,\), got \(2,\)",
    "lidarscene.render('range', ['apd-905', 'sipm-905'])": "record takes a Rig of several",
    "lidarscene.render('range', rig='rig')": r"record\(scene, Rig\(file\)",
    "scene.add('pedestrian', yaw=90)": r"pose=\(x, y, z, yaw",
    "scene.add(*box, 'brick')": r"are one tuple: \(vertices, faces\)",
    "setattr(sensor.laser, 'peak_power_w', 50)": r"Laser.peak_power_w cannot be set; sensor.replace\(",
    "setattr(scene.bodies[0], 'pose', None)": r"Body.pose cannot be set; scene.replace\({\"bodies.car.position_m",
    "setattr(scene.plot(), 'x', 3)": "Picture.x cannot be set$",
    "setattr(lidarscene.Simulator('range', 'apd-905'), 'sensor', sensor)": r"cannot be set; Simulator\(scene, sensor",
    "setattr(lidarscene.LiveSimulator('range', 'apd-905'), 'scene', scene)": r"scene cannot be set; live.place\(",
    "cloud.range_image(columns=3)": "known here: none",
    "cloud.save('a.png')": r"cloud.plot\(\).save",
    "sensor.laser.replace(peak_power_w=50)": r"sensor.replace\(",
    "lidarscene.max_range('apd-905', wavelength=905)": 'overrides={"laser.wavelength_nm": ...}',
    "lidarscene.render('range', weather='fog')": "weather.fog_visibility_km",
    "lidarscene.render('range', sun_elevation=10)": 'scene_overrides={"sun.elevation_deg": ...}',
    "lidarscene.render('range', start_time=1)": "begin_s=1.0",
    "lidarscene.Simulator('range', 'apd-905', seed=1)": r"simulator.render\(seed=1\)",
    "lidarscene.Simulator('range', 'apd-905', sun=1)": r"scene.replace\({\"sun.illuminance_klux\"",
    "lidarscene.batch(scenes=['car'], seeds=[1])": r"lidarscene.batch\('job', 'out'\)",
    "lidarscene.Simulator.render(None, frame=3)": "number=N",
    "lidarscene.Sensor.load('apd-905')": r"Sensor\(\"apd-905\"\) reads a name or a file",
    "lidarscene.Sensor(name='mine')": r"Sensor\(\): laser is missing; Sensor\(",
    "lidarscene.Material(reflectivity=20)": "from 0 to 1, got 20",
    "lidarscene.render(mesh, 'apd-905')": r"load_scene\(mesh, material='brick'\)",
    "scene['board']": r"Scene has no \[...\]; scene.bodies\[",
    "list(scene)": "'Scene' object is not iterable",
    "lidarscene.render('range', 'apd-905', overrides=scene)": "^overrides: must be .*, got .Scene",
    "sensor.detector.pde": "quantum_efficiency of an APD",
    "lidarscene.Pose(0, 0, 1.8)": r"by name, got 3 without; Pose.from_degrees\(position_m=",
    "lidarscene.Pose(position=(0, 0, 1.8))": "did you mean position_m[?]",
    "lidarscene.Body(name='a', material='brick')": r"unknown option 'material'; scene.add\(",
    "scene.sky.nothing": "Sky has no 'nothing'; known here: diffuse_share",
    "scene.add('car', velocity=(10, 0, 0))": "LiveSimulator",
    "lidarscene.nothing_like_it": r"dir\(lidarscene\) lists the names",
    "sensor.replace(laser__peak_power_w=50)": r"^apd-905 changes .* did you mean laser.peak_power_w[?]$",
    "sensor.laser.peak_power": "peak_power_w",
    "scene.add('pedestrain')": "did you mean pedestrian",
    "scene.add(box)": "'brick'",
    "sensor.tdc.threshold": "threshold_to_noise",
    "cloud.select('class', 'car')": "at most 1 without a name .*, got 2; the others go by name: class_=",
    "lidarscene.load_sensor('apd-905', gain=60)": "overrides=",
    "lidarscene.fov('vlp-16', range=3)": "unknown option 'range'; known here",
    "report['range']": r"did you mean range_m[?] must be one of name, range_m",
    "cloud.plot(color_by='range')": "colour_by",
    "cloud.plot(save='a.png')": r"plot\(\).save\('a.png'\)",
    "cloud.select(range=(0, 20))": r"cloud\[\(cloud.range > 5\)",
    "cloud.save('a.csv')": "to_csv",
    # A longer name, by its part.
    "cloud.to_ros2": r'cloud.save\("a.mcap"\)',
    "cloud.get_points": "cloud.points",
}


@pytest.mark.parametrize("guess", ANSWERS)
def test_a_guess_is_answered_in_one_line(guess: str) -> None:
    with pytest.raises((lidarscene.InputError, AttributeError, TypeError, ValueError), match=ANSWERS[guess]) as caught:
        eval(guess, dict(NAMES))
    assert "\n" not in str(caught.value)


WHOLE_COMMANDS = {
    "files/open3d.py": " --force-reinstall",
    "studies/paper/study.py": "--aperture-law",
    "studies/twin/twin_files.py": " --rays ",
    "studies/recorded.py": "as for --set",  # of a file of the package, that no user writes
}
"""Texts with names of the command line's options that are right outside of `cli`: commands from their first word."""


def test_messages_have_the_command_lines_names_of_options_only_there() -> None:
    """Rationale: an `OptionError` has a name of an option for either; no type tells a text that has the latter.

    A name alone, without a sentence, is an option's own, or an argument of another program.
    """
    package, found = Path(lidarscene.__file__).parent, {}
    for file in package.rglob("*.py"):
        code = file.read_text("utf-8")
        if not re.search(r"--[a-z]", code):
            continue
        name, nodes = file.relative_to(package).as_posix(), list(ast.walk(parse(code)))
        documented = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        texts = [part.value for part in nodes if isinstance(part, ast.Constant) and id(part) not in documented]
        named = [text for text in texts if " " in str(text) and re.search(r"(^|[\s(])--[a-z]", str(text))]
        if named and not name.startswith("cli/"):
            found[name] = " ".join(named)
    assert found.keys() == WHOLE_COMMANDS.keys()
    assert all(WHOLE_COMMANDS[name] in text for name, text in found.items())


def test_columns_have_the_names_of_keywords() -> None:
    np.testing.assert_array_equal(NAMES["cloud"].class_, NAMES["cloud"]["class"])


OWNERS = (
    "lidarscene|dataclasses|numpy|cloud|scene|sensor|report|body|pose|rig|mounted|material|picture|column|viewed|"
    "simulator|live"
)


def _tables_of_hints() -> dict[str, Mapping[str, str]]:
    """Texts of all hints: of each class whose objects have any, of the package, of keywords, suffixes and changes."""
    kinds = [HintedAttributes]
    for kind in kinds:
        kinds += kind.__subclasses__()
    changed = {kind.__name__: f"{kind.CHANGED_BY} {kind.MADE_BY}" for kind in kinds}
    keywords = {key: " ".join(words.values()) for key, words in FOREIGN_KEYWORDS.items()}
    tables = {kind.__qualname__: kind.FOREIGN_NAMES for kind in kinds if kind.__module__.startswith("lidarscene")}
    return {
        **tables,
        "package": lidarscene._FOREIGN_NAMES,
        "suffixes": OTHER_SUFFIXES,
        "changes": changed,
        "": keywords,
    }


def _expressions_in(text: str) -> Iterator[str]:
    """Code in a text: from the name of an owner on, as far as it is an expression."""
    for found in re.finditer(rf"(?<![\w.])({OWNERS})\.", text):
        code = re.split(" (?:is|are|has|of|in|and) ", text[found.start() :])[0]
        while code:
            with contextlib.suppress(SyntaxError):
                ast.parse(code, mode="eval")
                yield code.strip()
                break
            code = code[:-1]


def test_what_a_hint_names_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: no tool reads the code in texts."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    NAMES["scene"].add("car", position=(8, 3, 0)).save("car.toml")
    scene, rig = Scene("car.toml"), Rig("rig")
    sensor = APD.replace({"scanner.azimuth_step_deg": 2})
    cloud = lidarscene.render(scene, sensor).select(status="echo")  # false alarms have no true range
    cloud.save("a.ply")
    NAMES["mesh"].export("mesh.ply")
    names = {word: getattr(lidarscene, word) for word in lidarscene.__all__} | NAMES
    names |= {
        **{"scene": scene, "sensor": sensor, "cloud": cloud, "body": scene.bodies["car"], "pose": scene.sensor_pose},
        **{"rig": rig, "mounted": rig.sensors[0], "material": Material("brick"), "column": cloud.columns[0]},
        **{"picture": scene.plot(), "viewed": cloud.view(), "simulator": lidarscene.Simulator(scene, sensor)},
        **{"live": lidarscene.LiveSimulator(scene, sensor, movable=["car"], spares={"car": 1})},
        **{"dataclasses": dataclasses, "numpy": np, "points_m": np.zeros((1, 3)), "path": "b.ply", "folder": "out"},
        **{"N": 1, "file": "mesh.ply", "name": "car", "mesh": trimesh.creation.box()},
    }
    codes = {code for table in _tables_of_hints().values() for text in table.values() for code in _expressions_in(text)}
    assert len(codes) > 100
    for code in sorted(codes):
        # Data sets take a minute, and run in the tests of the documentation.
        if "..." not in code and "lidarscene.batch(" not in code:
            with contextlib.suppress(ImportError):  # a table format of pandas
                eval(code, dict(names))


def test_a_name_that_people_try_is_answered_by_its_hint() -> None:
    rig, scene, cloud = Rig("rig"), NAMES["scene"], NAMES["cloud"]
    owners = [cloud, scene, APD, rig, Material("brick"), NAMES["report"], scene.plot(), cloud.view()]
    owners += [scene.bodies[0], scene.sensor_pose, rig.sensors[0], cloud.columns[0]]
    for owner, hints in [(lidarscene, lidarscene._FOREIGN_NAMES), *((owner, owner.FOREIGN_NAMES) for owner in owners)]:
        for word, text in hints.items():
            if not word.startswith("_") and f"lidarscene.{word}" not in sys.modules:  # operators, and what is there
                with pytest.raises(AttributeError, match=f"'{word}'; {re.escape(text)}"):
                    getattr(owner, word)


def test_a_name_makes_a_sensor_a_scene_a_rig_a_material_and_a_cloud(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Sensor("apd-905").detector == APD.detector
    assert Sensor("apd-905", overrides="detector.gain=60").detector.gain == 60
    assert pickle.loads(pickle.dumps(Sensor("apd-905"))).replace(gain=60).detector.gain == 60
    assert [body.name for body in Scene("range").bodies] == [body.name for body in NAMES["scene"].bodies]
    assert Material("brick").bsdf == "diffuse"
    assert [mounted.label for mounted in Rig("rig").sensors] == [m.label for m in lidarscene.load_rig("rig").sensors]
    NAMES["cloud"].save("a.npz")
    np.testing.assert_array_equal(PointCloud("a.npz").xyz_m, NAMES["cloud"].xyz_m)
    with told("sensor 'apd' | apd-905"):
        Sensor("apd")


def test_a_reflectivity_makes_a_material() -> None:
    grey = Material(reflectivity=0.2)
    assert grey.at(905e-9) == {
        "name": "reflectivity 0.2",
        "bsdf": "diffuse",
        "wavelength_m": 905e-9,
        "reflectivity": 0.2,
    }
    scene = Scene().add(NAMES["mesh"], grey)
    assert scene.materials == {"reflectivity 0.2": grey}
    assert (
        len(scene.add(NAMES["mesh"], Material(reflectivity=0.2)).add(NAMES["mesh"], Material("brick")).materials) == 2
    )
    with pytest.raises(lidarscene.InputError, match="the scene has another of this name"):
        scene.add(NAMES["mesh"], Material(name="reflectivity 0.2", reflectivity=0.3))
    box = trimesh.creation.box()
    two = trimesh.Scene([box, box])
    choices = {
        name: Material(name="paint", reflectivity=value) for name, value in zip(two.geometry, (0.1, 0.8), strict=True)
    }
    with pytest.raises(lidarscene.InputError, match="the scene has another of this name"):
        lidarscene.load_scene(two, materials=choices)
    brick, mine = Material("brick"), Material(reflectivity=Material("brick").reflectivity)
    assert mine.at(905e-9)["reflectivity"] == brick.at(905e-9)["reflectivity"]
    assert mine.at(1550e-9)["reflectivity"] == brick.at(1550e-9)["reflectivity"] != brick.at(905e-9)["reflectivity"]
    assert Material(reflectivity=1 / 3).name != Material(reflectivity=0.333333).name


def test_an_object_with_hints_is_what_its_operators_say() -> None:
    assert not isinstance(NAMES["scene"], Iterable)
    assert not isinstance(APD, Iterable)
    assert not callable(lidarscene.Simulator.__new__(lidarscene.Simulator))


def test_a_sensor_has_its_range() -> None:
    assert NAMES["report"]["range_m"] == NAMES["report"].table["range_m"]
    assert APD.max_range(reflectivity=0.3).table == lidarscene.max_range("apd-905", reflectivity=0.3).table


def test_meshes_of_the_package_go_into_a_scene_by_their_names() -> None:
    scene = Scene().add("hatchback_395", "car_paint_red", position=(20, 0, 0)).add("pedestrian")
    car, person = scene.bodies
    materials = {part.name: part.material for part in car.parts}
    assert (car.name, car.class_name) == ("hatchback_395", "car")
    assert (person.name, person.class_name) == ("pedestrian", "pedestrian")
    assert materials["paint"] == "car_paint_red", "open in the catalogue"
    assert materials["tyre"] == "tyre_rubber", "the catalogue's"
    assert len(repr(car)) < 120, "a body is a line, not all of its triangles"


def test_packages_are_called_as_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import lidarscene.materials
    import lidarscene.view

    monkeypatch.chdir(tmp_path)
    assert "brick" in lidarscene.materials()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or len(opened) > 1)
    with pytest.warns(UserWarning, match=r"no browser here; the page is .*view\.html"):
        lidarscene.view(NAMES["cloud"])
    NAMES["cloud"].save("a.ply")
    lidarscene.view("a.ply")
    assert len(opened) == 2
    with told("scene 'sreet' | street"):
        lidarscene.view("sreet")
    assert [*inspect.signature(lidarscene.batch).parameters][:2] == ["job", "output"]
    assert pickle.loads(pickle.dumps(lidarscene.batch)) is lidarscene.batch


def test_a_package_is_callable_however_it_was_imported(run_python: Any) -> None:
    """Rationale: a package becomes an attribute of its parent by its first import, from anywhere."""
    (process := run_python("import lidarscene; print(lidarscene.materials()[0]); lidarscene.batch('jo', 'out')"))
    assert process.stdout.startswith("asphalt")
    assert "InputError: jo: no such file" in process.stderr
    (process := run_python("import lidarscene.batch as _, lidarscene; lidarscene.batch('jo', 'out')"))
    assert "InputError: jo: no such file" in process.stderr
    (process := run_python("import lidarscene.catalog as _, lidarscene; lidarscene.catalog()"))
    assert r"lidarscene.catalog is no function; sensors(), scenes()" in process.stderr


def test_a_check_lists_mistakes_and_doubts(tmp_path: Path) -> None:
    assert lidarscene.check("range") == lidarscene.check(APD) == []
    assert lidarscene.check(Rig("rig")) == lidarscene.check(Material("brick")) == []
    (recording,) = lidarscene.check("os0-32")
    assert "os0-32.pcap: must be a file that describes something" in recording
    (drop,) = lidarscene.check(APD.replace("tdc.bandwidth_mhz=1"))
    mounted = Rig("rig").sensors[0]
    doubtful = dataclasses.replace(mounted, sensor=APD.replace("tdc.bandwidth_mhz=1"))
    assert lidarscene.check(dataclasses.replace(Rig("rig"), sensors=(doubtful,))) == [drop]
    bright = NAMES["scene"].replace(sun={"illuminance_klux": 5000})
    assert [doubt.partition(" and")[0] for doubt in lidarscene.check(bright)] == ["sun.illuminance_klux is 5000,"]
    sensor = tmp_path / "slow.toml"
    sensor.write_text(files("sensors")["apd-905"].read_text().replace("peak_power_w", "peak_power"))
    (mistake,) = [line for line in lidarscene.check(sensor) if "unknown" in line]
    assert "did you mean laser.peak_power_w" in mistake


def test_a_check_reads_what_a_job_names(tmp_path: Path) -> None:
    job = tmp_path / "job.toml"
    job.write_text('scenes = ["none.toml"]\nframes = 1\n')
    (mistake,) = lidarscene.check(job)
    assert "none.toml" in mistake
    assert lidarscene.check("job") == []


def test_warnings_of_other_packages_are_no_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    def warn_of_age(_: Any) -> None:
        warnings.warn("old", DeprecationWarning, stacklevel=2)

    monkeypatch.setattr("lidarscene.checking.file_check._warn_of_content", warn_of_age)
    with pytest.warns(DeprecationWarning, match="old"):
        assert lidarscene.check(APD) == []


def test_a_street_is_a_scene_and_takes_numbers_of_numpy(tmp_path: Path) -> None:
    file = tmp_path / "street.toml"
    few = "house_share = [0, 0]\nparked_share = [0, 0]\nshown_m = 50\nwalking_spacing_m = [90, 99]\n"
    file.write_text(f"[street]\nseed = 5\nlanes = 1\nwet = true\nlength_m = 80\n{few}")
    keys = {"lanes": np.int64(1), "wet": np.bool_(True), "length_m": np.float32(80), "shown_m": 50}
    keys |= dict.fromkeys(("house_share", "parked_share"), np.zeros(2)) | {"walking_spacing_m": np.array([90, 99])}
    assert repr(lidarscene.street(np.int64(5), **keys).bodies) == repr(Scene(file).bodies)
    with told("town | from 3 to 12 | 99"):
        lidarscene.street(town=np.int64(99))
    with told("corners | cannot be combined with town"):
        lidarscene.street(town=4, corners="junctions")
    with pytest.raises(lidarscene.InputError, match="did you mean length_m"):
        lidarscene.street(lenght_m=80)
    with pytest.raises(lidarscene.InputError, match="osm and town: must be only one of them"):
        lidarscene.street(osm="map.osm", town=3)
    with pytest.raises(lidarscene.InputError, match="town: must be a whole number from 3 to 12, got 99"):
        lidarscene.street(town=99)
