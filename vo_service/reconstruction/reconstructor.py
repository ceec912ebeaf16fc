"""Reconstruction of a recording: frames with poses are fused into a mesh."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from drivers.camera import EndOfStream, FrameTimeout, PinholeCamera, RgbdCamera, RgbdFrame
from drivers.core.geometry import Array, Trajectory
from vo_service.reconstruction.gravity_alignment import UpDirectionEstimator
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.types.outputs import OutputBase


@dataclass(frozen=True)
class PreviewMap:
    """The surface, and the camera's positions (N, 3) in the world."""

    mesh: Mesh
    trajectory_m: Array


@dataclass(frozen=True)
class PreviewFrame:
    """The camera after the frame `seq`, with the same `preview_map` as before or a new one."""

    seq: int
    camera: PinholeCamera
    T_world_camera: Array
    preview_map: PreviewMap


class Preview(Protocol):
    """One preview of the map."""

    def show(self, item: PreviewFrame) -> None:
        """Queue a frame."""
        ...


class TrackedPoseRecorder(OutputBase):
    """Output that stores the poses for a map: those in state `tracking`.

    Each epoch has its own list, as poses before and after a loss are not in one world frame.
    """

    def __init__(self) -> None:
        self._poses_by_epoch: dict[int, list[tuple[float, Array]]] = {}
        self.frame_count = 0

    def on_update(self, update: OdometryUpdate) -> None:
        """Store the pose if its state is `tracking`."""
        self.frame_count += 1
        if update.state is TrackingState.TRACKING:
            poses = self._poses_by_epoch.setdefault(update.epoch, [])
            poses.append((update.frame.stamp_s, update.T_world_camera))

    def apply_correction(
        self, corrected: Trajectory, are_connected: Callable[[int, int], bool]
    ) -> None:
        """Replace the poses by those of a corrected trajectory and merge connected epochs.

        Args:
            corrected: The corrected trajectory; a frame without a pose in it is dropped.
            are_connected: Whether the transform between two epochs is known.
        """
        corrected_poses = dict(
            zip(corrected.stamps_s.tolist(), corrected.T_world_camera, strict=True)
        )
        merged: dict[int, list[tuple[float, Array]]] = {}
        for epoch, poses in self._poses_by_epoch.items():
            target = next((other for other in merged if are_connected(other, epoch)), epoch)
            merged.setdefault(target, []).extend(
                (stamp_s, corrected_poses[stamp_s])
                for stamp_s, _ in poses
                if stamp_s in corrected_poses
            )
        self._poses_by_epoch = merged

    @property
    def epoch_count(self) -> int:
        """Number of epochs that are not connected to each other."""
        return len(self._poses_by_epoch)

    @property
    def longest_trajectory(self) -> Trajectory:
        """Poses of the epoch with the most poses; empty if nothing was tracked."""
        longest = max(self._poses_by_epoch.values(), key=len, default=[])
        stamps_s = np.array([stamp_s for stamp_s, _ in longest])
        return Trajectory(stamps_s, np.array([T for _, T in longest]).reshape(-1, 4, 4))


READ_TIMEOUT_S = 0.25
# Previews get a new surface when the map has grown by this factor, which bounds the total cost.
PREVIEW_GROWTH = 1.2


@dataclass
class ReconstructionResult:
    """Counts and poses of the processed frames.

    Attributes:
        frames: Frames read from the recording.
        without_pose: Frames skipped because they have no good pose.
        without_depth: Frames skipped because no depth is in range.
        full_at_frame: Number, from 1, of the first frame that did not fit; 0 if all did.
        camera: Intrinsics of the first frame in the map.
        poses: T_world_camera (4x4) of each frame in the map.
        up_direction: Up direction from the frames.
    """

    frames: int = 0
    without_pose: int = 0
    without_depth: int = 0
    full_at_frame: int = 0
    camera: PinholeCamera | None = None
    poses: list[Array] = field(default_factory=list)
    up_direction: UpDirectionEstimator = field(default_factory=UpDirectionEstimator)

    @property
    def fused(self) -> int:
        """Number of frames in the map."""
        return len(self.poses)

    @property
    def trajectory_m(self) -> Array:
        """(fused, 3) positions of the camera in the world."""
        return np.array([T[:3, 3] for T in self.poses]).reshape(-1, 3)


class Reconstructor:
    """Fuses frames into a volume and shows the growing map in previews."""

    def __init__(
        self, volume: TsdfVolume, poses: Trajectory, previews: Sequence[Preview] = ()
    ) -> None:
        self.volume = volume
        self._poses = poses
        self._previews = previews
        self._preview_map = PreviewMap(Mesh.empty(), np.empty((0, 3)))
        self._previewed: PreviewFrame | None = None
        self._previewed_fraction = 0.0
        self.result = ReconstructionResult()

    def run(
        self, camera: RgbdCamera, stop: threading.Event, progress: Callable[[int, int], None]
    ) -> None:
        """Read an open camera to its end.

        Args:
            progress: Called after each frame with the frames read and the total, 0 if unknown.
        """
        while not stop.is_set():
            try:
                frame = camera.read(READ_TIMEOUT_S)
            except FrameTimeout:
                continue
            except EndOfStream:
                return
            self.add_frame(frame)
            progress(self.result.frames, camera.frame_count or 0)

    def add_frame(self, frame: RgbdFrame) -> None:
        """Fuse one frame if it has a good pose and depth."""
        result = self.result
        result.frames += 1
        T_world_camera = self._poses.pose_near(frame.stamp_s)
        if T_world_camera is None:
            result.without_pose += 1
            return
        if not self.volume.has_depth_in_range(frame.depth_m):
            result.without_depth += 1
            return
        self.volume.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)
        if self.volume.is_full and not result.full_at_frame:
            result.full_at_frame = result.frames
        result.camera = result.camera or frame.camera
        result.poses.append(T_world_camera)
        result.up_direction.add(T_world_camera, frame.gravity_m_s2)
        if self._previews:
            if self.volume.used_fraction >= PREVIEW_GROWTH * self._previewed_fraction:
                self._previewed_fraction = self.volume.used_fraction
                self._preview_map = PreviewMap(self.volume.extract_mesh(), result.trajectory_m)
            self._preview(PreviewFrame(frame.seq, frame.camera, T_world_camera, self._preview_map))

    def finish(self) -> Mesh:
        """Extract the final mesh and show it in the previews."""
        mesh = self.volume.extract_mesh()
        if self._previewed is not None:
            self._preview(
                replace(self._previewed, preview_map=PreviewMap(mesh, self.result.trajectory_m))
            )
        return mesh

    def _preview(self, frame: PreviewFrame) -> None:
        self._previewed = frame
        for preview in self._previews:
            preview.show(frame)
