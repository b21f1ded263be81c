"""`lidarscene compare`: everything it promises is there, and what it refuses."""

import csv
import dataclasses
import html
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from helpers.command_line import BEAMS, COARSE, WALL, Run
from helpers.drawn_street import street
from helpers.in_this_process import draw_nothing, draw_roughly
from PIL import Image

from lidarscene import PointCloud, load_sensor
from lidarscene.cli import main
from lidarscene.cloud.shades import rgb
from lidarscene.studies.compare import comparison_files
from lidarscene.studies.compare.comparison_study import aliasing_notes

PAIR = ("--sensors", "table1-apd,table1-sipm")
WEAK = (*COARSE, "--set=laser.peak_power_w=0.05")
SWEPT = ("--illuminance-klux", "0.1,100")
CHARTS = ("rate-range", "rate-incidence", "rate-reflectivity", "rate-class", "error-range", "snr-table1-sipm")
CLOUDS = (
    "cloud-table1-apd.png", "cloud-table1-sipm.png", "difference-table1-sipm.ply", "difference-table1-sipm.png",
)  # fmt: skip
FROM_CLOUDS = [
    *("index.html", "compare.json", "rate-body.csv", "pairs-table1-sipm.csv"),
    *(f"{chart}.{suffix}" for chart in CHARTS for suffix in ("png", "csv")),
    *CLOUDS,
]
NAMES = [*FROM_CLOUDS, "illuminance.png", "illuminance.csv", "table1-apd.ply", "table1-sipm.ply"]


@pytest.fixture(scope="module")
def folder(mi, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command run once; `test_clouds_from_files` draws the charts whole, tests/figures the pictures."""
    base = tmp_path_factory.mktemp("compare")
    (base / "wall.toml").write_text(WALL.replace('"wall"', '"wall"\nclass = "building"', 1))
    output_folder = base / "new" / "out"
    argv = ["compare", str(base / "wall.toml"), *PAIR, "-o", str(output_folder), *WEAK, *SWEPT]
    with pytest.MonkeyPatch.context() as patch:
        draw_roughly(patch)
        assert main.main(argv) == 0
    return output_folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_all_files_are_there_and_nothing_else(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)


def test_the_verdicts_come_first(folder: Path) -> None:
    """The ranges on equal terms, then one sentence on who finds more; the numbers are those of the JSON."""
    numbers = json.loads((folder / "compare.json").read_text("utf-8"))
    page = (folder / "index.html").read_text("utf-8")
    *terms, first = (html.unescape(text) for text in re.findall(r"<p>(.*?)</p>", page)[:5])
    assert terms == numbers["equal_terms"]
    lead = terms[0]
    assert lead.startswith("On equal terms")
    assert first == numbers["verdict"]
    shares = {sensor["name"]: sensor["rate"]["rate"] for sensor in numbers["sensors"]}
    # Both find all of this wall: `test_verdict_by_hand` has one that finds more.
    assert f"within chance: table1-apd {100.0 * shares['table1-apd']:.2f} %" in first
    assert f", table1-sipm {100.0 * shares['table1-sipm']:.2f} %. " in first
    assert "Ranges scatter least with" in first


def test_figures_stand_in_two_columns_and_no_row_is_empty(folder: Path) -> None:
    page = (folder / "index.html").read_text("utf-8")
    assert re.search(r'<div class="row">(<figure>.*?</figure>){4}</div>', page, re.DOTALL)
    for row in re.findall(r"<tr>(<td>.*?)</tr>", page, re.DOTALL):
        cells = re.findall(r"<td>(.*?)</td>", row)
        assert set(cells[1:]) - {"-", "0", ""}, cells


def test_both_clouds_have_one_scale(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rationale: the same colour means the same SNR in both pictures."""
    scales = []
    monkeypatch.setattr(
        comparison_files.plots,
        "perspective_picture",
        lambda *_, colours, **more: scales.append((more["colour_by"], colours.limits)),
    )
    weak, strong = (street(step_deg=4.0) for _ in range(2))
    strong = dataclasses.replace(strong, snr=10.0 * strong.snr)
    observed = [SimpleNamespace(cloud=cloud, name=name) for cloud, name in ((weak, "a"), (strong, "b"))]
    comparison = SimpleNamespace(observations=observed, against_first=list, matched=False)
    page = SimpleNamespace(add_pictures=lambda pictures: [draw(tmp_path) for *_, draw in pictures])
    comparison_files._add_clouds(page, comparison, None, ["a", "b"])
    assert [name for name, _ in scales] == ["snr", "snr"]
    assert scales[0] == scales[1]
    assert scales[0][1] == pytest.approx(np.percentile(np.concatenate([weak.snr, strong.snr]), (1, 99)))


def test_page_needs_no_other_file(folder: Path) -> None:
    page = (folder / "index.html").read_text("utf-8")
    sources = re.findall(r'(?:src|href)="([^"]{1,40})', page)
    pictures = [name for name in NAMES if name.endswith(".png")]
    tables = [name for name in NAMES if name.endswith(".csv") and name.replace(".csv", ".png") in pictures]
    assert len(sources) == len(pictures) + len(tables)
    assert all(source.startswith(("data:image/png;base64,", "data:text/csv;base64,")) for source in sources)
    assert "http" not in re.sub(r'"data:[^"]*"', "", page)
    assert "fire the same pulses" in page


def test_numbers_agree(folder: Path) -> None:
    """JSON, CSV and clouds are of the same run."""
    numbers = json.loads((folder / "compare.json").read_text("utf-8"))
    (pair,) = numbers["pairs"]
    for sensor in numbers["sensors"]:
        name = sensor["name"]
        cloud = PointCloud.load(folder / f"{name}.ply")
        assert (sensor["pulses"], sensor["points"]) == (BEAMS, len(cloud))
        assert sensor["rate"]["found"] == np.count_nonzero(cloud.status == 0)
        for key in ("range", "incidence", "reflectivity", "class", "body"):
            rows_of_sensor = [row for row in rows(folder / f"rate-{key}.csv") if row["sensor"] == name]
            assert sum(int(row["found"]) for row in rows_of_sensor) == sensor["rate"]["found"], key
            assert all(
                float(row["rate_low"]) <= float(row["rate"]) <= float(row["rate_high"]) for row in rows_of_sensor
            )
        assert sum(sensor["lost"].values()) == sensor["rate"]["surfaces"] - sensor["rate"]["found"]
    counts_found = [sensor["rate"]["found"] for sensor in numbers["sensors"]]
    assert [pair["both"] + pair["only_a"], pair["both"] + pair["only_b"]] == counts_found
    (row_of_all,) = [row for row in rows(folder / "pairs-table1-sipm.csv") if row["by"] == "all"]
    assert [int(row_of_all[key]) for key in ("both", "only_a", "only_b", "neither")] == [
        pair[key] for key in ("both", "only_a", "only_b", "neither")
    ]
    assert {row["illuminance_klux"] for row in rows(folder / "illuminance.csv")} == {"0.1", "100"}


def test_difference_cloud_opens_elsewhere(folder: Path) -> None:
    """Read by trimesh, with the column that says who found a point, and colours."""
    (pair,) = json.loads((folder / "compare.json").read_text("utf-8"))["pairs"]
    cloud = trimesh.load(folder / "difference-table1-sipm.ply")
    kinds = cloud.metadata["_ply_raw"]["vertex"]["data"]["difference"]
    assert np.bincount(kinds.ravel(), minlength=3).tolist() == [pair["both"], pair["only_a"], pair["only_b"]]
    expected = np.array([rgb(colour) for colour in comparison_files.COLOURS])
    assert np.array_equal(cloud.colors[:, :3], expected[kinds.ravel()])
    with Image.open(folder / "difference-table1-sipm.png") as picture:
        drawn = {colour for _, colour in picture.convert("RGB").getcolors(picture.width * picture.height)}
    assert {tuple(colour) for colour in expected[np.unique(kinds)].tolist()} <= drawn
    header = (folder / "difference-table1-sipm.ply").read_bytes().split(b"end_header")[0].decode("ascii")
    assert "comment difference 1 only_a" in header
    assert "A is table1-apd, B is table1-sipm" in header


def test_the_same_again_and_as_json(folder: Path, run: Run, rough_charts: None, tmp_path: Path) -> None:
    scene = folder.parents[1] / "wall.toml"
    printed = run.well("compare", str(scene), *PAIR, "-o", "again", *WEAK, *SWEPT, "--json", "--chunk", "50")
    files = [str(Path("again") / name) for name in NAMES]
    numbers = json.loads(printed)
    assert sorted(numbers.pop("files")) == sorted(files)
    assert numbers == json.loads((folder / "compare.json").read_text("utf-8"))
    for name in NAMES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_clouds_from_files(folder: Path, run: Run, small_pictures: None, tmp_path: Path) -> None:
    files = [str(folder / f"{name}.ply") for name in ("table1-apd", "table1-sipm")]
    printed = run.well("compare", *files, "-o", "out", "--json")
    numbers, before = json.loads(printed), json.loads((folder / "compare.json").read_text("utf-8"))
    for key in ("both", "only_a", "only_b"):
        assert numbers["pairs"][0][key] == before["pairs"][0][key]
    assert numbers["sensors"][0]["rate"]["expected"] is None
    assert numbers["rates_are_shares_of"] == "the pulses with which any of the clouds has an echo"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(FROM_CLOUDS)


def test_clouds_are_not_written_over(folder: Path, run: Run, tmp_path: Path) -> None:
    names = ("a.ply", "difference-b.ply", "b.ply")
    for name in names:
        (tmp_path / name).write_bytes((folder / "table1-apd.ply").read_bytes())
    ran = run("compare", *names, "-o", ".")
    assert ran.code == 2
    assert "must not overwrite an input, got difference-b.ply" in ran.err
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


def test_other_scanners_are_not_matched(folder: Path, run: Run, no_charts: None, tmp_path: Path) -> None:
    scene = str(folder.parents[1] / "wall.toml")
    steps = (f"--set=table1-{kind}:scanner.azimuth_step_deg=4" for kind in ("apd", "sipm"))
    sensors = ("--sensors", "table1-apd,vlp-16,table1-sipm", *steps)  # the first and the last are alike
    run.well("compare", scene, *sensors, "-o", "own")
    numbers = json.loads((tmp_path / "own" / "compare.json").read_text("utf-8"))
    assert (numbers["matched"], numbers["pairs"]) == (False, [])
    assert numbers["sensors"][0]["pulses"] != numbers["sensors"][1]["pulses"]
    assert "same-beams option" in (tmp_path / "own" / "index.html").read_text("utf-8")
    run.well("compare", str(tmp_path / "own" / "table1-apd.ply"), str(tmp_path / "own" / "vlp-16.ply"), "-o", "files")
    assert "share no pulses" in (tmp_path / "files" / "index.html").read_text("utf-8")
    run.well("compare", scene, *sensors, "-o", "same", "--same-beams")
    numbers = json.loads((tmp_path / "same" / "compare.json").read_text("utf-8"))
    assert numbers["matched"]
    assert numbers["sensors"][0]["pulses"] == numbers["sensors"][1]["pulses"]


def test_echoes_from_beyond_the_unambiguous_range_are_said() -> None:
    """Two of the echoes have the status; seven pulses in 1.8 us are unambiguous to 38.5 m."""
    names = ("os1-128", "table1-apd")
    sensors = [load_sensor("os1-128", overrides=["histogram.multiplier=7"]), load_sensor("table1-apd")]
    observed = [
        SimpleNamespace(name=name, cloud=SimpleNamespace(status=np.array(status)))
        for name, status in zip(names, ([0, 4, 1, 4], [0, 0, 1, 0]), strict=True)
    ]
    line = "os1-128: 2 echoes from beyond 38.5 m are reported too near by that range, status 4"
    assert aliasing_notes(observed, sensors) == (line,)


def test_nothing_found_at_all(
    mi, run: Run, rough_charts: None, wall: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sensors that see nothing are compared without a word of NaN."""
    run.well("compare", wall, *PAIR, "-o", "out", *COARSE, "--set=laser.peak_power_w=1e-6")
    numbers = json.loads((tmp_path / "out" / "compare.json").read_text("utf-8"))
    assert numbers["sensors"][0]["rate"]["found"] == 0
    draw_nothing(monkeypatch)  # of no surface: the charts are as empty
    run.well("compare", wall, *PAIR, "-o", "away", *COARSE, "--pose", "0,0,0,180")
    numbers = json.loads((tmp_path / "away" / "compare.json").read_text("utf-8"))
    assert numbers["sensors"][0]["rate"]["surfaces"] == 0
