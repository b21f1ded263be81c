"""Mistakes on the command line: each gives one clear line, exit code 2, and leaves nothing behind."""

import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.command_line import COARSE, WALL, Run
from helpers.documentation import ROOT
from helpers.folders import raise_disk_full
from helpers.mistakes import mistakes, told, typed
from helpers.recordings import OUSTER
from helpers.walls import LEFT_AND_RIGHT

import lidarscene
from lidarscene import catalog
from lidarscene.formats.registry import SUFFIXES
from lidarscene.rendering.simulator import Simulator

XML = "<scene version='3.0.0'><bsdf type='diffuse' id='grey'/><shape type='sphere' id='ball'/></scene>"
FILES = {
    "wall.toml": WALL,
    "both.toml": WALL + "scale = 0\n[sky]\ndiffuse_share = -1\n",
    "ending.toml": "[ego]\nposes = [{ time_s = 0 }, { time_s = 0.011, position_m = [1, 0, 0] }]\n" + WALL,
    "mesh.toml": '[[bodies]]\nname = "thing"\nmaterial = "concrete"\nmesh = "mesh.ply"\n',
    "mesh.ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "mesh.xml": "<scene version='3.0.0'><shape type='ply'><string name='filename' value='mesh.ply'/></shape></scene>",
    "based.toml": 'base = "mesh.xml"\n',
    "gray.toml": 'base = "grey.xml"\n[base_materials]\ngray = "brick"\n',
    "brik.toml": 'base = "grey.xml"\n[base_materials]\ngrey = "brik"\n',
    "grey.xml": XML,
    "eye.toml": WALL + "[sensor]\nname = 'table2'\n",
    "file.toml": WALL + "[sensor]\nname = 'none.toml'\n",
    "posed.toml": '[ego]\nposes_file = "way.ply"\n' + WALL,
    "way.ply": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n",
    "two.toml": LEFT_AND_RIGHT,
    "notes.txt": "hello",
    "sensor": "",
    "latin.toml": b'\nname = "caf\xe9"\n',
    "broken.toml": "a = = 1",
    "text.xml": "hello",
    "code.xml": "<?xml version='1.0' encoding='klingon'?><scene/>",
    "page.xml": "<page/>",
    "bare.xml": "<scene version='3.0.0'/>",
    "plugin.xml": XML.replace("sphere", "spher"),
    "obj.xml": "<scene version='3.0.0'><shape type='obj'><string name='filename' value='none.obj'/></shape></scene>",
    "lost.xml": "<scene version='3.0.0'><include filename='none.xml'/></scene>",
    "circle.xml": "<scene version='3.0.0'><include filename='circle.xml'/></scene>",
    "part.xml": "<scene version='3.0.0'><include filename='$part.xml'/></scene>",
    "hair.xml": "<scene version='3.0.0'><shape type='sphere' id='one'><bsdf type='hair' id='h'/></shape></scene>",
    "empty.pcap": "",
    "damaged.bin": bytes(17),
    "points.bin": np.array([[5.0, 0.0, 0.0, 0.1]], "<f4").tobytes(),
}
"""What the lines name: scenes, rigs, meshes, recordings, and what is none of them."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files, folders with their suffixes, and the shipped scenes."""
    folder = tmp_path_factory.mktemp("place")
    for name, content in FILES.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    for name in ("empty", "folder.ply", "folder.toml", "folder.xml"):
        (folder / name).mkdir()
    for suffix in (".pcap", ".json"):
        shutil.copy(OUSTER.with_suffix(suffix), folder / f"one{suffix}")
    (folder / "scenes").symlink_to(ROOT / "scenes")
    (folder / "link.ply").symlink_to("mesh.ply")
    small_cloud().save(folder / "cloud.ply")
    return folder


@pytest.fixture
def place(run: Run, shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The working directory, in which nothing can be traced: a mistake is told before."""
    monkeypatch.chdir(shared)
    for name in ("render", "stream"):
        monkeypatch.setattr(Simulator, name, None)


@mistakes(
    r"""
    render | SCENE, -o/--output | lidarscene render -h
    render car | -o/--output | lidarscene render -h
    render cars -o a.ply | scene 'cars' | car?
    render table1-apd -o a.ply | scene 'table1-apd' | a sensor
    render job -o a.ply | scene 'job' | an example
    render JOB -o a.ply | a job file
    render notes.txt -o a.ply | notes.txt | TOML
    render cloud.ply -o a.ply | point cloud | lidarscene view
    render car.fbx -o a.ply | car.fbx | FBX | Blender | glTF
    render latin.toml -o a.ply | latin.toml | UTF-8 | line 2
    render both.toml -o a.ply | both.toml | 1 more
    render none.toml -o a.ply | none.toml | no such file
    render folder.toml -o a.ply | folder.toml | TOML file | a folder
    render folder.xml -o a.ply | folder.xml | Mitsuba XML | a folder
    render 'two\nlines.toml' -o a.ply | two\nlines.toml | no such file
    render '' -o a.ply | empty | render | variable of the shell
    render wall.toml -o a.ply --sed 1 | --sed 1
    render wall.toml -oa.ply -ob.ply | -o/--output | once
    render wall.toml -o a.ply --no-deskew --deskew | --deskew/--no-deskew | once
    render wall.toml -o a.ply --frames 2 -- --frames | unrecognized arguments: -- --frames
    render wall.toml -o a.ply --verbose | --verbose | lidarscene render -h
    render wall.toml -o a.ply --sensors vlp-16 | --sensors vlp-16 | --sensor?
    render wall.toml -o a.ply --sensor car | sensor 'car' | a scene
    render wall.toml -o a.ply --sensor table1-apx | sensor 'table1-apx' | table1-apd?
    render wall.toml -o a.ply --sensor none.toml | none.toml | no such file
    render wall.toml -o a.ply --sensor LONG | sensor 'LONG' | apd-905
    render wall.toml -o a.ply --sensor wall.toml | wall.toml | 5 more | a scene file
    render wall.toml -o a.ply --sensor ./sensor | sensor | .toml
    render eye.toml -o a.ply | sensor 'table2' | table1-apd
    render file.toml -o a.ply | none.toml | no such file
    render wall.toml -o a.ply --rig wall.toml | wall.toml | 'sensors' | 1 more | a scene file
    render wall.toml -o a.ply --rig rig --sensor vlp-16 | --sensor | --rig | both
    render wall.toml -o a.ply --seed -1 | --seed | 0 | 4294967295 | -1
    render wall.toml -o a.ply --seed 4294967296 | --seed | 0 | 4294967295 | 4294967296
    render wall.toml -o a.ply --seed 1.5 | --seed | 0 | 4294967295 | 1.5
    render wall.toml -o a.ply --chunk 0 | --chunk | 1 | 2147483647 | 0
    render wall.toml -o a.ply --rays 5000 | --rays | 1 | 1024 | 5000
    render wall.toml -o a.ply --pose 1,2 | --pose | X,Y,Z[,YAW,PITCH,ROLL] | metres | 1e+08 | degrees | 1,2
    render wall.toml -o a.ply --pose nan,0,0 | --pose | nan,0,0
    render wall.toml -o a.ply --pose 1e300,0,0 | --pose | 1e300,0,0
    render wall.toml -o a.ply --pose a,b,c | --pose | a,b,c
    render wall.toml -o a.ply --pose --json | --pose | one argument
    render wall.toml -o a.ply --pose 1 2 3 | --pose | X,Y,Z[,YAW,PITCH,ROLL] | metres | 1
    render wall.toml -o a.ply --coordinates car | --coordinates | 'car' | world, vehicle, sensor
    render wall.toml -o a.ply --begin nan | --begin | nan
    render wall.toml -o a.ply --pulses 3 | --pulses | --waveforms
    render wall.toml -o a.ply --waveforms w.npz --pulses 5-1 | 0,100,2000-2010 | 5-1
    render wall.toml -o a --frames 0 | --frames | 1 | 10000 | 0
    render wall.toml -o a --frames 10001 | --frames | 1 | 10000 | 10001
    render ending.toml -o a --frames 3 COARSE | ego | 0.00924 | 0.01384 s | 0 | 0.011 s
    render ending.toml -o a --begin 5 --frames 1 COARSE | ego | 5 | 5.0046 s | 0 | 0.011 s
    render ending.toml -o a --begin -1 --frames 1 COARSE | ego | -1 | -0.9954 s | 0 | 0.011 s
    render wall.toml -o a.ply --set gain=60 | 'gain' | detector.gain?
    render wall.toml -o a.ply --set peak_power=60 | 'peak_power' | laser.peak_power_w?
    render wall.toml -o a.ply --set laser.power=3 | 'laser.power' | laser.peak_power_w?
    render wall.toml -o a.ply --set power=50 | power | table | 50 | laser.peak_power_w?
    render wall.toml -o a.ply --set led.power_w=50 | 'led' | laser.peak_power_w?
    render wall.toml -o a.ply --set scanner.fov=9 | scanner.azimuth_fov_deg | scanner.elevation_fov_deg?
    render wall.toml -o a.ply --set laser.peak_power_w | KEY=VALUE | detector.gain=60
    render wall.toml -o a.ply --set laser.peak_power_w 75 | 75 | --set laser.peak_power_w=75
    render wall.toml -o a.ply --sun 3 | --sun | by --scene-set sun.illuminance_klux=VALUE
    render wall.toml -o a.ply --fog | --fog | by --scene-set weather.fog_visibility_km=VALUE
    sweep apd-905 | 'sweep' | lidarscene range SENSOR --over AXIS
    catalog apd-905 | 'apd-905' | lidarscene catalog sensors apd-905 prints it
    render wall.toml -o a.ply --set sun.illuminance_klux=1 | 'sun' | the scene | --scene-set
    render wall.toml -o a.ply --set laser.wavelength_nm=800 | 'concrete' | 800 nm | 850 | 1550 nm
    render wall.toml -o a.ply --set scanner.azimuth_step_deg=1e-6 | 2^31 pulses
    render wall.toml -o a.ply --scene-set sun.klux=1 | 'sun.klux' | sun.illuminance_klux?
    render wall.toml -o a.ply --scene-set laser.peak_power_w=5 | laser | sensor | by --set
    render wall.toml -o a.ply --scene-set sun.illuminance_klux=100000 | 100000 | 100?
    render wall.toml -o a.ply --scene-set bodies.car.yaw_deg=3 | bodies.NAME.KEY | name of wall
    render wall.toml -o a.ply --rig two.toml | --output a.ply | folder | --rig
    render wall.toml -o a.ply --rig two.toml --frames 2 | --output a.ply | folder | --frames and --rig
    render wall.toml -o a.ply --merge | --merge | --rig
    render wall.toml -o out --rig two.toml --merge | --output out | .ply
    render wall.toml -o a.ply --rig two.toml --merge --coordinates sensor | --merge | --coordinates world | sensor
    render wall.toml -o a.ply --rig two.toml --merge --keep-missed m.npz | --keep-missed | --merge
    render wall.toml -o a --rig two.toml --set rear:tdc.stops=2 | 'rear' | left
    render wall.toml -o a --rig two.toml --set tdc.stop=2 | two.toml | sensors[0 "left"] | tdc.stop
    render none.toml -o a.abc | --output a.abc | SUFFIXES | --format
    render none.toml -o . | .ply
    render none.toml -o wall.toml/o.ply | wall.toml | a folder
    render none.toml -o /proc/none/o.ply | /proc/none | written
    render none.toml -o folder.ply | folder.ply | a file | a folder
    render none.toml -o '' | empty | -o
    render none.toml -o a.ply --format las | --output a.ply | .las
    render none.toml -o a.ply --format pdc | --format | 'pdc' | pcd?
    render none.toml -o a.bin --ascii | --ascii | ply | pcd
    render none.toml -o a.ply --labels coco | --labels | 'coco'
    render none.toml -o a.ply --range-image r.jpg | r.jpg | .png | .npz
    render none.toml -o a.ply --picture o.gif | --picture o.gif | .png | .svg
    render none.toml -o a.ply --keep-missed o.csv | --keep-missed o.csv | .npz
    render none.toml -o a.ply --keep-rays r.csv | r.csv | .npz | .parquet | .ply
    render none.toml -o a.ply --frames 3 | --output a.ply | folder | --frames
    render none.toml -o wall.toml --frames 2 | --output wall.toml | folder | --frames
    render none.toml -o a.mcap --frames 2 --labels kitti | --labels | folder of clouds
    render none.toml -o a.ply --dataset kitti | --output a.ply | folder | --dataset
    render none.toml -o a --dataset kitti --format kitti | --format | data set
    render none.toml -o a --dataset kitti --labels osi | --labels | data set
    render none.toml -o a --dataset kitti --ascii | --dataset | --ascii
    render none.toml -o a.mcap --epoch noon | --epoch | 2026-01-31 | 2026-01-31T12:00:00Z | noon
    render none.toml -o a.mcap --epoch 2040-01-01 | --epoch | '2040-01-01' | 1970 | 2038
    render none.toml -o a.ply --topic lidar | --topic | OUT.mcap
    render none.toml -o a.mcap --topic 'a b' | --topic | lidar/points | 'a b'
    render none.toml -o a.mcap --frame-id 9 | --frame-id | lidar_top | '9'
    render wall.toml -o a.mcap --frame-id map COARSE | a.mcap | frame_id | 'map'
    render wall.toml -o a.ply --vectors --no-truth COARSE | --vectors | --no-truth
    render wall.toml -o a.bin --vectors COARSE | --vectors | all columns | ply, pcd
    render wall.toml -o a.pcap --vectors --sensor vlp-16 | --vectors | all columns | ply, pcd
    render wall.toml -o a --vectors --dataset kitti COARSE | --vectors | all columns | ply, pcd
    render wall.toml -o a.ply --waveforms w.csv | --waveforms w.csv | .npz
    render wall.toml -o a.ply --waveforms w.npz --pulses 231 COARSE | pulses | 0 to 230
    render wall.toml -o a.ply --waveforms w.npz --pulses 0-99999999999 | --pulses | 0-99999999999
    render wall.toml -o a.ply --ambient a.jpg | --ambient a.jpg | .png | .npz
    render wall.toml -o a.ply --background-rays 0 | --background-rays | 1 | 1024 | 0
    render wall.toml -o a.ply --imu i.csv | --imu | [imu] | --set imu.model=bmi088
    render wall.toml -o a.ply --imu i.txt --set=imu.model=bmi088 | --imu i.txt | .csv
    render wall.toml -o a.ply --imu a.csv --poses a.csv --set=imu.model=bmi088 | --poses a.csv | .tum | .txt
    render wall.toml -o a.ply --poses p.csv | --poses p.csv | .tum | .txt
    render wall.toml -o a.ply --poses wall.toml/p.tum | wall.toml | written
    render wall.toml -o a.ply --set=imu.rate_hz=0 | imu.rate_hz | > 0 | 0
    render wall.toml -o a.ply --set=imu.model=own.toml | own.toml | no such file
    render wall.toml -o a.pcap --sensor table1-apd | sensor 'table1-apd' | packets
    render wall.toml -o a.ply --sensor vlp-16 --format pcap | --output a.ply | .pcap
    render wall.toml -o a.pcap --sensor vlp-16 --deskew | --deskew | clouds | packets
    render wall.toml -o a.pcap --sensor vlp-16 --labels kitti | --labels | clouds
    render wall.toml -o a.pcap --sensor vlp-16 --ascii | --ascii | clouds
    render wall.toml -o a.pcap --sensor vlp-16 --format pcap-legacy | Ouster | packets
    render mesh.toml -o mesh.ply | --output mesh.ply | an input
    render mesh.toml -o link.ply | --output link.ply | an input
    render based.toml -o link.ply | --output link.ply | an input
    render mesh.xml -o link.ply | --output link.ply | an input
    render posed.toml -o way.ply | --output way.ply | an input
    render text.xml -o a.ply | text.xml | XML | line 1, column 0
    render code.xml -o a.ply | code.xml | XML
    render page.xml -o a.ply | page.xml | Mitsuba scene
    render bare.xml -o a.ply | bare.xml | no shapes
    render plugin.xml -o a.ply | plugin.xml | shape type | 'spher'
    render obj.xml -o a.ply | obj.xml | Mitsuba scene | "obj"
    render lost.xml -o a.ply | none.xml | no such file
    render circle.xml -o a.ply | circle.xml | include each other
    render part.xml -o a.ply | part.xml | Mitsuba scene
    render hair.xml -o a.ply | hair.xml | BSDF 'h' | shape 'one'
    render gray.toml -o a.ply | grey.xml | base_materials | 'gray' | grey
    render brik.toml -o a.ply | brik.toml | base_materials.grey | 'brik' | brick
    render car apd-905 -o a.ply | --sensor apd-905
    render wall.toml -o a.ply --colors range | --colours?
    Render car -o a.ply | 'Render' | render?
    --sensor vlp-16 render car -o a.ply | the command goes first | lidarscene COMMAND --sensor
    ls | 'ls' | lidarscene catalog, catalog sensors
    plot car | 'plot' | render, stream, batch
    rendr | COMMAND | 'rendr' | render?
    '' view | empty | lidarscene
    view | CLOUD|DIR|SCENE|REC | lidarscene view -h
    view nothing.pcap | nothing.pcap | no such recording
    view nowhere/street.toml --save a.html | its name, street
    view a.blend | a.blend | Blender | glTF
    view notes.txt | notes.txt | '.txt' | .ply
    view empty | empty | .las, .laz, .npz, .parquet, .pcd, .ply | none
    view empty.pcap | empty.pcap | points | packets | empty file
    view damaged.bin --save p.html | damaged.bin | rows of 16 bytes
    view points.bin --frame 4 --save p.html | frame | 0 to 0 | 4
    view points.bin cloud.ply --save p.html | alone | 2 paths
    view points.bin --pose 0,0,1 --save p.html | --pose | scene | clouds
    view cloud.ply --frame 1 --save p.html | --frame | recording | cloud.ply
    view cloud.ply --pose 0,0,1 | --pose | scene | clouds
    view wall.toml --frame 1 | --frame | recording | wall.toml
    view wall.toml wall.toml | one scene | wall.toml and wall.toml
    view wall.toml --save page.pdf | --save page.pdf | .html
    view wall.toml --save wall.toml/page.html | wall.toml/page.html | written
    view wall.toml --port 99999 | --port | 0 | 65535 | 99999
    view wall.toml --set laser.colour=1 --save p.html | 'laser.colour'
    compare apd-905 sipm-905 | -o/--output | --sensors A,B
    compare apd-905 sipm-905 -o out | --sensors apd-905,sipm-905
    compare -o out --sensors table1-apd,table1-sipm | SCENE|CLOUD
    compare wall.toml --sensors table1-apd,table1-sipm | -o/--output | lidarscene compare -h
    compare wall.toml --sensors table1-apd table1-sipm -o out | --sensors A,B
    compare wall.toml --sensors table1-apd,table1-apx -o out | 'table1-apx' | table1-apd?
    compare wall.toml -o out | wall.toml | --sensors A,B | two clouds | one
    compare wall.toml wall.toml -o out --sensors table1-apd,table1-sipm | --sensors | one scene | 2 files
    compare wall.toml -o out --sensors table1-apd | --sensors | 2 to 7 | commas
    compare wall.toml -o wall.toml --sensors table1-apd,table1-sipm | wall.toml | a folder
    compare wall.toml -o out --sensors table1-apd,table1-sipm --illuminance-klux 10,1 | klux that rise | 10,1
    compare wall.toml -o out --sensors table1-apd,table1-sipm --illuminance-klux 1e9 | klux 1e+09 | 10000 klux
    compare cloud.ply b.ply -o out --illuminance-klux 1 | --illuminance-klux | scene | --sensors
    compare cloud.ply b.ply -o out --seed 0 | --seed | scene | --sensors
    compare a.ply b.ply -o out | a.ply | no such file
    compare wall.toml b.ply -o out | wall.toml | '.toml'
    range | SENSOR | lidarscene range -h
    range table1-apd --illuminance 1 | --illuminance-klux?
    range table1-apd,table1-sipm | one sensor | spaces
    range table1-apd --csv o.csv | --csv | --over
    range table1-apd --plot a.png | --plot | --over
    range table1-apd --quantity snrs | --quantity | 'snrs' | snr?
    range table1-apd --over gain | --over gain | table1-apd.toml | detector.gain?
    range table1-apd --over ranges | ranges | distance, illuminance_klux
    range table1-apd table1-sipm --over detector.gain | --over detector.gain | table1-sipm.toml
    range table1-apd --over detector.circuit_noise_na | 0 in table1-apd.toml | --from | --to
    range table1-apd --over detector.gain --from 0.5 | >= 1 | 0.5
    range table1-apd --over detector.gain --from -3 --to 5 --scale log | more than 0 | -3
    range table1-apd --over detector.gain --from 5 --to 5 | --from | below --to
    range table1-apd --over detector.gain --set detector.gain=3 | --set detector.gain=3 | --over
    range table1-apd --over distance --from 2000 | --from | below --to
    range table1-apd --over distance --from 0 | --from 0 | more than 0
    range table1-apd --over distance --n 1 | --n | 2 | 100000 | 1
    range table1-apd --over distance --to inf | --to | number | inf
    range table1-apd --over distance --quantity range | --over distance | --quantity range
    range table1-apd --over distance --distance 5 | --distance | --over distance
    range table1-apd --over distance --aperture-law cosine | --aperture-law | --over elevation
    range table1-apd --over distance --plot o.jpg | --plot o.jpg | .png | .svg
    range table1-apd --over distance --csv o.txt | --csv o.txt | .csv
    range table1-apd --over distance --sensitivities | --sensitivities | --over
    range table1-apd --over illuminance_klux --from 0 | more than 0 | logarithmic | even steps
    range table1-apd --over illuminance_klux --to 100000 | --to 100000 | 0 | 10000 klux | 100?
    range table1-apd --over illuminance_klux --illuminance-klux 5 | --illuminance-klux | --over illuminance_klux
    range table1-apd --over illuminance_klux --distance 5 | --distance | --quantity snr | pd
    range table1-apd --over azimuth --from -95 --aperture-law mirror | 89 degrees
    range table1-apd --set x:detector.gain=3 | 'x' | table1-apd
    range table1-apd --set detector.pde=0.3 | table1-apd.toml | --set detector.pde=0.3 | 'detector.pde'
    range table1-apd --reflectivity 10 | --reflectivity 10 | 0 or more | up to 1 | 0.1?
    range table1-apd --illuminance-klux 100000 | --illuminance-klux 100000 | 0 or more | up to 10000 klux | 100?
    range table1-apd --incidence 91 | --incidence 91 | 0 or more | up to 90 deg
    range table1-apd --probability 1 | --probability 1 | 0.001 or more | up to 0.999
    range table1-apd --distance 0 | --distance 0 | more than 0
    range table1-apd --transmittance 0 | --transmittance 0 | more than 0 | up to 1
    range table1-apd --visibility 0 | --visibility 0 | more than 0
    range table1-apd --extinction -1 | --extinction -1 | 0 or more
    range table1-apd --visibility 1 --extinction 1 | --visibility | --extinction
    range table1-apd --sun-angle x | --sun-angle | number | x
    range table1-apd --eye-safety --sensitivities --json | --json | --sensitivities | --eye-safety
    range table1-apd table1-sipm --sensitivities --plot o.png | --plot | --over
    fov table1-apd | -o/--output | lidarscene fov -h
    fov -o out | SENSOR | --rig | none
    fov table1-apd --rig r.toml -o out | SENSOR | --rig | both
    fov table1-apd -o out --pose 0,0,1 | --pose | --scene
    fov table1-apd -o out --time 1,0.5 | --time | seconds that rise | 1,0.5
    fov table1-apd -o out --time a,b | --time | seconds that rise | 0.1,0.5,1 | a,b
    fov table1-apd -o out --time 1000 | --time | 1000 s
    fov table1-apd -o out --cell 0 | --cell | 0.02 to 10 degrees | 0
    fov table1-apd -o out --reflectivity -1 | --reflectivity -1
    fov table1-apd -o out --mask round | --mask | 'round'
    paper | -o/--output
    paper -o notes.txt | notes.txt | a folder
    batch wall.toml -o out | wall.toml | 'scenes' | 1 more | a scene file
    batch none.toml -o out | none.toml | no such file
    batch job | -o/--output
    batch job -o notes.txt | --output notes.txt | folder | a file
    batch job -o out --workers 1 --scheduler a:1 | --workers | --scheduler | both
    batch job -o out --workers 0 | --workers | 1 | 1024 | 0
    check | FILE | lidarscene check -h
    catalog sensor | kind | 'sensor' | sensors?
    catalog sensors table1 | sensor 'table1' | table1-apd
    catalog materials brik | material 'brik' | brick
    catalog materials ../sensors/table1-apd | material '../sensors/table1-apd'
    catalog check vlp17 | sensor 'vlp17' | vlp-16
    schema scenes | kind | 'scenes' | scene?
    completion fish | 'fish'
    doctor --jsn | --jsn | --json? | lidarscene doctor -h
    sensor vlp-16 | --from, -o/--output | lidarscene sensor -h
    sensor --from notes.txt -o a.toml | json, OSF | pcap | (Ouster) | YAML | XML (Velodyne) | CSV | dat (Hesai)
    sensor --from . -o a.toml | a file | a folder
    sensor --from one.json -o mine.txt | --output mine.txt | .toml
    sensor --from one.json --like table1-apd -o a.toml | --like table1-apd | spins
    twin none.pcap -o out --frames 0-4 | --frames | numbers with commas | 0-4
    twin none.pcap -o out --held-out half | --held-out | number of a frame | half
    twin one.pcap -o out --held-out 0 | --held-out 0 | a frame
    twin one.pcap -o out --sensor vlp-16 | --sensor | 32 rings of the recording | 16 channels
    certify points.bin -o out | --metadata | --sensor NAME
    certify damaged.bin -o out | rows of 16 bytes
    certify one.pcap --scene wall.toml -o out | scene of a twin
    fit | lidarscene fit -h
    fit one.pcap --report r -o u.toml --poses p.csv --sensor os0-128 | --poses | --scene
    fit one.pcap --report r -o u.toml | --sensor | name
    fit one.pcap --report r -o u.toml --frames 1 --scene s.toml | --frames | --scene
    fit one.pcap --report r -o u.json --sensor os0-128 | u.json | .toml
    fit one.pcap --report r -o u.toml --sensor none.toml | --sensor none.toml | No such file
    fit one.pcap --report r -o u.toml --sensor broken.toml | sensor broken.toml | TOML
    stream wall.toml | --udp
    stream wall.toml --sensor vlp-16 | lidarscene stream -h
    stream wall.toml --udp 2368 | --udp | host | port | 127.0.0.1:2368 | 2368
    stream wall.toml --udp 127.0.0.1:0 | --udp | host | port | 127.0.0.1:0
    stream wall.toml --udp 127.0.0.1:9 --rate 0 | --rate | 0.001 | 1000 frames | 0
    stream wall.toml --udp 127.0.0.1:9 --sensor table1-apd | sensor 'table1-apd' | packets
    stream wall.toml --udp 127.0.0.1:9 --sensor vlp-16 --metadata a.json | --metadata | sensor 'vlp-16'
    street --length-m 10 -o out | street | length_m | >= 50 | 10.0
    street -o t.toml | --output | folder | t.toml
    street --length-m 60 --set length_m=70 -o out | --length-m | --set length_m=70 | both
    street --set street.length_m=60 -o out | --set street.length_m=60 | length_m?
    street --set lane=2 -o out | 'lane'
    street | -o/--output
    """,
    JOB=str(catalog.path_of("examples", "job")),
    LONG="long" * 99,
    COARSE=" ".join(COARSE),
    SUFFIXES=", ".join(SUFFIXES),
)
@pytest.mark.usefixtures("place")
def test_typed(run: Run, given: str, named: str) -> None:
    typed(run, named, *shlex.split(given))


@mistakes(
    """
    laser.peak_power_w=-3 | laser.peak_power_w | >= 1e-06 | -3
    laser.pek_power_w=3 | 'laser.pek_power_w' | peak_power_w? | wavelength_nm
    laser=3 | laser | table | 3
    scanner.elevation_fov_deg=0.0 | scanner.elevation_fov_deg | > 0 | 0.0
    scanner.azimuth_step_deg=41 | scanner | azimuth_step_deg | <= 40 | azimuth_fov_deg | 41
    scanner.type=galvo | scanner.type | 'raster' | galvo
    detector.cells=3 | 'detector.cells' | type, gain
    detector.gain=0.5 | detector.gain | >= 1 | 0.5
    detector.ionisation_ratio=0.1 | excess_noise_index | ionisation_ratio | both
    tdc.threshold_level=1 | threshold_to_noise | threshold_level | both
    tdc.threshold_to_noise=1e-30 | tdc.threshold_to_noise | >= 0.01 | 1e-30
    tdc.stops=1.5 | tdc.stops | whole number | 1.5
    mounting.position_m=[1, 2, 3, 4] | mounting.position_m | at most 3 | 4
    detector.gain | KEY=VALUE
    =60 | KEY=VALUE
    detector..gain=60 | KEY=VALUE
    laser.peak_power_w.x=1 | laser.peak_power_w | a value | not a table
    """
)
@pytest.mark.usefixtures("place")
def test_set(run: Run, given: str, named: str) -> None:
    file = "" if "KEY=VALUE" in named or "not a table" in named else "table1-apd.toml | "
    typed(run, f"{file}--set {given} | {named}", "render", "wall.toml", "-o", "o.ply", *COARSE, "--set", given)


def test_files_come_behind_the_mistake(run: Run, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("lenght = 3")
    for name, mistake in (("scene.toml", "'lenght'"), ("none.toml", "no such file")):
        for path in (name, str(tmp_path / name)):
            typed(run, f"{mistake} | ({path})", "render", path, "-o", "out.ply")


@pytest.mark.parametrize(
    ("target", "more", "file"),
    [
        ("lidarscene.files.atomic._sync", [], "new/o.ply"),
        ("zipfile.ZipFile", ["--keep-missed", "new/m.npz"], "new/m.npz"),
        ("lidarscene.files.spool.Spool.append", ["--keep-missed", "new/m.npz"], "new/m.npz"),
    ],
)
def test_a_full_disk(
    run: Run, wall: str, mi: ModuleType, monkeypatch: pytest.MonkeyPatch, target: str, more: list[str], file: str
) -> None:
    """Nothing half written stays, not even a new folder."""
    monkeypatch.setattr(target, raise_disk_full)
    typed(run, f"{file} | No space left on device", "render", wall, "-o", "new/o.ply", *COARSE, *more)


def raising(error: type[BaseException]) -> Any:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    return fail


@pytest.mark.parametrize("target", ["lidarscene.rendering.simulator.Simulator.stream", "lidarscene.files.atomic._sync"])
def test_interrupt_leaves_nothing(
    run: Run, tmp_path: Path, wall: str, mi: ModuleType, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    monkeypatch.setattr(target, raising(KeyboardInterrupt))
    ran = run("render", wall, "-o", "new/o.ply", *COARSE)
    assert (ran.code, ran.out, ran.err) == (130, "", "lidarscene: interrupted\n")
    assert [path.name for path in tmp_path.iterdir()] == [wall]


def test_memory_that_is_not_there(run: Run, wall: str, mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Simulator, "stream", raising(MemoryError))
    typed(run, "out of memory | --chunk", "render", wall, "-o", "new/o.ply", *COARSE, code=1)


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: lidarscene.load_rig("wall.toml"), "a scene file"),
        (lambda: lidarscene.render("wall.toml", pose=2.0 * np.eye(4)), "pose | yaw, pitch, roll | array([[2., 0.,"),
        (lambda: lidarscene.render("wall.toml", overrides="gain=3"), "'gain' | detector.gain?"),
        (lambda: lidarscene.render(lidarscene.load_sensor("vlp-16")), "Mitsuba | Sensor"),
        (lambda: lidarscene.record("wall.toml", outputs="a.abc"), "path a.abc | .ply"),
        (lambda: small_cloud().select(small_cloud().status), "select | cloud.status == 0"),
        (lambda: small_cloud().view(scene="kar"), "scene 'kar' | car"),
        (lambda: lidarscene.deskewed(small_cloud(), (1, 0, 0)), "Simulator.motion | tuple"),
    ],
)
def test_called(call: Callable[[], Any], named: str) -> None:
    """The public names of Python, whose answers the command line shares."""
    with told(named):
        call()


def test_wavelengths_within_a_table_are_none(run: Run, wall: str, mi: ModuleType) -> None:
    assert run("render", wall, "-o", "o.ply", *COARSE, "--set", "laser.wavelength_nm=1400").code == 0
