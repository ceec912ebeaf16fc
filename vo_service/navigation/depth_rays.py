"""The rays of a depth image in a level frame: a table, so that a reading costs two products."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel

# Every n-th pixel of every n-th row is used.
STRIDE = 2


class DepthRays(NamedTuple):
    """The rays of the used pixels of an image (rows, columns), in a level frame.

    A reading z has the range z * `horizontal`, and is z * `vertical` above the camera.

    Attributes:
        bin: int16 number of the ray's horizontal direction; -1 outside of all bins.
        horizontal: float32 length on the floor per meter of depth.
        vertical: float32 rise per meter of depth.
    """

    bin: NDArray[np.int16]
    horizontal: NDArray[np.float32]
    vertical: NDArray[np.float32]


class HeightBand(NamedTuple):
    """Which readings are obstacles, by their height above the floor and their range, meters.

    Attributes:
        camera_m: Height of the camera.
        min_m: Least height of an obstacle at range 0.
        rise: What the least height grows by per meter of range.
        max_m: Largest height of an obstacle.
        range_min_m: Least range.
        range_max_m: Largest range.
    """

    camera_m: float
    min_m: float
    rise: float
    max_m: float
    range_min_m: float
    range_max_m: float


def make_depth_rays(
    camera: PinholeCamera, R_level_camera: Array, first_angle_rad: float, step_rad: float, bins: int
) -> DepthRays:
    """Make the rays of a camera.

    Args:
        R_level_camera: 3x3, from optical axes to the level frame.
        first_angle_rad: Direction of bin 0: its middle; counterclockwise from x.
        step_rad: Angle between two bins.
        bins: Number of bins.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    shape = (-(-camera.height // STRIDE), -(-camera.width // STRIDE))
    rays = DepthRays(
        np.empty(shape, np.int16), np.empty(shape, np.float32), np.empty(shape, np.float32)
    )
    R = np.ascontiguousarray(R_level_camera, dtype=np.float64)
    _fill_rays(intrinsics, R, first_angle_rad, step_rad, bins, rays)
    return rays


@kernel
def _fill_rays(
    intrinsics: Array,
    R: Array,
    first_angle_rad: float,
    step_rad: float,
    bins: int,
    rays: DepthRays,
) -> None:
    fx, fy, cx, cy = intrinsics
    for i in range(rays.bin.shape[0]):
        y = (i * STRIDE - cy) / fy
        for j in range(rays.bin.shape[1]):
            x = (j * STRIDE - cx) / fx
            forward = R[0, 0] * x + R[0, 1] * y + R[0, 2]
            left = R[1, 0] * x + R[1, 1] * y + R[1, 2]
            number = int(np.floor((np.arctan2(left, forward) - first_angle_rad) / step_rad + 0.5))
            rays.bin[i, j] = number if 0 <= number < bins else -1
            rays.horizontal[i, j] = np.sqrt(forward * forward + left * left)
            rays.vertical[i, j] = R[2, 0] * x + R[2, 1] * y + R[2, 2]


def tiny_frame() -> RgbdFrame:
    """Return a frame of a few pixels, with which the kernels are compiled."""
    return RgbdFrame(
        seq=0,
        stamp_s=0.0,
        receive_time_s=0.0,
        color_bgr=np.zeros((4, 4, 3), np.uint8),
        depth_raw=np.full((4, 4), 1000, np.uint16),
        depth_factor=1000.0,
        camera=PinholeCamera(4, 4, 4.0, 4.0, 1.5, 1.5),
    )


def read_only(depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return a contiguous, read-only view: the kernels are compiled for one kind of array."""
    depth = np.ascontiguousarray(depth_raw).view()
    depth.flags.writeable = False
    return depth
