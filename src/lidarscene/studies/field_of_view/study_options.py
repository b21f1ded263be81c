"""Settings of a field-of-view study, as options. The command line reads them for ``--help``: no NumPy is loaded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ...errors import OptionError, one_line
from ...rendering.option_fields import Finite, OneOf, check_options, list_options, option
from ..ranging.conditions import Conditions

if TYPE_CHECKING:
    from ..ranging.plane import Target

TIMES_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4)
"""Choice: times [s] of the coverage unless a user names others."""

CELL_DEG = 0.28
"""Choice: size [degrees] of the cells unless a user names another."""


@list_options
@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOfViewStudy:
    """Settings of a study. ``target`` is the plane on which the range is mapped."""

    times_s: tuple[float, ...] = option(
        TIMES_S,
        help=f"times of the coverage in seconds (default {','.join(f'{time_s:g}' for time_s in TIMES_S)})",
        metavar="S,S,...",
        flags=("--time",),
    )
    cell_deg: float = option(
        CELL_DEG,
        Finite("degrees", 0.02, 10.0),
        help="size of the cells in degrees (default {default})",
        metavar="DEG",
        flags=("--cell",),
    )
    mask: str = option(
        "outline",
        OneOf(("outline", "reached")),
        help="field of view: the convex outline of the pattern (default), or only the cells that a pulse reaches",
    )
    target: Target = field(default_factory=lambda: Conditions().target())

    def __post_init__(self) -> None:
        check_options(self)
        object.__setattr__(self, "times_s", tuple(self.times_s))
        if not self.times_s or not all(math.isfinite(time_s) and time_s > 0.0 for time_s in self.times_s):
            raise OptionError("{times_s}: must be times above 0 s, got {0}", one_line(self.times_s))
