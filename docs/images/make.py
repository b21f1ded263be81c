"""Make the pictures of the documentation again: `python docs/images/make.py`, from the repository's root.

That of the view needs a Chromium, and is left as it is where there is none.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

from PIL import Image

import lidarscene
from lidarscene.plots import frame_picture

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
WIDTH, COLOURS = 1200, 256

sys.path.insert(0, str(ROOT / "tests" / "view"))
from chromium import Chromium, executable  # noqa: E402
from served import served  # noqa: E402

# The point of the car's paint that is nearest to this place in the picture.
CLICK = """(() => {
    const { frame, renderer, matrix } = viewer, { xyz, material, incidence_angle } = frame.arrays;
    const paint = frame.fields.find(field => field.name === "material").names.indexOf("car_paint_white");
    let nearest = [-1, Infinity];
    for (let i = 0; i < frame.count; i++) {
        if (material[i] !== paint || incidence_angle[i] > 70) continue;
        const seen = renderer.project(matrix, ...xyz.subarray(3 * i, 3 * i + 3));
        const away = Math.hypot(seen[0] - 560, seen[1] - 470);
        if (away < nearest[1]) nearest = [i, away];
    }
    viewer.select(nearest[0]);
})()"""


def main() -> None:
    """Render the car scene and store its picture small enough for a repository; then the view."""
    scene = lidarscene.load_scene(ROOT / "scenes" / "car.toml")
    finer = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]  # as `make car`
    cloud = lidarscene.render(scene, overrides=finer)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "car.png"
        frame_picture(cloud, path, **view)
        picture = Image.open(path).convert("RGB")
    store(
        picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS),
        "car.png",
    )
    if executable():
        store(view_picture(), "view.png")


def view_picture() -> Image.Image:
    """The page of the car scene, with a point clicked."""
    with (
        tempfile.TemporaryDirectory() as folder,
        served(ROOT / "scenes" / "car.toml") as page,
        Chromium(Path(folder) / "profile", width=1280, height=860) as browser,
    ):
        browser.open(page.url)
        browser.value("viewer.camera.zoom(0.72), viewer.draw()")
        browser.value(CLICK)
        browser.value("new Promise(done => setTimeout(done, 500))")
        browser.screenshot(Path(folder) / "view.png")
        return Image.open(Path(folder) / "view.png").convert("RGB")


def store(picture: Image.Image, name: str) -> None:
    """With a palette, as small as it gets."""
    small = picture.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    small.save(HERE / name, optimize=True)


if __name__ == "__main__":
    main()
