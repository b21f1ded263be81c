"""Scanners: pulse number in, direction, time and aperture out. One small module for each mechanism."""

from .base import Scanner as Scanner
from .flash import Flash as Flash
from .lissajous import Lissajous as Lissajous
from .mirror_optics import Gimbal as Gimbal
from .mirror_optics import MirrorPair as MirrorPair
from .mirror_raster import MirrorRaster as MirrorRaster
from .pattern import Pattern as Pattern
from .polygon import FacetSize as FacetSize
from .polygon import Polygon as Polygon
from .raster import Raster as Raster
from .risley import Risley as Risley
from .risley import Wedge as Wedge
from .spinning import Bank as Bank
from .spinning import Spinning as Spinning
