"""What the tests of the view look at: a coarse sensor, a small scene."""

COARSE = (
    "scanner.azimuth_fov_deg=40",
    "scanner.azimuth_step_deg=2",
    "scanner.elevation_fov_deg=20",
    "scanner.elevation_step_deg=2",
)

SCENE = """
name = "view"
[sun]
azimuth_deg = 180.0
[picture]
eye_m = [-4, -3, 4.8]
target_m = [10, 0, 1.8]
fov_deg = 60
[[bodies]]
name = "wall"
class = "building"
primitive = "plane"
size_m = [4, 4]
material = "concrete"
position_m = [10, 0, 1.8]
pitch_deg = 90
[[bodies]]
name = "pane"
class = "window"
primitive = "plane"
size_m = [1, 1]
material = "clear_glass"
position_m = [9, 3, 1.8]
pitch_deg = 90
[[bodies]]
name = "ball"
class = "ball"
primitive = "sphere"
radius_m = 0.8
material = "target_80"
position_m = [7, -3, 1.8]
"""
