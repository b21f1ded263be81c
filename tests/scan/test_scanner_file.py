"""[scanner] of a sensor file: every kind, in people's units, and one clear line for each mistake."""

from pathlib import Path

import numpy as np
import pytest
from helpers import scanners
from helpers.mistakes import mistakes, refused, told
from helpers.scanners import DEG

from lidarscene import catalog, load_sensor, scan
from lidarscene.files.toml import read_toml
from lidarscene.sensor.sensor_file import sensor_from_tables

SCANNERS = {
    "spinning": {
        "rotation_hz": -10.0,
        "cycle_us": 55.296,
        "elevation_deg": [float(e) for e in scanners.VLP16_FIRING_ORDER_DEG],
        "firing_time_us": [2.304 * n for n in range(16)],
        "height_mm": list(scanners.VLP16_HEIGHT_MM),
    },
    "mirror": {"azimuth_turn_deg": 15.0, "elevation_turn_deg": 6.0, "pulses_per_line": 120, "lines": 41},
    "lissajous": {
        "azimuth_turn_deg": 12.0,
        "elevation_turn_deg": 8.0,
        "azimuth_hz": 1310.0,
        "elevation_hz": 1190.0,
        "azimuth_phase_deg": 0.3 / DEG,
        "elevation_phase_deg": 1.2 / DEG,
        "frame_hz": 10.0,
        "incidence_deg": 0.3 / DEG,
        "side": "left",
    },
    "polygon": {
        "rotation_hz": 30.0,
        "facet_tilt_deg": [-4.0, -1.0, 2.0, 5.0],
        "duty": 0.6,
        "incidence_deg": 40.0,
        "inradius_mm": 30.0,
    },
    "risley": {
        "frame_hz": 10.0,
        "wedges": [
            {"angle_deg": 18.7481, "index": 1.51, "rotation_hz": -121.5657, "inclined_face": "out"},
            {"angle_deg": 17.9634, "index": 1.51, "rotation_hz": 77.743, "inclined_face": "in"},
        ],
    },
    "flash": {"columns": 61, "rows": 41, "pixel_pitch_um": 600.0},
    "raster": {"azimuth_fov_deg": 10.0, "elevation_fov_deg": 4.0, "azimuth_step_deg": 0.5, "elevation_step_deg": 1.0},
}
RATE_KHZ = {"spinning": 289.352, "lissajous": 200.0, "polygon": 150.0, "flash": 0.025}


def read_scanner(kind, folder=None, rate_khz=None, **changes):
    tables = read_toml(catalog.folder("sensors") / "table1-apd.toml")
    numbers = {"type": kind} | SCANNERS.get(kind, {}) | changes
    tables["scanner"] = {key: value for key, value in numbers.items() if value is not None}
    tables["laser"]["repetition_rate_khz"] = rate_khz or RATE_KHZ.get(kind, 100.0)
    tables["optics"]["aperture_radius_mm"] = 12.0
    return sensor_from_tables(tables, where="my.toml", folder=folder)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("spinning", scanners.vlp16()),
        ("lissajous", scanners.lissajous()),
        ("polygon", scanners.polygon()),
        ("risley", scanners.mid40()),
        ("flash", scanners.flash()),
    ],
)
def test_a_file_makes_the_same_scanner(kind, expected):
    """The same as in scanners.py, which is in SI units."""
    scanner = read_scanner(kind).scanner
    assert type(scanner) is type(expected)
    assert scanner.pulses == expected.pulses
    assert scanner.frame_s == pytest.approx(expected.frame_s, rel=1e-12)
    pulse = scanners.frame(expected)
    for component, expected_component in zip(scanner.direction(pulse), expected.direction(pulse), strict=True):
        np.testing.assert_allclose(component, expected_component, atol=3e-7)
    np.testing.assert_allclose(scanner.aperture_share(pulse), expected.aperture_share(pulse), atol=1e-6)


def test_mirrors_of_a_file():
    scanner = read_scanner("mirror", mirror_radius_mm=10.0, side="right", outer="azimuth", encoder_step_deg=0.1).scanner
    assert isinstance(scanner, scan.MirrorRaster)
    assert isinstance(scanner.mirrors, scan.Gimbal)
    assert (scanner.mirrors.side, scanner.mirrors.outer) == ("right", "azimuth")
    assert scanner.mirrors.incidence_rad == pytest.approx(45 * DEG)
    assert (scanner.mirrors.mirror_radius_m, scanner.mirrors.lens_radius_m) == (0.01, 0.012)
    assert (scanner.columns, scanner.rows, scanner.rate_hz) == (120, 41, 100e3)
    assert (scanner.fast_turn_rad, scanner.slow_turn_rad) == pytest.approx((15 * DEG, 6 * DEG))
    assert scanner.encoder_rad == pytest.approx(0.1 * DEG)
    two = read_scanner("mirror", mirrors="two", outer="azimuth", fast="elevation", jitter_mrad=0.5).scanner
    assert isinstance(two, scan.MirrorRaster)
    assert two.mirrors == scan.MirrorPair(last="azimuth")
    assert (two.fast_turn_rad, two.slow_turn_rad) == pytest.approx((6 * DEG, 15 * DEG))
    assert two.jitter_rad == pytest.approx(0.5e-3)


MISTAKES = [
    ("spinning", {"cycle_us": None}, "scanner | cycle_us and columns_per_turn"),
    ("spinning", {"height_mm": [1.0]}, "scanner | height_mm | 16 entries | elevation_deg | 1"),
    ("spinning", {"elevation_deg": []}, "scanner.elevation_deg | at least 1 | []"),
    ("spinning", {"cycle_us": 30.0}, "scanner | firing_time_us | < 30"),
    ("spinning", {"rotation_hz": 0.0}, "scanner | rotation_hz | 0"),
    ("spinning", {"rate_khz": 300.0}, "laser.repetition_rate_khz | 289.352 | 16 lasers | 55.296 us | 300"),
    ("mirror", {"mirrors": "two", "incidence_deg": 30.0}, 'scanner | incidence_deg | mirrors = "one" | "two"'),
    ("mirror", {"incidence_deg": 80.0, "elevation_turn_deg": 12.0}, "scanner | mirror"),
    ("mirror", {"azimuth_turn_deg": 50.0}, "scanner.azimuth_turn_deg | <= 45 | 50.0"),
    ("mirror", {"waveform": "square"}, "scanner.waveform | 'sawtooth', 'triangle' or 'sine' | \"square\""),
    ("mirror", {"pulses_per_line": 2**20, "lines": 2**20}, "scanner | 2^31 pulses | 1.1e+12"),
    ("lissajous", {"azimuth_hz": None}, "'scanner.azimuth_hz'"),
    ("polygon", {"facet_tilt_deg": [0.0, 0.0]}, "scanner.facet_tilt_deg | at least 3"),
    ("polygon", {"incidence_deg": 70.0}, "scanner | facets | < 90 degrees"),
    ("polygon", {"rate_khz": 0.1}, "scanner | facet | 1 | 2^24 pulses | 0.5"),
    ("risley", {"wedges": SCANNERS["risley"]["wedges"][:1]}, "scanner | wedges | 2 or 3 | mirror | 1"),
    (
        "risley",
        {"wedges": [w | {"angle_deg": 45.0} for w in SCANNERS["risley"]["wedges"]]},
        "scanner | wedges | angle_deg",
    ),
    ("flash", {"encoder_step_deg": 0.1}, "scanner | encoder_step_deg | flash"),
    (
        "flash",
        {"projection": "orthographic", "pixel_pitch_um": 1000.0},
        "scanner | < 1 focal lengths | orthographic | 1.2",
    ),
    ("galvo", {}, f'scanner.type | {", ".join(map(repr, scanners.KINDS))} | "galvo"'),
    ("raster", {"jitter_mrad": 0.0}, "scanner.jitter_mrad | >= 0.0002 | 0.0"),
    ("raster", {"lines": 3}, "'scanner.lines' | type, azimuth_fov_deg"),
]


test_one_clear_line_for_each_mistake = refused(
    lambda kind, changes: read_scanner(kind, **changes), *MISTAKES, where="my.toml"
)


# --- tables -----------------------------------------------------------------------------------------

CSV = "time_us, azimuth_deg, elevation_deg, channel\n" + "".join(f"{10 * n},{n},{-n},{n % 2}\n" for n in range(5))


def table_scanner(folder: Path, text: str, **changes):
    (folder / "own.csv").write_text(text, encoding="utf-8")
    return read_scanner("table", folder, file="own.csv", **changes).scanner


def test_csv(tmp_path):
    scanner = table_scanner(tmp_path, CSV)
    assert isinstance(scanner, scan.Pattern)
    pulse = np.arange(6, dtype=np.uint32)
    azimuth, elevation = scanner.angles(pulse)
    np.testing.assert_allclose(np.degrees(azimuth), [0, 1, 2, 3, 4, 0], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(elevation), [0, -1, -2, -3, -4, 0], rtol=1e-6)
    np.testing.assert_array_equal(scanner.channel(pulse), [0, 1, 0, 1, 0, 0])
    np.testing.assert_allclose(scanner.time_s(pulse), 1e-5 * np.arange(6), rtol=1e-12)
    assert scanner.frame_s == pytest.approx(5e-5)


def test_npz_and_the_length_of_a_frame(tmp_path):
    t = np.arange(1000) * 1e-5 + 3.0
    np.savez(tmp_path / "own.npz", azimuth_rad=np.sin(t), elevation_rad=0.1 * np.cos(t), time_s=t, other=["text"])
    scanner = read_scanner("table", tmp_path, file="own.npz", frame_ms=12.5).scanner
    assert (scanner.pulses, scanner.frame_s) == (1000, 0.0125)
    np.testing.assert_allclose(scanner.angles(scanners.frame(scanner))[0], np.sin(t), atol=1e-7)
    assert scanner.time_s(np.array([0, 1000])).tolist() == [0.0, 0.0125]


@mistakes(
    r"""
    | the first line | columns
    time_s,azimuth_deg\n0,1 | elevation_deg, elevation_rad | none
    time_s,time_ms,azimuth_deg,elevation_deg\n0,0,1,1 | time_s and time_ms
    time_s,azimuth_deg,elevation_deg | at least one pulse | none
    time_s,azimuth_deg,elevation_deg\n0,1,nan | elevation_deg | pulse 1 | finite number
    time_s,azimuth_deg,elevation_deg\n0,1,91 | elevations | -90 to 90 degrees
    time_s,azimuth_deg,elevation_deg\n0,1,1\n2,1,1\n1,1,1 | times | fall at pulse 3
    time_s,azimuth_deg,elevation_deg\n0,1,1\n0,x,1 | CSV | 'x'
    time_s,azimuth_deg,elevation_deg\n0,1,1 | all pulses | scanner.frame_ms
    SHORT | scanner.frame_ms | >= 0.04 | 0.01
    HALVES | channels | whole numbers below 2^24
    """,
    SHORT=CSV,
    HALVES=CSV.replace(",1\n", ",1.5\n"),
)
def test_mistakes_in_tables(tmp_path, given, named):
    with told(f"own.csv | {named}"):
        table_scanner(tmp_path, given, **({"frame_ms": 0.01} if "scanner.frame_ms | >=" in named else {}))


@pytest.mark.parametrize("name", ["gone.csv", "gone.npz"])
def test_no_such_table(tmp_path, name):
    with told(f"my.toml | {name} | no such file"):
        read_scanner("table", tmp_path, file=name)


def test_not_an_npz(tmp_path):
    (tmp_path / "own.npz").write_bytes(b"no zip")
    with told("own.npz | npz"):
        read_scanner("table", tmp_path, file="own.npz")


def test_exits_are_forward_left_and_up_in_the_head():
    """The beams of a head start there at azimuth 0; a quarter of a turn later forward is to the left."""
    lasers = len(load_sensor("vlp-16").scanner.firing_s)
    keys = [
        f"scanner.{axis}_mm={[millimetres] * lasers}"
        for axis, millimetres in (("forward", 30), ("left", 20), ("height", 10))
    ]
    scanner = load_sensor("vlp-16", overrides=keys).scanner
    pulse = np.arange(scanner.pulses, dtype=np.uint32)
    x, y, z = (np.asarray(component, float) for component in scanner.offset_m(pulse))
    head = np.asarray(scanner._mechanism(pulse)[0], float)
    np.testing.assert_allclose(x + 1j * y, (0.03 + 0.02j) * np.exp(1j * head), atol=1e-7)
    np.testing.assert_allclose(z, 0.01, atol=1e-7)
