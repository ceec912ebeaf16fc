"""A recording that comes by the same places again and again, so that loops have much to say."""

from pathlib import Path

import numpy as np

from drivers.core.geometry import Array, Trajectory, rigid_transform, so3_exp
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.vo_service.odometry.synthetic_views import render_corner

# So many frames out, and as many back, twice; each 7 cm and half a degree from the last.
OUTBOUND_FRAMES = 20
FRAME_COUNT = 4 * OUTBOUND_FRAMES + 1
STEP = rigid_transform(so3_exp([0.0, -0.0094, 0.0]), [0.07, 0.0, 0.0])


def write_loop_recording(folder: Path) -> Path:
    """Write it, with the truth."""
    frames = [render_corner(_pose(seq), seq) for seq in range(FRAME_COUNT)]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    truth = Trajectory(stamps_s, np.array([_pose(seq) for seq in range(FRAME_COUNT)]))
    with FrameRecorder(TumFolder(folder, ground_truth=truth)) as writer:
        for frame in frames:
            writer.write(frame)
    return folder


def _pose(seq: int) -> Array:
    """4x4 T_world_camera."""
    way = OUTBOUND_FRAMES - abs(seq % (2 * OUTBOUND_FRAMES) - OUTBOUND_FRAMES)
    return np.asarray(np.linalg.matrix_power(STEP, way))
