"""Light on the walls and the furniture, with soft shadows, computed once on a coarse grid."""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic.raycast import (
    CYLINDER,
    ROOM,
    Floats,
    intersect_box,
    intersect_sphere_or_cylinder,
)
from drivers.synthetic.solids import (
    FACE_FLIP,
    FACE_U_AXIS,
    FACE_V_AXIS,
    Solid,
    SolidArrays,
    SolidKind,
)

CELL_M = 0.08
AMBIENT = 0.42
LIGHTS_PER_LAMP = 3
FALL_OFF_M = 2.0
SURFACE_OFFSET_M = 0.01  # keeps a surface from shadowing itself
NEIGHBORS = 16  # points of a face whose shadows come from the same few solids


def make_lights(rng: np.random.Generator, half_m: Array) -> Array:
    """Make point lights (B, 4), position in meters and power, of two lamps and a window.

    Several points for each of them give soft shadows.
    """
    x, y, high = half_m[0], half_m[1], 2 * half_m[2]
    lamps = (
        ((rng.uniform(-0.5, 0.5) * x, rng.uniform(-0.5, 0.5) * y, high - 0.15), 1.3),
        ((rng.uniform(-0.8, 0.8) * x, rng.uniform(-0.8, 0.8) * y, high - 0.5), 0.7),
        ((0.93 * x * rng.choice((-1, 1)), rng.uniform(-0.6, 0.6) * y, 0.65 * high), 1.2),
    )
    points = [
        (*(np.array(position) + rng.normal(0.0, 0.10, 3) * (1, 1, 0.3)), power / LIGHTS_PER_LAMP)
        for position, power in lamps
        for _ in range(LIGHTS_PER_LAMP)
    ]
    return np.array(points)


def compute_face_brightness(solid: Solid, face: int, solids: SolidArrays, lights: Array) -> Floats:
    """Compute the brightness (rows, columns) over a face; 1 is full light.

    Args:
        lights: (B, 4) position in the world, m, and power of each light.
    """
    wide, high = solid.face_size_m(face)
    columns, rows = max(2, int(wide / CELL_M)), max(2, int(high / CELL_M))
    s, t = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    unit, normal = _surface_points(solid.kind, face, s.ravel(), t.ravel())
    R, center = solid.T_world_solid[:3, :3], solid.T_world_solid[:3, 3]
    points = (unit * solid.half_m) @ R.T + center
    normals = normal @ R.T
    light = _compute_brightness(
        points, normals, lights, solids.kind, solids.to_unit, solids.center_m
    )
    return light.reshape(rows, columns)


def _surface_points(kind: SolidKind, face: int, s: Array, t: Array) -> tuple[Array, Array]:
    """Unit cube points and outward normals at texture coordinates s, t in 0 .. 1."""
    if kind in (SolidKind.CYLINDER, SolidKind.SPHERE):
        angle, z = 2 * np.pi * (s - 0.5), 1.0 - 2.0 * t
        radius = np.ones_like(z) if kind is SolidKind.CYLINDER else np.sqrt(1.0 - z * z)
        unit = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
        return unit, unit * (1.0, 1.0, 0.0 if kind is SolidKind.CYLINDER else 1.0)
    axis, side = face // 2, 2.0 * (face % 2) - 1.0
    flip = side * FACE_FLIP[axis] * (-1.0 if kind is SolidKind.ROOM else 1.0)
    unit = np.empty((len(s), 3))
    unit[:, axis] = side
    unit[:, FACE_U_AXIS[axis]] = flip * (2.0 * s - 1.0)
    unit[:, FACE_V_AXIS[axis]] = 1.0 - 2.0 * t
    normal = np.zeros_like(unit)
    normal[:, axis] = side * (-1.0 if kind is SolidKind.ROOM else 1.0)
    return unit, normal


@kernel
def _compute_brightness(
    points: Array,
    normals: Array,
    lights: Array,
    kind: NDArray[np.int64],
    to_unit: Array,
    center_m: Array,
) -> Floats:
    """Compute the brightness (N,) at the points (N, 3) of a face with unit normals.

    It is the ambient light and the light of each point light that is not occluded.
    """
    light = np.full(len(points), AMBIENT, dtype=np.float32)
    radii_m = _bounding_radii_m(to_unit)
    near = np.empty(len(kind), np.int64)
    for first in range(0, len(points), NEIGHBORS):
        stop = min(first + NEIGHBORS, len(points))
        middle, reach_m = _bounding_sphere(points[first:stop])
        for bulb in lights:
            count = -1  # not known yet: many faces are turned away from the light
            for i in range(first, stop):
                p, n = points[i], normals[i]
                wx, wy, wz = bulb[0] - p[0], bulb[1] - p[1], bulb[2] - p[2]
                distance_m = math.sqrt(wx * wx + wy * wy + wz * wz)
                cosine = (wx * n[0] + wy * n[1] + wz * n[2]) / distance_m
                if cosine <= 0.0:
                    continue
                if count < 0:
                    count = _find_occluders(middle, reach_m, bulb, kind, center_m, radii_m, near)
                x, y, z = (
                    p[0] + SURFACE_OFFSET_M * n[0],
                    p[1] + SURFACE_OFFSET_M * n[1],
                    p[2] + SURFACE_OFFSET_M * n[2],
                )
                if not _is_occluded(x, y, z, wx, wy, wz, kind, to_unit, center_m, near[:count]):
                    light[i] += bulb[3] * cosine / (1.0 + (distance_m / FALL_OFF_M) ** 2)
    return light


@kernel
def _bounding_radii_m(to_unit: Array) -> Array:
    """Return the radii (S,) of spheres around the solids with `to_unit` (S, 3, 3)."""
    radii_m = np.empty(len(to_unit))
    for s in range(len(to_unit)):
        square = 0.0  # each row is an axis over half a side
        for k in range(3):
            square += 1.0 / (to_unit[s, k, 0] ** 2 + to_unit[s, k, 1] ** 2 + to_unit[s, k, 2] ** 2)
        radii_m[s] = math.sqrt(square)
    return radii_m


@kernel
def _bounding_sphere(points: Array) -> tuple[Array, float]:
    """Return a sphere around points (N, 3): its center (3,), and its radius, m."""
    middle = (points[0] + points[-1]) / 2.0
    radius_m = 0.0
    for p in points:
        x, y, z = p[0] - middle[0], p[1] - middle[1], p[2] - middle[2]
        radius_m = max(radius_m, math.sqrt(x * x + y * y + z * z))
    return middle, radius_m


@kernel
def _find_occluders(
    middle: Array,
    reach_m: float,
    bulb: Array,
    kind: NDArray[np.int64],
    center_m: Array,
    radii_m: Array,
    found: NDArray[np.int64],
) -> int:
    """Find the solids that may be between a light and points within `reach_m` of `middle`.

    They are written to `found` (S,); their number is returned. The room is none of them.
    """
    wx, wy, wz = bulb[0] - middle[0], bulb[1] - middle[1], bulb[2] - middle[2]
    square = wx * wx + wy * wy + wz * wz
    count = 0
    for s in range(len(kind)):
        x, y, z = (
            center_m[s, 0] - middle[0],
            center_m[s, 1] - middle[1],
            center_m[s, 2] - middle[2],
        )
        along = min(1.0, max(0.0, (x * wx + y * wy + z * wz) / square))
        x, y, z = x - along * wx, y - along * wy, z - along * wz
        limit_m = radii_m[s] + reach_m + 2.0 * SURFACE_OFFSET_M
        if kind[s] != ROOM and x * x + y * y + z * z <= limit_m * limit_m:
            found[count] = s
            count += 1
    return count


@kernel
def _is_occluded(
    x: float,
    y: float,
    z: float,
    wx: float,
    wy: float,
    wz: float,
    kind: NDArray[np.int64],
    to_unit: Array,
    center_m: Array,
    occluders: NDArray[np.int64],
) -> bool:
    """Whether one of the occluders is between (x, y, z) and (x + wx, y + wy, z + wz)."""
    for s in occluders:
        M, c = to_unit[s], center_m[s]
        ax, ay, az = x - c[0], y - c[1], z - c[2]
        ox, oy, oz = rotate(M, ax, ay, az)
        dx, dy, dz = rotate(M, wx, wy, wz)
        if kind[s] >= CYLINDER:
            t = intersect_sphere_or_cylinder(ox, oy, oz, dx, dy, dz, kind[s] == CYLINDER)
        else:
            t = intersect_box(ox, oy, oz, dx, dy, dz, False)
        if t < 1.0:
            return True
    return False


@kernel
def rotate(M: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Multiply M (3, 3) by (x, y, z)."""
    return (
        M[0, 0] * x + M[0, 1] * y + M[0, 2] * z,
        M[1, 0] * x + M[1, 1] * y + M[1, 2] * z,
        M[2, 0] * x + M[2, 1] * y + M[2, 2] * z,
    )
