"""Program of the mapper's process.

It connects SLAM, which keeps the keyframes, with the reconstruction, which fuses them.
"""

from collections.abc import Iterable
from functools import partial

from drivers.core.process.service_connection import ServiceConnection
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper.mesh_job import FusedMesh
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.worker import run_mapper


def fuse_keyframes(keyframes: Iterable[MeshKeyframe], config: MapConfig) -> FusedMesh:
    """Fuse the depth and color of keyframes into a mesh."""
    # Imported here: only the process that makes a mesh needs the memory of these kernels.
    from vo_service.reconstruction.mesh import write_ply
    from vo_service.reconstruction.tsdf_volume import TsdfVolume
    from vo_service.reconstruction.voxel_block_grid import TsdfConfig

    volume = TsdfVolume(TsdfConfig(voxel_m=config.voxel_m, memory_mb=config.mesh_memory_mb))
    for keyframe in keyframes:
        depth_m, color_bgr = keyframe.depth_m, keyframe.color_bgr
        if volume.has_depth_in_range(depth_m):
            volume.integrate(depth_m, color_bgr, keyframe.camera, keyframe.T_odom_camera)
    mesh = volume.extract_mesh()
    return FusedMesh(len(mesh.triangles), volume.is_full, partial(write_ply, mesh=mesh))


def run(service: ServiceConnection) -> None:
    """Run the mapper until the service asks the process to end."""
    run_mapper(service, fuse_keyframes)
