"""Names for what Mitsuba and Dr.Jit hand out, as far as this package uses it.

Neither brings types that a checker can read: their classes exist only once a variant is set. A signature that names
a `Ray` or an `Interaction` still says what goes in, and a misspelt attribute of one is found.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

from ...maths.arrays import Array, Lanes, Mask, Numbers
from ...maths.vectors import Vector


class DeviceArray(Array, Protocol):
    """A Dr.Jit array of the active variant: numbers, whole numbers or flags, one for each lane."""

    def numpy(self) -> Numbers:
        """The values; waits until they are computed."""

    def __iter__(self) -> Iterator[Array]:
        """The components of a vector, or the numbers of the lanes."""


class DeviceVector(DeviceArray, Protocol):
    """Mitsuba's vector, point or normal of each lane."""

    @property
    def x(self) -> Array:
        """The first component."""

    @property
    def y(self) -> Array:
        """The second component."""

    @property
    def z(self) -> Array:
        """The third component."""


class Ray(Protocol):
    """`mitsuba.Ray3f`: origin, unit direction and largest distance of each lane."""

    o: DeviceVector
    d: DeviceVector
    maxt: Lanes

    def __call__(self, t: Lanes, /) -> DeviceVector:
        """The points at these distances."""


class Bsdf(Protocol):
    """`mitsuba.BSDF`: of one material, or a pointer to that of each lane."""

    def flags(self) -> int:
        """Kinds of its lobes, as `mitsuba.BSDFFlags`."""

    def id(self) -> str:
        """Its name in a Mitsuba file."""

    def eval(self, ctx: object, si: object, wo: object, active: Mask = True, /) -> Any:
        """f_r cos(theta_o), 1/sr."""

    def eval_null_transmission(self, si: object, active: Mask = True, /) -> Any:
        """Share of the light that goes straight on."""

    def eval_diffuse_reflectance(self, si: object, active: Mask = True, /) -> Any:
        """Diffuse hemispherical reflectivity."""


class Interaction(Protocol):
    """`mitsuba.SurfaceInteraction3f`: the point at which each lane met a surface.

    Attributes:
        t: distance
        p: point
        n: normal
        sh_frame: frame whose z is the normal
        wi: direction back along the ray, in that frame
        shape: pointer to the shape; on the device its number in Mitsuba's registry
        prim_index: number of the triangle within the shape
    """

    t: Lanes
    p: DeviceVector
    n: DeviceVector
    sh_frame: Any
    wi: DeviceVector
    shape: Any
    prim_index: Array

    def bsdf(self) -> Bsdf:
        """BSDF of the shape that was met."""

    def to_local(self, direction: object, /) -> DeviceVector:
        """A direction in the frame whose z is the normal."""

    def to_world(self, direction: object, /) -> DeviceVector:
        """A direction in that frame, in the frame of the ray."""


class Hit(Protocol):
    """`mitsuba.PreliminaryIntersection3f`: distance, shape, triangle and place on it only."""

    valid: Array
    t: Lanes
    shape: Any
    prim_index: Array
    prim_uv: DeviceVector

    def is_valid(self) -> Array:
        """True where a surface was met."""

    def compute_surface_interaction(self, ray: Ray, flags: object, active: object, /) -> Interaction:
        """Compute point, normal and everything else about the hit."""


class TracedScene(Protocol):
    """`mitsuba.Scene`, as rays ask it."""

    def ray_intersect_preliminary(self, ray: Ray, *, coherent: bool, active: object) -> Any:
        """The nearest `Hit` of each active ray."""

    def ray_test(self, ray: Ray, *, coherent: bool, active: object) -> Any:
        """True for each active ray that meets a surface."""


class Shape(Protocol):
    """`mitsuba.Shape`: a mesh, or a shape of a Mitsuba file."""

    def id(self) -> str:
        """Its name in the file."""

    def class_name(self) -> str:
        """Name of its class, such as 'Sphere'."""

    def bsdf(self) -> Any:
        """Its `Bsdf`."""

    def primitive_count(self) -> int:
        """Triangles of a mesh, 1 of others."""

    def is_mesh(self) -> bool:
        """True if it is made of triangles."""

    def vertex_positions_buffer(self) -> Any:
        """(3 v,) coordinates of the vertices of a mesh, on the device."""

    def faces_buffer(self) -> Any:
        """(3 f,) indices into the vertices of a mesh."""


def components(vector: DeviceVector) -> Vector:
    """Return x, y and z, as the formulas for NumPy and Dr.Jit take them."""
    x, y, z = vector
    return x, y, z
