"""The measurements of a tour, frame by frame, and their file."""

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
    """Measurements of F frames, in order.

    Attributes:
        stamp_s: (F,).
        T_room_camera: (F, 4, 4) true poses.
        T_world_camera: (F, 4, 4) estimated poses.
        has_pose: (F,) whether the estimate is valid.
        epoch: (F,).
        cpu_ms: (F,) processor time of the thread for the pose.
        loop_closure_ms: (F,) processor time after that, for the map.
        memory_mb: (F,) memory of the process, including the virtual Kinect.
        optimized: The optimized poses at the end.
        loop_closures: All loop closures.
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
        """Estimated trajectory of the frames with a pose."""
        return Trajectory(self.stamp_s[self.has_pose], self.T_world_camera[self.has_pose])

    @property
    def truth(self) -> Trajectory:
        """True trajectory of all frames."""
        return Trajectory(self.stamp_s, self.T_room_camera)

    def save(self, file: Path) -> None:
        """Save the arrays in a .npz file."""
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
        """Load a file of `save`."""
        with np.load(file) as arrays:
            loops = zip(
                arrays["loop_place_stamp_s"].tolist(),
                arrays["loop_stamp_s"].tolist(),
                arrays["loop_T_place_camera"],
                strict=True,
            )
            return cls(
                stamp_s=arrays["stamp_s"],
                T_room_camera=arrays["T_room_camera"],
                T_world_camera=arrays["T_world_camera"],
                has_pose=arrays["ok"],
                epoch=arrays["epoch"],
                cpu_ms=arrays["cpu_ms"],
                loop_closure_ms=arrays["loops_ms"],
                memory_mb=arrays["memory_mb"],
                optimized=Trajectory(
                    arrays["corrected_stamp_s"], arrays["corrected_T_world_camera"]
                ),
                loop_closures=[LoopClosureRecord(*loop) for loop in loops],
            )
