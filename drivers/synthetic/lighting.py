"""Light on the walls and the furniture, with soft shadows, worked out once on a coarse grid."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import kernel
from drivers.synthetic.raycast import ROOM, TUBE, Floats, meet_box, meet_round
from drivers.synthetic.solids import FACE_FLIP, FACE_U, FACE_V, Kind, Solid, SolidArrays

CELL_M = 0.08
AMBIENT = 0.42
BULBS_PER_LAMP = 3
FALL_OFF_M = 2.0


def bulbs(rng: np.random.Generator, half_m: Array) -> Array:
    """Points of light (B, 4): position in metres and power; two lamps and a window, each soft."""
    x, y, high = half_m[0], half_m[1], 2 * half_m[2]
    lamps = (
        ((rng.uniform(-0.5, 0.5) * x, rng.uniform(-0.5, 0.5) * y, high - 0.15), 1.6),
        ((rng.uniform(-0.8, 0.8) * x, rng.uniform(-0.8, 0.8) * y, high - 0.5), 0.9),
        ((0.93 * x * rng.choice((-1, 1)), rng.uniform(-0.6, 0.6) * y, 0.65 * high), 1.5),
    )
    points = [
        (*(np.array(position) + rng.normal(0.0, 0.10, 3) * (1, 1, 0.3)), power / BULBS_PER_LAMP)
        for position, power in lamps
        for _ in range(BULBS_PER_LAMP)
    ]
    return np.array(points)


def light_on_face(solid: Solid, face: int, solids: SolidArrays, lights: Array) -> Floats:
    """Brightness (rows, columns) over a face, 1 is full light."""
    wide, high = solid.face_size_m(face)
    columns, rows = max(2, int(wide / CELL_M)), max(2, int(high / CELL_M))
    s, t = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    unit, normal = _surface(solid.kind, face, s.ravel(), t.ravel())
    R, centre = solid.T_world_solid[:3, :3], solid.T_world_solid[:3, 3]
    points = (unit * solid.half_m) @ R.T + centre
    normals = normal @ R.T
    light = lit(points, normals, lights, solids.kind, solids.to_unit, solids.centre_m)
    return light.reshape(rows, columns)


def _surface(kind: Kind, face: int, s: Array, t: Array) -> tuple[Array, Array]:
    """Points in the unit cube and outward normals where a skin's pixel (s, t in 0..1) lies."""
    if kind in (Kind.TUBE, Kind.BALL):
        angle, z = 2 * np.pi * (s - 0.5), 1.0 - 2.0 * t
        radius = np.ones_like(z) if kind is Kind.TUBE else np.sqrt(1.0 - z * z)
        unit = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
        return unit, unit * (1.0, 1.0, 0.0 if kind is Kind.TUBE else 1.0)
    axis, side = face // 2, 2.0 * (face % 2) - 1.0
    flip = side * FACE_FLIP[axis] * (-1.0 if kind is Kind.ROOM else 1.0)
    unit = np.empty((len(s), 3))
    unit[:, axis] = side
    unit[:, FACE_U[axis]] = flip * (2.0 * s - 1.0)
    unit[:, FACE_V[axis]] = 1.0 - 2.0 * t
    normal = np.zeros_like(unit)
    normal[:, axis] = side * (-1.0 if kind is Kind.ROOM else 1.0)
    return unit, normal


@kernel
def lit(
    points: Array,
    normals: Array,
    lights: Array,
    kind: NDArray[np.int64],
    to_unit: Array,
    centre_m: Array,
) -> Floats:
    """Brightness (N,) at points (N, 3) with unit normals: ambient, and each bulb not hidden."""
    light = np.full(len(points), AMBIENT, dtype=np.float32)
    for i in range(len(points)):
        for bulb in lights:
            way = bulb[:3] - points[i]
            distance_m = np.sqrt(np.sum(way * way))
            cosine = np.sum(way * normals[i]) / distance_m
            if cosine <= 0.0:
                continue
            if not hidden(points[i] + 0.01 * normals[i], way, kind, to_unit, centre_m):
                light[i] += bulb[3] * cosine / (1.0 + (distance_m / FALL_OFF_M) ** 2)
    return light


@kernel
def hidden(
    start: Array, way: Array, kind: NDArray[np.int64], to_unit: Array, centre_m: Array
) -> bool:
    """True if a solid other than the room stands between `start` and `start + way`."""
    for s in range(len(kind)):
        if kind[s] == ROOM:
            continue
        M, away = to_unit[s], start - centre_m[s]
        ox = M[0, 0] * away[0] + M[0, 1] * away[1] + M[0, 2] * away[2]
        oy = M[1, 0] * away[0] + M[1, 1] * away[1] + M[1, 2] * away[2]
        oz = M[2, 0] * away[0] + M[2, 1] * away[1] + M[2, 2] * away[2]
        dx = M[0, 0] * way[0] + M[0, 1] * way[1] + M[0, 2] * way[2]
        dy = M[1, 0] * way[0] + M[1, 1] * way[1] + M[1, 2] * way[2]
        dz = M[2, 0] * way[0] + M[2, 1] * way[1] + M[2, 2] * way[2]
        if kind[s] >= TUBE:
            t = meet_round(ox, oy, oz, dx, dy, dz, kind[s] == TUBE)
        else:
            t = meet_box(ox, oy, oz, dx, dy, dz, False)
        if t < 1.0:
            return True
    return False
