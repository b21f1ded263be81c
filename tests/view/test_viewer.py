"""What the page's buttons give away: a picture, a command."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from helpers.chromium import Chromium
from helpers.clouds import small_cloud
from helpers.served import open_saved, served
from helpers.small_scene import COARSE
from helpers.waiting import wait_until
from matplotlib import image

from lidarscene import PointCloud
from lidarscene.cli.main import main


def press(browser: Chromium, name: str) -> None:
    """Press the mouse in the middle of a button."""
    button = f"document.getElementById('{name}')"
    browser.value(f"{button}.scrollIntoView()")
    left, top, width, height = browser.box(button)
    browser.click(left + width / 2, top + height / 2)


PNG_END = b"IEND\xaeB`\x82"


def test_a_picture_is_saved(browser: Chromium, tmp_path: Path) -> None:
    """The file that the browser stores is what the canvas shows: as large, and with points on the background."""
    open_saved(browser, tmp_path, small_cloud(500))
    browser.value("document.getElementById('size').value = 4")
    press(browser, "go-fit")
    browser.store_in(tmp_path)
    press(browser, "picture")
    # The browser makes an empty file first.
    wait_until(lambda: any(path.read_bytes().endswith(PNG_END) for path in tmp_path.glob("*.png")))
    picture = image.imread(next(tmp_path.glob("*.png")))
    assert list(picture.shape[1::-1]) == browser.value("[viewer.canvas.width, viewer.canvas.height]")
    background = np.array([11, 14, 20]) / 255
    is_drawn = np.abs(picture[:, :, :3] - background).max(axis=2) > 0.1
    assert is_drawn.sum() > 500


def test_the_page_says_that_it_waits_and_names_what_is_pointed_at(browser: Chromium, tmp_path: Path) -> None:
    """A page whose frame has not come says so in its middle; then a resting pointer shows the name of the body."""
    cloud = small_cloud(500)
    page = open_saved(browser, tmp_path, cloud)
    assert '<p id="wait">loading scene and points' in page.read_text("utf-8")
    browser.until("viewer && viewer.frame")
    assert browser.value("byId('wait').hidden && !byId('wait').textContent.includes('rendering')")
    press(browser, "go-fit")
    named = next(i for i, body in enumerate(cloud.body) if body >= 0)
    browser.value(f"viewer.pick = () => {named}, 0")
    browser.value("viewer.canvas.dispatchEvent(new PointerEvent('pointermove', {clientX: 600, clientY: 300})), 0")
    browser.until("!byId('hover').hidden")
    assert browser.value("byId('hover').textContent") == cloud.body_names[cloud.body[named]]
    browser.value("viewer.pick = () => -1, 0")
    browser.value("viewer.canvas.dispatchEvent(new PointerEvent('pointermove', {clientX: 700, clientY: 300})), 0")
    browser.until("byId('hover').hidden")


def test_nines_are_not_rounded_away(browser: Chromium, tmp_path: Path) -> None:
    open_saved(browser, tmp_path, small_cloud(5))
    shown = browser.value("[1, 0.9999, 0.99999, 0.5].map(value => formatted(value, ''))")
    assert shown == ["1", "0.9999", "1 \u2212 1.0e-5", "0.5"]


def test_a_scale_over_less_than_three_decades_has_ticks_all_along(browser: Chromium, tmp_path: Path) -> None:
    open_saved(browser, tmp_path, small_cloud(5))
    browser.value("Object.assign(viewer.legend, {low: 1, high: 76, log: true}).build()")
    ticks = browser.value("[...document.querySelectorAll('.ticks span')].map(tick => Number(tick.textContent))")
    assert ticks == [1, 5, 20]
    browser.value("byId('legend').replaceChildren()")
    assert browser.value("getComputedStyle(byId('legend')).display") == "none", "no empty box while the page waits"


def test_a_command_is_copied(browser: Chromium, mi: object, scene_file: Path, tmp_path: Path) -> None:
    """It goes to the clipboard, and run, it writes the points that the page shows; without the right to write there
    it is told in a window, to be copied by hand.
    """
    with served(scene_file, *[f"--set={option}" for option in COARSE]) as view:
        browser.open(view.url)
        browser.resize(1440, 900)
        places = browser.value("""['#copy', '[aria-label="frame"]', '[aria-label="seed"]'].map(
            choice => document.querySelector(`#live ${choice}`).getBoundingClientRect().bottom)""")
        assert max(places) < 900, "copy, frame and seed are seen on a laptop"
        browser.resize(1280, 800)
        browser.value("viewer.settings['laser.peak_power_w'] = 20, viewer.render(), 0")
        browser.until("!viewer.busy")
        browser.value("""(() => {
            window.written = [];
            navigator.clipboard.writeText = async text => { window.written.push(text); };
        })()""")
        press(browser, "copy")
        browser.until("document.getElementById('copy').textContent === 'copied'")
        (command,) = browser.value("window.written")
        browser.value("""(() => {
            navigator.clipboard.writeText = async () => { throw new Error("not allowed"); };
            window.prompt = (...told) => window.written.push(told[1]);
        })()""")
        press(browser, "copy")
        browser.until("window.written.length === 2")
        assert browser.value("window.written[1]") == command
        snr = browser.value("[...viewer.frame.arrays.snr]")
    words = shlex.split(command)
    assert words[:2] == ["lidarscene", "render"]
    output = words.index("-o") + 1
    words[output] = str(tmp_path / "again.ply")
    assert main(words[1:]) == 0
    assert PointCloud.load(tmp_path / "again.ply").snr.tolist() == pytest.approx(snr, rel=1e-6)


def test_keys_fingers_and_fewer_points_while_it_moves(browser: Chromium, tmp_path: Path) -> None:
    """Keys do what the buttons do; two fingers apart by twice as much bring the eye to half its distance; of too
    many points every third is drawn while the camera moves, and all of them when it stands.
    """
    open_saved(browser, tmp_path, small_cloud(500))
    browser.until("viewer?.frame !== null")
    browser.value("viewer.renderer.mostDragged = 200")
    press_key = "key => dispatchEvent(new KeyboardEvent('keydown', { key }))"
    first = browser.value("viewer.camera.eye")
    browser.value(f"({press_key})('t'), 0")
    assert browser.value("viewer.camera.axes.away")[2] > 0.9
    browser.value(f"({press_key})('R'), 0")
    assert browser.value("viewer.camera.eye") == pytest.approx(first)
    size = browser.value("Number(document.getElementById('size').value)")
    browser.value(f"({press_key})('+'), 0")
    assert browser.value("Number(document.getElementById('size').value)") == pytest.approx(size + 0.3)
    before_m = browser.value("viewer.camera.distance")
    finger = """(type, id, x) => viewer.canvas.dispatchEvent(
        new PointerEvent(type, { pointerId: id, clientX: x, clientY: 300, button: 0, buttons: 1 }))"""
    drawn = browser.value(f"""(() => {{
        const finger = {finger}, steps = [];
        viewer.canvas.setPointerCapture = () => {{}};
        finger("pointerdown", 1, 500), finger("pointerdown", 2, 600);
        finger("pointermove", 2, 700);
        viewer.draw(), steps.push(viewer.renderer.step);
        finger("pointerup", 1, 500), finger("pointerup", 2, 700);
        viewer.draw(), steps.push(viewer.renderer.step);
        return [...steps, viewer.renderer.gl.getError()];
    }})()""")
    assert drawn == [3, 1, 0]
    assert browser.value("viewer.camera.distance") == pytest.approx(before_m / 2)
    assert browser.value("viewer.selected") == -1
