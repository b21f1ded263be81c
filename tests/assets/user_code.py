"""What users write, never run: mypy checks its types with the package, and pyright accepts it."""

from pathlib import Path

import numpy as np

import lidarscene as ls
from lidarscene import FrameOptions, Material, Outputs, PointCloud, Pose, Report, Scene, Sensor, TraceOptions

cloud = ls.render("car", seed=1)
cloud2: PointCloud = ls.render(Path("car.toml"), "table1-apd", seed=0, rays=4, pose=(0, 0, 2))
near = cloud[cloud["range"] < 30]
n: int = len(near)
rng = cloud["range"].max()
both = cloud + cloud2
xyz = both.xyz.mean(axis=0)
arr = np.asarray(cloud)
img = cloud.range_image()["range"]
pic = cloud.plot("range")
pic.save("a.png")
near.save("a.ply", ascii=True)
c3 = ls.load("a.ply")
for frame in ls.render_frames("drive", frames=3, seed=2):
    print(len(frame), frame.metadata["sensor"])
sensor = ls.load_sensor("vlp-16", overrides={"laser.peak_power_w": 30})
s2: Sensor = sensor.replace("laser.peak_power_w=60")
s3 = sensor.replace({"laser.peak_power_w": 60.0})
s4 = sensor.replace(laser={"peak_power_w": 60})
scene: Scene = ls.load_scene("car")
scene2 = scene.add("hut.stl", "brick", (1, 2, 3, 90), name="hut")
scene3 = scene.add((np.zeros((3, 3)), np.array([[0, 1, 2]])), "brick", Pose())
sim = ls.Simulator(scene, sensor, TraceOptions(rays=3))
c5 = sim.render(FrameOptions(seed=3))
c6 = sim.render(seed=3, number=2)
r: Report = ls.max_range(["vlp-16", sensor], illuminance=20.0)
col = r.table["maximum_range_m"]
r.save("out")
r.plot().save("x.png")
ls.fov("vlp-16", times_s=(0.1, 0.5))
ls.compare("street", ["table1-apd", s2], same_beams=True, seed=4)
ls.compare([cloud, "b.ply"])
ls.compare(cloud, real="os1.pcap", recorded_frame=3)
ls.fit("os1.pcap", "os1-128").save("fit")
t = ls.twin("os1.pcap", "out/twin", held_out="columns")
ls.render(t)
with ls.open_recording("os1.pcap") as rec:
    sweep = rec[0]
    print(sweep.range_m.max(), len(rec))
print(ls.sensors()[0], ls.scenes())
rec2 = ls.record("car", outputs="a.ply")
rec3 = ls.record("car", outputs=Outputs("a.ply"))
boxes = ls.boxes(cloud, scene)
try:
    ls.load_sensor("x")
except ls.InputError as e:
    print(e)
sun = ls.Sun(illuminance_klux=20.0)
sc = ls.Scene(name="x", sun=sun)
ok = cloud.status == ls.Status.ECHO
m: Material = scene.materials["brick"]
