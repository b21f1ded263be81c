"""Open a recording: the suffix of the file's name selects the reader, which is imported then."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..catalog import file_or_example
from ..errors import InputError, OptionError
from ..files.arguments import checks_arguments
from ..files.optional import import_optional
from ..formats.cloud_description import input_errors
from .recording import Recording

Reader = Callable[[Path, Path | None], Recording]


@checks_arguments
def open_recording(
    path: str | os.PathLike[str], metadata: str | os.PathLike[str] | None = None, *, sensor_index: int = 0
) -> Recording:
    """Open a recording: a file, a folder of a ROS bag, a folder of files of points, or the catalogue's example by name.

    Args:
        metadata: the unit's own description where the maker keeps it apart: json of an Ouster (None: the file of the
            recording's name beside it), YAML of a Velodyne, CSV of a Hesai (None: the model's, from the decoder)
        sensor_index: which sensor of an OSF, from 0

    Raises:
        InputError: in one line, for a file that is missing, empty, damaged or of no known kind
    """
    file, metadata_file = _located(path), None if metadata is None else Path(metadata)
    if not file.exists():
        raise InputError(f"{file}: no such recording")
    if metadata_file is not None and not metadata_file.is_file():
        raise InputError(f"{metadata_file}: no such metadata file")
    if file.is_dir():
        read: Reader = _open_bag if (file / "metadata.yaml").is_file() else _open_cloud
    else:
        suffix = next((suffix for suffix in READERS if file.name.lower().endswith(suffix)), None)
        if suffix is None:
            raise InputError(f"{file}: must be a recording that ends in {', '.join(READERS)}, got '{file.suffix}'")
        if not file.stat().st_size:
            raise InputError(f"{file}: must have points or packets, got an empty file")
        read = READERS[suffix]
    if read is _open_osf:
        recording = _open_osf(file, metadata_file, sensor_index)
    elif sensor_index:
        raise OptionError(
            "{sensor_index} {0}: needs an OSF, which may have several sensors, got {1}", sensor_index, file
        )
    else:
        recording = read(file, metadata_file)
    if not recording.count:
        recording.close_file()
        raise InputError(f"{file}: must have frames of a lidar, got none")
    return recording


def extras_of(path: str | os.PathLike[str], metadata: str | os.PathLike[str] | None = None) -> tuple[str, ...]:
    """Groups of packages that open a recording, as far as its name and the files beside it say."""
    from .pcap_reader import metadata_of

    file = _located(path)
    suffix = file.suffix.lower()
    if suffix in (".osf", ".pcap"):
        description = metadata_of(file, None if metadata is None else Path(metadata))
        return ("ouster",) if description is not None and description.suffix.lower() in (".json", ".osf") else ()
    is_bag = suffix in (".mcap", ".db3", ".bag") or (file / "metadata.yaml").is_file()
    by_suffix = {".las": "las", ".laz": "las", ".feather": "parquet"}
    return ("ros",) if is_bag else (by_suffix[suffix],) if suffix in by_suffix else ()


def _open_ouster(path: Path, metadata: Path | None) -> Recording:
    from .ouster_reader import open_ouster

    return open_ouster(path, metadata)


def _open_osf(path: Path, metadata: Path | None, sensor_index: int = 0) -> Recording:
    """Open an OSF in a process of its own: ouster-sdk crashes over some damaged ones."""
    from .child_reader import open_in_child
    from .ouster_reader import open_ouster

    import_optional("ouster.sdk", extra="ouster")  # raises here, with the command that installs it
    return open_in_child(open_ouster, path, metadata, sensor_index)


def _open_packets(path: Path, metadata: Path | None) -> Recording:
    """Open a pcap with the reader of the maker whose packets it has; a json, given or beside it, means Ouster."""
    from . import hesai_reader, velodyne_reader
    from .pcap_reader import metadata_of, packets_of

    metadata_file = metadata_of(path, metadata)
    if metadata_file is not None and metadata_file.suffix.lower() == ".json" and metadata_file.is_file():
        return _open_ouster(path, metadata)
    with input_errors(path):
        packets = packets_of(
            path, lambda payload: velodyne_reader.is_velodyne(payload) or hesai_reader.is_hesai(payload)
        )
    if not packets:
        must = "must have packets of Velodyne or Hesai, or an Ouster's metadata as {1}.json beside it"
        raise OptionError(f"{{0}}: {must} (or as {{metadata}})", path, path.stem)
    if velodyne_reader.is_velodyne(packets[0].payload):
        return velodyne_reader.open_velodyne(path, metadata, packets.where(velodyne_reader.is_velodyne))
    return hesai_reader.open_hesai(path, metadata, packets.where(hesai_reader.is_hesai))


def _open_bag(path: Path, metadata: Path | None) -> Recording:
    from .bags import open_bag

    return open_bag(path, metadata)


def _open_cloud(path: Path, metadata: Path | None) -> Recording:
    from .point_files import open_cloud

    return open_cloud(path, metadata)


READERS: dict[str, Reader] = {
    ".pcap": _open_packets,
    ".osf": _open_osf,
    ".mcap": _open_bag,
    ".db3": _open_bag,
    ".bag": _open_bag,
    ".pcd.bin": _open_cloud,
    ".bin": _open_cloud,
    ".pcd": _open_cloud,
    ".ply": _open_cloud,
    ".las": _open_cloud,
    ".laz": _open_cloud,
    ".feather": _open_cloud,
}
"""Suffix of a file's name, the longest first -> reader."""


ONLY_RECORDINGS = (".pcap", ".osf", ".mcap", ".db3", ".bag", ".bin", ".feather")
"""Suffixes of recordings; no cloud that lidarscene can read back has them."""

EITHER = (".ply", ".pcd", ".las", ".laz")
"""Suffixes of clouds; one that another program than lidarscene wrote counts as a recording."""


def _located(path: str | os.PathLike[str]) -> Path:
    """Path of a recording, or of the example of this name; a folder with nothing to read does not hide it."""
    kinds = ("metadata.yaml", *READERS)
    with suppress(OSError, ValueError):  # a name with a null character is no file
        if any(name.lower().endswith(kinds) for name in os.listdir(path)):
            return Path(path)
    return file_or_example(path)


def is_recording(path: Path) -> bool:
    """Whether a path, or an example's name, is a recording and no cloud of lidarscene; False if it cannot be read.

    Reading such a file later raises the error.
    """
    with suppress(OSError):
        return _is_recording(_located(path))
    return False


def _is_recording(path: Path) -> bool:
    name = path.name.lower()
    if os.path.isdir(path):
        inside = [entry.name.lower() for entry in path.iterdir()]
        return "metadata.yaml" in inside or (
            any(name.endswith(".bin") for name in inside) and not any(name.endswith(EITHER) for name in inside)
        )
    if name.endswith(ONLY_RECORDINGS):
        return True
    if not name.endswith(EITHER) or not os.path.isfile(path):
        return False
    from .point_files import is_own

    return not is_own(path)
