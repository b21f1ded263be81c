"""[sampler] of a sensor file: what measures a pulse that has tripped the comparator."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..files.toml import FileModel
from .model import Adc, MultiLevel

Positive = Annotated[float, Field(gt=0)]


class MultiLevelFile(FileModel):
    """[sampler] type = "multi_level_tdc"."""

    type: Literal["multi_level_tdc"]
    levels: Annotated[tuple[Annotated[float, Field(gt=1)], ...], Field(min_length=1, max_length=8)] = Field(
        description="above the threshold, in thresholds, rising"
    )

    @model_validator(mode="after")
    def _rising(self) -> MultiLevelFile:
        if tuple(sorted(set(self.levels))) != self.levels:
            raise ValueError("levels: rising numbers were expected")
        return self

    def build(self, pulse_fwhm_ns: float) -> MultiLevel:
        """In thresholds; the width of the pulse plays no part."""
        return MultiLevel(levels=(1.0, *self.levels))


MOST_SAMPLES = 1024
"""A thread of the device holds those of a crossing for up to 16 pulses: 128 KiB with this many."""


class AdcFile(FileModel):
    """[sampler] type = "adc"."""

    type: Literal["adc"]
    rate_mhz: Positive
    bits: Annotated[int, Field(ge=1, le=24)]
    full_scale: Positive = Field(description="largest sample, amperes (APD) or cells (SiPM)")
    estimator: Literal["matched_filter", "centroid"] = "matched_filter"

    def build(self, pulse_fwhm_ns: float) -> Adc:
        """In SI units, with as many samples as four pulse widths hold."""
        least = 1e3 / pulse_fwhm_ns
        if self.rate_mhz < least * (1.0 - 1e-9):
            raise InputError(
                f"sampler.rate_mhz: at least {least:g} was expected (one sample in a pulse), {self.rate_mhz:g} came"
            )
        samples = math.ceil(4.0 * self.rate_mhz / least - 1e-9) + 1
        if samples > MOST_SAMPLES:
            raise InputError(
                f"sampler.rate_mhz: at most {0.25 * (MOST_SAMPLES - 1) * least:g} was expected "
                f"({MOST_SAMPLES} samples in four pulse widths), {self.rate_mhz:g} came"
            )
        return Adc(
            rate_hz=self.rate_mhz * 1e6,
            step=self.full_scale / 2**self.bits,
            full_scale=self.full_scale,
            samples=samples,
            room=1 << samples.bit_length(),  # not a kernel for each number of samples
            estimator=self.estimator,
        )


AnySamplerFile = Annotated[MultiLevelFile | AdcFile, Field(discriminator="type")]
