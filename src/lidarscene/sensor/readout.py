"""[sampler] of a sensor file: what measures a pulse that has tripped the comparator."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number, Table
from ..files.toml import FileModel, read_toml, validate
from .electronics import Adc, Intensity, MultiLevel

Positive = Annotated[float, Number(gt=0, le=1e9)]


class MultiLevelFile(FileModel):
    """[sampler] type = "multi_level_tdc"."""

    type: Literal["multi_level_tdc"]
    levels: Annotated[tuple[Annotated[float, Number(gt=1, le=1e6)], ...], Field(min_length=1, max_length=8)] = Field(
        description="of the comparators above the threshold, in thresholds, rising"
    )

    @model_validator(mode="after")
    def _rising(self) -> MultiLevelFile:
        if tuple(sorted(set(self.levels))) != self.levels:
            raise ValueError(f"levels: must be rising numbers, got {list(self.levels)}")
        return self

    def build(self, pulse_fwhm_ns: float) -> MultiLevel:
        """Convert to thresholds; the pulse width is not used."""
        return MultiLevel(levels=(1.0, *self.levels))


MOST_SAMPLES = 1024
"""A thread of the device holds those of a crossing for up to 16 pulses: 128 KiB with this many."""


class AdcFile(Table[Adc]):
    """[sampler] type = "adc"."""

    type: Literal["adc"]
    bits: Annotated[int, Field(ge=1, le=24)] = Field(description="from zero to full scale")

    def build(self, pulse_fwhm_ns: float) -> Adc:
        """Convert to SI units, with as many samples as four pulse widths hold.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        least_rate_mhz = 1e3 / pulse_fwhm_ns
        if self.rate_mhz < least_rate_mhz * (1.0 - 1e-9):
            raise InputError(
                f"sampler.rate_mhz: must be >= {least_rate_mhz:g} (one sample in a pulse), got {self.rate_mhz:g}"
            )
        samples = math.ceil(4.0 * self.rate_mhz / least_rate_mhz - 1e-9) + 1
        if samples > MOST_SAMPLES:
            raise InputError(
                f"sampler.rate_mhz: must be <= {0.25 * (MOST_SAMPLES - 1) * least_rate_mhz:g} "
                f"({MOST_SAMPLES} samples in four pulse widths), got {self.rate_mhz:g}"
            )
        return self.in_si(
            step=self.full_scale / 2**self.bits,
            samples=samples,
            room=1 << samples.bit_length(),  # not a kernel for each number of samples
        )


AnySamplerFile = Annotated[MultiLevelFile | AdcFile, Field(discriminator="type")]


class RangeCorrectedFile(Table[Intensity], only=("kind", "reference_m", "measures")):
    """[intensity] kind = "range_corrected": optical power, as if all echoes came from one range."""

    kind: Literal["range_corrected"]


_REFLECTIVITY = (
    "kind",
    "white_value",
    "exponent",
    "retro",
    "retro_reflectivity",
    "coarse_above",
    "coarse_step",
    "measures",
)


class ReflectivityFile(Table[Intensity], only=_REFLECTIVITY):
    """[intensity] kind = "reflectivity": 0 to 255, from the echo's power and range."""

    kind: Literal["reflectivity"]

    @model_validator(mode="after")
    def _has_both_of_the_coarse(self) -> ReflectivityFile:
        if (self.coarse_above is None) != (self.coarse_step is None):
            raise ValueError("coarse_above and coarse_step must be given together, got one")
        return self


AnyIntensityFile = Annotated[RangeCorrectedFile | ReflectivityFile, Field(discriminator="kind")]


Illuminance = Annotated[float, Number(ge=0, le=1e4, multiple=1e3)]
Share = Annotated[float, Field(gt=0, le=1)]


class RepeatabilityFile(FileModel):
    """[[published.repeatability]]: scatter of the range at an SNR, or at a range on a target."""

    sigma_m: Positive = Field(description="standard deviation of one shot's range")
    snr: Positive | None = Field(default=None, description="of the echo, (11)")
    at_m: Positive | None = Field(default=None, description="range of the target")
    reflectivity: Share | None = Field(default=None, description="of that target")
    illuminance_klux: Illuminance | None = Field(default=None, description="there; if left out that of `[published]`")
    at_most: bool = Field(default=False, description="the figure is an upper bound")
    recording: bool = Field(default=False, description="measured by others in recordings, not stated by the maker")
    assumed: tuple[Literal["snr", "reflectivity", "illuminance_klux"], ...] = Field(
        default=(),
        description=(
            'keys of conditions above that are not published but assumed here; `"snr"`: the maker'
            " does not say what its SNR is, and (11) is taken"
        ),
    )
    source: Annotated[str, Field(min_length=1)] = Field(description="source of the figures")

    @model_validator(mode="after")
    def _one_condition(self) -> RepeatabilityFile:
        if (self.snr is None) == (self.at_m is None):
            raise ValueError("one of snr and at_m must be given, got both or none")
        if self.at_m is not None and self.reflectivity is None:
            raise ValueError("at_m needs reflectivity; name it in assumed if it is not known")
        for key in self.assumed:
            if getattr(self, key) is None:
                raise ValueError(f"assumed names {key}, which has no value here")
        return self


class ModesFile(FileModel):
    """[published.modes]: factors of the range in a sensor's modes, as a table of settings and signal multipliers."""

    settings: Annotated[tuple[tuple[str, ...], ...], Field(min_length=1)] = Field(
        description="of each row, as for `--set`; they replace those of `[published]`"
    )
    multiplier: Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        description="`histogram.multiplier` of each column"
    )
    range_factors: tuple[tuple[Positive, ...], ...] = Field(
        description="rows of ranges over that in the mode of `[published]`"
    )
    source: Annotated[str, Field(min_length=1)] = Field(description="source of the figures")

    @model_validator(mode="after")
    def _rectangular(self) -> ModesFile:
        shape = [len(row) for row in self.range_factors]
        if shape != [len(self.multiplier)] * len(self.settings):
            raise ValueError(
                f"range_factors must have {len(self.settings)} rows of {len(self.multiplier)}, got rows of {shape}"
            )
        return self


class PublishedFile(FileModel):
    """[published]: performance and its conditions; what is left out is not published."""

    range_m: Positive | None = Field(default=None, description="range at the next two conditions")
    reflectivity: Share | None = Field(default=None, description="of the target at that range")
    illuminance_klux: Illuminance | None = Field(default=None, description="at that range")
    also: tuple[tuple[Share, Positive], ...] = Field(
        default=(), description="further pairs of reflectivity and range, at the same illuminance"
    )
    dark: tuple[tuple[Share, Positive], ...] = Field(
        default=(), description="pairs of reflectivity and range without light"
    )
    unknowns: dict[str, tuple[Positive, Annotated[float, Field(gt=1, le=1e6)]]] = Field(
        default_factory=dict,
        description=(
            "numbers that are fitted to all these ranges, together with the laser's power: by dotted key, what is"
            " assumed of it, and the factor by which it may be off either way"
        ),
    )
    settings: tuple[str, ...] = Field(
        default=(), description="the mode in which ranges, scatter and false points hold, as for `--set`"
    )
    repeatability: tuple[RepeatabilityFile, ...] = Field(default=(), description="scatter of the range, below")
    modes: ModesFile | None = Field(default=None, description="ranges in other modes, below")
    false_points: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="fraction of the pulses that report noise, at that illuminance"
    )
    points_per_second: Positive | None = Field(default=None, description="one return a pulse, rounded as published")
    assumed: tuple[str, ...] = Field(
        default=(), description="keys of the conditions above that are not published but assumed here"
    )
    source: Annotated[str, Field(min_length=1)] = Field(description="source of the other figures")

    @model_validator(mode="after")
    def _complete(self) -> PublishedFile:
        missing = [key for key in ("reflectivity", "illuminance_klux") if getattr(self, key) is None]
        if self.range_m is not None and missing:
            raise ValueError(f"range_m needs {' and '.join(missing)}; name it in assumed if it is not known")
        for key in ("also", "false_points"):
            if getattr(self, key) and self.illuminance_klux is None:
                raise ValueError(f"{key} needs illuminance_klux; name it in assumed if it is not known")
        for key in ("dark", "unknowns"):
            if getattr(self, key) and self.range_m is None:
                raise ValueError(f"{key} needs range_m, the range in the light")
        for key in self.assumed:
            if key not in type(self).model_fields or getattr(self, key) is None:
                raise ValueError(f"assumed names {key}, which has no value here")
        return self

    @property
    def daylight_klux(self) -> float:
        """Illuminance at that range; that of bright sun where it is not published."""
        return 100.0 if self.illuminance_klux is None else self.illuminance_klux


def read_published(path: Path) -> PublishedFile | None:
    """[published] of a sensor file, None where it has none.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    tables = read_toml(path)
    if "published" not in tables:
        return None
    return validate(PublishedFile, tables["published"], f"{path}: published")
