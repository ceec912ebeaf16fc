"""``kinect-vo evaluate``: compare a trajectory with its ground truth."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import MAX_STAMP_DIFFERENCE_S, Array, Trajectory
from drivers.core.trajectory_files import read_trajectory_file
from drivers.layouts import find_layout
from drivers.playback.recording_formats import RecordingFormat, recording_format
from drivers.recording.recording import ImageTopics
from drivers.tum.folder import read_frame_pairs
from drivers.tum.ground_truth import TRUTH_FILES, find_ground_truth, read_ground_truth
from vo_service.cli.options import Json, Topics, parse_finite, parse_seconds
from vo_service.cli.recordings import open_and_announce
from vo_service.cli.request import CommandRequest, argument, option
from vo_service.terminal import announce
from vo_service.tools.evaluation.evaluation import evaluate
from vo_service.tools.evaluation.plot import write_plot

EPILOG = """\
examples:
  kinect-vo evaluate poses.txt recordings/desk
  kinect-vo evaluate poses.txt recordings/desk/groundtruth.txt --picture desk.png
  kinect-vo evaluate poses.txt truth.txt --json | jq .ate_rmse_m

Both files hold lines of: stamp tx ty tz qx qy qz qw. The formats of EuRoC (nanoseconds, commas),
KITTI (12 numbers; stamps of the frames, of times.txt beside it, or 30 a second) and Redwood or
Open3D (trajectory.log) are recognized, and a line says so. Poses are paired by the nearest stamp
within 20 ms (--max-difference); --time-offset moves the trajectory if the clocks differ.

ATE: distances after the best rigid alignment, without scale. Mean global error: distances with the
first poses joined. RPE: root mean square over one frame and over one second.

Coverage: poses with ground truth, divided by frames with ground truth. The frames are those listed
beside the ground truth (rgb.txt and depth.txt, or associations.txt). Without a list, a ground truth
with a pose at the stamp of every pose counts as one per frame; otherwise the coverage is unknown.

A metric that cannot be computed is "-" in the table and null in JSON.
"""
# Keys of the summary of `replay` that are unknown from two trajectory files.
REPLAY_ONLY_KEYS = ("failed", "skipped", "stage_ms", "cpu_ms_per_frame")


@dataclass(frozen=True, kw_only=True)
class EvaluationRequest(CommandRequest):
    """The trajectory, the truth, and how to compare them."""

    trajectory: Path = argument("file of poses", "TRAJECTORY")
    folder: Path = argument("file of true poses, or a recording that has them", "GROUNDTRUTH")
    topics: Topics = None
    max_difference: float = option(
        "largest difference between the stamps of a pose and its truth (default: %(default)s)",
        MAX_STAMP_DIFFERENCE_S,
        "SECONDS",
        parse_seconds,
    )
    time_offset: float = option(
        "add this to the stamps of TRAJECTORY (default: %(default)s)", 0.0, "SECONDS", parse_finite
    )
    json: Json = False
    picture: Path | None = option(
        "plot the trajectory and the ground truth (.png or .svg)", metavar="FILE"
    )


def run(request: EvaluationRequest) -> int:
    """Compare and print."""
    truth, frames_s, truth_file = _read_ground_truth(request.folder, request.topics)
    trajectory = _read_poses(request.trajectory, frames_s)
    shifted = Trajectory(trajectory.stamps_s + request.time_offset, trajectory.T_world_camera)
    try:
        evaluation = evaluate(shifted, truth, frames_s, request.max_difference)
    except InputError as error:
        raise InputError(
            f"{request.trajectory} against {truth_file}: {error}, or give --time-offset or "
            "--max-difference"
        ) from error
    if request.picture is not None:
        title = f"{request.trajectory.name}: ATE RMSE {1e3 * evaluation.ate_rmse_m:.2f} mm"
        write_plot(request.picture, shifted, truth, title, request.max_difference)
    if request.json:
        frames = {"frames": None if frames_s is None else len(frames_s)}
        unknown = dict.fromkeys(REPLAY_ONLY_KEYS)
        print(json.dumps(frames | unknown | evaluation.as_json()))
    else:
        print(evaluation.as_table())
    return 0


def _read_poses(file: Path, frames_s: Array | None) -> Trajectory:
    """Read a file in any format, and log what it was taken for."""
    found = read_trajectory_file(file, frames_s)
    if found.note:
        announce(f"{file}: {found.note}")
    return found.poses


def _read_ground_truth(
    path: Path, topics: ImageTopics | None
) -> tuple[Trajectory, Array | None, Path]:
    """Read the true poses, the stamps of the frames if known, and the file of the poses."""
    if recording_format(path) is RecordingFormat.TUM and find_layout(path) is None:
        return _read_tum_ground_truth(path)
    recording = open_and_announce(path, None, topics)
    if recording.ground_truth is None:
        where = "" if path.is_dir() else ", neither in /tf nor in a topic of poses"
        raise InputError(f"{path}: has no true poses{where}; name a file of them")
    return recording.ground_truth, recording.frames.stamps_s, path


def _read_tum_ground_truth(path: Path) -> tuple[Trajectory, Array | None, Path]:
    """Read the true poses of a folder, or of a file beside the lists of frames."""
    if not path.is_dir():
        frames_s = read_listed_frame_stamps_s(path.parent)
        return _read_poses(path, frames_s), frames_s, path
    file = find_ground_truth(path)
    if file is None:
        raise InputError(f"{path}: has no true poses ({', '.join(TRUTH_FILES)}); name their file")
    frames_s = read_listed_frame_stamps_s(path)
    truth, note = read_ground_truth(path, frames_s)
    if note:
        announce(note)
    assert truth is not None
    return truth, frames_s, file


def read_listed_frame_stamps_s(folder: Path) -> Array | None:
    """Read the stamps of a recording's frames.

    Returns:
        (N,) stamps, s; None if the folder is not a recording.

    Raises:
        InputError: If the recording's lists cannot be read.
    """
    lists = [["associations.txt"], ["rgb.txt", "depth.txt"]]
    if not any(all((folder / name).is_file() for name in names) for names in lists):
        return None
    return np.array([pair.color.stamp_s for pair in read_frame_pairs(folder).pairs])
