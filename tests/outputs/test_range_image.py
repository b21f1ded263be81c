"""Range images as other programs read them."""

from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import PIL.Image
import pytest
from helpers import street
from helpers.mistakes import told

from lidarscene.cloud.pixels import images
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.files.encodings import png
from lidarscene.outputs.range_image import write_range_image


def test_png_in_pillow(tmp_path: Path) -> None:
    """Reference: Pillow; colours of 8 bits, grey of 16, texts."""
    rng = np.random.default_rng(1)
    colours, grey = rng.integers(0, 256, (5, 7, 3), np.uint8), rng.integers(0, 65536, (6, 3), np.uint16)
    for image in (colours, grey):
        (tmp_path / "a.png").write_bytes(png.encode_png(image, text={"Title": "naïve"}))
        with PIL.Image.open(tmp_path / "a.png") as theirs:
            np.testing.assert_array_equal(np.asarray(theirs), image)
            assert theirs.text == {"Title": "naïve"}


def test_every_beam_has_its_pixel(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Reference: the raster of the street, 151 by 61 beams with an echo below the horizon. Range to half a step."""
    files = write_range_image(tmp_path / "a.png", street_cloud)
    assert [file.name for file in files] == ["a.png", "a.intensity.png", "a.ambient.png", "a.status.png"]
    images = {}
    for file in files:
        with PIL.Image.open(file) as image:
            images[file.name] = np.asarray(image)
    has_point = images["a.status.png"] == 1
    assert np.count_nonzero(has_point) == len(street_cloud)
    assert has_point.shape[1] == 151
    row, column = pixel_of(street_cloud, has_point.shape[0])
    assert has_point[row, column].all()
    np.testing.assert_allclose(images["a.png"][row, column] / 100.0, street_cloud.range_m, atol=0.0051)
    peak = street_cloud.intensity.max()
    levels = images["a.intensity.png"][row, column]
    np.testing.assert_allclose(levels / 65535.0 * peak, street_cloud.intensity, atol=0.51 * peak / 65535.0)
    assert not images["a.png"][~has_point].any()


def pixel_of(cloud: PointCloud, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column by the raster's step of 0.4 degrees; the top row is the highest with an echo."""
    highest = np.degrees(cloud.elevation_rad.max())
    row = np.rint((highest - np.degrees(cloud.elevation_rad)) / 0.4).astype(int)
    assert row.max() == rows - 1
    return row, np.rint((30.0 - np.degrees(cloud.azimuth_rad)) / 0.4).astype(int)


def test_npz_has_the_values_and_the_angles(tmp_path: Path, street_cloud: PointCloud) -> None:
    (path,) = write_range_image(tmp_path / "a.npz", street_cloud)
    with np.load(path) as archive:
        point = archive["point"]
        np.testing.assert_array_equal(archive["range"][point >= 0], street_cloud.range_m[point[point >= 0]])
        azimuth, elevation = archive["azimuth_deg"], archive["elevation_deg"]
        assert archive["range"].shape == (len(elevation) - 1, len(azimuth) - 1)
    for edges, angle, axis in ((azimuth, street_cloud.azimuth_rad, 1), (elevation, street_cloud.elevation_rad, 0)):
        cell = np.nonzero(point >= 0)[axis]
        values = np.degrees(angle[point[point >= 0]])
        assert ((values <= edges[cell] + 1e-3) & (values >= edges[cell + 1] - 1e-3)).all()


def test_a_range_beyond_16_bits_stays_the_largest() -> None:
    cloud = street.cloud()
    far = PointCloud(**{f: getattr(cloud, f) for f in cloud.__dataclass_fields__} | {"range_m": cloud.range_m + 1000})
    assert images(far)["range"].max() > 1000


def test_an_empty_cloud_and_a_wrong_name(tmp_path: Path) -> None:
    empty = street.cloud().select(slice(0, 0))
    write_range_image(tmp_path / "a.png", empty)
    assert not matplotlib.image.imread(tmp_path / "a.png").any()
    with told("a.jpg | .png | .npz"):
        write_range_image(tmp_path / "a.jpg", empty)


def test_levels_of_a_png(tmp_path: Path) -> None:
    """A centimetre of range each, up to 655.35 m, beyond which they stay; the others by 65,535 of their largest."""
    cloud = street.cloud(step_deg=4.0)
    near, far = np.arange(len(cloud)) % 2 == 0, np.arange(len(cloud)) % 2 == 1
    cloud = replace(cloud, range_m=np.where(far, 700.0, 123.456), intensity=np.where(near, 0.25, 8.0))
    write_range_image(tmp_path / "a.png", cloud)
    assert set(np.unique(np.asarray(PIL.Image.open(tmp_path / "a.png"))).tolist()) - {0} == {12_346, 65_535}
    picture = PIL.Image.open(tmp_path / "a.intensity.png")
    assert set(np.unique(np.asarray(picture)).tolist()) - {0} == {round(65_535 / 32), 65_535}
    step, unit = picture.info["Description"].removeprefix("one step is ").split(" ")
    assert (float(step) * 65_535, unit) == (pytest.approx(8.0), "A")
