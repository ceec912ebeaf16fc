"""Intersection of a ray with a solid, in the solid's own unit cube."""

import math

from drivers.core.jit import kernel

NEAR_M = 0.02
FAR_M = 1e6


@kernel
def intersect_box(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, inside: bool
) -> float:
    """Return t where o + t d enters the unit cube, or leaves it if `inside`; FAR_M if nowhere."""
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
    """Return t where o + t d first hits the unit sphere or open cylinder; FAR_M if nowhere."""
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
