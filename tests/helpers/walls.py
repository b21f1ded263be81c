"""Scene files' text that several folders of tests share."""

from pathlib import Path

WALL = """
[[bodies]]
name = "wall"
primitive = "plane"
size_m = [4, 4]
material = "concrete"
position_m = [10, 0, 1.8]
pitch_deg = 90
"""


def rig_text(*sensors: tuple[str, ...]) -> str:
    """Text of a rig file, from the label, the sensor and further lines of each."""
    return "".join(
        "\n".join(("[[sensors]]", f'label = "{label}"', f'sensor = "{sensor}"', *lines, ""))
        for label, sensor, *lines in sensors
    )


LEFT_AND_RIGHT = rig_text(
    ("left", "table1-apd", "position_m = [0, 1, 1.8]"), ("right", "table1-sipm", "position_m = [0, -1, 1.8]")
)
ROOF_AND_LEFT = rig_text(
    ("roof", "table1-apd", "position_m = [0, 0, 1.8]", 'set = ["detector.gain=50"]'),
    ("left", "own.toml", "yaw_deg = 90"),
)

APPROACHED = """
[ego]
speed_m_s = 20

[[bodies]]
name = "wall"
primitive = "box"
class = "car"
size_m = [1, 4, 4]
material = "concrete"
position_m = [10, 0, 1.8]
"""
"""A wall that stands, of a car's class, and a sensor that drives towards it."""

MOVING = f"""{APPROACHED}
[bodies.motion]
velocity_m_s = [-10, 2, 0]
"""
"""A wall and a sensor that move."""


def write_moving_rig(folder: Path) -> str:
    """Write a car and a sensor that move, by 5 and 9 cm in a frame of 4.6 ms, and a rig of two sensors.

    Returns:
        the name of the scene
    """
    (folder / "moving.toml").write_text(MOVING)
    (folder / "rig.toml").write_text(LEFT_AND_RIGHT)
    return "moving.toml"
