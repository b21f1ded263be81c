"""Scanners: pulse number in, direction, time and aperture out. One small module for each mechanism."""

from .base import Scanner as Scanner
from .flash import Flash as Flash
from .lissajous import Lissajous as Lissajous
from .mirror import MirrorRaster as MirrorRaster
from .mirrors import Gimbal as Gimbal
from .mirrors import MirrorPair as MirrorPair
from .pattern import Pattern as Pattern
from .polygon import Polygon as Polygon
from .raster import Raster as Raster
from .risley import Risley as Risley
from .risley import Wedge as Wedge
from .spinning import Spinning as Spinning
