"""A recording that comes by the same places again and again, so that loops have much to say."""

from pathlib import Path

import numpy as np

from drivers.geometry import Array, rigid_transform, rotation_from_vector
from drivers.trajectory import StampedPoses
from drivers.tum.writer import TumWriter
from tests.vo_service.odometry.synthetic_views import view_of_a_corner

# So many frames out, and as many back, twice; each 7 cm and half a degree from the last.
OUT = 20
COUNT = 4 * OUT + 1
STEP = rigid_transform(rotation_from_vector([0.0, -0.0094, 0.0]), [0.07, 0.0, 0.0])


def write_there_and_back(folder: Path) -> Path:
    """Write it, with the truth."""
    frames = [view_of_a_corner(_pose(seq), seq) for seq in range(COUNT)]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    truth = StampedPoses(stamps_s, np.array([_pose(seq) for seq in range(COUNT)]))
    with TumWriter(folder, ground_truth=truth) as writer:
        for frame in frames:
            writer.write(frame)
    return folder


def _pose(seq: int) -> Array:
    """4x4 T_world_camera."""
    way = OUT - abs(seq % (2 * OUT) - OUT)
    return np.asarray(np.linalg.matrix_power(STEP, way))
