"""Electrical power of a sensor as data: `[power]` of a sensor file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..files.table_model import Table
from ..maths.attributes import HintedAttributes
from ..maths.units import Quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Power(HintedAttributes):
    """What a sensor draws: the laser's driver by its light, and the rest. No part of the simulation."""

    driver_efficiency: Annotated[float, Quantity(gt=0, le=1, about="mean power of the light over that of its driver")]
    electronics_w: Annotated[float, Quantity(ge=0, le=1e5, about="of receiver, bias, converter and computer")] = 0.0
    scanner_w: Annotated[float, Quantity(ge=0, le=1e5, about="of motors or mirrors")] = 0.0

    def driver_w(self, light_w: float) -> float:
        """Power of the laser's driver for this mean power of the light."""
        return light_w / self.driver_efficiency

    def total_w(self, light_w: float) -> float:
        """Power of the whole sensor."""
        return self.driver_w(light_w) + self.electronics_w + self.scanner_w


class PowerFile(Table[Power]):
    """[power]: what the sensor draws."""
