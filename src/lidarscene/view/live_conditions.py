"""Conditions of a live scene that the page can change: weather, number of rays, frame number and seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from ..maths.units import sliders
from ..rendering.option_fields import Whole
from ..rendering.render_options import NUMBERS, SEEDS, FrameOptions, TraceOptions
from ..rendering.render_options import RAYS as TRACED
from ..scene.scene import Scene
from ..scene.weather import Weather
from ..sensor.parts import other_parts
from .controls import DETECTOR, Control, Settings, number_of

WEATHER = {
    f"weather.{quantity.for_field(field)}": (field, quantity, slider)
    for field, (quantity, slider) in sliders(Weather).items()
}
"""Key of the scene file -> field of Weather and its declaration."""

FOG = "weather.fog_visibility_km"
RAYS, SEED, FRAME, BUDGET = "run.rays", "run.seed", "run.frame", "run.budget"
KEYS = (*WEATHER, RAYS, SEED, FRAME, BUDGET)
CLEAR_KM = WEATHER[FOG][2].high
"""Visibility from which the slider means no fog."""


class LiveConditions(NamedTuple):
    """Scene and options under the page's settings; ``budget`` is True if the page shows the points' link budgets."""

    scene: Scene
    trace: TraceOptions
    frame: FrameOptions
    budget: bool


def controls(scene: Scene, frame: FrameOptions) -> list[Control]:
    """Sliders of the conditions, at the values of the scene and of the command line."""
    weather = {key: getattr(scene.air.weather, field) for key, (field, *_) in WEATHER.items()}
    return [
        *(
            Control(
                key=key,
                label=slider.label,
                unit=slider.unit,
                low=slider.low,
                high=slider.high,
                value=slider.high if weather[key] is None else quantity.in_file(weather[key]),
                log=slider.log,
                least=quantity.ge,
                most=quantity.le,
            )
            for key, (_, quantity, slider) in WEATHER.items()
        ),
        _whole(RAYS, "rays per pulse", TRACED, 1, 64.0),
        _whole(FRAME, "frame", NUMBERS, frame.number, 50.0),
        _whole(SEED, "seed", SEEDS, frame.seed, 100.0),
    ]


def _whole(key: str, label: str, numbers: Whole, value: int, high: float) -> Control:
    """Slider of an option that is a whole number."""
    low, most = float(numbers.low), float(numbers.high)
    return Control(
        key=key, label=label, unit="", low=low, high=high, value=float(value), least=low, most=most, whole=True
    )


def conditions(scene: Scene, frame: FrameOptions, settings: Settings) -> LiveConditions:
    """Apply settings to the scene's weather and to the options.

    Raises:
        InputError: for a number out of bounds
    """
    limits = {control.key: control for control in controls(scene, frame)}
    values = {key: number_of(key, settings[key]) for key in KEYS if key in settings}
    for key, value in values.items():
        if key in limits:
            limits[key].check(value)
    changes = {field: quantity.in_si(values[key]) for key, (field, quantity, _) in WEATHER.items() if key in values}
    if values.get(FOG, 0.0) >= CLEAR_KM and scene.air.weather.fog is None:
        changes["fog_visibility_m"] = None
    weather = dataclasses.replace(scene.air.weather, **changes)
    frame_options = dataclasses.replace(
        frame, seed=int(values.get(SEED, frame.seed)), number=int(values.get(FRAME, frame.number))
    )
    return LiveConditions(
        scene=dataclasses.replace(scene, air=dataclasses.replace(scene.air, weather=weather)),
        trace=TraceOptions(rays=int(values.get(RAYS, 1))),
        frame=frame_options,
        budget=bool(values.get(BUDGET, 1)),
    )


def command(
    scene: str, sensor: str, overrides: Sequence[str], settings: Settings, *, donor_name: str = ""
) -> list[str]:
    """Words of the command line that renders the same.

    Args:
        donor_name: sensor whose detector is chosen; "" for the sensor's own
    """
    words = ["lidarscene", "render", scene]
    frame = int(number_of(FRAME, settings.get(FRAME, 0)))
    words += ["-o", "out", "--frames", str(frame + 1)] if frame else ["-o", "out.ply"]
    words += ["--sensor", sensor]
    if donor_name:
        overrides = [f"{DETECTOR}={donor_name}", *other_parts(DETECTOR, overrides)]
    for assignment in overrides:
        words += ["--set", assignment]
    for key, value in settings.items():
        if key in (RAYS, SEED):
            words += [f"--{key.partition('.')[2]}", f"{value:g}" if isinstance(value, float) else str(value)]
        elif key == FOG and number_of(key, value) >= CLEAR_KM:
            continue
        elif key not in ("sensor", DETECTOR, FRAME, BUDGET):
            option = "--scene-set" if key.startswith(("sun.", "weather.")) else "--set"
            words += [option, f"{key}={value:.6g}" if isinstance(value, float) else f"{key}={value}"]
    return words
