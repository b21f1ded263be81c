"""The page in a real browser: what it draws, what a click shows, what the controls do."""

import base64
import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chromium import Chromium
from helpers.recordings import FIRINGS, pcap, turns
from helpers.served import open_saved, served
from helpers.small_scene import COARSE
from matplotlib import colormaps, image

import lidarscene
from lidarscene import PointCloud, Pose, load_scene, load_sensor
from lidarscene.cli.main import main
from lidarscene.cloud.pixels import camera_for
from lidarscene.rendering.stages import ambient_of
from lidarscene.studies.budget import budget_of

SETS = [f"--set={option}" for option in COARSE]
WIDTH, HEIGHT = 1280, 800


@pytest.fixture(scope="module")
def cloud(mi: Any, scene_file: Path) -> PointCloud:
    return lidarscene.render(scene_file, "table1-apd", overrides=COARSE)


@pytest.fixture(scope="module")
def saved_page(cloud: PointCloud, scene_file: Path) -> Path:
    """The page of the cloud over its scene."""
    folder = scene_file.parent
    cloud.save(folder / "a.ply")
    assert main(["view", str(folder / "a.ply"), str(scene_file), *SETS, "--save", str(folder / "page.html")]) == 0
    return folder / "page.html"


@pytest.fixture(scope="module")
def live(mi: Any, scene_file: Path) -> Iterator[str]:
    """The address of the scene served: each page that is opened there begins with the files' own settings."""
    with served(scene_file, *SETS) as view:
        yield view.url


def pixel_places(browser: Chromium) -> np.ndarray:
    """(n, 3) column and row in the window, and depth, of every point, as the page projects them."""
    script = """(() => {
        const { frame, renderer, matrix, canvas } = viewer, box = canvas.getBoundingClientRect();
        return Array.from({ length: frame.count }, (_, i) => {
            const [x, y, depth] = renderer.project(matrix, ...frame.arrays.xyz.subarray(3 * i, 3 * i + 3));
            return [x + box.left, y + box.top, depth];
        });
    })()"""
    return np.array(browser.value(script))


def screenshot(browser: Chromium, folder: Path) -> np.ndarray:
    """The window as (height, width, 3), 0 to 1, after the next picture is drawn."""
    browser.value("new Promise(done => { viewer.draw(); requestAnimationFrame(() => requestAnimationFrame(done)); })")
    path = folder / "shown.png"
    browser.screenshot(path)
    return np.asarray(image.imread(BytesIO(path.read_bytes()))[:, :, :3])


def leave_points_alone(browser: Chromium) -> None:
    """Hide meshes and panel, and draw points of 4 pixels."""
    browser.value("byId('opacity').value = 0, byId('right').style.display = 'none', byId('size').value = 4")


def point_card(browser: Chromium) -> dict[str, str]:
    """The table of a point: text by what stands before it."""
    rows = browser.value("""[...document.querySelectorAll('#card tr')].filter(row => row.cells.length > 1)
        .map(row => [row.cells[0].firstChild.textContent, row.cells[1].textContent])""")
    return dict(rows)


def number(text: str) -> float:
    """What '1.5 µA' says, in the unit without its prefix."""
    parts = re.fullmatch(r"(-?[\d.e+-]+)(?:\u202f([fpnµmk]?)(?:W|A|s|m|°|cells)?)?", text)
    assert parts, text
    prefix = parts[2] if parts[2] != "m" or text[-1] in "WAs" else ""
    scale = dict(zip("fpnµmk", (1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1e3), strict=True)).get(prefix or "", 1.0)
    return float(parts[1]) * scale


def test_a_saved_page_needs_nothing_else(browser: Chromium, saved_page: Path) -> None:
    """Rationale: opened from a file, the page asks for itself and nothing more, and complains of nothing."""
    assert not re.search(r"(src|href)=\"(?!data:)", saved_page.read_text(encoding="utf-8"))
    browser.open(saved_page.as_uri())
    assert browser.value("document.getElementById('error').textContent") == ""
    messages = [text for text in browser.messages if "GPU stall" not in text]  # the screenshot's own cost
    assert messages == [f"request {saved_page.as_uri()}"[:88]]


def test_points_stand_where_they_should_in_their_colours(browser, saved_page, scene_file, cloud, tmp_path):
    """Rationale: the page's projection against that of `pixels`, and the colour under each point against
    matplotlib's map. Tolerances: a hundredth of a pixel, float32; 6 of 255: 17 stops miss the map by 5 at most.
    """
    browser.open(saved_page.as_uri())
    view = load_scene(scene_file).camera
    assert view is not None
    camera = camera_for(cloud, eye_m=view.eye_m, target_m=view.target_m, fov_deg=view.fov_deg)
    left, top, width, height = browser.box("viewer.canvas")
    column, row, depth = camera.project(cloud.xyz_m, width=int(width), height=int(height))
    page = pixel_places(browser)
    np.testing.assert_allclose(page, np.stack([column + left, row + top, depth], axis=1), atol=0.01)

    leave_points_alone(browser)
    picture = screenshot(browser, tmp_path)
    low, high = browser.value("[viewer.legend.low, viewer.legend.high]")
    part = np.clip(np.log(cloud.intensity / low) / np.log(high / low), 0, 1)
    expected = colormaps["inferno"](0.3 + 0.7 * np.floor(part * 255) / 255)[:, :3]
    drawn = 0
    for i in np.flatnonzero(cloud.status == 0):
        x, y = np.rint(page[i, :2] - 0.5).astype(int)
        is_near = np.hypot(*(page[:, :2] - page[i, :2]).T) < 16
        if is_near.sum() == 1 and left + 8 < x < left + width - 8 and 8 < y < height - 8:
            np.testing.assert_allclose(picture[y, x], expected[i], atol=6 / 255)
            drawn += 1
    assert drawn > 50


def test_a_click_shows_the_budget(browser: Chromium, saved_page: Path, cloud: PointCloud, scene_file: Path) -> None:
    """Rationale: the table on the page against `budget_of` and the cloud's own columns, to its four digits."""
    sensor, scene = load_sensor("table1-apd", overrides=COARSE), load_scene(scene_file)
    budget = budget_of(cloud, sensor, ambient_of(scene, sensor))
    browser.open(saved_page.as_uri())
    page = pixel_places(browser)
    i = int(np.flatnonzero((cloud.body == 0) & (cloud.status == 0))[20])
    browser.click(page[i, 0], page[i, 1])
    assert browser.value("viewer.selected") == i
    table = point_card(browser)
    assert table["body"] == "wall"
    assert table["class"] == "building"
    assert table["material"] == "concrete"
    assert table["status"] == "echo"
    for label, value in {
        "range": cloud.range_m[i],
        "true range": cloud.true_range_m[i],
        "x": cloud.xyz_m[i, 0],
        "incidence angle": np.degrees(cloud.incidence_angle_rad[i]),
        "reflectivity": cloud.reflectivity[i],
        "echo power": budget.echo_power_w[i],
        "lambertian power": budget.lambertian_power_w[i],
        "background power": budget.background_power_w[i],
        "threshold": budget.threshold[i],
        "peak signal": budget.signal[i],
        "signal": 0.0,
        "noise": budget.noise[i],
        "SNR": cloud.snr[i],
        "detection probability": cloud.detection_probability[i],
        "intensity": cloud.intensity[i],
    }.items():
        assert number(table[label]) == pytest.approx(value, rel=6e-4, abs=6e-5 * (" range" in label)), label
    assert "not Lambertian" not in browser.value("document.getElementById('card').textContent")
    browser.click(300, 70)  # nothing there, below the buttons
    assert browser.value("document.getElementById('card').hidden")


def test_a_phone_shows_the_budget_below_the_picture(browser: Chromium, saved_page: Path) -> None:
    """Rationale: a narrow page has no room beside the point, and its budget shall not hide the point."""
    browser.resize(390, 844)
    try:
        browser.open(saved_page.as_uri())
        browser.value("viewer.select(0)")
        card, picture = browser.value(
            "['#card', 'main'].map(s => (({top, bottom, width}) => [top, bottom, width])"
            "(document.querySelector(s).getBoundingClientRect()))"
        )
        assert card == [pytest.approx(picture[1], abs=1), 844, 390]
        assert picture[2] == browser.value("document.documentElement.scrollWidth") == 390
        buttons, frames = browser.value(
            "document.getElementById('frames').hidden = false, ['places', 'frames'].map(name => "
            "(({top, bottom}) => [top, bottom])(document.getElementById(name).getBoundingClientRect()))"
        )
        assert buttons[1] <= frames[0]
    finally:
        browser.resize(WIDTH, HEIGHT)


def test_what_is_hidden_is_not_there(browser: Chromium, saved_page: Path, cloud: PointCloud, tmp_path: Path) -> None:
    """The status filter and a click on a kind in the legend: out of the picture, and not to be picked."""
    browser.open(saved_page.as_uri())
    leave_points_alone(browser)
    page = pixel_places(browser)
    i = int(np.flatnonzero((cloud.body == 0) & (cloud.status == 0))[20])
    x, y = (int(v) for v in page[i, :2])
    empty = np.array([11, 14, 20]) / 255
    assert np.abs(screenshot(browser, tmp_path)[y, x] - empty).max() > 0.1
    browser.value("document.querySelector('#statuses input').click()")
    np.testing.assert_allclose(screenshot(browser, tmp_path)[y, x], empty, atol=2 / 255)
    browser.click(x, y)
    assert browser.value("viewer.selected") == -1
    browser.value("document.querySelector('#statuses input').click()")
    browser.enter("#field", "class")
    kinds = browser.value("[...document.querySelectorAll('.kinds button')].map(row => row.textContent)")
    counts = {name: int((cloud.class_id == k).sum()) for k, name in enumerate(cloud.class_names)}
    assert sorted(kinds) == sorted(f"{name}{count}" for name, count in counts.items() if count)
    assert np.abs(screenshot(browser, tmp_path)[y, x] - empty).max() > 0.1
    browser.value(
        "[...document.querySelectorAll('.kinds button')].find(row => /building/.test(row.textContent)).click()"
    )
    np.testing.assert_allclose(screenshot(browser, tmp_path)[y, x], empty, atol=2 / 255)


def test_frames_and_their_slider(browser: Chromium, mi: Any, scene_file: Path, tmp_path: Path) -> None:
    """A folder of clouds, in the order of the numbers in their names."""
    folder = tmp_path / "frames"
    counts = []
    for number_, x in ((2, 0.0), (10, 3.0), (0, -4.0)):
        cloud = lidarscene.render(scene_file, overrides=COARSE, pose=Pose(position_m=np.array([x, 0, 0])))
        cloud.save(folder / f"frame_{number_}.ply")
        counts.append((number_, len(cloud)))
    open_saved(browser, tmp_path, folder)
    assert browser.value("document.getElementById('meshes').hidden")
    for place, (number_, count) in enumerate(sorted(counts)):
        browser.enter("#frame", place, event="input")
        browser.until(f"viewer.frame.name === 'frame_{number_}.ply'")
        assert browser.value("viewer.frame.count") == count
    assert browser.value("document.getElementById('frame-name').textContent").startswith("3 / 3")


def test_a_recording_that_begins_with_an_empty_frame(browser: Chromium, library: Any, tmp_path: Path) -> None:
    """Rationale: the page found no range to colour by. Its scale comes from the first frame with points, at 10 m."""
    library("velodyne_decoder")
    lost = {(laser, firing) for laser in range(16) for firing in range(75 * FIRINGS)}
    open_saved(browser, tmp_path, pcap(tmp_path / "a.pcap", turns(150, missing=lost)))
    assert browser.value("viewer.frame.count") == 0
    assert browser.value("viewer.colourBy") == "range"
    browser.enter("#frame", 1, event="input")
    browser.until("viewer.frame.count > 0 && viewer.legend.values.length > 0")
    assert browser.value("viewer.legend.low") == pytest.approx(10.0, abs=0.1)


def test_live_controls_render_in_place(browser: Chromium, live: str, scene_file: Path) -> None:
    """A slider moved on the page gives the points of `render` with the same --set; the clicked pulse stays."""
    browser.open(live)
    page = pixel_places(browser)
    i = browser.value("viewer.frame.arrays.body.indexOf(0) + 20")
    browser.click(page[i, 0], page[i, 1])
    before = point_card(browser)
    browser.enter('#controls input[type=number][aria-label="laser power"]', 20)
    browser.until("!viewer.busy")
    cloud = lidarscene.render(scene_file, "table1-apd", overrides=[*COARSE, "laser.peak_power_w=20.0"])
    assert browser.value("viewer.frame.count") == len(cloud)
    assert browser.value("[...viewer.frame.arrays.snr]") == pytest.approx(cloud.snr.tolist(), rel=1e-6)
    after = point_card(browser)
    assert after["time"] == before["time"]
    assert number(after["echo power"]) == pytest.approx(number(before["echo power"]) * 20 / 45, rel=1e-3)

    browser.enter("#choice-detector", 1, of="selectedIndex")
    browser.until("!viewer.busy && viewer.frame.controls.some(one => one.key === 'detector.pde')")
    assert browser.value("document.querySelector('#legend div').textContent") == "intensity [cells]"
    labels = browser.value("[...document.querySelectorAll('.control > div')].map(one => one.firstChild.textContent)")
    assert "PDE" in labels
    assert "gain" not in labels
    sipm = ("laser.peak_power_w=20.0",)
    cloud = lidarscene.render(scene_file, "table1-sipm", overrides=[*COARSE, *sipm])
    assert browser.value("viewer.frame.count") == len(cloud)

    browser.value("viewer.settings['detector.pde'] = 2, viewer.render(), 0")
    browser.until("!document.getElementById('note-detector.pde').hidden")
    assert "must be" in browser.value("document.getElementById('note-detector.pde').textContent")
    browser.value("viewer.settings['detector.eye'] = 2, viewer.render(), 0")
    browser.until("!document.getElementById('error').hidden")
    assert "detector.eye" in browser.value("document.getElementById('error').textContent")


def test_the_camera_turns_and_comes_back(browser: Chromium, saved_page: Path) -> None:
    browser.open(saved_page.as_uri())
    before = pixel_places(browser)
    browser.drag((800, 400), (900, 450))
    browser.until("!viewer.drawn")
    assert np.abs(pixel_places(browser) - before).max() > 10
    browser.value("dispatchEvent(new KeyboardEvent('keydown', { key: 'r' }))")
    browser.until("!viewer.drawn")
    np.testing.assert_allclose(pixel_places(browser), before, atol=0.05)


def test_places_of_the_camera(browser: Chromium, saved_page: Path, cloud: PointCloud) -> None:
    """The eye at the sensor is the sensor's; from above, beside and in the fit nearly all points are in the window."""
    browser.open(saved_page.as_uri())
    browser.value("document.getElementById('go-sensor').click()")
    np.testing.assert_allclose(browser.value("viewer.camera.eye"), cloud.sensor_position_m, atol=1e-4)
    left, top, width, height = browser.box("viewer.canvas")
    for place, axis in (("top", 2), ("side", 1), ("fit", None)):
        browser.value(f"document.getElementById('go-{place}').click(), viewer.draw()")
        x, y, depth = pixel_places(browser).T
        inside = (depth > 0) & (x > left) & (x < left + width) & (y > top) & (y < top + height)
        assert inside.mean() > 0.9, place
        if axis is not None:
            up_and_away = browser.value("viewer.camera.axes.away")
            assert abs(up_and_away[axis]) > 0.99, place
    browser.value("document.getElementById('go-first').click()")
    assert browser.value("viewer.camera.eye") == pytest.approx(browser.value("viewer.stage.camera.eye"))


def test_distance_between_two_points(browser: Chromium, saved_page: Path, cloud: PointCloud) -> None:
    """Reference: the cloud's own positions; to a millimetre."""
    browser.open(saved_page.as_uri())
    first, second = np.flatnonzero((cloud.body == 0) & (cloud.status == 0))[[5, 40]].tolist()
    browser.value(f"viewer.select({first}), viewer.measure({second})")
    distance_text = browser.value("document.getElementById('distance').textContent")
    distance_m = float(np.linalg.norm(cloud.xyz_m[first] - cloud.xyz_m[second]))
    assert float(distance_text.split("\u202f")[0]) == pytest.approx(distance_m, abs=6e-4)
    browser.value(f"viewer.select({second})")
    assert browser.value("document.getElementById('distance')") is None


def test_a_mistake_stands_beside_its_field(browser: Chromium, live: str) -> None:
    """What the page knows is told at once and not sent; what the server refuses is told there too."""
    typed = """((label, value) => {
        const box = document.querySelector(`#controls input[type=number][aria-label="${label}"]`);
        box.value = value;
        box.dispatchEvent(new Event('change'));
        return [box.classList.contains('wrong'), box.closest('.control').querySelector('p').textContent];
    })"""
    browser.open(live)
    assert browser.value(f"{typed}('rays per pulse', '2.5')") == [True, "must be a whole number"]
    assert browser.value(f"{typed}('rain', '-3')") == [True, "must be >= 0 mm/h"]
    assert browser.value(f"{typed}('laser power', '')") == [True, "must be a number"]
    assert not any(text.endswith("/render") for text in browser.messages)
    browser.value(f"{typed}('laser power', '-5')")
    browser.until("!viewer.busy")
    note = browser.value("document.getElementById('note-laser.peak_power_w').textContent")
    assert note.startswith("must be >= 1e-06, got -5")
    assert browser.value("document.getElementById('error').hidden")
    assert browser.value(f"{typed}('laser power', '30')") == [False, ""]
    browser.until("!viewer.busy")
    assert browser.value("viewer.frame.command").endswith("--set laser.peak_power_w=30")


def test_budgets_come_when_they_are_looked_at(browser: Chromium, live: str) -> None:
    """A slider asks for points alone; a click, or a colour by the budget, asks for it."""
    browser.open(live)
    browser.value("viewer.settings['sun.illuminance_klux'] = 50, viewer.render(), 0")
    browser.until("!viewer.busy && viewer.frame.budget === false")
    assert browser.value("viewer.frame.arrays.echo_power === undefined")
    assert browser.value("[...document.querySelectorAll('#field option')].some(o => o.value === 'echo_power')")
    browser.value("viewer.select(3)")
    browser.until("!viewer.busy && viewer.frame.budget === true")
    assert "echo power" in point_card(browser)
    browser.value("viewer.select(-1), viewer.render(), 0")
    browser.until("!viewer.busy && viewer.frame.budget === false")
    browser.enter("#field", "echo_power")
    browser.until("!viewer.busy && viewer.frame.budget === true")
    assert browser.value("viewer.legend.low > 0")


def test_shadows_follow_the_sun(browser: Chromium, cloud: PointCloud, tmp_path: Path) -> None:
    """A post on a plane, the sun at 45 degrees on either side: the ground beside it is dark away from the sun alone.

    Two places 1 m to the left and right of a post 2 m high; those in the sun are twice as bright as those in shadow.
    """
    (tmp_path / "post.toml").write_text(
        '[[bodies]]\nname = "ground"\nprimitive = "plane"\nsize_m = [30, 30]\nmaterial = "concrete"\n'
        '[[bodies]]\nname = "post"\nprimitive = "box"\nsize_m = [0.6, 0.6, 2.0]\nmaterial = "concrete"\n'
        "position_m = [8.0, 0.0, 1.0]\n[picture]\neye_m = [0.0, 0.0, 6.0]\ntarget_m = [8.0, 0.0, 0.0]\n"
    )
    open_saved(browser, tmp_path, cloud.select(slice(0, 1)), tmp_path / "post.toml")
    brightness = {}
    for sun in (1, -1):
        browser.value(f"viewer.sun = [0, {sun} * Math.SQRT1_2, Math.SQRT1_2], viewer.draw(), 0")
        picture = screenshot(browser, tmp_path)
        for side in (1, -1):
            x, y, _ = browser.value(f"viewer.renderer.project(viewer.matrix, 8.0, {side}, 0.0)")
            left = browser.value("viewer.canvas.getBoundingClientRect().left")
            brightness[sun, side] = float(picture[int(y), int(x + left)].mean())
    assert brightness[1, 1] > 1.5 * brightness[1, -1]
    assert brightness[-1, -1] > 1.5 * brightness[-1, 1]


def test_clouds_without_truth_or_points(browser: Chromium, cloud: PointCloud, tmp_path: Path) -> None:
    """They show what they have."""
    for name, shown_cloud in (("plain", cloud.without_truth()), ("empty", cloud.select(slice(0, 0)))):
        open_saved(browser, tmp_path, shown_cloud)
        assert browser.value("viewer.frame.count") == len(shown_cloud)
        assert browser.value("viewer.frame.fields.some(one => one.name === 'true_range')") is (name == "empty")
        if len(shown_cloud):
            x, y, _ = pixel_places(browser)[len(shown_cloud) // 2]
            browser.click(x, y)
            table = point_card(browser)
            assert "SNR" in table
            assert "echo power" not in table
            assert "lidarscene view CLOUD SCENE" in browser.value("document.getElementById('card').textContent")


def test_far_from_the_origin(browser: Chromium, cloud: PointCloud, tmp_path: Path) -> None:
    """UTM coordinates: drawn around the sensor in single precision, told in full."""
    shift = np.array([500_000.0, 5_400_000.0, 100.0])
    moved = PointCloud(
        **{a: getattr(cloud, a) for a in cloud.__dataclass_fields__ if a not in ("xyz_m", "metadata")},
        xyz_m=cloud.xyz_m.astype(np.float64) + shift,
        metadata={**cloud.metadata, "sensor_position_m": "500000.0 5400000.0 100.0"},
    )
    open_saved(browser, tmp_path, moved)
    i = len(cloud) // 2
    browser.value(f"viewer.select({i})")
    table = point_card(browser)
    np.testing.assert_allclose([number(table[k]) for k in "xyz"], moved.xyz_m[i], atol=2e-4)


def test_the_same_input_makes_the_same_page(saved_page: Path, scene_file: Path, tmp_path: Path) -> None:
    second_page = tmp_path / "again.html"
    assert main(["view", str(saved_page.with_name("a.ply")), str(scene_file), *SETS, "--save", str(second_page)]) == 0
    assert second_page.read_bytes() == saved_page.read_bytes()
    blobs = re.findall(r'id="blob-([\w-]+)">([^<]*)<', saved_page.read_text(encoding="utf-8"))
    assert [name for name, _ in blobs] == ["stage", "frame-0"]
    assert all(base64.b64decode(text) for _, text in blobs)
