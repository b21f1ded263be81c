"""What the amplifier's frequency response does: range over bandwidth, and the undershoot of AC coupling."""

import numpy as np
from drawing import INK, dark, saved

import lidarscene
from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.light.waveform import sample_power_and_signal
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.conditions import PROBABILITY
from lidarscene.studies.ranging.plane import Target

RESPONSES = {"none": "#9aa4b2", "gaussian": "#ffc14d", "single_pole": "#5ec8f2"}
BACKGROUND_W = 2.5e-8


def response() -> None:
    """Range of the paper's APD over its bandwidth, and two echoes behind AC coupling."""
    figure, (left, right) = dark(1, 2, height=5.2)
    bandwidths = np.geomspace(4.0, 400.0, 60)
    for name, colour in RESPONSES.items():
        reach = []
        for mhz in bandwidths:
            sensor = lidarscene.load_sensor(
                "table1-apd", overrides=[f"receiver.response='{name}'", f"receiver.bandwidth_mhz={float(mhz)!r}"]
            )
            reach.append(plane.detection_range_m(sensor, Target(), PROBABILITY)[0])
        left.plot(bandwidths, reach, color=colour, label=name)
    left.axvline(350.0 / 6.0, color=INK, linewidth=0.7, linestyle=(0, (4, 4)))
    left.text(61.0, 860.0, "0.35 / FWHM", color=INK, fontsize=9)
    left.set(xscale="log", ylim=(0.0, 900.0), xticks=(5, 10, 20, 50, 100, 200, 400))
    left.set_xticklabels(("5", "10", "20", "50", "100", "200", "400"))
    left.minorticks_off()
    left.set_xlabel("bandwidth (-3 dB) [MHz]", color=INK)
    left.set_title(f"range at P_d {PROBABILITY:g} [m] of table1-apd", color=INK, loc="left", fontsize=11)
    left.legend(frameon=False, labelcolor=INK)

    parts = SubEchoes(range_m=np.array([40.0, 60.0]), peak_power_w=np.array([3e-6, 3e-8]), count=2)
    light = EchoTrain(
        parts=(parts,), surfaces=2, has_surface=np.array([True]), background_power_w=np.array([BACKGROUND_W])
    )
    range_m = np.linspace(35.0, 120.0, 3000)
    for coupling, colour in (("DC-coupled", "#ffc14d"), ("AC-coupled at 500 kHz", "#5ec8f2")):
        override = ["receiver.ac_coupling_khz=500"] if coupling.startswith("AC") else []
        sensor = lidarscene.load_sensor("table1-apd", overrides=["receiver.response='gaussian'", *override])
        _, (signal,) = sample_power_and_signal(light, sensor, range_m / 149896229.0)
        right.plot(range_m, 1e6 * signal, color=colour, label=coupling)
    level = float(sensor.threshold(sensor.working_point(light.background_power_w))[0])
    right.axhline(1e6 * level, color=INK, linewidth=0.7, linestyle=(0, (4, 4)))
    right.text(100.0, 1.15e6 * level, "threshold", color=INK, fontsize=9)
    right.set(ylim=(-3.5, 4.0))
    right.set_xlabel("range [m]", color=INK)
    right.set_title("signal [µA]: an echo a hundred times weaker, 20 m behind", color=INK, loc="left", fontsize=11)
    right.legend(frameon=False, labelcolor=INK)
    saved(figure, "response.png")
