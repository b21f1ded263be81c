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
c3 = ls.load_cloud("a.ply")
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
r: Report = ls.max_range(["vlp-16", sensor], illuminance_klux=20.0)
col = r.table["range_m"]
r.save("out")
r.plot().save("x.png")
ls.fov("vlp-16", times_s=(0.1, 0.5))
ls.compare("street", ["table1-apd", s2], same_beams=True, seed=4)
ls.compare([cloud, "b.ply"])
ls.certify("os1.pcap", "os1-128", frame=3)
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
watts = ls.budget(cloud, scene, "table1-apd").echo_power_w.max()
try:
    ls.load_sensor("x")
except ls.InputError as e:
    print(e)
sun = ls.Sun(illuminance_klux=20.0)
sc = ls.Scene(name="x", sun=sun)
ok = cloud.status == ls.Status.ECHO
m: Material = scene.materials["brick"]

# Studies beyond one range.
swept = ls.sweep(["vlp-16", sensor], "illuminance_klux", start=0.1, stop=100.0, points=50, reflectivity=0.3)
ls.sweep(sensor, "detector.gain", quantity="snr", distance=150, log=True).save("gain")
worth = ls.sensitivities("vlp-16", distance=80)
strongest: str = worth.table["parameter"][0]
safe = ls.eye_safety([sensor, s2])
if safe.passed is None:
    print("not judged", safe.numbers)
ls.design(Path("my-study.toml"), Path("out/study")).plot("front").save("front.png")
fitted = ls.fit(["a.osf", "b.osf"], "os2-128", sensor_index=1, frames=[0, 1, 2], metadata="os2.json")
fitted.write("sensor.toml", "my-os2.toml")
ls.fit("os1.pcap", scene="out/twin/scene.toml", poses="poses.csv")

# What a designer changes.
hot = ls.load_sensor("my-apd.toml", overrides=["detector.gain=80", "detector.temperature_k=330"])
noise = hot.working_point(0.0)

# What a trainer of perception does.
frames: list[PointCloud] = list(ls.render_frames("drive", "os1-128", frames=2, seed=7))
frame_boxes = ls.boxes(frames[0], ls.load_scene("drive"))
ls.record("drive", ls.load_rig("rig"), outputs=Outputs("out/rig"), frames=2)

# A scene without a file.
target = ls.Scene(name="board", sun=ls.Sun(illuminance_klux=50.0), air=ls.Air(visibility_m=5e3))
target = target.add((np.zeros((3, 3)), np.array([[0, 1, 2]])), "concrete", (20, 0, 1), name="board")
live = ls.LiveSimulator(target, "vlp-16")

# By name, in the words of the README.
mine: Sensor = Sensor("apd-905")
yard: Scene = Scene("car", overrides={"sun.illuminance_klux": 1})
ls.render(yard, mine).select(class_="car", status="echo").range_m.mean()
ls.Rig("rig")
brick: Material = Material("brick")
again: PointCloud = PointCloud("a.ply")
mine.max_range(reflectivity=0.3)
mine.replace(peak_power_w=50).save("mine.toml")
road: Scene = ls.street(3, lanes=2, length_m=200.0)
road.add("pedestrian", position=(20, 0, 0)).add("car", pose=np.eye(4)).save("road.toml")
findings: list[str] = ls.check("mine.toml") + ls.check(road) + ls.check(mine)
done: int = ls.batch("job", "out/job", workers=2).rendered
ls.view(cloud, scene="car")
ls.view("car").save("page.html")
print(ls.materials()[0])
moved = cloud.transform(np.eye(4))

# What a type checker must refuse: `mypy --strict` warns of a remark that ignores nothing.
ls.render("car", sed=1)  # type: ignore[call-overload]
ls.render("car", seed="one")  # type: ignore[call-overload]
ls.max_range("vlp-16", reflectvity=0.1)  # type: ignore[call-arg]
ls.max_range(3)  # type: ignore[arg-type]
ls.sweep("vlp-16")  # type: ignore[call-arg]
ls.sweep("vlp-16", "distance", pionts=3)  # type: ignore[call-arg]
ls.fov("vlp-16", mask=3)  # type: ignore[arg-type]
ls.compare("car", sensor="vlp-16")  # type: ignore[call-arg]
ls.fit("os1.pcap", "os1-128", frames=1)  # type: ignore[arg-type]
ls.twin("os1.pcap")  # type: ignore[call-arg]
ls.design("gain")  # type: ignore[call-arg]
Sensor(3)  # type: ignore[arg-type]
ls.Sun(klux=20.0)  # type: ignore[call-arg]
cloud.range_m = rng  # type: ignore[misc]
report: str = ls.eye_safety("vlp-16")  # type: ignore[assignment]
