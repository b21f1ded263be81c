"""Colour scales: colours of the values of a column, and round numbers along the scale.

Perceptual colour maps without their dark end, which would vanish on the background; the page of `view` has the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..maths.arrays import Numbers

# 33 colours of matplotlib's maps (viridis and inferno by Smith and van der Walt, turbo by Mikhailov); between them
# colours are interpolated, to 4 of 255.
MAPS = {
    "viridis": (
        "472a7a 46337f 443b84 414487 3e4c8a 3a538b 375b8d 33638d 306a8e 2d718e 2a778e 277e8e 25848e 228b8d "
        "20928c 1f988b 1f9f88 21a585 25ac82 2db27d 37b878 42be71 50c46a 5ec962 6ece58 7fd34e 90d743 a2da37 "
        "b5de2b c8e020 dae319 ece51b fde725"
    ),
    "turbo": (
        "a91601 bc2002 cc2b04 da3907 e5470b ef5811 f66c19 fb8122 fe962b fea933 faba39 f2c93a e7d739 d9e436 "
        "c8ef34 b7f735 a4fc3c 8bff4b 71fe5f 55fa76 3cf58e 27eea4 1ae4b6 18d9c8 1ecbda 28bceb 35abf8 4099ff "
        "4687fb 4776ee 4664da 4451bf 3f3e9c"
    ),
    "inferno": (
        "6a176e 741a6e 7d1e6d 85216b 8f2469 972766 a02a63 a92e5e b1325a ba3655 c13a50 ca404a d24644 d84c3e "
        "df5337 e45a31 ea632a ef6c23 f2741c f67e14 f8870e fa9207 fb9d07 fca60c fcb216 fbbc21 f9c72f f7d340 "
        "f4dd4f f2e865 f1f179 f5f992 fcffa4"
    ),
}

LOGARITHMIC = ("intensity", "snr")
ROUND_RANGES_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Mapping from values to colours.

    Attributes:
        kind: spacing of the colours; "root" gives more contrast at near ranges
    """

    low: float
    high: float
    kind: Literal["linear", "logarithmic", "root"]
    map: str

    def part(self, value: float) -> float:
        """Position of a value on the scale, from 0 to 1."""
        return float(self._parts(np.array([value]))[0])

    def _parts(self, values: Numbers) -> Numbers:
        clipped = np.clip(values.astype(np.float64), self.low, self.high)
        if self.kind == "logarithmic":
            return np.asarray(np.log(clipped / self.low) / math.log(self.high / self.low))
        linear = (clipped - self.low) / (self.high - self.low)
        return np.asarray(np.sqrt(linear) if self.kind == "root" else linear)

    def rgb(self, values: Numbers) -> Numbers:
        """(n, 3) uint8 colours of (n,) finite values."""
        levels = self.table((np.arange(256) + 0.5) / 256)
        return np.asarray(levels[(255.999 * self._parts(values)).astype(np.intp)])

    def table(self, parts: Numbers) -> Numbers:
        """(k, 3) uint8 colours of places on the scale."""
        anchors = np.array([list(bytes.fromhex(colour)) for colour in MAPS[self.map].split()], np.float64)
        places = np.linspace(0.0, 1.0, len(anchors))
        mixed = [np.interp(parts, places, channel) for channel in anchors.T]
        return np.asarray(np.rint(np.stack(mixed, axis=-1)).astype(np.uint8))

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Round values on the scale and their texts, about ``most`` of them."""
        values: list[float] = []
        if self.kind == "root":
            values = [float(range_m) for range_m in ROUND_RANGES_M if self.low <= range_m <= self.high]
        elif self.kind == "logarithmic":
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            steps = (1.0, 2.0, 5.0) if self.high < 30.0 * self.low else (1.0,)
            values = [
                factor * 10.0**decade
                for decade in decades
                for factor in steps
                if self.low <= factor * 10.0**decade <= self.high
            ]
        if len(values) < 2:
            exact = 10.0 ** math.floor(math.log10((self.high - self.low) / max(most, 1)))
            step = next(factor * exact for factor in (1, 2, 5, 10) if (self.high - self.low) / (factor * exact) <= most)
            values = [
                multiple * step for multiple in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)
            ]
        thinned = values[:: -(-len(values) // max(most, 1))]
        powers = self.kind == "logarithmic" and not all(1e-3 <= value < 1e4 for value in thinned)
        return [(value, _tick_text(value, powers=powers)) for value in thinned]


def _tick_text(value: float, *, powers: bool) -> str:
    """Text of a round number; small and large ones, or with ``powers`` all, as powers of ten."""
    if value and (powers or not 1e-3 <= abs(value) < 1e5):
        digits, _, power = f"{value:.0e}".partition("e")
        raised = "10" + str(int(power)).translate(_SUPERSCRIPTS)
        return (raised if digits == "1" else f"{digits}·{raised}").replace("-", "\N{MINUS SIGN}")
    return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")


def scale_of(name: str, values: Numbers, *, limits: tuple[float, float] | None = None) -> Scale:
    """Scale of a column from its 1st to its 99th percentile: logarithmic for powers, root for ranges."""
    usable = values[np.isfinite(values)]
    if name in LOGARITHMIC:
        usable = usable[usable > 0]
    low, high = np.percentile(usable, (1, 99)).tolist() if len(usable) else (0.1, 1.0)
    if name.endswith("probability"):
        low, high = 0.0, 1.0
    low, high = (low, high) if limits is None else limits
    if name in LOGARITHMIC:
        return Scale(low=low, high=max(high, low * 1.01), kind="logarithmic", map="inferno")
    is_range = name.endswith("range")
    colours = "turbo" if name in ("range", "true_range") else "viridis"
    high = high if high > low else low + 1.0
    return Scale(low=low, high=high, kind="root" if is_range else "linear", map=colours)
