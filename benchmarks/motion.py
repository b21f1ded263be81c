"""What motion costs: the same scene with bodies traced in their own frames, as ratios to the still one."""

import dataclasses
import math
from pathlib import Path

import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Spline
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Scene

MOVERS = (1, 5, 10, 20)
MOST = {20: 1.3}
MOST_AWAY = 1.1
AWAY_M = 300.0
STILL = "still"
AWAY = "still, out of the way"

FAST = "laser.repetition_rate_khz=250"  # as fast as its window allows: tables of four seconds instead of twenty

TEXT = """The frame of `table1-apd` above, at 250 kHz, with the sensor on a vehicle that drives (slowly), and with the
cars and people nearest to it as moving bodies (which stand still, so that the same surfaces are met). Cars of one
colour share one shape, and so do the people. Those out of the way are 300 m behind the sensor, where no beam goes, and
so they are for the still frame beside them. Tables: numpy's work before a frame, where everything is in 0.1 s, by
splines."""


def measure(scene_file: Path, *, step_deg: float, rounds: int) -> Section:
    """Ratios of whole frames to the still one's, and the seconds of the tables."""
    steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    scene, sensor = load_scene(scene_file), load_sensor("table1-apd", overrides=[*steps, FAST])
    mobile = [body.name for body in scene.bodies if body.class_name in ("car", "pedestrian")]
    far_m = {
        body.name: float(np.linalg.norm(body.pose.position_m - scene.sensor_pose.position_m)) for body in scene.bodies
    }
    nearest = sorted(mobile, key=lambda name: far_m[name])
    scenes = {STILL: scene, "vehicle drives": dataclasses.replace(scene, ego=Course(speed_m_s=1.0))}
    scenes |= {f"{count} bodies move": with_movable(scene, nearest[:count]) for count in MOVERS if count <= len(mobile)}
    moved_away, out = f"{max(MOVERS)} bodies move, out of the way", nearest[: max(MOVERS)]
    scenes |= {AWAY: with_shifted(scene, out), moved_away: with_movable(with_shifted(scene, out), out)}
    simulators = {name: Simulator(variant, sensor, interactions=0) for name, variant in scenes.items()}
    seconds = clock.in_turns({name: simulator.render for name, simulator in simulators.items()}, rounds=rounds)
    goals = {f"{count} bodies move": most for count, most in MOST.items()}
    rows = [_row(seconds, name, STILL, goals.get(name)) for name in scenes if name not in (STILL, AWAY, moved_away)]
    rows.append(_row(seconds, moved_away, AWAY, MOST_AWAY))
    most = max(len(simulator.world.movers) for simulator in simulators.values())
    return Section("Motion", TEXT, [*rows, _tables(most, rounds)])


def with_movable(scene: Scene, names: list[str]) -> Scene:
    """The scene with these bodies as ones that could move."""
    bodies = tuple(
        dataclasses.replace(body, motion=Course(start=body.pose)) if body.name in names else body
        for body in scene.bodies
    )
    return dataclasses.replace(scene, bodies=bodies)


def with_shifted(scene: Scene, names: list[str]) -> Scene:
    """The scene with these bodies where no beam goes."""
    shift_m = -AWAY_M * scene.sensor_pose.rotation[:, 0]
    bodies = tuple(
        dataclasses.replace(body, pose=dataclasses.replace(body.pose, position_m=body.pose.position_m + shift_m))
        if body.name in names
        else body
        for body in scene.bodies
    )
    return dataclasses.replace(scene, bodies=bodies)


def _row(seconds: clock.Seconds, name: str, still_case: str, most: float | None) -> Row:
    median, low, high = clock.ratio(seconds, name, still_case)
    goal = "" if most is None else verdict(f"at most {most:g}", median <= most)
    return Row(
        f"{name} / {STILL}", f"{median:.2f}", f"{low:.2f} to {high:.2f}", f"{np.median(seconds[name]):.3f} s", goal
    )


def _tables(count: int, rounds: int) -> Row:
    """Numpy's work before a frame: where so many splines and the sensor are, every half millisecond."""
    from lidarscene.maths.motion_table import MotionTable

    times = np.linspace(0.0, 2.0, 21)
    way = tuple(Pose.from_degrees(position_m=(20 * t, math.sin(t), 0.0), yaw_deg=30 * t) for t in times)
    motions = [Spline(time_s=times, poses=way)] * (count + 1)
    task = {"tables": lambda: MotionTable.from_motions(motions, start_s=0.5, length_s=0.1, centre_m=np.zeros(3))}
    values = clock.in_turns(task, rounds=rounds)["tables"]
    return Row(
        f"tables of {count + 1} motions", f"{np.median(values):.3f} s", f"{values.min():.3f} to {values.max():.3f}"
    )
