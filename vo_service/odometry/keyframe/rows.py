"""A standing point as the rows of a moving camera see it, each at its own time."""

from drivers.geometry import Array
from drivers.jit import inline_kernel
from vo_service.odometry.keyframe.movement import propagate_point

# A row's time depends on where the point is, and that on the time: so many rounds settle it.
ITERATIONS = 2


@inline_kernel
def row_time(v: float, height: int, readout_s: float) -> float:
    """When a row is taken, after the middle one."""
    return (v - 0.5 * (height - 1)) * readout_s / height


@inline_kernel
def project(x: float, y: float, z: float, intrinsics: Array) -> tuple[float, float]:
    """Pixel u, v of a point in front of the camera."""
    return (
        intrinsics[0] * x / z + intrinsics[2],
        intrinsics[1] * y / z + intrinsics[3],
    )


@inline_kernel
def project_rolling_shutter(
    motion: Array,
    x: float,
    y: float,
    z: float,
    intrinsics: Array,
    height: int,
    readout_s: float,
    skew_s: float,
) -> tuple[float, float, float]:
    """Pixel u, v and depth of a point in the row that sees it.

    movement  of the camera in its own axes, see `movement`
    late_s    the middle row after the instant that the point is given for
    """
    u, v = project(x, y, z, intrinsics)
    z_then = z
    for _ in range(ITERATIONS):
        delay_s = skew_s + row_time(v, height, readout_s)
        x_then, y_then, z_then = propagate_point(motion, x, y, z, delay_s)
        u, v = project(x_then, y_then, z_then, intrinsics)
    return u, v, z_then
