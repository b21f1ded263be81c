"""Scene files' text that several folders of tests share."""

WALL = """
[[bodies]]
name = "wall"
primitive = "plane"
size_m = [4, 4]
material = "concrete"
position_m = [10, 0, 1.8]
pitch_deg = 90
"""

LEFT_AND_RIGHT = """
[[sensors]]
label = "left"
sensor = "table1-apd"
position_m = [0, 1, 1.8]

[[sensors]]
label = "right"
sensor = "table1-sipm"
position_m = [0, -1, 1.8]
"""

MOVING = """
[ego]
speed_m_s = 20

[[bodies]]
name = "wall"
primitive = "box"
class = "car"
size_m = [1, 4, 4]
material = "concrete"
position_m = [10, 0, 1.8]

[bodies.motion]
velocity_m_s = [-10, 2, 0]
"""
"""A wall and a sensor that move."""
