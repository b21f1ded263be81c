"""glTF files that tests write themselves: numbers in a buffer, and the JSON that says what they are."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

WALL = np.array([[10, -2, -2], [10, 2, -2], [10, 2, 2], [10, -2, 2]], float)
"""Corners of a wall of 4 x 4 m, 10 m before the origin; y up, and in the middle of the axes."""

WALL_FACES = np.array([0, 1, 2, 0, 2, 3])


class Gltf:
    """A file that grows, one entry after the other."""

    def __init__(self) -> None:
        self.content: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.data = b""

    def add(self, kind: str, **entry: Any) -> int:
        """Append an entry to a list; returns its number."""
        self.content.setdefault(kind, []).append(entry)
        return len(self.content[kind]) - 1

    def view(self, data: bytes) -> int:
        self.data += bytes(-len(self.data) % 4)
        number = self.add("bufferViews", buffer=0, byteOffset=len(self.data), byteLength=len(data))
        self.data += data
        return number

    def numbers(self, values: Any, dtype: str = "f4", **keys: Any) -> int:
        """An accessor of these rows."""
        rows = np.asarray(values, dtype=f"<{dtype}")
        rows = rows.reshape(len(rows), -1)
        kind = {"componentType": COMPONENTS[dtype], "count": len(rows), "type": TYPES[rows.shape[1]]}
        return self.add("accessors", bufferView=self.view(rows.tobytes()), **kind, **keys)

    def image(self, pixels: Any) -> int:
        """A texture of these pixels, (h, w, 3 or 4) uint8."""
        buffer = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(buffer, "PNG")
        image = self.add("images", bufferView=self.view(buffer.getvalue()), mimeType="image/png")
        return self.add("textures", source=image)

    def mesh(self, positions: Any = WALL, faces: Any = WALL_FACES, *, dtype: str = "f4", **keys: Any) -> int:
        """A mesh of one primitive; ``keys`` are further keys of it, of which `attributes` are further attributes."""
        normalized = {"normalized": True} if keys.pop("normalized", False) else {}
        attributes = {"POSITION": self.numbers(positions, dtype, **normalized), **keys.pop("attributes", {})}
        indices = {} if faces is None else {"indices": self.numbers(faces, "u2")}
        return self.add("meshes", primitives=[{"attributes": attributes, **indices, **keys}])

    def skinned_wall(self, joints: int, weights: int) -> None:
        """The wall on two joints, 1 m along x and 1 m along y; accessors of four rows of joints and of weights."""
        self.mesh(attributes={"JOINTS_0": joints, "WEIGHTS_0": weights})
        self.content["scenes"] = [{"nodes": [0, 1, 2]}]
        self.add("nodes", mesh=0, skin=0)
        self.add("nodes", translation=[1, 0, 0])
        self.add("nodes", translation=[0, 1, 0])
        self.add("skins", joints=[1, 2])

    def save(self, path: Path, *, required: tuple[str, ...] = (), used: tuple[str, ...] = ()) -> Path:
        """Write a GLB file."""
        if self.data:
            self.content["buffers"] = [{"byteLength": len(self.data)}]
        if required or used:
            self.content |= {"extensionsUsed": [*used, *required], "extensionsRequired": list(required)}
        text = json.dumps(self.content).encode()
        text += b" " * (-len(text) % 4)
        body = self.data + bytes(-len(self.data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path
