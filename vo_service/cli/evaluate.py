"""``kinect-vo evaluate``: compare a trajectory with its ground truth."""

import argparse
import json
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, read_trajectory
from drivers.recording_camera import RecordingFormat, recording_format
from drivers.tum import read_frame_pairs
from vo_service.cli.options import add_topics_option
from vo_service.cli.recordings import open_and_announce
from vo_service.tools.evaluation import Evaluation, evaluate
from vo_service.tools.evaluation.plot import write_plot

EPILOG = """\
examples:
  kinect-vo evaluate poses.txt recordings/desk
  kinect-vo evaluate poses.txt recordings/desk/groundtruth.txt --picture desk.png
  kinect-vo evaluate poses.txt truth.txt --json | jq .ate_rmse_m

Both files hold lines of: stamp tx ty tz qx qy qz qw. Poses are paired by the nearest stamp
within 20 ms. ATE: distances after the best rigid alignment, without scale. Mean global error:
distances with the first poses joined. RPE: root mean square over one frame and over one second.

Coverage: poses with ground truth, divided by frames with ground truth. The frames are those listed
beside the ground truth (rgb.txt and depth.txt, or associations.txt). Without a list, a ground truth
with a pose at the stamp of every pose counts as one per frame; otherwise the coverage is unknown.

A metric that cannot be computed is "-" in the table and null in JSON.
"""
# Keys of the summary of `replay` that are unknown from two trajectory files.
REPLAY_ONLY_KEYS = ("failed", "skipped", "stage_ms", "cpu_ms_per_frame")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("trajectory", metavar="TRAJECTORY", type=Path, help="file of poses")
    parser.add_argument(
        "folder", metavar="GROUNDTRUTH", type=Path,
        help="file of true poses, or a recording with groundtruth.txt or true poses in /tf",
    )  # fmt: skip
    add_topics_option(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")
    parser.add_argument(
        "--picture", metavar="FILE", type=Path,
        help="plot the trajectory and the ground truth (.png or .svg)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Compare and print.

    Raises:
        UserFacingError: If a file cannot be read or written, or if the trajectories do not match.
    """
    trajectory = read_trajectory(args.trajectory)
    truth, frames_s, truth_file = _read_ground_truth(args)
    try:
        evaluation = evaluate(trajectory, truth, frames_s)
    except InputError as error:
        raise InputError(f"{args.trajectory} against {truth_file}: {error}") from error
    if args.picture is not None:
        title = f"{args.trajectory.name}: ATE RMSE {1e3 * evaluation.ate_rmse_m:.2f} mm"
        write_plot(args.picture, trajectory, truth, title)
    print(_as_json(evaluation, frames_s) if args.json else evaluation.as_table())
    return 0


def _read_ground_truth(args: argparse.Namespace) -> tuple[Trajectory, Array | None, Path]:
    """Read the true poses, the stamps of the frames if known, and the file of the poses."""
    path: Path = args.folder
    if recording_format(path) is RecordingFormat.TUM:
        file = path / "groundtruth.txt" if path.is_dir() else path
        return read_trajectory(file), read_listed_frame_stamps_s(file.parent), file
    recording = open_and_announce(args, None)
    if recording.ground_truth is None:
        raise InputError(f"{path}: has no true poses, neither in /tf nor in a topic of poses")
    return recording.ground_truth, recording.frames.stamps_s, path


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


def _as_json(evaluation: Evaluation, frames_s: Array | None) -> str:
    frames = {"frames": None if frames_s is None else len(frames_s)}
    return json.dumps(frames | dict.fromkeys(REPLAY_ONLY_KEYS) | evaluation.as_json())
