"""Scanners: where each pulse of a frame goes, and when.

A real pattern is not an even grid: mirrors bend it, facets cut the aperture, encoders round reported angles. So each
mechanism is modelled by its own geometry, in a small module. A scanner is a function of the pulse's number, so that any
part of a frame can be traced without the rest, and pulses need no memory.

base           what all scanners have in common
raster         rows and columns, without a mechanism
spinning       a rotating head of channels
mirror_raster  lines by a fast mirror, one below the other by a slow one
mirror_optics  where one or two mirrors send a beam
polygon        a rotating polygon of facets
lissajous      two resonant axes
risley         rotating prisms
flash          all directions at once
pattern        a table of directions and times
scanner_file   base of the tables of a sensor file
turns          how far something that rotates or swings has come
aperture       how much of the receiver is left off the axis
"""

from .base import Scanner as Scanner
from .flash import Flash as Flash
from .flash import FlashFile as FlashFile
from .lissajous import Lissajous as Lissajous
from .lissajous import LissajousFile as LissajousFile
from .lissajous import Swing as Swing
from .mirror_optics import Gimbal as Gimbal
from .mirror_optics import MirrorPair as MirrorPair
from .mirror_raster import MirrorFile as MirrorFile
from .mirror_raster import MirrorRaster as MirrorRaster
from .pattern import Pattern as Pattern
from .pattern import TableFile as TableFile
from .polygon import Facets as Facets
from .polygon import Polygon as Polygon
from .polygon import PolygonFile as PolygonFile
from .raster import Raster as Raster
from .raster import RasterFile as RasterFile
from .risley import Risley as Risley
from .risley import RisleyFile as RisleyFile
from .risley import TurningMirror as TurningMirror
from .risley import Wedge as Wedge
from .spinning import AzimuthSweep as AzimuthSweep
from .spinning import Bank as Bank
from .spinning import Spinning as Spinning
from .spinning import SpinningFile as SpinningFile

AnyScannerFile = (
    RasterFile | SpinningFile | MirrorFile | LissajousFile | PolygonFile | RisleyFile | FlashFile | TableFile
)
"""[scanner] of a sensor file: a new mechanism is a module of its own and its table here."""
