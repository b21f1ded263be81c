"""Standard solar spectra and the position of the sun, by pvlib: the only door to pvlib in this package.

pvlib is optional and takes a second to load, because it brings pandas and SciPy. It is imported when it is first
needed; without it one line of error names the package to install.
"""

from __future__ import annotations

import functools
from datetime import datetime
from types import ModuleType

import numpy as np

from ..errors import LidarSceneError
from ..physics.optics.solar_spectrum import SpectralCurve


@functools.cache
def pvlib() -> ModuleType:
    """Return the `pvlib` module.

    Raises:
        LidarSceneError: in one line, with what to install
    """
    try:
        import pvlib as module

        module.spectrum.get_reference_spectra  # noqa: B018  (new in 0.11)
        return module  # type: ignore[no-any-return]
    except (ImportError, OSError, AttributeError) as error:
        raise LidarSceneError(
            "the sun's place and spectrum need pvlib 0.11 or newer, which cannot be imported "
            f"({' '.join(str(error).split())}); try: pip install 'lidarscene[sun]', or pip install pvlib"
        ) from error


@functools.cache
def reference_spectrum(name: str) -> SpectralCurve:
    """Return a column of ASTM G173-03, 280 to 4000 nm, as pvlib ships it.

    "global": air mass 1.5, on a surface tilted by 37 degrees towards the sun, sky and ground included;
    "direct": the sun and 2.5 degrees of sky around it, at normal incidence; "extraterrestrial": above the air.
    """
    table = pvlib().spectrum.get_reference_spectra(standard="ASTM G173-03")
    return SpectralCurve(wavelength_m=1e-9 * np.asarray(table.index), value=1e9 * np.asarray(table[name]))


def sun_north_up_deg(*, latitude_deg: float, longitude_deg: float, time: datetime) -> tuple[float, float]:
    """Return azimuth (clockwise from north) and elevation of the sun, refraction at sea level included.

    By the solar position algorithm of Reda and Andreas (NREL/TP-560-34302), good to 0.0003 degrees without
    refraction. ``time`` has to have its offset from UTC.
    """
    if time.utcoffset() is None:
        raise ValueError(f"time must have an offset from UTC, got {time.isoformat()}")
    module = pvlib()
    import pandas

    sun = module.solarposition.get_solarposition(
        pandas.DatetimeIndex([time]), latitude_deg, longitude_deg, method="nrel_numpy"
    )
    return float(sun["azimuth"].iloc[0]), float(sun["apparent_elevation"].iloc[0])
