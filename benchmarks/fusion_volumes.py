"""TSDF volumes with a common interface."""

from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform, transform_points
from vo_service.reconstruction.tsdf_config import TsdfConfig
from vo_service.reconstruction.tsdf_volume import TsdfVolume

MAX_DEPTH_M = TsdfConfig().max_depth_m
TRUNCATION_VOXELS = 4.0
RAYCAST_EVERY = 60
# The box of a dense volume: the room and its walls.
BOX_M = (7.04, 6.40, 3.20)


class FusionVolume(Protocol):
    """A volume that fuses frames into a surface."""

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """Fuse one frame."""
        ...

    def points_m(self) -> Array:
        """Points (N, 3) of the surface, in the world."""
        ...


class ServiceVolume:
    """The volume of `kinect-vo reconstruct`."""

    def __init__(self, voxel_m: float) -> None:
        self._fusion = TsdfVolume(TsdfConfig(voxel_m=voxel_m, memory_mb=2000))

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        self._fusion.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)

    def points_m(self) -> Array:
        """See `FusionVolume`; the points are those of the mesh."""
        return self._fusion.extract_mesh().vertices_m.astype(np.float64)


class OpenCvVolume:
    """Base of OpenCV's volumes."""

    def __init__(self, kind: int, voxel_m: float) -> None:
        self._settings = cv2.VolumeSettings(kind)
        self._settings.setVoxelSize(voxel_m)
        self._settings.setTsdfTruncateDistance(TRUNCATION_VOXELS * voxel_m)
        self._settings.setMaxDepth(MAX_DEPTH_M)
        self._kind = kind
        self._volume: cv2.Volume | None = None

    def get_volume(self, frame: RgbdFrame) -> cv2.Volume:
        """Return the volume; create it for the first frame's camera and depth format."""
        if self._volume is None:
            self._settings.setDepthFactor(frame.depth_factor)
            self._settings.setIntegrateWidth(frame.camera.width)
            self._settings.setIntegrateHeight(frame.camera.height)
            self._settings.setCameraIntegrateIntrinsics(frame.camera.K.astype(np.float32))
            self._settings.setRaycastWidth(frame.camera.width)
            self._settings.setRaycastHeight(frame.camera.height)
            self._settings.setCameraRaycastIntrinsics(frame.camera.K.astype(np.float32))
            self._volume = cv2.Volume(self._kind, self._settings)
        return self._volume


class OpenCvHashVolume(OpenCvVolume):
    """OpenCV's sparse volume: points without colors, no triangles.

    `fetchPointsNormals` returns every voxel near the surface (opencv/opencv issue 22896), so the
    surface is ray-cast from some of the poses.
    """

    def __init__(self, voxel_m: float) -> None:
        super().__init__(cv2.VolumeType_HashTSDF, voxel_m)
        self._poses: list[Array] = []

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        depth = frame.depth_raw.astype(np.float32)
        self.get_volume(frame).integrate(depth, T_world_camera.astype(np.float32))
        self._poses.append(T_world_camera)

    def points_m(self) -> Array:
        """See `FusionVolume`."""
        return np.vstack([self._raycast_points_m(T) for T in self._poses[::RAYCAST_EVERY]])

    def _raycast_points_m(self, T_world_camera: Array) -> Array:
        assert self._volume is not None, "call add first"
        points_m = _to_points_m(
            np.asarray(self._volume.raycast(T_world_camera.astype(np.float32))[0])
        )
        met = np.all(np.isfinite(points_m), axis=1)
        return transform_points(T_world_camera, points_m[met])


class OpenCvDenseVolume(OpenCvVolume):
    """OpenCV's dense volume: a fixed box; points with colors, no triangles."""

    def __init__(self, voxel_m: float) -> None:
        super().__init__(cv2.VolumeType_ColorTSDF, voxel_m)
        resolution = np.array([round(side / voxel_m) for side in BOX_M], np.int32)
        self._settings.setVolumeResolution(resolution)
        corner_m = [-BOX_M[0] / 2, -BOX_M[1] / 2, -0.2]
        self._settings.setVolumePose(rigid_transform(np.eye(3), corner_m).astype(np.float32))

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        depth = frame.depth_raw.astype(np.float32)
        # The binding only accepts four float channels.
        color = cv2.cvtColor(frame.color_bgr, cv2.COLOR_BGR2BGRA).astype(np.float32)
        pose = T_world_camera.astype(np.float32)
        self.get_volume(frame).integrateColor(depth, color, pose)

    def points_m(self) -> Array:
        """See `FusionVolume`."""
        assert self._volume is not None, "call add first"
        return _to_points_m(self._volume.fetchPointsNormalsColors()[0])


def _to_points_m(points: NDArray[Any]) -> Array:
    xyz: Array = points.reshape(-1, points.shape[-1])[:, :3].astype(np.float64)
    return xyz
