"""Which heights above the floor are obstacles, by the configuration and the camera's mounting."""

import numpy as np

from drivers.core.geometry import Array
from vo_service.config_tables import ScanConfig
from vo_service.navigation.depth_rays import HeightBand

# The least height grows with the range, so that a floor that is tilted by this much is none.
MAX_TILT_ERROR_RAD = np.radians(1.0)
# Without a largest height, the band ends this far above the camera.
ABOVE_CAMERA_M = 0.15
# Half of a Kinect's vertical field of view.
HALF_VIEW_RAD = np.radians(21.75)


def height_band(config: ScanConfig, camera_m: float, range_max_m: float) -> HeightBand:
    """Return the band of obstacles.

    Args:
        camera_m: Height of the camera above the floor, meters.
        range_max_m: Largest range.
    """
    top_m = camera_m + ABOVE_CAMERA_M if config.max_height_m is None else config.max_height_m
    return HeightBand(
        camera_m,
        config.min_height_m,
        float(np.tan(MAX_TILT_ERROR_RAD)),
        top_m,
        config.range_min_m,
        range_max_m,
    )


def mounting_problem(config: ScanConfig, T_base_camera: Array) -> str:
    """Return why obstacles cannot be told well with a mounting; "" = no reason.

    Args:
        T_base_camera: 4x4 pose of the optical camera in the base, which stands on the floor.
    """
    height_m = float(T_base_camera[2, 3])
    if height_m <= config.min_height_m:
        return (
            f"T_base_camera has the camera {height_m:g} m above the floor, so that nothing can be "
            "told from the floor; set translation_m to its position above the floor"
        )
    x, y, z = T_base_camera[:3, :3] @ (0.0, np.tan(HALF_VIEW_RAD), 1.0)
    if -z * config.range_max_m <= height_m * np.hypot(x, y):
        return (
            f"a camera {height_m:g} m high, mounted as T_base_camera tells, sees no floor within "
            f"{config.range_max_m:g} m: low obstacles are not seen; mount it lower, or tilt it down"
        )
    if config.max_height_m is not None and config.max_height_m < height_m:
        return (
            f"scan.max_height_m = {config.max_height_m:g} is below the camera ({height_m:g} m): "
            "what is higher is overlooked, and the space in front of it counts as free"
        )
    return ""
