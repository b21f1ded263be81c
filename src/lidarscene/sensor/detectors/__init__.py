"""Detectors as data, a module for each kind; and the working point that a background puts them in.

working_point  what the comparator needs to know of a detector
apd            avalanche photodiode with its amplifier
sipm           silicon photomultiplier
matching       whether a laser and a detector go together
"""

from .apd import Apd
from .sipm import Sipm
from .working_point import CellMemory, Filtered, WorkingPoint

Detector = Apd | Sipm

__all__ = ["Apd", "CellMemory", "Detector", "Filtered", "Sipm", "WorkingPoint"]
