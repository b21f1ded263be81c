"""Picture of surfaces: what a rough road sends back, how far a lidar sees it, a wall with a pattern of its own."""

import dataclasses

import numpy as np
from drawing import INK, bar_of, dark, saved

import lidarscene
from lidarscene.materials.material import Material, Spectrum
from lidarscene.materials.material_file import catalogue_material
from lidarscene.maths.pose import Pose
from lidarscene.physics.optics import reflection
from lidarscene.scene.meshes.primitives import plane_mesh
from lidarscene.scene.meshes.reflectivity_patterns import ReflectivityPattern
from lidarscene.scene.scene import Body, Part, Scene, Sun

SLOPES_DEG = (0, 25, 45)
COLOURS = ("#9aa4b2", "#4cc9f0", "#ffb703")


def surfaces() -> None:
    """Three charts side by side."""
    figure, (back, road, wall) = dark(1, 3, height=3.9)
    _back(back)
    _road(road)
    bar_of(figure, _wall(wall), wall, "intensity")
    for axes in (back, road):
        axes.legend(facecolor="none", edgecolor="none", labelcolor=INK, fontsize=9)
    for axes, title in (
        (back, "sent back, of a surface of 10 %"),
        (road, "beams of an OS1-128 that a road of 11 % returns"),
        (wall, "a brick wall by its texture"),
    ):
        axes.set_title(title, color=INK, fontsize=10)
        axes.xaxis.label.set_color(INK)
        axes.yaxis.label.set_color(INK)
    saved(figure, "surfaces.png")


def _back(axes) -> None:
    theta = np.linspace(0.0, 89.5, 180)
    cos = np.cos(np.radians(theta))
    for slope, colour in zip(SLOPES_DEG, COLOURS, strict=True):
        per_sr = reflection.rough_diffuse_per_sr(
            reflectivity=0.1, relief=reflection.relief(np.radians(slope)), cos_in=cos, cos_out=cos, cos_between=1.0
        )
        axes.plot(theta, np.pi * per_sr * cos, color=colour, label=_name(slope))
    axes.set(xlabel="angle of incidence [deg]", ylabel="pi f_r cos(theta)", ylim=(0.0, 0.11))


def _name(slope_deg: int) -> str:
    return f"facets of {slope_deg} deg" if slope_deg else "Lambert"


def _road(axes) -> None:
    sensor = lidarscene.load_sensor("os1-128")
    edges = np.arange(4.0, 70.0, 3.0)
    for slope, colour in zip(SLOPES_DEG, COLOURS, strict=True):
        surface = Material(
            name="road",
            bsdf="diffuse",
            reflectivity=Spectrum.constant(0.114),
            parameters={"facet_slope_deg": float(slope)} if slope else {},
        )
        ground = _plane(surface, size_m=(200.0, 200.0), pose=Pose())
        scene = Scene(
            bodies=(ground,),
            materials={"road": surface},
            sensor_pose=Pose.from_degrees(position_m=(0, 0, 1.8)),
            sun=Sun(illuminance_klux=50.0),
        )
        # A laser of 1 MW has an echo from all that a beam meets.
        strong = dataclasses.replace(sensor, laser=dataclasses.replace(sensor.laser, peak_power_w=1e6))
        kept, met = (np.histogram(_ranges(scene, one), edges)[0] for one in (sensor, strong))
        ring = met > 0  # far away there are gaps between rings
        axes.plot(((edges[1:] + edges[:-1]) / 2)[ring], (kept[ring] / met[ring]), color=colour, label=_name(slope))
    axes.set(xlabel="range [m]", ylabel="share of beams")


def _ranges(scene: Scene, sensor) -> np.ndarray:
    """True ranges of the first echoes of a frame."""
    cloud = lidarscene.Simulator(scene, sensor).render(seed=0)
    return cloud.true_range_m[(cloud.status == 0) & (cloud.return_number == 1)]


def _wall(axes):
    image = _bricks()
    brick = catalogue_material("brick")
    vertices, _ = plane_mesh(size_m=(4.0, 6.0))
    uv = np.stack([vertices[:, 1] / 6.0 + 0.5, 0.5 + vertices[:, 0] / 4.0], axis=1)
    wall = _plane(
        brick,
        size_m=(4.0, 6.0),
        pose=Pose.from_degrees(position_m=(10.0, 0.0, 0.0), pitch_deg=90.0),
        pattern=ReflectivityPattern(kind="colour", values=image, uv=uv * (3.0, 2.0), mean=float(image.mean())),
    )
    keys = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]
    keys += ["scanner.azimuth_fov_deg=30", "scanner.elevation_fov_deg=20", "intensity.kind='reflectivity'"]
    sensor = lidarscene.load_sensor("table1-apd", overrides=keys)
    cloud = lidarscene.Simulator(
        Scene(bodies=(wall,), materials={"brick": brick}, sun=Sun(illuminance_klux=0.0)), sensor
    ).render(seed=0)
    cloud = cloud.select(cloud.status == 0)
    axes.set_aspect("equal")
    axes.set(xlabel="y [m]", ylabel="z [m]")
    return axes.scatter(-cloud.xyz_m[:, 1], cloud.xyz_m[:, 2], c=cloud.intensity, s=1.5, cmap="magma", linewidths=0)


def _bricks() -> np.ndarray:
    """Red of two courses of bricks of five shades, and of their mortar; it repeats."""
    image = np.full((80, 160), 0.45)
    shades = np.array([0.22, 0.3, 0.26, 0.18])
    for course in range(2):
        for number in range(2):
            start = 80 * number + 40 * course
            columns = np.arange(start + 3, start + 77) % 160
            image[course * 40 + 4 : course * 40 + 37, columns] = shades[2 * course + number]
    return image


def _plane(surface: Material, *, size_m, pose: Pose, pattern: ReflectivityPattern | None = None) -> Body:
    vertices, faces = plane_mesh(size_m=size_m)
    part = Part(vertices_m=vertices, faces=faces, material=surface.name, pattern=pattern)
    return Body(name="surface", class_name="surface", parts=(part,), pose=pose)
