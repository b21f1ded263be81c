"""Detectors as data, a module for each kind, and their working point under a background.

working_point  noise, response and its inverse, as the comparator uses them
apd_detector   avalanche photodiode with its amplifier
sipm_detector  silicon photomultiplier
matching       checks that a laser and a detector fit each other
"""

from .apd_detector import Apd
from .sipm_detector import Sipm
from .working_point import CellMemory, Filtered, WorkingPoint

Detector = Apd | Sipm

__all__ = ["Apd", "CellMemory", "Detector", "Filtered", "Sipm", "WorkingPoint"]
