"""Select the encoder of a sensor's packets by its construction: number of lasers and firing times."""

from __future__ import annotations

from ...errors import InputError
from ...scan.spinning import Spinning
from ...sensor.sensor_model import Sensor
from .ouster_encoder import match_ouster
from .packet_encoder import PacketEncoder, turns_clockwise
from .pandar64_encoder import match_pandar64
from .velodyne_encoder import MODELS, match_velodyne

KNOWN = (*(model.name for model in MODELS), "os0-128", "os1-128", "os2-128", "pandar64")


def select_encoder(sensor: Sensor, profile: str = "default") -> PacketEncoder:
    """Return a new encoder of this sensor's packets.

    Args:
        profile: profile of an Ouster's packets, a key of `ouster_encoder.PROFILES`

    Raises:
        InputError: in one line, for a sensor that has no format of packets
    """
    ouster = match_ouster(sensor, profile)
    encoder = ouster or match_velodyne(sensor) or match_pandar64(sensor)
    if encoder is None:
        raise InputError(
            f"sensor '{sensor.name}': has no format of packets; lasers and firing times must be those of one of "
            f"{', '.join(KNOWN)}"
        )
    if profile != "default" and ouster is None:
        raise InputError(f"sensor '{sensor.name}': must be an Ouster for packets of the profile '{profile}'")
    assert isinstance(sensor.scanner, Spinning)
    if not turns_clockwise(sensor.scanner):
        raise InputError(
            f"sensor '{sensor.name}': scanner.rotation_hz: must be negative for packets, as their makers turn"
        )
    if sensor.intensity is None or sensor.intensity.kind != "reflectivity":
        raise InputError(
            f"sensor '{sensor.name}': intensity.kind: must be 'reflectivity' for packets, whose points have 0 to 255"
        )
    return encoder
