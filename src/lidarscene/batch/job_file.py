"""Job files: what `lidarscene batch` renders, TOML in, `JobFile` out. Paths in a job file are relative to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from ..errors import InputError
from ..files.overrides import toml_text
from ..files.table_model import Number
from ..files.toml import FileModel, read_toml, validate
from ..formats.registry import FORMATS
from ..outputs.output_options import Outputs
from ..rendering.option_fields import Whole, options_of
from ..rendering.render_options import SEEDS, FrameOptions, TraceOptions
from ..scene.motion import EgoFile

Name = Annotated[str, Field(min_length=1)]
Seed = Annotated[int, Field(ge=SEEDS.low, le=SEEDS.high)]

# JSON Schema for editors: a list of values, or a table of further keys. The values are checked with the scenes.
SWEPT: JsonDict = {"additionalProperties": {"anyOf": [{"type": "array", "minItems": 1}, {"type": "object"}]}}

WHOLE_DRIVES = ("mcap", "mcap-ouster", "rrd")
"""Data sets of a file for each drive, by its format."""

MOST_FRAMES = 10_000_000
"""Most frames of one combination."""


def _key(kind: type[Any], name: str) -> Any:
    """Key of the file that is an option: its default, its help as description, the bounds of a whole number."""
    field, declaration = options_of(kind)[name]
    bounds: dict[str, Any] = {}
    if isinstance(declaration.values, Whole):
        bounds = {"ge": declaration.values.low, "le": declaration.values.high}
    return Field(default=field.default, description=declaration.help, **bounds)


def _leaves(tables: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Iterate over dotted keys and their values, tables flattened: ``"a.b" = 1`` and ``a.b = 1`` are equal here.

    A range, a table with ``low`` and ``high``, is a value.
    """
    for key, value in tables.items():
        if isinstance(value, dict) and not {"low", "high"} <= value.keys():
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _require_unique(key: str, values: Sequence[Any]) -> None:
    """Raise ValueError for a value that is there more than once."""
    texts = [toml_text(value) for value in values]
    text, count = Counter(texts).most_common(1)[0] if texts else ("", 0)
    if count > 1:
        raise ValueError(f"{key}: values must be unique, got {text} ({count} times)")


class SweepFile(FileModel):
    """[sweep]: values of the scene's and the sensor's keys; every one with every other."""

    scene: dict[str, Any] = Field(
        default={}, description="lists of values of the scene file's keys, as `--scene-set`", json_schema_extra=SWEPT
    )
    sensor: dict[str, Any] = Field(
        default={},
        description="lists of values of the sensor file's keys, as `--set`; for every sensor of a rig",
        json_schema_extra=SWEPT,
    )

    @model_validator(mode="after")
    def _lists(self) -> SweepFile:
        for kind in ("scene", "sensor"):
            for key, values in _leaves(getattr(self, kind)):
                if not isinstance(values, tuple) or not values:
                    raise ValueError(f"{kind}.{key}: must be a list of values, got {toml_text(values)}")
                _require_unique(f"{kind}.{key}", values)
        return self

    def scene_values(self) -> dict[str, tuple[Any, ...]]:
        """Values by dotted key of the scene file."""
        return dict(_leaves(self.scene))

    def sensor_values(self) -> dict[str, tuple[Any, ...]]:
        """Values by dotted key of the sensor file."""
        return dict(_leaves(self.sensor))


class RangeFile(FileModel):
    """A range of numbers from which one is drawn for each drive: ``{ low = 1, high = 100, log = true }``."""

    low: Annotated[float, Number(ge=-1e12, le=1e12)] = Field(description="minimum")
    high: Annotated[float, Number(ge=-1e12, le=1e12)] = Field(description="maximum")
    log: bool = Field(default=False, description="each factor is as likely as any other, not each step")

    @model_validator(mode="after")
    def _rises(self) -> RangeFile:
        if not self.low < self.high:
            raise ValueError(f"high must be above low, {self.low:g}, got {self.high:g}")
        if self.log and self.low <= 0:
            raise ValueError(f"low: must be > 0 with log, got {self.low:g}")
        return self

    def value(self, share: float) -> float:
        """Value below which this share of the draws lies, to six digits."""
        if self.log:
            return float(f"{self.low * (self.high / self.low) ** share:.6g}")
        return float(f"{self.low + (self.high - self.low) * share:.6g}")


class DrawsFile(FileModel):
    """[draws]: values drawn anew for each drive, from ranges or lists, of the scene's and the sensor's keys."""

    scene: dict[str, Any] = Field(
        default={},
        description="lists or ranges, `{ low = 1, high = 100, log = true }`, of the scene file's keys",
        json_schema_extra=SWEPT,
    )
    sensor: dict[str, Any] = Field(
        default={},
        description="lists or ranges of the sensor file's keys; one draw for all sensors of a rig",
        json_schema_extra=SWEPT,
    )

    @model_validator(mode="after")
    def _drawable(self) -> DrawsFile:
        for kind in ("scene", "sensor"):
            for key, value in _leaves(getattr(self, kind)):
                if isinstance(value, dict):
                    try:
                        validate(RangeFile, value, f"{kind}.{key}")
                    except InputError as error:
                        raise ValueError(str(error)) from None
                elif not isinstance(value, tuple) or not value:
                    must = "must be a list, or a range with low and high"
                    raise ValueError(f"{kind}.{key}: {must}, got {toml_text(value)}")
        return self

    def rules(self, kind: Literal["scene", "sensor"]) -> dict[str, RangeFile | tuple[Any, ...]]:
        """Ranges and lists by dotted key of the scene or sensor file."""
        leaves = _leaves(getattr(self, kind))
        return {key: RangeFile(**value) if isinstance(value, dict) else value for key, value in leaves}


class TrajectoryFile(EgoFile):
    """[[trajectories]]: a motion of the ego vehicle, in place of the scene's own."""

    label: Name = Field(description="names it in the manifest")

    def override(self, folder: Path | None = None) -> str:
        """Override of a scene file that sets this motion; ``folder`` of the job file resolves its poses_file."""
        settings = self.model_dump(include=self.model_fields_set - {"label"}, exclude_unset=True)
        if folder is not None and self.poses_file is not None:
            settings["poses_file"] = str(folder.absolute() / self.poses_file)
        return f"ego={toml_text(settings)}"


class SplitFile(FileModel):
    """[splits]: parts of a data set."""

    train: Annotated[float, Number(ge=0, le=1)] = Field(
        default=1.0, description="fraction of the frames for training; the three add up to 1"
    )
    val: Annotated[float, Number(ge=0, le=1)] = Field(default=0.0, description="fraction of the frames for validation")
    test: Annotated[float, Number(ge=0, le=1)] = Field(default=0.0, description="fraction of the frames for tests")
    by: Literal["street", "drive", "frames"] = Field(
        default="street",
        description="what goes whole into one part: a street (drives that differ only in light, weather, paint, "
        "traffic, the vehicle's motion, sensor and seed), a drive (one scene, sensor and seed), or runs of consecutive "
        "frames of each drive",
    )

    @model_validator(mode="after")
    def _add_up(self) -> SplitFile:
        total = self.train + self.val + self.test
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"train, val and test must add up to 1, got {total:g}")
        return self

    def shares(self) -> dict[str, float]:
        """Share of each part."""
        return {"train": self.train, "val": self.val, "test": self.test}


class JobFile(FileModel):
    """A whole job file: the product of its lists."""

    name: str = Field(default="", description="for people")
    scenes: Annotated[tuple[Name, ...], Field(min_length=1)] = Field(description="scene files")
    sensors: tuple[Name, ...] = Field(
        default=(), description="catalogue names or sensor files; each scene's own if there are no rigs either"
    )
    rigs: tuple[Name, ...] = Field(default=(), description="rig files; a cloud for each of their sensors")
    trajectories: tuple[TrajectoryFile, ...] = Field(
        default=(), description="motions of the ego vehicle in place of the scene's `[ego]`"
    )
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)] = Field(
        default=1, description="frames of each combination, one after the other"
    )
    begin_s: Annotated[float, Number(ge=-1e12, le=1e12)] = _key(FrameOptions, "begin_s")
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = Field(default=(0,), description="seeds")
    seed_count: Annotated[int, Field(ge=1, le=2**32)] | None = Field(
        default=None, description="seeds 0 to this number less one, in place of `seeds`"
    )
    sweep: SweepFile = Field(default=SweepFile(), description="values to vary")
    draws: DrawsFile = Field(default=DrawsFile(), description="values drawn anew for each drive")
    dataset: Literal["kitti", "semantickitti", "nuscenes", "mcap", "mcap-ouster", "rrd"] | None = Field(
        default=None,
        description="the folder becomes such a data set, clouds and labels; the last three are a file for each drive",
    )
    splits: SplitFile | None = Field(default=None, description="parts of the data set; all of it trains without")
    format: str = Field(
        default="ply",
        description="of the clouds' files, one of these (docs/formats.md)",
        json_schema_extra={"enum": list(FORMATS)},
    )
    coordinates: Literal["world", "vehicle", "sensor"] = Field(default="world", description="frame of the points")
    truth: bool = Field(default=True, description="false leaves the ground truth out")
    deskew: bool | None = Field(
        default=None,
        description="whether the clouds are without the sensor's own motion; if left out, those of `kitti`, "
        "`semantickitti` and `nuscenes` are, as the real ones, and others are not",
    )
    all_around: bool = _key(Outputs, "all_around")
    own_car: bool = _key(Outputs, "own_car")
    rays: int = _key(TraceOptions, "rays")
    interactions: int = _key(TraceOptions, "interactions")
    chunk: int | None = _key(FrameOptions, "chunk")

    @model_validator(mode="after")
    def _one_way(self) -> JobFile:
        for key in ("scenes", "sensors", "rigs", "seeds"):
            _require_unique(key, getattr(self, key))
        _require_unique("trajectories", [trajectory.label for trajectory in self.trajectories])
        for kind, swept in (("scene", self.sweep.scene_values()), ("sensor", self.sweep.sensor_values())):
            if both := swept.keys() & self.draws.rules(cast(Any, kind)).keys():
                raise ValueError(f"draws.{kind}.{min(both)}: is in sweep, too")
        if self.format not in FORMATS:
            raise ValueError(f"format: must be one of {', '.join(FORMATS)}, got '{self.format}'")
        if self.dataset is not None and "format" in self.model_fields_set:
            raise ValueError("format: a data set has its own, leave it out with dataset")
        if self.splits is not None and self.dataset is None:
            raise ValueError("splits: needs dataset")
        if self.seed_count is not None and "seeds" in self.model_fields_set:
            raise ValueError("must have only one of seeds and seed_count, got both")
        return self

    def all_seeds(self) -> Sequence[int]:
        """Seeds of the job, in order."""
        return self.seeds if self.seed_count is None else range(self.seed_count)

    @property
    def is_deskewed(self) -> bool:
        """Whether the clouds are without the sensor's own motion."""
        return self.dataset not in (None, *WHOLE_DRIVES) if self.deskew is None else self.deskew

    def trace_options(self) -> TraceOptions:
        """Options of tracing, the same for all frames."""
        return TraceOptions(rays=self.rays, interactions=self.interactions)

    def frame_options(self, seed: int, number: int) -> FrameOptions:
        """Options of the frame with this seed and number."""
        return FrameOptions(
            seed=seed, number=number, begin_s=self.begin_s, coordinates=self.coordinates, chunk=self.chunk
        )


def read_job(path: Path) -> JobFile:
    """Read and check a job file.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return validate(JobFile, read_toml(path), str(path))
