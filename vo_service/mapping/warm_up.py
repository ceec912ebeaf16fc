"""Compile what maps are made with, or load it from the cache.

Nothing heavy is imported before that is asked for.
"""

import time
from collections.abc import Callable

import numpy as np

from drivers.camera import PinholeCamera

CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)


def warm_up_mapping(tell: Callable[[str], None]) -> float:
    """Make a map of a made-up wall; returns the seconds that took.

    `tell` gets the name of each stage as it begins.
    """
    from vo_service.mapping.fusion import Fusion
    from vo_service.mapping.fusion_settings import FusionSettings
    from vo_service.mapping.pictures import camera_view

    begin_s = time.monotonic()
    fusion = Fusion(FusionSettings(voxel_m=0.05, memory_mb=10))
    depth_m = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    colour_bgr = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    tell("fusion")
    fusion.add(depth_m, colour_bgr, CAMERA, np.eye(4))
    tell("mesh")
    mesh = fusion.mesh()
    tell("pictures")
    camera_view(mesh, CAMERA, np.eye(4))
    return time.monotonic() - begin_s
