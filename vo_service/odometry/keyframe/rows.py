"""A standing point as the rows of a moving camera see it, each at its own time."""

from drivers.geometry import Array
from drivers.jit import inline_kernel

# A row's time depends on where the point is, and that on the time: so many rounds settle it.
ROUNDS = 2


@inline_kernel
def moved(
    velocity: Array, x: float, y: float, z: float, delay_s: float
) -> tuple[float, float, float]:
    """Where a standing point is in the camera's axes after some time, to the second order.

    velocity  (6,) twist of the camera in its own axes, m/s and rad/s
    """
    vx, vy, vz, wx, wy, wz = velocity
    # What the point does in the camera's axes: minus (v + w x p), which itself turns with the axes.
    ax, ay, az = wz * y - wy * z - vx, wx * z - wz * x - vy, wy * x - wx * y - vz
    half = 0.5 * delay_s * delay_s
    return (
        x + delay_s * ax + half * (wz * ay - wy * az),
        y + delay_s * ay + half * (wx * az - wz * ax),
        z + delay_s * az + half * (wy * ax - wx * ay),
    )


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
def project_moving(
    velocity: Array,
    x: float,
    y: float,
    z: float,
    intrinsics: Array,
    height: int,
    readout_s: float,
    late_s: float,
) -> tuple[float, float, float]:
    """Pixel u, v and depth of a point in the row that sees it.

    late_s  the middle row after the instant that the point is given for
    """
    u, v = project(x, y, z, intrinsics)
    z_then = z
    for _ in range(ROUNDS):
        delay_s = late_s + row_time(v, height, readout_s)
        x_then, y_then, z_then = moved(velocity, x, y, z, delay_s)
        u, v = project(x_then, y_then, z_then, intrinsics)
    return u, v, z_then
