"""Ray casting: the solid that each pixel sees, and its depth.

A ray of a pixel is (x, y, 1) in camera axes, so the ray's parameter is the depth z in meters.
Every row has its own pose (rolling shutter).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic.solids import SolidArrays, SolidKind

NEAR_M = 0.02
FAR_M = 1e6


@kernel
def intersect_box(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, inside: bool
) -> float:
    """Return t where o + t d enters the unit cube, or leaves it if `inside`; FAR_M if nowhere.

    Args:
        ox, oy, oz: Origin o of the ray in the unit cube.
        dx, dy, dz: Direction d.
        inside: Whether the ray starts inside: the cube is the room.
    """
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    cx, cy, cz = -ox * ix, -oy * iy, -oz * iz
    rx, ry, rz = abs(ix), abs(iy), abs(iz)
    enter = max(cx - rx, max(cy - ry, cz - rz))
    leave = min(cx + rx, min(cy + ry, cz + rz))
    if inside:
        return leave
    return enter if enter <= leave and enter > NEAR_M else FAR_M


@kernel
def intersect_sphere_or_cylinder(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, is_cylinder: bool
) -> float:
    """Return t where o + t d first hits the unit sphere or open cylinder; FAR_M if nowhere.

    Args:
        ox, oy, oz: Origin o of the ray in the unit cube.
        dx, dy, dz: Direction d.
        is_cylinder: Whether the solid is a cylinder along z.
    """
    w = 0.0 if is_cylinder else 1.0
    a = dx * dx + dy * dy + w * dz * dz
    half_b = ox * dx + oy * dy + w * oz * dz
    root = half_b * half_b - a * (ox * ox + oy * oy + w * oz * oz - 1.0)
    if root < 0.0:
        return FAR_M
    root = math.sqrt(root)
    for t in ((-half_b - root) / a, (-half_b + root) / a):
        if t > NEAR_M and abs(oz + t * dz) <= 1.0:
            return t
    return FAR_M


TILE = 16
# How far a solid's outline may move between the three projected rows, in tan(angle).
OUTLINE_MARGIN = 0.01
BOX, ROOM, CYLINDER = int(SolidKind.BOX), int(SolidKind.ROOM), int(SolidKind.CYLINDER)

Floats = NDArray[np.float32]
Indices = NDArray[np.int32]


@dataclass(frozen=True)
class RaycastScene:
    """The solids as seen from each row's pose.

    Attributes:
        kind: (S,) values of `SolidKind`.
        frames: (H, S, 3, 4) maps camera coordinates of a row to a solid's unit cube.
        candidates: (tile rows, tile columns, S + 1) solids that a tile may see, nearest first,
            ended by -1.
        near_m: (S,) smallest depth of each solid.
    """

    kind: NDArray[np.int64]
    frames: Array
    candidates: Indices
    near_m: Array


@dataclass(frozen=True)
class RayGrid:
    """The rays of all pixels, and their bounds in each tile.

    Attributes:
        rays: (H, W, 2) on the plane z = 1.
        bounds: (tile rows, tile columns, 4): min x, max x, min y, max y.
    """

    rays: Array
    bounds: Array

    @classmethod
    def from_rays(cls, rays: Array) -> "RayGrid":
        """Make the grid of `rays` (H, W, 2)."""
        down, across = np.arange(0, rays.shape[0], TILE), np.arange(0, rays.shape[1], TILE)
        bounds = [
            ufunc.reduceat(ufunc.reduceat(rays[..., channel], down, axis=0), across, axis=1)
            for channel in (0, 1)
            for ufunc in (np.minimum, np.maximum)
        ]
        return cls(rays, np.stack(bounds, axis=-1))


def prepare_scene(solids: SolidArrays, grid: RayGrid, T_body_camera: Array) -> RaycastScene:
    """Prepare the scene for casting the rays of `grid`.

    Args:
        T_body_camera: (B, H, 4, 4) pose of each row in each body's frame.
    """
    frames = _unit_frames(solids.to_unit, solids.center_m, solids.body, T_body_camera)
    rows = np.array([0, len(grid.rays) // 2, len(grid.rays) - 1])
    T_camera_body = np.asarray(np.linalg.inv(T_body_camera[:, rows]), np.float64)
    outlines = _project_outlines(solids.corners_m, solids.body, T_camera_body)
    order = np.argsort(outlines[:, 0], kind="stable")
    candidates = _list_candidates(outlines, order, grid.bounds)
    return RaycastScene(solids.kind, frames, candidates, outlines[:, 0].copy())


@kernel
def _unit_frames(
    to_unit: Array, center_m: Array, body: NDArray[np.int64], T_body_camera: Array
) -> Array:
    """Transforms (H, S, 3, 4) from a row's camera coordinates to each solid's unit cube."""
    height = T_body_camera.shape[1]
    frames = np.empty((height, len(to_unit), 3, 4))
    for row in range(height):
        for s in range(len(to_unit)):
            M, T = to_unit[s], T_body_camera[body[s], row]
            for i in range(3):
                for j in range(3):
                    frames[row, s, i, j] = M[i, 0] * T[0, j] + M[i, 1] * T[1, j] + M[i, 2] * T[2, j]
                frames[row, s, i, 3] = (
                    M[i, 0] * (T[0, 3] - center_m[s, 0])
                    + M[i, 1] * (T[1, 3] - center_m[s, 1])
                    + M[i, 2] * (T[2, 3] - center_m[s, 2])
                )
    return frames


@kernel
def _project_outlines(corners_m: Array, body: NDArray[np.int64], T_camera_body: Array) -> Array:
    """Bounds (S, 5) of each solid: smallest depth, then min x, max x, min y, max y at z = 1.

    They are the union over the given poses. A solid behind the camera has an empty range.
    """
    outlines = np.empty((len(corners_m), 5))
    outlines[:] = np.inf
    outlines[:, 2] = -np.inf
    outlines[:, 4] = -np.inf
    p = np.empty((8, 3))
    for s in range(len(corners_m)):
        outline = outlines[s]
        for T in T_camera_body[body[s]]:
            for i in range(8):
                for j in range(3):
                    c = corners_m[s, i]
                    p[i, j] = T[j, 0] * c[0] + T[j, 1] * c[1] + T[j, 2] * c[2] + T[j, 3]
            for i in range(8):
                if p[i, 2] >= NEAR_M:
                    _extend_outline(outline, p[i, 0], p[i, 1], p[i, 2])
                for bit in (1, 2, 4):
                    a, b = p[i], p[i ^ bit]
                    if a[2] >= NEAR_M and b[2] < NEAR_M:
                        k = (NEAR_M - a[2]) / (b[2] - a[2])
                        _extend_outline(
                            outline, a[0] + k * (b[0] - a[0]), a[1] + k * (b[1] - a[1]), NEAR_M
                        )
    return outlines


@kernel
def _extend_outline(outline: Array, x: float, y: float, z: float) -> None:
    outline[0] = min(outline[0], z)
    outline[1] = min(outline[1], x / z)
    outline[2] = max(outline[2], x / z)
    outline[3] = min(outline[3], y / z)
    outline[4] = max(outline[4], y / z)


@kernel
def _list_candidates(outlines: Array, order: NDArray[np.int64], bounds: Array) -> Indices:
    """List the candidates of each tile; see `RaycastScene`."""
    lists = np.full((bounds.shape[0], bounds.shape[1], len(order) + 1), -1, dtype=np.int32)
    for i in range(bounds.shape[0]):
        for j in range(bounds.shape[1]):
            n = 0
            for s in order:
                is_outside_x = (
                    outlines[s, 1] > bounds[i, j, 1] + OUTLINE_MARGIN
                    or outlines[s, 2] < bounds[i, j, 0] - OUTLINE_MARGIN
                )
                is_outside_y = (
                    outlines[s, 3] > bounds[i, j, 3] + OUTLINE_MARGIN
                    or outlines[s, 4] < bounds[i, j, 2] - OUTLINE_MARGIN
                )
                if not (is_outside_x or is_outside_y):
                    lists[i, j, n] = s
                    n += 1
    return lists


# The kernels below get whole arrays and indices: a slice in an inner loop costs more than the
# arithmetic, because all threads share its reference count.


@kernel
def cast_rays(
    rays: Array, kind: NDArray[np.int64], frames: Array, candidates: Indices, near_m: Array
) -> tuple[Floats, Indices]:
    """Cast all rays; returns depth (H, W) in meters and the index of the solid (H, W), or -1.

    Args:
        rays: (H, W, 2) x, y of each pixel on the plane z = 1, camera axes.
        kind: (S,) kind of each solid.
        frames: (H, S, 3, 4) from the camera at each row to the unit cube of each solid.
        candidates: Solids of each tile, see `RaycastScene`.
        near_m: (S,) smallest depth of each solid, m.
    """
    height, width = rays.shape[0], rays.shape[1]
    depth_m = np.empty((height, width), dtype=np.float32)
    solid = np.empty((height, width), dtype=np.int32)
    all_best, all_nearest = np.empty(TILE), np.empty(TILE, dtype=np.int64)
    for v in range(height):
        for j in range(candidates.shape[1]):
            first = j * TILE
            count = min(TILE, width - first)
            best, nearest = all_best[:count], all_nearest[:count]
            best[:], nearest[:] = FAR_M, -1
            for n in range(candidates.shape[2]):
                s = candidates[v // TILE, j, n]
                if s < 0 or near_m[s] >= best.max():
                    break
                _cast_at_solid(rays, v, first, s, kind[s], frames, best, nearest)
            for k in range(count):
                depth_m[v, first + k], solid[v, first + k] = best[k], nearest[k]
    return depth_m, solid


@kernel
def _cast_at_solid(
    rays: Array,
    v: int,
    first: int,
    s: int,
    kind: int,
    frames: Array,
    best: Array,
    nearest: NDArray[np.int64],
) -> None:
    """Cast neighboring rays of row v at solid s.

    Args:
        rays: (H, W, 2), see `cast_rays`.
        first: Column of the first ray.
        kind: Kind of the solid.
        frames: (H, S, 3, 4), see `cast_rays`.
        best: (N,) depth of what each ray hits first, m; in and out.
        nearest: (N,) index of that solid; in and out.
    """
    if kind > ROOM:
        for k in range(len(best)):
            t = _intersect(rays[v, first + k, 0], rays[v, first + k, 1], v, s, kind, frames)
            if t < best[k]:
                best[k], nearest[k] = t, s
        return
    # Most solids are boxes: without branches, the compiler vectorizes this loop.
    for k in range(len(best)):
        ox, oy, oz, dx, dy, dz = in_unit_cube(
            rays[v, first + k, 0], rays[v, first + k, 1], v, s, frames
        )
        t = intersect_box(ox, oy, oz, dx, dy, dz, kind == ROOM)
        is_nearer = t < best[k]
        best[k] = t if is_nearer else best[k]
        nearest[k] = s if is_nearer else nearest[k]


@kernel
def cast_ray(
    x: float,
    y: float,
    v: int,
    u: int,
    kind: NDArray[np.int64],
    frames: Array,
    candidates: Indices,
    near_m: Array,
) -> tuple[float, int]:
    """Depth and index of the first solid that the ray (x, y, 1) of pixel (v, u) hits.

    FAR_M and -1 if it hits none.

    Args:
        x, y: Ray on the plane z = 1, camera axes.
    """
    best, solid = FAR_M, -1
    i, j = v // TILE, u // TILE
    for n in range(candidates.shape[2]):
        s = candidates[i, j, n]
        if s < 0 or near_m[s] >= best:
            break
        t = _intersect(x, y, v, s, kind[s], frames)
        if t < best:
            best, solid = t, s
    return best, solid


@kernel
def _intersect(x: float, y: float, v: int, s: int, kind: int, frames: Array) -> float:
    """Depth where the ray (x, y, 1) of row v hits solid s; FAR_M if nowhere."""
    ox, oy, oz, dx, dy, dz = in_unit_cube(x, y, v, s, frames)
    if kind <= ROOM:
        return intersect_box(ox, oy, oz, dx, dy, dz, kind == ROOM)
    return intersect_sphere_or_cylinder(ox, oy, oz, dx, dy, dz, kind == CYLINDER)


@kernel
def in_unit_cube(
    x: float, y: float, v: int, s: int, frames: Array
) -> tuple[float, float, float, float, float, float]:
    """Origin and direction of the ray (x, y, 1) of row v in the unit cube of solid s.

    Args:
        x, y: Ray on the plane z = 1, camera axes.
        frames: (H, S, 3, 4), see `cast_rays`.
    """
    return (
        frames[v, s, 0, 3],
        frames[v, s, 1, 3],
        frames[v, s, 2, 3],
        frames[v, s, 0, 0] * x + frames[v, s, 0, 1] * y + frames[v, s, 0, 2],
        frames[v, s, 1, 0] * x + frames[v, s, 1, 1] * y + frames[v, s, 1, 2],
        frames[v, s, 2, 0] * x + frames[v, s, 2, 1] * y + frames[v, s, 2, 2],
    )
