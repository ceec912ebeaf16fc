"""Compilation of the reconstruction kernels. Heavy imports happen in the function."""

from collections.abc import Callable

import numpy as np

from drivers.camera import PinholeCamera
from vo_service.kernels.compilation import ensure_compiled

CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)


def warm_up_reconstruction(report_stage: Callable[[str], None]) -> None:
    """Compile the kernels, or load them from the cache, by mapping a synthetic wall.

    Args:
        report_stage: Called with the name of each stage as it starts, and with the progress of
            compilation.
    """
    ensure_compiled(["reconstruction"], report_stage)
    reconstruct_wall(report_stage)


def reconstruct_wall(report_stage: Callable[[str], None]) -> None:
    """Run all stages on a synthetic wall."""
    from vo_service.reconstruction.render import render_camera_view
    from vo_service.reconstruction.tsdf_volume import TsdfVolume
    from vo_service.reconstruction.voxel_block_grid import TsdfConfig

    volume = TsdfVolume(TsdfConfig(voxel_m=0.05, memory_mb=10))
    depth_m = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    color_bgr = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    report_stage("fusion")
    volume.integrate(depth_m, color_bgr, CAMERA, np.eye(4))
    report_stage("mesh")
    mesh = volume.extract_mesh()
    report_stage("pictures")
    render_camera_view(mesh, CAMERA, np.eye(4))
