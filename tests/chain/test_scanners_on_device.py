"""Scanners on the device: the same as numpy, exact for ten million pulses, nothing compiled twice."""

import dataclasses
import gc
import math

import numpy as np
import pytest
from helpers import launches, rounding, scanners
from helpers.scanners import ALL, DEG

from lidarscene import load_sensor, scan, sensors
from lidarscene.kernel.device import transfer

pytestmark = pytest.mark.usefixtures("mi")


def on_device(scanner, pulse):
    """Direction, angles, channel, share and offset of these pulses, as numpy arrays."""
    scanner = transfer.opaque(scanner)
    arrays = [*scanner.direction(pulse), *scanner.angles(pulse), scanner.channel(pulse)]
    arrays += [scanner.aperture_share(pulse), *(scanner.offset_m(pulse) or ())]
    transfer.start([a for a in arrays if not isinstance(a, float)])
    return [np.array(a) if isinstance(a, float) else np.array(a.numpy()) for a in arrays]


@pytest.mark.parametrize("frames", [0, 24 * 3600 * 20 + 1])
@pytest.mark.parametrize("name", ALL)
def test_numpy_and_device_agree(name, frames):
    """Tolerance: single precision; the numpy side of the mirrors computes in it too. At once, and a day later."""
    scanner = ALL[name]()
    first = frames * scanner.pulses
    pulse = first + np.arange(scanner.pulses)
    expected = [*scanner.direction(pulse), *scanner.angles(pulse), scanner.channel(pulse)]
    expected += [scanner.aperture_share(pulse), *(scanner.offset_m(pulse) or ())]
    computed = on_device(scanner.at_phase(scanner.phase(first)), transfer.counter(0, scanner.pulses))
    for angle, reference in zip(computed, expected, strict=True):
        off = np.abs(angle.astype(float) - reference)
        off = np.minimum(off, np.abs(off - 2 * math.pi))  # plus and minus 180 degrees are one azimuth
        np.testing.assert_array_less(off, rounding.limit(4e-6))


@pytest.mark.parametrize("name", sensors())
def test_times_on_the_device_are_those_of_numpy(name):
    """Bit for bit, for every sensor of the catalogue: at once, a day later, and beyond a rollover of pulse numbers."""
    scanner = load_sensor(name).scanner
    clock = transfer.opaque(scanner.clock, double=True)
    pulse = np.append(np.arange(min(scanner.pulses, 4000)), scanner.pulses - 1)
    for frames in (0, 24 * 3600 * 20 + 1, 2**31 // scanner.pulses * 5):
        earlier = frames * scanner.pulses
        before = transfer.opaque(scanner.clock.before(earlier), double=True)
        computed = clock.time_s(transfer.unsigned_numbers(pulse), earlier=before).numpy()
        assert computed.dtype == np.float64
        np.testing.assert_array_equal(computed, scanner.time_s(earlier + pulse))


def test_phases_of_ten_million_pulses(mi):
    """A Lissajous at 2 MHz and prisms, pulse 9 999 000 and on, against float64: the turns themselves to 1e-6 rad."""
    first = 9_999_000
    pulse = transfer.counter(first, 1000)
    t = np.arange(first, first + 1000)
    risley = scanners.mid40()
    for wedge, f in zip(transfer.opaque(risley).wedges, (-121.5657, 77.7430), strict=True):
        expected = 2 * math.pi * np.remainder(t * (f / 100e3), 1.0)
        error = wedge.turns.angle_rad(pulse).numpy() - expected
        assert np.abs(np.remainder(error + math.pi, 2 * math.pi) - math.pi).max() < 1e-6
    fast = scanners.lissajous(rate_hz=2e6)
    azimuth, elevation = transfer.opaque(fast)._mechanism(pulse)
    for angle, amplitude, f, p in ((azimuth, 12, 1310.0, 0.3), (elevation, 8, 1190.0, 1.2)):
        expected = amplitude * DEG * np.sin(2 * math.pi * np.remainder(t * (f / 2e6), 1.0) + p)
        assert np.abs(angle.numpy() - expected).max() < 1e-6


CHANGED = {
    "raster": lambda: scanners.raster(azimuth_step_rad=0.02, columns=77),
    "vlp16": lambda: scanners.vlp16(
        rotation_hz=20.0,
        elevation_rad=[0.02 * n for n in range(32)],
        azimuth_rad=[0.01] * 32,
        firing_s=[1e-6 * n for n in range(32)],
        start_m=([0.1] * 32, [0.0] * 32, [0.0] * 32),
    ),
    "mirror_step": lambda: scanners.mirror(
        columns=99, rows=7, fast_turn_rad=0.1, line_duty=0.5, mirrors=scanners.gimbal(incidence_rad=0.2)
    ),
    "lissajous": lambda: scanners.lissajous(
        azimuth=scan.Swing(frequency_hz=900.0, phase_rad=0.0, turn_rad=12 * DEG),
        elevation=scan.Swing(frequency_hz=77.0, phase_rad=0.0, turn_rad=8 * DEG),
        mirrors=scanners.gimbal(side="left"),
    ),
    "polygon": lambda: scanners.polygon(tilt_rad=[0.01] * 6, rotation_hz=50.0, side="right", duty=0.4),
    "mid40": lambda: scanners.mid40(index=[1.6, 1.7], rotation_hz=[10.0, -3.0], angle_rad=[0.1, 0.2]),
    "six_beams": lambda: scanners.mid40(tilted=["in", "in"], index=[1.4, 1.3], beam_elevation_rad=[0.01, 0.02]),
    "flash": lambda: scanners.flash(columns=11, rows=13, pitch=0.01),
    "pattern": lambda: scanners.pattern(
        azimuth_rad=np.zeros(9), elevation_rad=np.zeros(9), time_s=np.arange(9.0), channel=np.zeros(9)
    ),
}


@pytest.mark.parametrize("name", CHANGED)
def test_other_numbers_compile_nothing(name):
    """Other angles, rates, counts, even other tables are data; only the kind of scanner chooses code."""
    pulse = transfer.counter(0, 1000)
    with launches.launched() as before:
        on_device(dataclasses.replace(ALL[name](), encoder_rad=1e-3), pulse)
    with launches.launched(after=before):
        other = dataclasses.replace(CHANGED[name](), encoder_rad=2e-3)
        on_device(other.at_phase(other.phase(2**40)), transfer.counter(5000, 1000))


def test_tables_go_to_the_device_once():
    from lidarscene.maths.arrays import xp

    scanner = scanners.pattern()
    pulse = transfer.counter(0, 10)
    uploaded = xp(pulse)._uploaded
    on_device(scanner, pulse)
    (array,) = uploaded[scanner.azimuth_rad].values()
    on_device(scanner, pulse)
    assert next(iter(uploaded[scanner.azimuth_rad].values())) is array
    before = len(uploaded)
    del scanner, array
    gc.collect()
    assert len(uploaded) == before - 3  # azimuth, elevation, channel


def test_every_kind_is_tried():
    kinds = {type(make()) for make in ALL.values()}
    assert kinds == {
        scan.Raster,
        scan.Spinning,
        scan.MirrorRaster,
        scan.Lissajous,
        scan.Polygon,
        scan.Risley,
        scan.Flash,
        scan.Pattern,
    }
    assert {type(make()) for make in CHANGED.values()} == kinds
