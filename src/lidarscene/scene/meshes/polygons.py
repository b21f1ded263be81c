"""Polygons as triangles: a fan for those that are convex, ears cut off one after the other (mapbox-earcut) for others.

A fan from the first corner of an L fills its notch, where nothing is. OBJ and OFF files are rewritten with triangles
before a mesh library reads them, since the libraries make fans; and binary PLY files as text where polygons differ in
their numbers of corners, since trimesh does not read them.

Symbols: v vertices, p polygons, c corners of all polygons one after the other, t triangles.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ...files.encodings.ply import NUMPY_TYPES
from ...maths.arrays import Numbers
from ...maths.vectors import cross_in_plane

STRAIGHT = 1e-9
"""Accuracy bought: sine of the angle by which a corner may turn inwards and still count as straight: rounding."""


def triangulate(vertices: Numbers, counts: Numbers, corners: Numbers) -> tuple[Numbers, Numbers]:
    """Cut polygons into triangles, in their order.

    Args:
        vertices: (v, 3)
        counts: (p,) corners of each polygon
        corners: (c,) indices into the vertices

    Returns:
        (t, 3) indices into ``corners``, and (t,) the polygon of each triangle: of n corners n - 2, fewer of a concave
        one with corners in line
    """
    starts = np.cumsum(counts) - counts
    # A polygon of n corners is n - 2 triangles, however it is cut.
    pieces = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), pieces)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = starts[polygon]
    triangles = np.stack([first, first + step + 1, first + step + 2], axis=1)
    ends, kept = np.cumsum(pieces), np.ones(len(polygon), dtype=bool)
    for number, flat in _concave(vertices, counts, starts, corners):
        ears, begin = _ears(flat), ends[number] - pieces[number]
        triangles[begin : begin + len(ears)] = starts[number] + ears
        kept[begin + len(ears) : ends[number]] = False
    return triangles[kept], polygon[kept]


def _concave(vertices: Numbers, counts: Numbers, starts: Numbers, corners: Numbers) -> list[tuple[int, Numbers]]:
    """Number of each polygon that is not convex, and its corners in its plane, counter-clockwise."""
    large = np.flatnonzero(counts > 3)
    if not len(large):
        return []
    sizes = counts[large]
    owner = np.repeat(np.arange(len(large)), sizes)
    begins = np.cumsum(sizes) - sizes
    place = np.arange(len(owner)) - begins[owner]
    points = vertices[corners[starts[large][owner] + place]]
    points = points - points[begins][owner]
    behind, ahead = begins[owner] + (place - 1) % sizes[owner], begins[owner] + (place + 1) % sizes[owner]
    before, after = points - points[behind], points[ahead] - points
    # Twice the area, with the normal as its direction (Newell).
    normals = np.add.reduceat(np.cross(points, points[ahead]), begins)
    turns = np.einsum("ci,ci->c", np.cross(before, after), normals[owner])
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1) * np.linalg.norm(normals, axis=1)[owner]
    concave = np.flatnonzero(np.logical_or.reduceat(turns < -STRAIGHT * lengths, begins))
    return [(int(large[i]), _in_plane(points[begins[i] : begins[i] + sizes[i]], normals[i])) for i in concave]


def _in_plane(points: Numbers, normal: Numbers) -> Numbers:
    """(n, 2) coordinates of points in the plane of a normal, from whose tip they turn counter-clockwise."""
    z = normal / np.linalg.norm(normal)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.stack([points @ x, points @ np.cross(z, x)], axis=1)


def _ears(points: Numbers) -> Numbers:
    """(n - 2, 3) triangles of a polygon of (n, 2) corners, counter-clockwise; fewer of one with corners in line."""
    from mapbox_earcut import triangulate_float64

    ears = np.asarray(triangulate_float64(points, np.array([len(points)], np.uint32)), dtype=np.int64).reshape(-1, 3)
    # Its triangles turn clockwise or counter-clockwise with the release.
    turned = cross_in_plane(points[ears[:, 1]] - points[ears[:, 0]], points[ears[:, 2]] - points[ears[:, 0]]) < 0.0
    ears[turned] = ears[turned, ::-1]
    return ears


_OBJ_ODDITIES = {
    rb"\r\n?": b"\n",
    rb"^(?:\xef\xbb\xbf[ \t]*|[ \t]+)": b"",
    rb"^(?!#)([^\\\n]*+)\\\n": rb"\1 ",
    rb"^(\w+)\t": rb"\1 ",
    rb"^((?:v|vt|vn|f) [^#\n]*+)#.*": rb"\1",
}
"""Choice: what trimesh does not read in OBJ files, and what it reads instead: ends of lines, indents, lines that go on
in the next one, tabs after the first word, and comments after numbers."""


def obj_in_triangles(data: bytes) -> bytes:
    """The text of an OBJ file with triangles in place of its polygons; only they stay where they cannot be read."""
    for pattern, text in _OBJ_ODDITIES.items():
        data = re.sub(pattern, text, data, flags=re.MULTILINE)
    if re.search(rb"^f(?:[ \t]+\S+){4}", data, re.MULTILINE) is None:
        return data
    lines = data.split(b"\n")
    vertices: list[list[bytes]] = []
    polygons: dict[int, list[bytes]] = {}
    corners: list[int] = []
    try:
        for number, line in enumerate(lines):
            words = line.split()
            if words[:1] == [b"v"]:
                vertices.append(words[1:4])
            elif words[:1] == [b"f"] and len(words) > 4:
                polygons[number] = words[1:]
                # Below 0 they count back from the last vertex so far.
                named = [int(word.partition(b"/")[0]) for word in words[1:]]
                corners += [index - 1 if index > 0 else len(vertices) + index for index in named]
        triangles = _triangles_of(np.array(vertices, dtype=np.float64), list(polygons.values()), corners)
    except (ValueError, IndexError):
        return data
    for number, faces in zip(polygons, triangles, strict=True):
        lines[number] = b"\n".join(b"f " + b" ".join(face) for face in faces)
    return b"\n".join(lines)


def off_in_triangles(data: bytes) -> bytes:
    """The text of an OFF file with triangles in place of its polygons; one that cannot be read is returned as it is."""
    lines = [line for line in (line.partition(b"#")[0].strip() for line in data.splitlines()) if line]
    try:
        head = 0 if lines[0].split()[1:] else 1
        vertex_count, face_count = (int(word) for word in lines[head].split()[1 - head : 3 - head])
        first = head + 1 + vertex_count
        vertices = np.array([line.split()[:3] for line in lines[head + 1 : first]], dtype=np.float64)
        rows = [line.split() for line in lines[first : first + face_count]]
        polygons = [row[1 : 1 + int(row[0])] for row in rows]
        if max(map(len, polygons)) <= 3:
            return data
        triangles = _triangles_of(vertices, polygons, [int(word) for polygon in polygons for word in polygon])
    except (ValueError, IndexError):
        return data
    faces = [b"3 " + b" ".join(face) for of_polygon in triangles for face in of_polygon]
    counts = b"OFF\n%d %d 0" % (vertex_count, len(faces))
    return b"\n".join([counts, *lines[head + 1 : first], *faces, b""])


def ply_as_text(data: bytes) -> bytes:
    """A binary PLY file as one of text; one that cannot be read is returned as it is."""
    try:
        form, elements, start = _ply_header(data)
        order = {"binary_little_endian": "<", "binary_big_endian": ">"}[form]
        rows = []
        for count, properties in elements:
            for _ in range(count if properties else 0):
                row: list[str] = []
                for names in properties:
                    numbers = 1
                    for name in names:
                        dtype = np.dtype(order + NUMPY_TYPES[name])
                        values = np.frombuffer(data, dtype, numbers, start).tolist() if numbers else []
                        start += dtype.itemsize * numbers
                        row += map(repr, values)
                        numbers = values[0] if values else 0
                rows.append(" ".join(row))
    except (IndexError, KeyError, TypeError, ValueError):
        return data
    head = data.partition(b"end_header")[0].replace(form.encode(), b"ascii")
    return head + b"end_header\n" + "\n".join([*rows, ""]).encode()


def _ply_header(data: bytes) -> tuple[str, list[tuple[int, list[list[str]]]], int]:
    """Format of a PLY file, its elements, and where they begin.

    An element is its number of rows and the types of its properties; a list has the type of its length and that of its
    numbers.
    """
    head, _, body = data.partition(b"end_header")
    form, elements = "", list[tuple[int, list[list[str]]]]()
    for words in (line.split() for line in head.decode("ascii").splitlines()):
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            elements.append((int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][1].append(words[2:4] if words[1] == "list" else words[1:2])
    return form, elements, len(data) - len(body) + body.index(b"\n") + 1


def _triangles_of(vertices: Numbers, polygons: Sequence[list[bytes]], corners: list[int]) -> list[list[list[bytes]]]:
    """Triangles of each polygon, as the words of its corners.

    Raises:
        IndexError: for a corner that is no vertex
    """
    if not all(0 <= corner < len(vertices) for corner in corners):
        raise IndexError("a face names a vertex that is not there")
    counts = np.array([len(polygon) for polygon in polygons])
    triangles, owner = triangulate(vertices, counts, np.array(corners))
    words = [word for polygon in polygons for word in polygon]
    result: list[list[list[bytes]]] = [[] for _ in polygons]
    for triangle, polygon in zip(triangles.tolist(), owner.tolist(), strict=True):
        result[polygon].append([words[corner] for corner in triangle])
    return result
