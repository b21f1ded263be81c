"""Counting photons over many shots: one point's histogram with a wall in the sun, and pile-up at Table 1."""

import numpy as np
from drawing import INK, dark, saved

import lidarscene
from lidarscene.detection.photon_counting.histograms import histograms
from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.photon_counting import dead_time
from lidarscene.studies.ranging import plane

ALL, FIRST, LIGHT = "#ffc14d", "#5ec8f2", "#9aa4b2"
SENSOR, RANGE_M, KLUX = "os1-128", 15.0, 60.0
CELL_HZ, BIN_NS, SHOTS = 63e6, 1.0, 1e5
"""Background of one of Table 1's cells; the figure's bins and shots."""


def photon_counting() -> None:
    """A histogram of an Ouster in the sun, and first photons that die out against a dead time."""
    figure, (left, right) = dark(1, 2, height=5.2)
    sensor = lidarscene.load_sensor(SENSOR)
    light = plane.echoes_of_plane(sensor, plane.Target(illuminance_klux=KLUX), np.array([RANGE_M]))
    part = SubEchoes(range_m=light.range_m, peak_power_w=light.peak_power_w, count=1)
    train = EchoTrain(
        parts=(part,), surfaces=1, has_surface=light.has_surface, background_power_w=light.background_power_w
    )
    shown = histograms(train, sensor, seed=1, pulse=np.zeros(1, dtype=np.uint32))
    metres = 0.5 * SPEED_OF_LIGHT_M_S * shown.time_s
    left.step(metres, shown.counts[0], where="mid", color=LIGHT, linewidth=0.8, label="drawn")
    left.plot(metres, shown.expected[0], color=ALL, linewidth=1.2, label="mean")
    left.set(xlim=(0.0, 40.0), ylim=(0.0, None))
    left.set_xlabel("range [m]", color=INK)
    left.set_title(
        f"counts of a bin in {float(sensor.histogram.shots):.0f} shots: 10 % wall at {RANGE_M:.0f} m, {KLUX:.0f} klux",
        color=INK,
        loc="left",
        fontsize=11,
    )
    left.legend(frameon=False, labelcolor=INK)

    time_ns = BIN_NS * (np.arange(200) + 0.5)
    far = 2e9 * 15.0 / SPEED_OF_LIGHT_M_S
    rate_hz = CELL_HZ + 1e9 * 0.5 * np.exp(-0.5 * ((time_ns - far) / 2.0) ** 2) / (2.0 * np.sqrt(2.0 * np.pi))
    rng = np.random.default_rng(1)
    range_m = 0.5e-9 * SPEED_OF_LIGHT_M_S * time_ns
    for name, colour, dead_s in (("dead time 10 ns", ALL, 1e-8), ("first photon of a shot", FIRST, np.inf)):
        share = dead_time.firing_shares(rate_hz, bin_s=1e-9 * BIN_NS, dead_time_s=dead_s, steady=np.isfinite(dead_s))
        right.step(range_m, rng.binomial(int(SHOTS), share), where="mid", color=colour, label=name)
    law = SHOTS * CELL_HZ * 1e-9 * BIN_NS * np.exp(-0.42 * range_m)
    right.plot(range_m, law, color=INK, linewidth=0.7, linestyle=(0, (4, 4)), label="exp(-0.42 R / m)")
    right.set(yscale="log", ylim=(0.7, 2e4), xlim=(0.0, 30.0))
    right.set_xlabel("range [m]", color=INK)
    right.set_title("counts of a Table 1 cell in 100,000 shots, echo at 15 m", color=INK, loc="left", fontsize=11)
    right.legend(frameon=False, labelcolor=INK)
    saved(figure, "photon_counting.png")
