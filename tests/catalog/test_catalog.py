"""Names of the catalogue as people type them."""

from pathlib import Path

import pytest
from helpers.mistakes import refused, told

from lidarscene import InputError, catalog, load_sensor
from lidarscene.cli.main import main
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.scene.scene_file import scene_path


@pytest.mark.parametrize(
    ("kind", "typed", "entry"),
    [
        ("sensors", "VLP16", "vlp-16"),
        ("sensors", "vlp_16", "vlp-16"),
        ("sensors", "Table1-APD", "table1-apd"),
        ("sensors", "OS1 128", "os1-128"),
        ("materials", "Car-Paint-Black", "car_paint_black"),
        ("scenes", "Street", "street"),
        ("imus", "BMI088", "bmi088"),
        ("examples", "OS0_32", "os0-32.pcap"),
        ("meshes", "Lamp-Post", "lamp_post.glb"),
    ],
)
def test_case_and_separators_do_not_matter(kind: str, typed: str, entry: str) -> None:
    assert catalog.path_of(kind, typed) == catalog.folder(kind) / (entry if "." in entry else f"{entry}.toml")


def test_a_file_here_comes_before_the_example_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert catalog.file_or_example("rig") == catalog.path_of("examples", "rig")
    assert catalog.file_or_example("job", tmp_path) == catalog.path_of("examples", "job")
    for path in ("rig.toml", "nothing", tmp_path / "rig"):
        assert catalog.file_or_example(path) == Path(path)
    (tmp_path / "rig").touch()
    assert catalog.file_or_example("rig") == Path("rig")


@pytest.mark.parametrize("kind", catalog.KINDS)
def test_a_folder_here_hides_no_entry_of_its_name(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in catalog.names(kind):
        (tmp_path / name).mkdir(exist_ok=True)
        assert catalog.path_of(kind, name) == catalog.files(kind)[name]
        assert kind != "examples" or catalog.file_or_example(name) == catalog.files(kind)[name]
        assert kind != "scenes" or scene_path(name) == catalog.files(kind)[name]
    (tmp_path / "folder").mkdir()
    with told(f"folder | {catalog.singular(kind)}"):
        catalog.path_of(kind, "folder")


@pytest.mark.parametrize("kind", catalog.KINDS)
def test_no_two_entries_differ_in_case_and_separators_alone(kind: str) -> None:
    """Else the spelling of one would open the other."""
    spelled = [name.lower().replace("-", "").replace("_", "") for name in catalog.names(kind)]
    assert len(set(spelled)) == len(spelled) > 0


test_an_unknown_name_lists_what_fits = refused(
    catalog.path_of,
    ("sensors", "velodyne", "hdl-32e or hdl-64e or vlp-16 or vlp-32c or vls-128?"),
    (
        "sensors",
        "Ouster",
        "os0-128 or os0-128-rev7 or os1-128 or os1-128-rev7 or os2-128 or os2-128-rev7 or osdome-128?",
    ),
    ("sensors", "OS1-64", "os1-128 or os1-128-rev7?"),
    ("sensors", "VLP-64C", "vlp-16 or vlp-32c?"),
    ("sensors", "table1", "table1-apd or table1-sipm?"),
    ("sensors", "Car", "car | a scene"),
    ("sensors", "VLP16,OS1-128", "spaces"),
    ("materials", "aluminium", "brushed_aluminium or mirror_aluminium?"),
    ("materials", "xyzzy", "asphalt"),
    ("materials", "../sensors/vlp-16", "asphalt"),
)


def test_without_the_folder_of_scenes_a_line_says_where_it_was_searched(monkeypatch, tmp_path):
    monkeypatch.setattr(catalog, "folder", lambda kind: tmp_path / kind)
    for name in ("street", "ab"):
        with told(f"scene {name!r} | {tmp_path / 'scenes'}"):
            catalog.path_of("scenes", name)


def test_a_sensor_has_its_name_however_it_was_typed() -> None:
    assert load_sensor("VLP16").name == load_sensor("vlp-16").name == "vlp-16"


def test_an_example_is_a_sensor_by_its_name() -> None:
    for typed in ("my-apd", "MY_APD"):
        assert catalog.sensor_path(typed) == catalog.path_of("examples", "my-apd")
        assert load_sensor(typed).name == "my-apd"
    for other in ("rig", "os0-32"):
        with told(f"sensor {other!r} | example"):
            load_sensor(other)


@pytest.mark.parametrize(("kind", "name"), [("examples", "my-apd"), ("sensors", "vlp-16")])
def test_a_file_that_is_not_there_yet_is_one_command_away(kind, name, tmp_path, monkeypatch, capsys):
    """The line of the message, as typed, makes the file that was asked for."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        load_sensor(f"{name}.toml")
    missing, _, rest = str(caught.value).partition("; lidarscene ")
    assert missing == f"{name}.toml: no such file"
    words, _, target = rest.removesuffix(" makes it").partition(" > ")
    assert main(words.split()) == 0
    Path(target).write_text(capsys.readouterr().out, encoding="utf-8")
    assert load_sensor(f"{name}.toml").name == name
    with told("nothing.toml | no such file"):
        load_sensor("nothing.toml")


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_steps_of_ranges_are_whole_millimetres(name: str) -> None:
    """Makers count in 1 to 5 mm, or 2.5. Steps of 26.7 ps are a millimetre beside those of 4 mm at 2 m."""
    step_mm = 0.5e3 * SPEED_OF_LIGHT_M_S * float(load_sensor(name).tdc.least_significant_bit_s)
    assert step_mm == pytest.approx(round(2.0 * step_mm) / 2.0, rel=1e-5)
