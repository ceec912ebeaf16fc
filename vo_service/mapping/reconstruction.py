"""Frames and their poses in, a map out: what `reconstruct` does, apart from files and options."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.camera import EndOfStream, NoFrameYet, PinholeCamera, RgbdCamera, RgbdFrame
from drivers.geometry import Array
from vo_service.mapping.frame_poses import FramePoses
from vo_service.mapping.fusion import Fusion
from vo_service.mapping.mesh import Mesh
from vo_service.mapping.upright import UpGuess
from vo_service.mapping.watching import MapSoFar, MapView, Sight

TICK_S = 0.25
# Whoever watches gets a new surface when the map has grown so much: the sum stays small.
GROWTH = 1.2


@dataclass
class Harvest:
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
    full_at: int = 0
    camera: PinholeCamera | None = None
    poses: list[Array] = field(default_factory=list)
    up: UpGuess = field(default_factory=UpGuess)

    @property
    def fused(self) -> int:
        """Frames that are in the map."""
        return len(self.poses)

    @property
    def path_m(self) -> Array:
        """(fused, 3) where the camera was, in the world."""
        return np.array([T[:3, 3] for T in self.poses]).reshape(-1, 3)


class Reconstruction:
    """Fuses frame after frame, and shows the map as it grows to whoever watches."""

    def __init__(self, fusion: Fusion, poses: FramePoses, views: Sequence[MapView] = ()) -> None:
        self._fusion = fusion
        self._poses = poses
        self._views = views
        self._so_far = MapSoFar(Mesh.empty(), np.empty((0, 3)))
        self._last: Sight | None = None
        self._shown_share = 0.0
        self.harvest = Harvest()

    def run(
        self, camera: RgbdCamera, stop: threading.Event, progress: Callable[[int, int], None]
    ) -> None:
        """Read an open camera to its end, or until `stop` is set."""
        while not stop.is_set():
            try:
                frame = camera.read(TICK_S)
            except NoFrameYet:
                continue
            except EndOfStream:
                return
            self.add(frame)
            progress(self.harvest.frames, camera.frame_count or 0)

    def add(self, frame: RgbdFrame) -> None:
        """Fuse one frame, if it has a good pose and depth."""
        harvest = self.harvest
        harvest.frames += 1
        T_world_camera = self._poses.at(frame.stamp_s)
        if T_world_camera is None:
            harvest.without_pose += 1
            return
        if not self._fusion.has_depth(frame.depth_m):
            harvest.without_depth += 1
            return
        self._fusion.add(frame.depth_m, frame.colour_bgr, frame.camera, T_world_camera)
        if self._fusion.is_full and not harvest.full_at:
            harvest.full_at = harvest.frames
        harvest.camera = harvest.camera or frame.camera
        harvest.poses.append(T_world_camera)
        harvest.up.add(T_world_camera, frame.gravity_m_s2)
        if self._views:
            self._show_growth(frame, T_world_camera)

    def finish(self) -> Mesh:
        """The whole surface; whoever watches sees it too."""
        mesh = self._fusion.mesh()
        if self._last is not None:
            self._show(replace(self._last, so_far=MapSoFar(mesh, self.harvest.path_m)))
        return mesh

    def _show_growth(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        if self._fusion.share_used >= GROWTH * self._shown_share:
            self._shown_share = self._fusion.share_used
            self._so_far = MapSoFar(self._fusion.mesh(), self.harvest.path_m)
        self._last = Sight(frame.seq, frame.camera, T_world_camera, self._so_far)
        self._show(self._last)

    def _show(self, sight: Sight) -> None:
        for view in self._views:
            view.show(sight)
