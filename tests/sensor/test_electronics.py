"""Numbers that follow from those of the converter and the amplifier."""

import pytest

from lidarscene.sensor.electronics import Intensity, Receiver, Tdc


def test_the_converter_listens_behind_blanking_and_counts_the_background_in_its_window():
    converter = Tdc(window_s=4e-6, bandwidth_hz=1e8, blanking_s=1e-6)
    assert converter.listening_s == pytest.approx(3e-6)
    assert converter.ambient_s == 4e-6
    assert Tdc(window_s=4e-6, bandwidth_hz=1e8, ambient_window_s=1e-6).ambient_s == 1e-6


def test_what_filters_the_pulse():
    """B over the cutoff is sqrt(pi / ln 2) / 2 of a Gaussian and pi / 2 of a pole (docs/theory_receivers.md 5)."""
    ratios = {"none": 1.0, "gaussian": 1.0645, "single_pole": 1.5708}
    for response, ratio in ratios.items():
        amplifier = Receiver(response=response)
        assert amplifier.noise_ratio == pytest.approx(ratio, rel=1e-4)
        assert amplifier.filters == (response != "none")
    assert Receiver(ac_coupling_hz=5e5).filters


def test_units_of_the_intensity():
    assert Intensity(kind="range_corrected").unit == "W"
    assert Intensity(kind="reflectivity").unit == "1"
