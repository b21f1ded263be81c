"""Detectors as data, a module for each kind, and their working point under a background.

detector       what every kind gives
apd_detector   avalanche photodiode with its amplifier
geiger         cells in Geiger mode: fill factor, overvoltage, temperature
sipm_detector  silicon photomultiplier
spad_detector  macro-pixel of single-photon avalanche diodes: `spad_array` has its numbers, `macropixel` what it counts
working_point  noise, response and its inverse, as the comparator uses them
matching       checks that a laser and a detector fit each other
"""

from .apd_detector import Apd, ApdFile
from .detector import Detector, Reception, Wave
from .geiger import GeigerDetector
from .sipm_detector import Sipm, SipmFile
from .spad_detector import Spad, SpadFile
from .working_point import CellMemory, Filtered, WorkingPoint

AnyDetectorFile = ApdFile | SipmFile | SpadFile
"""[detector] of a sensor file: a new kind is a module of its own and its table here."""

__all__ = [
    "AnyDetectorFile",
    "Apd",
    "CellMemory",
    "Detector",
    "Filtered",
    "GeigerDetector",
    "Reception",
    "Sipm",
    "Spad",
    "Wave",
    "WorkingPoint",
]
