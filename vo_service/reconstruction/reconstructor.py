"""Frames and their poses in, a map out: what `reconstruct` does, apart from files and options."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.camera import EndOfStream, FrameTimeout, PinholeCamera, RgbdCamera, RgbdFrame
from drivers.core.geometry import Array
from vo_service.reconstruction.frame_poses import FramePoses
from vo_service.reconstruction.gravity_alignment import UpDirectionEstimator
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.preview import Preview, PreviewFrame, PreviewMap
from vo_service.reconstruction.tsdf_volume import TsdfVolume

READ_TIMEOUT_S = 0.25
# Whoever watches gets a new surface when the map has grown so much: the sum stays small.
PREVIEW_GROWTH = 1.2


@dataclass
class ReconstructionResult:
    """What became of the frames.

    frames         read from the recording
    without_pose   left out: no pose, or not a good one
    without_depth  left out: not one reading in range
    full_at        number, from 1, of the first frame that found no room for all of it; 0: all did
    camera         intrinsics of the first frame in the map
    poses          T_world_camera of each frame in the map
    up             which way is up, as far as the frames tell
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
        """Frames that are in the map."""
        return len(self.poses)

    @property
    def trajectory_m(self) -> Array:
        """(fused, 3) where the camera was, in the world."""
        return np.array([T[:3, 3] for T in self.poses]).reshape(-1, 3)


class Reconstructor:
    """Fuses frame after frame, and shows the map as it grows to whoever watches."""

    def __init__(
        self, volume: TsdfVolume, poses: FramePoses, previews: Sequence[Preview] = ()
    ) -> None:
        self._volume = volume
        self._poses = poses
        self._previews = previews
        self._preview_map = PreviewMap(Mesh.empty(), np.empty((0, 3)))
        self._last_preview_frame: PreviewFrame | None = None
        self._previewed_fraction = 0.0
        self.result = ReconstructionResult()

    def run(
        self, camera: RgbdCamera, stop: threading.Event, progress: Callable[[int, int], None]
    ) -> None:
        """Read an open camera to its end, or until `stop` is set."""
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
        """Fuse one frame, if it has a good pose and depth."""
        harvest = self.result
        harvest.frames += 1
        T_world_camera = self._poses.find(frame.stamp_s)
        if T_world_camera is None:
            harvest.without_pose += 1
            return
        if not self._volume.has_depth_in_range(frame.depth_m):
            harvest.without_depth += 1
            return
        self._volume.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)
        if self._volume.is_full and not harvest.full_at_frame:
            harvest.full_at_frame = harvest.frames
        harvest.camera = harvest.camera or frame.camera
        harvest.poses.append(T_world_camera)
        harvest.up_direction.add(T_world_camera, frame.gravity_m_s2)
        if self._previews:
            self._update_previews(frame, T_world_camera)

    def finish(self) -> Mesh:
        """The whole surface; whoever watches sees it too."""
        mesh = self._volume.extract_mesh()
        if self._last_preview_frame is not None:
            self._show_in_previews(
                replace(
                    self._last_preview_frame, preview_map=PreviewMap(mesh, self.result.trajectory_m)
                )
            )
        return mesh

    def _update_previews(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        if self._volume.used_fraction >= PREVIEW_GROWTH * self._previewed_fraction:
            self._previewed_fraction = self._volume.used_fraction
            self._preview_map = PreviewMap(self._volume.extract_mesh(), self.result.trajectory_m)
        self._last_preview_frame = PreviewFrame(
            frame.seq, frame.camera, T_world_camera, self._preview_map
        )
        self._show_in_previews(self._last_preview_frame)

    def _show_in_previews(self, frame: PreviewFrame) -> None:
        for view in self._previews:
            view.show(frame)
