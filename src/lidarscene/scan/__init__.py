"""Scanners: pulse number in, direction and time out. One small module for each mechanism."""

from .base import Scanner as Scanner
from .raster import Raster as Raster
