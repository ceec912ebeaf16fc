"""All that is measured of a tour, frame by frame, and the file that keeps it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.runners import LoopClosureRecord
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory


@dataclass(frozen=True)
class TourRecord:
    """F frames, in order.

    T_room_camera   (F, 4, 4) the truth
    T_world_camera  (F, 4, 4) what was said; ok (F,) whether it counts, epoch (F,) in which world
    cpu_ms          (F,) processor time of the thread until it gave the pose
    loops_ms        (F,) and after that, for places and loops
    memory_mb       (F,) of the whole process, the virtual Kinect in it
    corrected       the poses as they are thought to be in the end
    """

    stamp_s: Array
    T_room_camera: Array
    T_world_camera: Array
    has_pose: NDArray[np.bool_]
    epoch: NDArray[np.int64]
    cpu_ms: Array
    loop_closure_ms: Array
    memory_mb: Array
    optimized: Trajectory
    loop_closures: Sequence[LoopClosureRecord]

    @property
    def trajectory(self) -> Trajectory:
        """Of the frames that have a pose."""
        return Trajectory(self.stamp_s[self.has_pose], self.T_world_camera[self.has_pose])

    @property
    def truth(self) -> Trajectory:
        """Of all frames."""
        return Trajectory(self.stamp_s, self.T_room_camera)

    def save(self, file: Path) -> None:
        """All of it as arrays in a .npz file."""
        T_place_camera = [loop.T_keyframe_camera for loop in self.loop_closures]
        np.savez_compressed(
            file,
            stamp_s=self.stamp_s,
            T_room_camera=self.T_room_camera,
            T_world_camera=self.T_world_camera,
            ok=self.has_pose,
            epoch=self.epoch,
            cpu_ms=self.cpu_ms,
            loops_ms=self.loop_closure_ms,
            memory_mb=self.memory_mb,
            corrected_stamp_s=self.optimized.stamps_s,
            corrected_T_world_camera=self.optimized.T_world_camera,
            loop_place_stamp_s=[loop.keyframe_stamp_s for loop in self.loop_closures],
            loop_stamp_s=[loop.stamp_s for loop in self.loop_closures],
            loop_T_place_camera=np.reshape(T_place_camera, (-1, 4, 4)),
        )

    @classmethod
    def load(cls, file: Path) -> "TourRecord":
        """What `save` wrote."""
        with np.load(file) as kept:
            loops = zip(
                kept["loop_place_stamp_s"].tolist(),
                kept["loop_stamp_s"].tolist(),
                kept["loop_T_place_camera"],
                strict=True,
            )
            return cls(
                stamp_s=kept["stamp_s"],
                T_room_camera=kept["T_room_camera"],
                T_world_camera=kept["T_world_camera"],
                has_pose=kept["ok"],
                epoch=kept["epoch"],
                cpu_ms=kept["cpu_ms"],
                loop_closure_ms=kept["loops_ms"],
                memory_mb=kept["memory_mb"],
                optimized=Trajectory(kept["corrected_stamp_s"], kept["corrected_T_world_camera"]),
                loop_closures=[LoopClosureRecord(*loop) for loop in loops],
            )
