"""Solids that a room is made of, and the arrays in which the kernels read them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, rigid_transform, so3_exp
from drivers.synthetic.textures import TexturePainter


class SolidKind(IntEnum):
    """Shape of a solid in its own unit cube, -1 to 1 along each axis."""

    BOX = 0
    ROOM = 1  # a box seen from inside
    CYLINDER = 2  # upright, open at both ends
    SPHERE = 3


FACES = 6  # a box's: -x +x -y +y -z +z; a round solid has one texture, face 0
# For a face across axis x, y, z: the axes along its texture's columns and rows, and the sign that
# makes writing run from left to right when seen from outside.
FACE_U_AXIS = (1, 0, 0)
FACE_V_AXIS = (2, 2, 1)
FACE_FLIP = (1.0, -1.0, 1.0)


@dataclass(frozen=True)
class Solid:
    """A shape with half extents `half_m` (3,) in its own frame, and a texture for each face."""

    kind: SolidKind
    T_world_solid: Array
    half_m: Array
    textures: tuple[TexturePainter, ...]

    def transform(self, T: Array) -> "Solid":
        """Return the solid moved by the rigid transform `T` (4, 4) of the world."""
        return replace(self, T_world_solid=T @ self.T_world_solid)

    def face_size_m(self, face: int) -> tuple[float, float]:
        """Width and height of a face's texture in meters."""
        x, y, z = (2.0 * float(half) for half in self.half_m)
        if self.kind in (SolidKind.CYLINDER, SolidKind.SPHERE):
            return np.pi * (x + y) / 2, z
        return ((y, z), (x, z), (x, y))[face // 2]


def make_solid(
    center_m: Sequence[float],
    size_m: Sequence[float],
    textures: TexturePainter | tuple[TexturePainter, ...],
    yaw_rad: float = 0.0,
    kind: SolidKind = SolidKind.BOX,
) -> Solid:
    """Make an upright solid.

    Args:
        center_m: Its center (3,) in the world.
        size_m: Its full size (3,).
        textures: One texture for all faces, or one for each.
        yaw_rad: Rotation about z.
    """
    face_textures = textures if isinstance(textures, tuple) else (textures,) * FACES
    T = rigid_transform(so3_exp([0.0, 0.0, yaw_rad]), center_m)
    return Solid(kind, T, np.asarray(size_m, dtype=np.float64) / 2, face_textures)


@dataclass(frozen=True)
class SolidArrays:
    """S solids as the kernels read them, each in the frame of its rigid body.

    Attributes:
        kind: (S,) values of `SolidKind`.
        to_unit: (S, 3, 3) rotates and scales a vector into a solid's unit cube.
        center_m: (S, 3).
        corners_m: (S, 8, 3); corner i and corner i ^ (1, 2 or 4) share an edge.
        body: (S,); 0 is the room, which rests in the world; the others are moving objects.
    """

    kind: NDArray[np.int64]
    to_unit: Array
    center_m: Array
    corners_m: Array
    body: NDArray[np.int64]

    @classmethod
    def pack(cls, *bodies: Sequence[Solid]) -> "SolidArrays":
        """Pack the solids of all bodies, in their order, the room's first."""
        solids = [solid for body in bodies for solid in body]
        unit = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) * 2.0 - 1.0
        R = np.array([s.T_world_solid[:3, :3] for s in solids])
        center = np.array([s.T_world_solid[:3, 3] for s in solids])
        half = np.array([s.half_m for s in solids])
        return cls(
            kind=np.array([int(s.kind) for s in solids], dtype=np.int64),
            to_unit=np.ascontiguousarray(R.transpose(0, 2, 1) / half[:, :, None]),
            center_m=center,
            corners_m=(unit * half[:, None, :]) @ R.transpose(0, 2, 1) + center[:, None, :],
            body=np.repeat(np.arange(len(bodies)), [len(body) for body in bodies]),
        )
