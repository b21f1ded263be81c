"""A canvas: pixels and texts in, a PNG or SVG file out.

matplotlib needs half a second for an empty picture, more than a frame of a lidar. A picture of points has a few texts,
ticks and bars. They are drawn here, with matplotlib's font and Pillow, which comes with it.
"""

from __future__ import annotations

import base64
import functools
import html
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..cloud.shades import rgb
from ..files.atomic import atomic_output
from ..files.encodings.png import encode_png
from ..maths.arrays import Numbers
from .lines import suffix_of

SMALLEST_PX = 5


class _Text(NamedTuple):
    x: float
    y: float
    text: str
    size: int
    anchor: str
    bold: bool
    upright: bool


class Canvas:
    """A picture to draw on, of one colour at first; x to the right, y down, in pixels.

    Attributes:
        image: (height, width, 3) uint8

    Args:
        ink: colour of texts
    """

    def __init__(self, size_px: tuple[int, int], colour: str, ink: str) -> None:
        width, height = size_px
        self.ink = ink
        pixels = bytearray(rgb(colour).tobytes() * (width * height))  # a fifth of the time that NumPy takes
        self.image = np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
        self._texts: list[_Text] = []

    @property
    def unit(self) -> float:
        """Pixels for one pixel of a picture 1920 pixels wide; sizes of texts and marks are given for that width."""
        return self.image.shape[1] / 1920

    def show(self, image: Numbers, x: int, y: int) -> None:
        """Copy an image, (h, w, 3) uint8, with its upper left corner at (x, y)."""
        for colour in range(3):  # a colour at a time: rows of three bytes take four times as long
            self.image[y : y + image.shape[0], x : x + image.shape[1], colour] = image[..., colour]

    def fill(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """Fill a rectangle, at least one pixel wide and high."""
        left, top = round(x), round(y)
        self.image[top : max(round(y + height), top + 1), left : max(round(x + width), left + 1)] = rgb(colour)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        *,
        anchor: str = "lm",
        bold: bool = False,
        upright: bool = False,
    ) -> None:
        """Add a line of text.

        Args:
            anchor: point of the text that is at (x, y): l, m or r, and t, m or b
            upright: read from below
        """
        pixels = max(round(size * self.unit), SMALLEST_PX)
        self._texts.append(_Text(x, y, text, pixels, anchor, bold, upright))

    def length(self, text: str, size: float, *, bold: bool = False) -> float:
        """Length of a line of text, pixels."""
        return float(_font(max(round(size * self.unit), SMALLEST_PX), bold).getlength(text))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the format of the suffix, atomically.

        Raises:
            InputError: if a file, a key or a value cannot be understood
            OutputError: if a result cannot be written
        """
        data = self._png(with_texts=True) if suffix_of(path) == "png" else self._svg()
        with atomic_output(path) as temporary:
            temporary.write_bytes(data)

    def _png(self, *, with_texts: bool) -> bytes:
        from PIL import Image, ImageDraw

        image = Image.fromarray(self.image)
        draw = ImageDraw.Draw(image)
        for label in self._texts if with_texts else ():
            font = _font(label.size, label.bold)
            if label.upright:
                _draw_upright(image, label, font, self.ink)
            else:
                draw.text((label.x, label.y), label.text, fill=self.ink, font=font, anchor=_ANCHORS[label.anchor])
        return encode_png(np.asarray(image), is_sparse=True)  # a third of the time of Pillow's, and fewer bytes

    def _svg(self) -> bytes:
        """SVG with the pixels as an image and the texts as texts."""
        height, width = self.image.shape[:2]
        size = f'width="{width}" height="{height}"'
        pixels = base64.b64encode(self._png(with_texts=False)).decode("ascii")
        font = 'font-family="DejaVu Sans, sans-serif"'
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {width} {height}" {font}>',
            f'<image {size} href="data:image/png;base64,{pixels}"/>',
        ]
        for label in self._texts:
            turned = f' transform="rotate(-90 {label.x:.1f} {label.y:.1f})"' if label.upright else ""
            weight = ' font-weight="bold"' if label.bold else ""
            lines.append(
                f'<text x="{label.x:.1f}" y="{label.y:.1f}" font-size="{label.size}" fill="{self.ink}"{weight} '
                f'text-anchor="{_SVG_ACROSS[label.anchor[0]]}" '
                f'dominant-baseline="{_SVG_ALONG[label.anchor[1]]}"{turned}>'
                f"{html.escape(label.text)}</text>"
            )
        return "\n".join([*lines, "</svg>\n"]).encode("utf-8")


_ANCHORS = {a + b: a + {"t": "a", "m": "m", "b": "d"}[b] for a in "lmr" for b in "tmb"}
_SVG_ACROSS = {"l": "start", "m": "middle", "r": "end"}
_SVG_ALONG = {"t": "hanging", "m": "central", "b": "text-after-edge"}


@functools.cache
def _font(size: int, bold: bool) -> Any:
    """DejaVu Sans, from matplotlib's files; finding it imports nothing of matplotlib."""
    from PIL import ImageFont

    package = find_spec("matplotlib")
    for folder in package.submodule_search_locations or () if package else ():
        file = Path(folder) / "mpl-data" / "fonts" / "ttf" / f"DejaVuSans{'-Bold' if bold else ''}.ttf"
        if file.is_file():
            # Shaping by Raqm would need another library, and no text here asks for it.
            return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)
    return ImageFont.load_default(size)


def _draw_upright(image: Any, label: _Text, font: Any, ink: str) -> None:
    """Draw a text that is read from below, its middle at the label's (x, y)."""
    from PIL import Image, ImageDraw

    left, top, right, bottom = font.getbbox(label.text)
    mask = Image.new("L", (max(right - left, 1), max(bottom - top, 1)), 0)
    ImageDraw.Draw(mask).text((-left, -top), label.text, fill=255, font=font)
    mask = mask.transpose(Image.Transpose.ROTATE_90)
    image.paste(ink, (round(label.x - mask.width / 2), round(label.y - mask.height / 2)), mask)
