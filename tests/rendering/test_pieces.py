"""Long scenes in pieces: near the vehicle as the whole scene, the same whatever came before, with names that stay."""

from pathlib import Path

import numpy as np
import pytest
from helpers import chain
from helpers.scene_text import scene_of

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.rendering.pieces import pieces_of
from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("mi")

REACH_M, BEGINS_S = 30.0, (0.0, 2.0, 4.0)
WALLS = "\n".join(
    f'[[bodies]]\nname = "wall_{number}"\nprimitive = "box"\nsize_m = [2, 0.5, 3]\n'
    f'material = "{("brick", "concrete", "plaster_white")[number % 3]}"\nposition_m = [{5 + 7 * number}, {side}, 1.5]\n'
    for number, side in zip(range(20), [5, -6] * 10, strict=True)
)
SCENE = f"[sun]\nilluminance_klux = 1\n[ego]\nspeed_m_s = 20\nposition_m = [0, 0.5, 0]\n{WALLS}"
GROUND = '[[bodies]]\nname = "road"\nprimitive = "plane"\nsize_m = [400, 20]\nmaterial = "asphalt"\n'
MOVES = '[[bodies]]\nname = "van"\nprimitive = "box"\nsize_m = [4, 2, 2]\nmaterial = "brick"\nposition_m = [12, 0, 1]\n'


def simulator(folder: Path, reach: str) -> Simulator:
    scene = scene_of(folder, f"{reach}\n{SCENE}{GROUND}{MOVES}[bodies.motion]\nspeed_m_s = 20\n")
    return Simulator(scene, chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.5"))


def points_by_pulse(cloud: PointCloud) -> dict[int, tuple[str, float]]:
    """Name of the body, and range, of each echo that is nearer than the reach, by its time."""
    assert cloud.body is not None
    assert cloud.true_range_m is not None
    rows = np.flatnonzero((cloud.status == 0) & (cloud.true_range_m < REACH_M))
    return {
        round(cloud.time_s[row] * 1e9): (cloud.body_names[cloud.body[row]], float(cloud.true_range_m[row]))
        for row in rows
    }


def test_pieces_are_the_scene(tmp_path: Path) -> None:
    """Echoes within reach are of the same bodies at the same ranges as in the whole scene, at three places of the way.

    Traced coordinates have other origins, so that ranges differ by rounding, 1e-5 m at 140 m, and a beam at an edge may
    meet the other side: one in a thousand is allowed, and their noise may then lose them.
    """
    pieces, whole = simulator(tmp_path, f"reach_m = {REACH_M}"), simulator(tmp_path, "")
    seen = set()
    for begin_s in BEGINS_S:
        a, b = (points_by_pulse(rendered.render(seed=2, begin_s=begin_s)) for rendered in (pieces, whole))
        assert len(a) > 500
        same = [pulse for pulse in a if pulse in b and a[pulse][0] == b[pulse][0]]
        assert len(same) >= 0.999 * max(len(a), len(b))
        apart_m = [abs(a[pulse][1] - b[pulse][1]) for pulse in same]
        assert np.quantile(apart_m, 0.999) < 1e-3
        seen |= {name for name, _ in a.values()}
    assert {"road", "van"} < seen
    assert len(seen) > 10


def test_a_piece_follows_from_the_frame(tmp_path: Path) -> None:
    """Frames in any order are the same to the bit; names of bodies, classes and materials are those of the scene."""
    forward, backward = simulator(tmp_path, f"reach_m = {REACH_M}"), simulator(tmp_path, f"reach_m = {REACH_M}")
    clouds = {begin_s: forward.render(seed=2, begin_s=begin_s) for begin_s in BEGINS_S}
    assert set(pieces_of(forward.scene, BEGINS_S)) == {(0, 0), (1, 0), (2, 0)}
    for begin_s in reversed(BEGINS_S):
        again = backward.render(seed=2, begin_s=begin_s)
        for name in ("xyz_m", "body", "material", "class_id", "intensity"):
            np.testing.assert_array_equal(getattr(clouds[begin_s], name), getattr(again, name))
    first = clouds[0.0]
    for cloud in clouds.values():
        assert cloud.body_names == first.body_names
        assert cloud.class_names == first.class_names
        assert cloud.material_names == first.material_names
