"""Accuracy on changed recordings: tiny changes, a wrong calibration, faults, and other sensors.

Each FOLDER is a TUM folder with ground truth. ATE RMSE, mean global error and RPE over a second are
in millimeters.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.corruptions import CORRUPTIONS, Corruption
from benchmarks.harness import FOLDERS, Json, ResultCache, Table, Variants, median, option
from benchmarks.other_sensors import make_other_sensors
from benchmarks.tracking import (
    METHOD,
    FrameChange,
    evaluate_accuracy,
    open_frames_with_truth,
    track_changed,
    track_with,
)
from drivers.camera import RgbdFrame
from drivers.tum.folder import open_tum_folder
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.views import FeatureView
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.surf.recovery import RecoveredPose, SurfRecovery
from vo_service.odometry.warm_up import warm_up

MAX_FOCAL_ERROR_PX = 0.5
MAX_DELAY_ERROR_S = 0.0003
UNCHANGED = "unchanged"
TINY_COLUMNS = ("unchanged", "smallest", "median", "largest")
FIGURES = {"ATE": "ate_m", "RPE/1s": "rpe_1s_m", "failed": "failed"}
TINY_TABLE, COUNT_TABLE = (
    Table(28, *(f"{name}:11{form}" for name in TINY_COLUMNS), "ratio:11.2f")
    for form in (".2mm", "g")
)
CALIBRATION_TABLE = Table(28, "ATE:10.2mm", "global:10.2mm", "RPE/1s:10.2mm", "failed:10d")
SENSOR_METHODS = ("direct", "surf")
SENSOR_TABLE = Table(
    28,
    *(column for each in SENSOR_METHODS for column in (f"lost {each}:12d", f"ATE {each}:12.1mm")),
)


@dataclass(frozen=True)
class Perturbation:
    """A tiny change of all frames of a recording."""

    seed: int
    focal_px: float
    delay_s: float

    def __str__(self) -> str:
        return f"{self.seed}: {self.focal_px:+.2f} px {1e3 * self.delay_s:+.2f} ms"

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Change a frame; its noise depends on the seed and the frame's number alone."""
        rng = np.random.default_rng([self.seed, frame.seq])
        noise = rng.integers(-1, 2, (*frame.depth_raw.shape, 1), np.int16)
        camera = frame.camera
        return replace(
            frame,
            color_bgr=np.clip(frame.color_bgr + noise, 0, 255).astype(np.uint8),
            camera=replace(camera, fx=camera.fx + self.focal_px, fy=camera.fy + self.focal_px),
            skew_s=frame.skew_s + self.delay_s,
        )


def make_perturbation(seed: int) -> Perturbation:
    """Draw the perturbation of a seed."""
    focal, delay = np.random.default_rng(seed).uniform(-1.0, 1.0, 2).tolist()
    return Perturbation(seed, MAX_FOCAL_ERROR_PX * focal, MAX_DELAY_ERROR_S * delay)


@option("kept", metavar="KEPT", type=Path, help="folder of stored results")
@FOLDERS
@METHOD
@option("--count", type=int, default=20, help="perturbations of each recording")
def measure_tiny_changes(args: argparse.Namespace) -> None:
    """Sensitivity of a method to tiny changes of a recording.

    Each perturbation changes the focal length by up to 0.5 px, the delay of depth by up to 0.3 ms,
    and each pixel's brightness by -1, 0 or 1 gray level, at random but the same in every run.
    Errors of a robust method hardly change: the largest should be at most 1.5 times the smallest.
    "failed" are frames without a pose. Finished runs are stored in KEPT/results.json, and the same
    command continues with the next. Remove KEPT when the odometry has changed.
    """
    cache = ResultCache(args.kept)
    warm_up(args.method, lambda stage: None)
    for folder in args.folder:

        def run(name: str, change: FrameChange, folder: Path = folder) -> Json:
            return cache.get_or_run(
                f"{folder.resolve()} {args.method} {name}",
                lambda: asdict(track_changed(args.method, folder, change)[1]),
            )

        unchanged = run(UNCHANGED, lambda frame: frame)
        perturbations = map(make_perturbation, range(1, args.count + 1))
        changed = [run(str(each), each.apply) for each in perturbations]
        print(f"{folder}\n{format_spread(args.method, unchanged, changed)}", flush=True)


def format_spread(method: str, unchanged: Json, changed: Sequence[Json]) -> str:
    """A row for each figure: without change, and the range over all perturbations."""
    lines = [f"{method}, {len(changed)} perturbations", TINY_TABLE.head]
    for label, key in FIGURES.items():
        values = [result[key] for result in changed]
        spread = [None] * 3 if None in values else [min(values), median(values), max(values)]
        is_length = key != "failed"
        ratio = max(values) / spread[0] if is_length and spread[0] else None
        table = TINY_TABLE if is_length else COUNT_TABLE
        lines.append(table.row(label, unchanged[key], *spread, ratio))
    return "\n".join(lines)


@FOLDERS
@METHOD
def measure_wrong_calibration(args: argparse.Namespace) -> None:
    """Errors from a wrong calibration: the same recordings with one changed camera parameter.

    "failed" are the frames without a pose. The calibration of the recordings must be exact: use
    rendered ones.
    """
    for folder in args.folder:
        print(f"{folder}\n{CALIBRATION_TABLE.head}")
        for name, change in make_calibration_errors().items():
            _, result = track_changed(args.method, folder, change)
            errors_m = (result.ate_m, result.global_m, result.rpe_1s_m)
            print(CALIBRATION_TABLE.row(name, *errors_m, result.failed), flush=True)


def make_calibration_errors() -> Mapping[str, FrameChange]:
    """Calibration errors by name."""
    return {
        "correct": lambda frame: frame,
        "focal length + 1 %": lambda frame: _scale_focal_length(frame, 1.01),
        "focal length - 1 %": lambda frame: _scale_focal_length(frame, 0.99),
        "focal length + 3 %": lambda frame: _scale_focal_length(frame, 1.03),
        "focal length - 3 %": lambda frame: _scale_focal_length(frame, 0.97),
        "center + 3 px": lambda frame: replace(
            frame, camera=replace(frame.camera, cx=frame.camera.cx + 3.0)
        ),
        "depth scale + 1 %": lambda frame: replace(frame, depth_factor=frame.depth_factor / 1.01),
        "depth scale - 1 %": lambda frame: replace(frame, depth_factor=frame.depth_factor / 0.99),
        "readout + 5 ms": lambda frame: replace(frame, readout_s=frame.readout_s + 0.005),
        "readout - 5 ms": lambda frame: replace(frame, readout_s=max(frame.readout_s - 0.005, 0.0)),
        "depth offset + 5 ms": lambda frame: replace(frame, skew_s=frame.skew_s + 0.005),
        "without timing": lambda frame: replace(frame, readout_s=0.0, skew_s=0.0),
    }


def _scale_focal_length(frame: RgbdFrame, factor: float) -> RgbdFrame:
    camera = frame.camera
    return replace(frame, camera=replace(camera, fx=factor * camera.fx, fy=factor * camera.fy))


class NullRecovery(SurfRecovery):
    """Never recovers."""

    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        """See `SurfRecovery`."""
        return None


RECOVERIES = {"without": NullRecovery, "with": SurfRecovery}
CORRUPTED_FIGURES = {"lost": "16d", "epochs": "16d", "ATE": "16.1mm", "CPU ms": "16.1f"}
CORRUPTED_TABLE = Table(
    *(16, "frames:9d"),
    *(f"{name} {case}:{width}" for name, width in CORRUPTED_FIGURES.items() for case in RECOVERIES),
)


@FOLDERS
def measure_corrupted(args: argparse.Namespace) -> None:
    """Tracking by `surf` of recordings with corrupted pieces, with and without recovery.

    Each FOLDER has some hundred frames. A frame is lost if it has no pose; after 30 in a row
    tracking restarts in a new epoch. The ATE is that of all published
    poses, across epochs. CPU milliseconds are the largest of any frame, without decoding. "without"
    compares each frame with the last good one only.
    """
    warm_up("surf", lambda stage: None)
    for folder in args.folder:
        print(f"{folder}\n{CORRUPTED_TABLE.head}")
        for name, corruption in CORRUPTIONS.items():
            both = [_track_corrupted(folder, corruption, each) for each in RECOVERIES.values()]
            values = [value for pair in zip(*both, strict=True) for value in pair]
            print(CORRUPTED_TABLE.row(name, *values[1:]), flush=True)


def _track_corrupted(
    folder: Path, corruption: Corruption, make_recovery: type[SurfRecovery]
) -> tuple[float | None, ...]:
    """Track all frames once; return their number, lost ones, new epochs, error, largest time."""
    count = len(open_tum_folder(folder, None).frames.pairs)
    parameters, timer = SurfParameters(), CpuStageTimer()
    odometry = SurfOdometry(parameters=parameters, recovery=make_recovery(parameters), timer=timer)
    with open_frames_with_truth(folder, corruption.faults(count)) as (frames, truth):
        tracked = track_with(odometry, timer, corruption.swing(frames, count), OdomFrame())
    each = evaluate_accuracy(tracked, truth)
    return each.frames, each.failed, each.resets, each.ate_m, float(tracked.cpu_ms.max())


@FOLDERS
def measure_other_sensors(args: argparse.Namespace) -> None:
    """Tracking of recordings as other sensors would have them, by `direct` and by `surf`.

    Images have other sizes; inverse depth has more noise, which neighbors share as with stereo; a
    smaller depth image is registered to the color image pixel by pixel, which leaves a grid with
    holes; little of the view has depth; depth is half as fast as color; or the room is dark.
    "lost" are the frames without a pose.
    """
    for method in SENSOR_METHODS:
        warm_up(method, lambda stage: None)
    for folder in args.folder:
        print(f"{folder}\n{SENSOR_TABLE.head}")
        for name, change in make_other_sensors().items():
            runs = [track_changed(method, folder, change)[1] for method in SENSOR_METHODS]
            figures = [figure for run in runs for figure in (run.failed, run.ate_m)]
            print(SENSOR_TABLE.row(name, *figures), flush=True)


VARIANTS: Variants = {
    "tiny": measure_tiny_changes,
    "calibration": measure_wrong_calibration,
    "corrupted": measure_corrupted,
    "sensors": measure_other_sensors,
}
