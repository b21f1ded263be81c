"""Frequency response of the amplifier behind the detector.

An amplifier filters pulse and noise alike. A low pass lowers and widens the pulse; AC coupling, a high pass, leaves an
undershoot behind it.

low_pass   peak, width and noise behind a Gaussian filter or a single pole
high_pass  the undershoot behind an echo
"""
