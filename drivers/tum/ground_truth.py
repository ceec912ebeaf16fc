"""The true poses of a folder in TUM format."""

from pathlib import Path

import numpy as np

from drivers.calibration import BONN_CALIBRATION, find_benchmark_calibration
from drivers.core.geometry import Array, Trajectory, rigid_transform
from drivers.core.trajectory_files import read_trajectory_file

TRUTH_FILES = ("groundtruth.txt", "groundtruth.csv", "trajectory.log")
# Bonn's true poses are of markers on the camera. Its page gives both transforms: the axes of the
# motion capture, and the camera in the frame of the markers, whose rotation has a scale of 1.06.
T_BONN_AXES = np.array([[-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
_BONN_ROTATION = ((1.0157, 0.1828, -0.2389), (0.0009, -0.8431, -0.6413), (-0.3009, 0.6147, -0.8085))
_U, _, _VT = np.linalg.svd(_BONN_ROTATION)
T_BONN_MARKERS_CAMERA = rigid_transform(_U @ _VT, (0.0113, -0.0098, 0.0111))


def find_ground_truth(folder: Path) -> Path | None:
    """Return the file of the true poses of a TUM folder; None if it has none."""
    return next((folder / name for name in TRUTH_FILES if (folder / name).exists()), None)


def read_ground_truth(folder: Path, frames_s: Array | None) -> tuple[Trajectory | None, str]:
    """Read the true poses, in any format, and what they were taken for; "" for TUM's.

    Args:
        frames_s: (F,) stamps of its frames, for formats without stamps.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    file = find_ground_truth(folder)
    if file is None:
        return None, ""
    found = read_trajectory_file(file, frames_s)
    if find_benchmark_calibration(folder) is not BONN_CALIBRATION:
        return found.poses, f"{file}: {found.note}" if found.note else ""
    T_world_markers = T_BONN_AXES @ found.poses.T_world_camera @ T_BONN_AXES
    return (
        Trajectory(found.poses.stamps_s, T_world_markers @ T_BONN_MARKERS_CAMERA),
        f"{file}: poses of Bonn's markers, converted to those of the camera",
    )
