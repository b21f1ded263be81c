"""JSON and numbers of a glTF 2.0 file, and what it declares before any geometry.

A file says in `extensionsUsed` and `extensionsRequired` how its numbers are to be taken. A reader that passes over one
of them gets another shape: coordinates of whole numbers are kilometres wide, and of a thousand trees one is left. So a
required extension that is not honoured is an error, and an optional one a warning.

Source: glTF 2.0, Khronos Group (2021), section 3 and the pages of the extensions.
"""

from __future__ import annotations

import binascii
import io
import json
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from ...errors import InputError, LidarSceneError, OptionWarning, warn
from ...files.inputs import LARGEST_PART, read_file
from ...files.optional import import_optional
from ...maths.arrays import Numbers

HONOURED = (
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
)
"""Extensions whose shapes and colours are read as they are meant; an unlit material has a base colour as others do."""

DRACO = "KHR_draco_mesh_compression"

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")

DECODED = "`gltf-transform cp {0} decoded.glb` writes it without"
"""Way round compressed geometry: glTF-Transform's command line decodes what it copies."""

REMEDIES = {
    **dict.fromkeys((DRACO, *MESHOPT), DECODED),
    "KHR_texture_basisu": "`gltf-transform ktxdecompress {0} decoded.glb` writes its textures as PNG",
}
"""Extension -> what to do with a file that needs it; {0} is the file."""

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

TRIANGLES = 4
"""Mode of a primitive; those below are points and lines."""

_MOST_ZEROS = 1 << 26
"""Most numbers of an accessor without data, which are all 0: a few bytes of JSON may ask for any number of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GltfDeclaration:
    """What a file says of itself before any geometry.

    Attributes:
        meshes: number of meshes
        skins: number of skins
        used: extensions that it uses
        required: those without which it cannot be read
        masked: names of the materials whose `alphaMode` is MASK
        missing: files of images that are not there
        unread: what else of the file is not read, in words
    """

    meshes: int
    skins: int
    used: tuple[str, ...]
    required: tuple[str, ...]
    masked: tuple[str, ...]
    missing: tuple[str, ...]
    unread: tuple[str, ...]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Extensions that are not honoured."""
        return tuple(name for name in self.used if name not in HONOURED)

    def check(self, path: Path) -> None:
        """Raise InputError for a required extension that is not honoured; warn of optional ones and missing images."""
        for name in self.left_out:
            if name in self.required:
                remedy = REMEDIES.get(name, "export the file without it").format(path)
                raise InputError(f"{path}: extensionsRequired: {name} cannot be read; {remedy}")
        if self.left_out:
            names = ", ".join(self.left_out)
            warn(OptionWarning("{0}: optional extensions that are left out: {1}", path, names))
        if self.missing:
            names = ", ".join(self.missing)
            warn(OptionWarning("{0}: images that are not there, whose colours and gaps are left out: {1}", path, names))


def declaration(path: Path) -> GltfDeclaration:
    """Read what a file declares; no geometry is read.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    try:
        content = GltfDocument(path).content
        used, required = (
            tuple(str(name) for name in content.get(key, ())) for key in ("extensionsUsed", "extensionsRequired")
        )
        return GltfDeclaration(
            meshes=len(content.get("meshes", [])),
            skins=len(content.get("skins", [])),
            used=tuple(dict.fromkeys((*used, *required))),
            required=required,
            masked=_named(content, "MASK"),
            missing=_missing_images(content, path.parent),
            unread=_unread(content),
        )
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())[:200]}") from None


def _named(content: Mapping[str, Any], alpha_mode: str) -> tuple[str, ...]:
    """Names of the materials with an `alphaMode`."""
    materials = enumerate(content.get("materials", []))
    return tuple(str(entry.get("name", number)) for number, entry in materials if entry.get("alphaMode") == alpha_mode)


def _missing_images(content: Mapping[str, Any], folder: Path) -> tuple[str, ...]:
    """Files of images that are not in the folder."""
    uris = [image["uri"] for image in content.get("images", []) if "uri" in image]
    names = [unquote_to_bytes(uri).decode("utf-8") for uri in uris if not uri.startswith("data:")]
    return tuple(name for name in names if not os.path.isfile(folder / name))  # False for a name that no file can have


def _unread(content: Mapping[str, Any]) -> tuple[str, ...]:
    """What a file has that is not read, in words."""
    primitives = [primitive for mesh in content.get("meshes", []) for primitive in mesh["primitives"]]
    attributes = [primitive["attributes"] for primitive in primitives]
    colours = [content["accessors"][names["COLOR_0"]] for names in attributes if "COLOR_0" in names]
    samplers = content.get("samplers", [])
    repeat = 10497  # the constant of OpenGL, and the default
    found = {
        "transparency (alphaMode BLEND), which a material of glass has: {}": ", ".join(_named(content, "BLEND")),
        "animations: {}": len(content.get("animations", [])),
        "points and lines: {}": sum(primitive.get("mode", TRIANGLES) < TRIANGLES for primitive in primitives),
        "alpha of the colours of vertices: {}": sum(colour["type"] == "VEC4" for colour in colours),
        "images that do not repeat: {}": sum(
            {sampler.get("wrapS", repeat), sampler.get("wrapT", repeat)} != {repeat} for sampler in samplers
        ),
    }
    return tuple(text.format(value) for text, value in found.items() if value)


class GltfDocument:
    """JSON and buffers of a file.

    Attributes:
        path: of the file
        content: its JSON
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        data, self._chunk = path.read_bytes(), b""
        if data[:4] == b"glTF":
            data, self._chunk = _chunks(data)
        self.content: dict[str, Any] = json.loads(data.decode("utf-8-sig"))
        if not isinstance(self.content, dict):
            raise ValueError("its JSON must be an object")
        version = str(self.content.get("asset", {}).get("version"))
        if not version.startswith("2."):
            raise ValueError(f"must be glTF 2, got version {version}")
        self._buffers: dict[int, bytes] = {}
        self._accessors: dict[int, Numbers] = {}
        self._images: dict[int, Numbers | None] = {}

    def item(self, kind: str, index: int) -> dict[str, Any]:
        """An entry of one of the file's lists.

        Raises:
            ValueError: if there is none
        """
        entries = self.content.get(kind, [])
        if not isinstance(index, int) or not 0 <= index < len(entries):
            raise ValueError(f"{kind}: there are {len(entries)}, and number {index} is named")
        entry: dict[str, Any] = entries[index]
        return entry

    def view(self, index: int) -> tuple[memoryview, int | None]:
        """Bytes of a buffer view, and its stride if it has one."""
        view = self.item("bufferViews", index)
        start = view.get("byteOffset", 0)
        data = memoryview(self._buffer(view["buffer"], view))[start : start + view["byteLength"]]
        return data, view.get("byteStride")

    def _buffer(self, index: int, view: Mapping[str, Any]) -> bytes:
        if index not in self._buffers:
            buffer = self.item("buffers", index)
            packed = next((name for name in MESHOPT if name in view.get("extensions", {})), None)
            if packed is not None and "uri" not in buffer and not (index == 0 and self._chunk):
                raise InputError(f"{packed} cannot be read; {REMEDIES[packed].format(self.path)}")
            self._buffers[index] = self._file(buffer["uri"]) if "uri" in buffer else self._chunk
        return self._buffers[index]

    def _file(self, uri: str) -> bytes:
        """Bytes of a data URI, or of a file beside this one.

        Raises:
            InputError: for a file that cannot be read
        """
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            data = unquote_to_bytes(text)
            return binascii.a2b_base64(data) if head.endswith(";base64") else data
        name = unquote_to_bytes(uri).decode("utf-8")
        try:
            return read_file(self.path.parent / name, "a file of a mesh", largest=LARGEST_PART)
        except InputError as error:
            raise InputError(f"cannot be read as a mesh: {error}") from None

    def accessor(self, index: int, values: Numbers | None = None) -> Numbers:
        """Numbers of an accessor, (rows, components): whole ones as they are, fractions (`normalized`) in float64.

        Args:
            values: decoded rows in place of those of the buffer
        """
        if values is None and index in self._accessors:
            return self._accessors[index]
        accessor = self.item("accessors", index)
        dtype, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _SIZES[accessor["type"]]
        rows = self._rows(accessor, dtype, width) if values is None else np.asarray(values).reshape(-1, width)
        if accessor.get("normalized") and rows.dtype.kind in "iu":
            rows = np.maximum(rows / float(np.iinfo(dtype).max), -1.0)
        if values is None:
            self._accessors[index] = rows
        return rows

    def _rows(self, accessor: Mapping[str, Any], dtype: np.dtype[Any], width: int) -> Numbers:
        count = int(accessor["count"])
        if "bufferView" in accessor:
            rows = self._strided(accessor["bufferView"], accessor.get("byteOffset", 0), dtype, (count, width))
        elif count * width > _MOST_ZEROS:
            raise ValueError(f"accessors: {count} rows without a bufferView")
        else:
            rows = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            sparse, rows = accessor["sparse"], rows.copy()
            where, what = sparse["indices"], sparse["values"]
            changed = int(sparse["count"])
            index_dtype = np.dtype(_COMPONENTS[where["componentType"]])
            index = self._strided(where["bufferView"], where.get("byteOffset", 0), index_dtype, (changed, 1))[:, 0]
            rows[index] = self._strided(what["bufferView"], what.get("byteOffset", 0), dtype, (changed, width))
        return rows

    def _strided(self, view: int, offset: int, dtype: np.dtype[Any], shape: tuple[int, int]) -> Numbers:
        data, stride = self.view(view)
        # Raises ValueError or TypeError where the view is too short.
        return np.ndarray(shape, dtype, data, offset, (stride or dtype.itemsize * shape[1], dtype.itemsize))

    def image(self, texture: int) -> Numbers | None:
        """Pixels of a texture, (h, w, 4) uint8, first row at the top; None for an image that is not there or cannot be
        decoded.
        """
        entry = self.item("textures", texture)
        index = entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source", entry.get("source"))
        if index is None:
            return None
        if index not in self._images:
            from PIL import Image

            source = self.item("images", index)
            try:
                data = self._file(source["uri"]) if "uri" in source else bytes(self.view(source["bufferView"])[0])
                with Image.open(io.BytesIO(data)) as image:
                    self._images[index] = np.asarray(image.convert("RGBA"))
            except InputError:  # of a file that is not there; `GltfDeclaration.check` has warned
                self._images[index] = None
            except (OSError, SyntaxError, Image.DecompressionBombError):
                self._images[index] = None
                what = f"{self.path}: images[{index}]"
                warn(OptionWarning("{0} cannot be decoded; its colours and gaps are left out", what))
        return self._images[index]

    def draco(self, primitive: Mapping[str, Any]) -> Any:
        """Decode a primitive that Draco has compressed; None for another, or one that is also there plainly.

        Raises:
            LidarSceneError: without DracoPy
        """
        packed = primitive.get("extensions", {}).get(DRACO)
        if packed is None or "bufferView" in self.item("accessors", primitive["attributes"]["POSITION"]):
            return None
        try:
            decoder = import_optional("DracoPy", extra="draco")
        except LidarSceneError as error:
            raise LidarSceneError(f"{self.path}: {DRACO}: {error}; or {DECODED.format(self.path)}") from None
        return decoder.decode(bytes(self.view(packed["bufferView"])[0]))


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """JSON and binary chunk of a GLB file, after its header of 12 bytes.

    Raises:
        ValueError: if there is no JSON
    """
    found: dict[bytes, bytes] = {}
    start = 12
    while start + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, start)
        found.setdefault(kind, data[start + 8 : start + 8 + length])
        start += 8 + length
    if b"JSON" not in found:
        raise ValueError("a GLB file must have a chunk of JSON")
    return found[b"JSON"], found.get(b"BIN\0", b"")
