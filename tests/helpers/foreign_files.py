"""Files of others, whole and spoilt: recordings of every kind, what makers say of a unit, USD stages, meshes that refer
to other files.

Each whole file is small, and is made when it is first asked for. It is spoilt by bytes, and by meaning: numbers within
packets, messages and rows of points, fields of a header, leaves of json, cells of a database.
"""

from __future__ import annotations

import contextlib
import json
import random
import shutil
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from helpers.clouds import small_cloud
from helpers.formats import PLACED, write_bag
from helpers.packets import firings_of, packets_of, random_frame
from helpers.recordings import OUSTER, hesai_packet, pcap, scan_bag, turns, vls_packet
from helpers.spoiling import number, other_numbers, spoilt, spoilt_bytes, spoilt_lines, text
from lidarscene.errors import InputError, LidarSceneError
from lidarscene.formats.packets.ouster_encoder import PROFILES
from lidarscene.formats.packets.pcap import pcap_stream
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.recordings.pcap_reader import map_file, records_of
from lidarscene.sensor.sensor_file import load_sensor

EXTREMES = (
    *(struct.pack("<f", value) for value in (np.nan, np.inf, -np.inf, 3e38, -3e8, 1e-40, 0.0)),
    *(struct.pack("<d", value) for value in (np.nan, np.inf, 1e308, -3e8, 0.0)),
    *(struct.pack("<I", value) for value in (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 65536)),
    *(struct.pack("<Q", value) for value in (0, 2**31, 2**32, 2**40, 2**63 - 1, 2**63, 2**64 - 1)),
    *(struct.pack("<H", value) for value in (0, 1, 0x7FFF, 0xFFFF)),
    b"\0",
    b"\xff",
)
"""Values that a number in a binary file may be set to."""

ROWS = np.array([[9.0, 1.0, 0.5, 0.2, 0.0], [8.0, -2.0, 0.1, 0.9, 1.0], [0.0, 0.0, 0.0, 0.0, 2.0]] * 9, "<f4")


def _velodyne(folder: Path) -> Path:
    return pcap(folder / "vlp.pcap", [*turns(12), *turns(4)])


def _vls(folder: Path) -> Path:
    return pcap(folder / "vls.pcap", [vls_packet(60 * n, 20, 160 * n) for n in range(8)])


def _hesai(folder: Path) -> Path:
    return pcap(folder / "xt.pcap", [hesai_packet(144 * n, 2500) for n in range(8)])


def _pandar64(folder: Path) -> Path:
    sensor = load_sensor("pandar64")
    packets = packets_of(select_encoder(sensor), sensor, [random_frame(sensor)])
    return pcap(folder / "p64.pcap", [packet.payload for packet in packets[:20]])


def _ouster(folder: Path) -> Path:
    shutil.copy(OUSTER.with_suffix(".json"), folder / "os.json")
    return Path(shutil.copy(OUSTER, folder / "os.pcap"))


def _our_ouster(profile: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        sensor = load_sensor("os0-128", overrides=["scanner.columns_per_turn=512"])
        with pcap_stream(folder / "ours.pcap", select_encoder(sensor, profile)) as take:
            take(firings_of(sensor))
        path = folder / "ours.pcap"
        data = path.read_bytes()
        records = [record for _, _, record in records_of(map_file(path), path)]
        path.write_bytes(data[: records[5].stop])  # 96 columns of 512
        return path

    return write


def _osf(folder: Path) -> Path:
    from ouster.sdk import core, osf

    info = core.SensorInfo(OUSTER.with_suffix(".json").read_text())
    writer = osf.Writer(str(folder / "a.osf"), info)
    frame = core.LidarFrame(info)
    frame.status[:] = 1
    frame.timestamp[:] = 10**9 + np.arange(1024) * 97_656
    frame.measurement_id[:] = np.arange(1024)
    frame.field("RANGE")[:] = 4000
    writer.save(0, frame)
    writer.close()
    return folder / "a.osf"


def _rows(name: str, columns: int) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(ROWS[:, :columns].tobytes())
        return folder / name

    return write


def _cloud(name: str, **options: Any) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        small_cloud(30).save(folder / name, **options)
        return folder / name

    return write


def _compressed_pcd(folder: Path) -> Path:
    import lzf

    header = (
        f"VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(ROWS)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(ROWS)}\nDATA binary_compressed\n"
    )
    unpacked = np.ascontiguousarray(ROWS[:, :4].T).tobytes()
    packed = lzf.compress(unpacked)
    path = folder / "c.pcd"
    path.write_bytes(header.encode() + struct.pack("<II", len(packed), len(unpacked)) + packed)
    return path


def _bag(name: str, storage: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        metadata = PLACED | {"frame_start_s": "2.0", "sensor_to_world": "0 -1 0 1  1 0 0 2  0 0 1 3"}
        clouds = [small_cloud(20, seed=seed, metadata=metadata) for seed in (1, 2)]
        write_bag(folder / name, *clouds, storage=storage)
        return folder / name

    return write


RECORDINGS: dict[str, Callable[[Path], Path]] = {
    "velodyne pcap": _velodyne,
    "vls pcap": _vls,
    "hesai pcap": _hesai,
    "pandar64 pcap": _pandar64,
    "ouster pcap": _ouster,
    **{f"our ouster pcap {profile}": _our_ouster(profile) for profile in PROFILES},
    "osf": _osf,
    "kitti": _rows("k.bin", 4),
    "nuscenes": _rows("n.pcd.bin", 5),
    "ascii pcd": _cloud("a.pcd", ascii=True),
    "binary pcd": _cloud("b.pcd"),
    "compressed pcd": _compressed_pcd,
    "ascii ply": _cloud("a.ply", ascii=True),
    "binary ply": _cloud("b.ply"),
    "las": _cloud("a.las"),
    "laz": _cloud("a.laz"),
    "mcap": _bag("a.mcap", "mcap"),
    "db3": _bag("b.db3", "sqlite3"),
    "bag of packets": lambda folder: scan_bag(folder / "scans", packets=8),
}
"""Kind -> function that writes a whole recording into a folder and returns its path."""

VELODYNE_XML = "<boost_serialization><DB>\n<enabled_>" + "<item>1</item>\n" * 16 + "</enabled_>\n<points_>\n"
VELODYNE_XML += "".join(
    f"<item><px>\n<id_>{n}</id_>\n<rotCorrection_>{0.3 * n - 2}</rotCorrection_>\n<vertCorrection_>{2 * n - 15}"
    "</vertCorrection_>\n<vertOffsetCorrection_>1.2</vertOffsetCorrection_>\n<horizOffsetCorrection_>2.6"
    "</horizOffsetCorrection_>\n</px></item>\n"
    for n in range(16)
)
DESCRIPTIONS = {
    "ouster.json": OUSTER.with_suffix(".json").read_bytes(),
    "velodyne.yaml": (
        "num_lasers: 16\ndistance_resolution: 0.002\nlasers:\n"
        + "".join(
            f"- {{dist_correction: 0.0, laser_id: {n}, rot_correction: 0.0, vert_correction: {0.035 * n - 0.26},\n"
            "   vert_offset_correction: 0.0112, horiz_offset_correction: 0.026}\n"
            for n in range(16)
        )
    ).encode(),
    "velodyne.xml": f"{VELODYNE_XML}</points_></DB></boost_serialization>\n".encode(),
    "hesai.csv": (
        "Laser id,Elevation,Azimuth\n" + "".join(f"{n + 1},{15 - n * 0.6:.3f},{0.1 * (n % 3):.3f}\n" for n in range(64))
    ).encode(),
}
"""Name -> what a maker says of a unit."""

USD = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    subLayers = [@{part}@]
)
def Xform "all" (
    references = @{part}@</part>
)
{{
    double3 xformOp:translate = (9, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "mesh"
    {{
        point3f[] points = [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        int[] holeIndices = []
        color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]
        rel material:binding = </all/paint>
        def GeomSubset "side"
        {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [0]
        }}
    }}
    def Material "paint"
    {{
        token outputs:surface.connect = </all/paint/preview.outputs:surface>
        def Shader "preview"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.2, 0.3, 0.4)
            token outputs:surface
        }}
    }}
    def Cube "cube"
    {{
        double size = 1
    }}
    def Plane "plane"
    {{
        double width = 2
        double length = 1
        token axis = "X"
    }}
    def Cone "cone"
    {{
        double height = 1
        double radius = 0.5
        token axis = "Y"
    }}
    def PointInstancer "many"
    {{
        point3f[] positions = [(1, 0, 0), (2, 0, 0)]
        int[] protoIndices = [0, 0]
        rel prototypes = </all/cube>
    }}
}}
"""
PART = '#usda 1.0\ndef Xform "part"\n{\n    def Sphere "ball"\n    {\n        double radius = 1\n    }\n}\n'

GLTF = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "translation": [8, 0, 0], "children": []}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
    "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    "textures": [{"source": 0}],
    "images": [{"uri": "part.png"}],
    "buffers": [{"uri": "part.bin", "byteLength": 44}],
    "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ],
}
TRIANGLE = np.array([0, 0, 0, 1, 0, 0, 0, 1, 1], "<f4").tobytes() + np.array([0, 1, 2, 0], "<u2").tobytes()
OBJ_WITH_MATERIALS = "mtllib {part}\nusemtl a\nv 8 0 0\nv 8 1 0\nv 8 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
MTL = "newmtl a\nKd 0.1 0.5 0.2\nmap_Kd {part}\n"
PARTS = (
    "pipe",
    "folder",
    "/dev/zero",
    "/dev/stdin",
    "none",
    "../in",
    "/proc/self/mem",
    "x" * 300,
    "http://127.0.0.1:9/a",
)
"""What a mesh file should not refer to."""


class ForeignFiles:
    """Whole files of each kind, and spoilt copies of them.

    Args:
        whole: folder of the whole files
        folder: folder of the spoilt ones
    """

    def __init__(self, whole: Path, folder: Path) -> None:
        self._whole, self._folder = whole, folder
        whole.mkdir()
        self._recordings: dict[str, Path | None] = {}

    def recording(self, rng: random.Random) -> tuple[str, Path]:
        """Kind and path of a spoilt recording."""
        while True:
            kind = rng.choice(list(RECORDINGS))
            if kind == "osf" and rng.random() < 0.8:
                continue  # each takes a process
            if kind not in self._recordings:
                folder = self._whole / kind
                folder.mkdir()
                try:
                    self._recordings[kind] = RECORDINGS[kind](folder)
                except (LidarSceneError, ImportError) as error:
                    if isinstance(error, InputError):
                        raise
                    self._recordings[kind] = None  # a package is missing
            whole = self._recordings[kind]
            if whole is not None:
                return kind, self._spoilt_recording(rng, whole)

    def description(self, rng: random.Random, name: str | None = None) -> Path:
        """Path of a spoilt description of a unit."""
        name = name or rng.choice(list(DESCRIPTIONS))
        whole = DESCRIPTIONS[name]
        return self._write(name, spoilt_json(rng, whole) if name.endswith("json") else spoilt(rng, whole))

    def stage(self, rng: random.Random) -> Path:
        """Path of a spoilt USD stage, as text, binary or archive, with a part that may be anything."""
        suffix = rng.choice(("usda", "usda", "usdc", "usdz"))
        part = rng.choice((*PARTS, "s.usda", *["part.usda"] * 10))
        stage = USD.format(part=part)
        if part == "part.usda":
            self._write("part.usda", PART.encode() if rng.random() < 0.5 else spoilt(rng, PART.encode()))
        if suffix == "usda":
            return self._write("s.usda", spoilt(rng, stage.encode()))
        whole = self._whole / f"s.{suffix}"
        if not whole.exists():
            from pxr import Sdf, UsdUtils

            (self._whole / "part.usda").write_text(PART)
            (self._whole / "s.usda").write_text(USD.format(part="part.usda"))
            Sdf.Layer.FindOrOpen(str(self._whole / "s.usda")).Export(str(self._whole / "s.usdc"))
            UsdUtils.CreateNewUsdzPackage(str(self._whole / "s.usda"), str(self._whole / "s.usdz"))
        data = whole.read_bytes()
        return self._write(whole.name, rng.choice((spoilt_bytes, spoilt_in_place))(rng, data))

    def mesh(self, rng: random.Random) -> Path:
        """Path of a spoilt OBJ or glTF whose parts may be anything."""
        part = rng.choice((*PARTS, *["part.bin"] * 6))
        self._write("part.bin", TRIANGLE if rng.random() < 0.5 else spoilt_bytes(rng, TRIANGLE))
        if rng.random() < 0.5:
            self._write("a.mtl", spoilt_lines(rng, MTL.format(part=part)).encode("utf-8", "surrogatepass"))
            whole = OBJ_WITH_MATERIALS.format(part="a.mtl" if rng.random() < 0.7 else part)
            return self._write("r.obj", spoilt(rng, whole.encode()))
        content = json.loads(json.dumps(GLTF))
        content[rng.choice(("images", "buffers"))][0]["uri"] = part
        return self._write("r.gltf", spoilt_json(rng, json.dumps(content).encode()))

    def _write(self, name: str, data: bytes) -> Path:
        path = self._folder / name
        path.write_bytes(data)
        return path

    def _spoilt_recording(self, rng: random.Random, whole: Path) -> Path:
        path = self._folder / whole.name
        if whole.is_dir():
            shutil.rmtree(path, ignore_errors=True)
            shutil.copytree(whole, path)
            parts = sorted(path.iterdir())
            part = rng.choice(parts)
            if rng.random() < 0.05:
                part.unlink()
            else:
                _spoil(rng, part)
            return path
        for beside in whole.parent.iterdir():
            if beside.is_file():
                shutil.copy(beside, self._folder)
        description = path.with_suffix(".json")
        if description.exists() and rng.random() < 0.4:
            description.write_bytes(spoilt_json(rng, description.read_bytes()))
            if rng.random() < 0.5:
                return path
        _spoil(rng, path)
        return path


def spoilt_json(rng: random.Random, whole: bytes) -> bytes:
    """Leaves and entries of json changed; or spoilt as text."""
    if rng.random() < 0.2:
        return spoilt(rng, whole)
    content = json.loads(whole)
    for _ in range(rng.choice((1, 1, 2, 4))):
        table: Any = content
        while True:
            keys = list(table) if isinstance(table, dict) else list(range(len(table)))
            if not keys:
                break
            key = rng.choice(keys)
            if isinstance(table[key], dict | list) and table[key] and rng.random() < 0.8:
                table = table[key]
                continue
            if rng.random() < 0.2:
                del table[key]
            else:
                table[key] = _json_value(rng, table[key])
            break
    return json.dumps(content).encode()


def _json_value(rng: random.Random, value: Any) -> Any:
    kind = rng.randint(0, 7)
    if kind <= 1 and isinstance(value, int | float):
        return value * rng.choice((-1, 0, 2, 1000, 1e9, 0.5))
    if kind == 2 and isinstance(value, list):
        return value * rng.choice((0, 2, 100))
    if kind <= 4:
        with contextlib.suppress(ValueError):
            return json.loads(number(rng))
    if kind == 5:
        return text(rng)
    return rng.choice((None, True, [], {}, [[]], [value], {"a": value}, -1, 1e300, 2**70, float("inf"), float("nan")))


def spoilt_in_place(rng: random.Random, data: bytes, start: int = 0, stop: int | None = None) -> bytes:
    """Bytes of the same length, with numbers between start and stop made extreme."""
    spoilt_data = bytearray(data)
    stop = len(data) if stop is None else min(stop, len(data))
    for _ in range(rng.choice((1, 1, 2, 8))):
        extreme = rng.choice(EXTREMES) if rng.random() < 0.8 else rng.randbytes(rng.choice((1, 2, 4)))
        offset = rng.randint(start, max(stop - len(extreme), start))
        if offset + len(extreme) <= len(spoilt_data):
            spoilt_data[offset : offset + len(extreme)] = extreme
    return bytes(spoilt_data)


def _spoil(rng: random.Random, path: Path) -> None:
    """Spoil a file by bytes, or by what its kind of file means."""
    data = path.read_bytes()
    suffix = path.suffix.lower()
    if rng.random() < 0.3 or not data:
        path.write_bytes(spoilt(rng, data))
    elif suffix == ".pcap":
        records = [record for _, _, record in records_of(map_file(path), path)]
        record = rng.choice(records)
        path.write_bytes(spoilt_in_place(rng, data, record.start + (42 if rng.random() < 0.8 else 0), record.stop))
    elif suffix == ".db3":
        _spoil_database(rng, path)
    elif suffix == ".mcap":
        path.write_bytes(spoilt_in_place(rng, data, *rng.choice(_mcap_records(data))))
    elif (suffix == ".pcd" or suffix == ".ply") and rng.random() < 0.6:
        end = next(data.index(word) + len(word) for word in (b"end_header\n", b"\nDATA ") if word in data)
        header = rng.choice((spoilt_lines, other_numbers))(rng, data[:end].decode("latin-1"))
        path.write_bytes(header.encode("utf-8", "surrogatepass") + data[end:])
    elif suffix in (".las", ".laz") and rng.random() < 0.6:
        path.write_bytes(spoilt_in_place(rng, data, 90, 700 if rng.random() < 0.5 else 375))
    else:
        path.write_bytes(spoilt_in_place(rng, data))


def _mcap_records(data: bytes) -> list[tuple[int, int]]:
    """Start and end of each record, from its length on."""
    records, offset = [], 8
    while offset + 9 <= len(data) - 8:
        (length,) = struct.unpack_from("<Q", data, offset + 1)
        records.append((offset, offset + 9 + min(length, 200)))
        offset += 9 + length
    return records


def _spoil_database(rng: random.Random, path: Path) -> None:
    """Change one cell of an SQLite file."""
    with contextlib.closing(sqlite3.connect(path)) as database, database, contextlib.suppress(sqlite3.Error):
        tables = [name for (name,) in database.execute("select name from sqlite_master where type = 'table'")]
        table = rng.choice(["messages", "messages", "topics", *tables])
        columns = [row[1] for row in database.execute(f"pragma table_info({table})")]
        column = "data" if table == "messages" and rng.random() < 0.7 else rng.choice(columns)
        rows = database.execute(f"select rowid, {column} from {table}").fetchall()
        row, value = rng.choice(rows) if rows else (0, None)
        if isinstance(value, bytes):
            value = spoilt_in_place(rng, value, 0, 300 if rng.random() < 0.7 else None)
            value = value[: rng.randrange(len(value) + 1)] if rng.random() < 0.15 else value
        else:
            value = rng.choice((None, 0, -1, 2**62, 1.5, b"a", text(rng).encode("utf-8", "replace").decode()))
        database.execute(f"update {table} set {column} = ? where rowid = ?", (value, row))
