"""Tracking of recordings with corrupted pieces, with and without recovery.

    python -m benchmarks recovery FOLDER... [--json]

Each FOLDER is a TUM folder of some hundred frames, which are all held in memory. A frame is lost if
it has no pose; after 30 in a row tracking restarts in a new epoch. The ATE is that of all published
poses, across epochs, in millimeters. CPU milliseconds are the largest of any frame, without
decoding. "without" compares each frame with the last good one only.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import add_json_option, make_printer, print_json
from benchmarks.tracking import evaluate_trajectory, read_all_frames
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.geometry import Array, Trajectory, so3_exp
from drivers.recording_camera import RecordingCamera
from vo_service.odometry import warm_up
from vo_service.odometry.features import FeatureView, SurfParameters
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.surf.recovery import RecoveredPose, SurfRecovery

Frames = list[RgbdFrame]
Image = NDArray[np.integer[Any]]
FrameTransform = Callable[[Frames], Frames]  # the corrupted frames, perhaps fewer

BLUR_SAMPLES = 9  # views within the exposure that are averaged for motion blur


@dataclass(frozen=True)
class SwingMotion:
    """A swing about the camera's own axes: to one side, back, and to the other side.

    Attributes:
        furthest_rad: (3,) rotation vector of the largest deviation.
    """

    max_rotation_rad: tuple[float, float, float]
    rate_hz: float
    exposure_s: float

    def rotation_at(self, time_s: float) -> Array:
        """R_mounting_camera, 3x3."""
        furthest_rad = np.array(self.max_rotation_rad)
        return so3_exp(furthest_rad * np.sin(2 * np.pi * self.rate_hz * time_s))


@dataclass(frozen=True)
class FrameCorruption:
    """A corruption of `pieces` evenly spread pieces of `frames` frames each."""

    corrupt: FrameTransform
    frames: int
    pieces: int

    def apply(self, frames: Frames) -> Frames:
        """Return the frames with corrupted pieces; frames between the pieces do not change."""
        out: Frames = []
        begin = 0
        for n in range(self.pieces):
            first = (2 * n + 1) * len(frames) // (2 * self.pieces) - self.frames // 2
            last = first + self.frames
            out += frames[begin:first] + self.corrupt(frames[first:last])
            begin = last
        return out + frames[begin:]


def blacken(piece: Frames) -> Frames:
    """Make color black; depth needs no light."""
    return [replace(f, color_bgr=np.zeros_like(f.color_bgr)) for f in piece]


def freeze(piece: Frames) -> Frames:
    """Repeat the first images with new stamps."""
    first = piece[0]
    return [replace(f, color_bgr=first.color_bgr, depth_raw=first.depth_raw) for f in piece]


def replace_with_noise(piece: Frames) -> Frames:
    """Replace color and depth by noise."""
    return [_noise_frame(f) for f in piece]


def remove(piece: Frames) -> Frames:
    """Remove all frames."""
    return piece[:0]


def add_swing(piece: Frames, motion: SwingMotion) -> Frames:
    """Swing the camera and return it, with motion blur."""
    begin_s = piece[0].stamp_s
    return [_rotate(f, motion, f.stamp_s - begin_s) for f in piece]


def _noise_frame(frame: RgbdFrame) -> RgbdFrame:
    random = np.random.default_rng(frame.seq)
    shape = frame.color_bgr.shape
    gray = random.integers(0, 256, (*shape[:2], 1), np.uint8)
    farthest = int(5.0 * frame.depth_factor)
    return replace(
        frame,
        color_bgr=np.repeat(gray, 3, axis=2),
        depth_raw=random.integers(0, farthest, shape[:2]).astype(np.uint16),
    )


def _rotate(frame: RgbdFrame, swing: SwingMotion, time_s: float) -> RgbdFrame:
    exposed_s = time_s + swing.exposure_s * np.linspace(-0.5, 0.5, BLUR_SAMPLES)
    shots = [
        _warp(frame.color_bgr, frame, swing.rotation_at(t), cv2.INTER_LINEAR) for t in exposed_s
    ]
    R = swing.rotation_at(time_s)
    depth = _warp(frame.depth_raw, frame, R, cv2.INTER_NEAREST)
    return replace(
        frame,
        color_bgr=np.mean(shots, axis=0).astype(np.uint8),
        depth_raw=np.rint(depth * _depth_scale(frame, R)).astype(np.uint16),
    )


def _warp(image: Image, frame: RgbdFrame, R: Array, interpolation: int) -> Image:
    """Warp an image to the view of the rotated camera, by its pixel rays rotated back."""
    K = frame.camera.K
    size = frame.camera.width, frame.camera.height
    flags = interpolation | cv2.WARP_INVERSE_MAP
    mapping = K @ R @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(image, mapping, size, flags=flags))


def _depth_scale(frame: RgbdFrame, R: Array) -> Array:
    """Depth (H, W) along the rotated camera's axis of one meter along the original axis."""
    camera = frame.camera
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    share: Array = 1.0 / (R[2, 0] * x[None, :] + R[2, 1] * y[:, None] + R[2, 2])
    return share


# A push against the robot: at most 14 degrees per frame.
SHAKE = SwingMotion((0.15, 0.4, 0.1), rate_hz=2.75, exposure_s=0.012)
# A turn to both sides in a dim room: at most 4 degrees per frame.
PAN = SwingMotion((0.15, 0.7, 0.1), rate_hz=0.5, exposure_s=0.025)

CORRUPTIONS: Mapping[str, FrameCorruption] = {
    "black 0.5 s": FrameCorruption(blacken, 15, 4),
    "frozen 0.5 s": FrameCorruption(freeze, 15, 4),
    "noise 0.5 s": FrameCorruption(replace_with_noise, 15, 4),
    "shaken 1 s": FrameCorruption(partial(add_swing, motion=SHAKE), 30, 3),
    "panned 2 s": FrameCorruption(partial(add_swing, motion=PAN), 60, 2),
    "missing 0.5 s": FrameCorruption(remove, 15, 4),
    "missing 1 s": FrameCorruption(remove, 30, 3),
    "missing 2 s": FrameCorruption(remove, 60, 2),
    "missing 3 s": FrameCorruption(remove, 90, 1),
}


class NullRecovery(SurfRecovery):
    """Never recovers."""

    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        """See `SurfRecovery`."""
        return None


RECOVERIES = {"without": NullRecovery, "with": SurfRecovery}


@dataclass(frozen=True)
class RecoveryOutcome:
    """Result of one pass: frames, frames without a pose, new epochs, and the error."""

    frames: int
    lost: int
    epochs: int
    ate_m: float | None
    cpu_ms: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    print_line = make_printer(args)
    print_json(args, {str(folder): measure(folder, print_line) for folder in args.folder})


def measure(
    folder: Path, print_line: Callable[[str], None]
) -> dict[str, dict[str, RecoveryOutcome]]:
    """Measure all corruptions; results by corruption, then by recovery."""
    frames, truth = load_frames(folder)
    warm_up("surf", lambda stage: None)
    print_line(f"{folder}\n{format_header()}")
    results: dict[str, dict[str, RecoveryOutcome]] = {}
    for name, corruption in CORRUPTIONS.items():
        corrupted = corruption.apply(frames)
        results[name] = {recovery: _track(corrupted, truth, recovery) for recovery in RECOVERIES}
        print_line(format_row(name, results[name]))
    return results


def load_frames(folder: Path) -> tuple[Frames, Trajectory | None]:
    """Load all frames of a folder, and the ground truth."""
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        return list(read_all_frames(camera)), camera.ground_truth


def _track(frames: Frames, truth: Trajectory | None, recovery: str) -> RecoveryOutcome:
    """Track all frames once."""
    parameters = SurfParameters()
    odometry = SurfOdometry(parameters=parameters, recovery=RECOVERIES[recovery](parameters))
    estimates, cpu_ms = [], 0.0
    for frame in frames:
        begin_s = time.thread_time()
        estimates.append(odometry.estimate(frame))
        cpu_ms = max(cpu_ms, (time.thread_time() - begin_s) * 1e3)
    evaluation = evaluate_trajectory(estimates, [frame.stamp_s for frame in frames], truth)
    return RecoveryOutcome(
        frames=len(frames),
        lost=sum(not e.ok for e in estimates),
        epochs=sum(e.is_reset for e in estimates),
        ate_m=evaluation.ate_rmse_m if evaluation else None,
        cpu_ms=cpu_ms,
    )


def format_header() -> str:
    """Format the column heads."""
    names = ("frames", "lost", "", "epochs", "", "ATE", "", "CPU ms", "")
    recoveries = ("", *("without", "with") * 4)
    return (
        f"{'':16}"
        + "".join(f"{n:>9}" for n in names)
        + f"\n{'':16}"
        + "".join(f"{recovery:>9}" for recovery in recoveries)
    )


def format_row(name: str, outcomes: Mapping[str, RecoveryOutcome]) -> str:
    """Format one corruption: each figure without recovery, then with it."""
    both = [outcomes[recovery] for recovery in RECOVERIES]
    cells = [f"{both[0].frames}"]
    cells += [f"{o.lost}" for o in both] + [f"{o.epochs}" for o in both]
    cells += ["-" if o.ate_m is None else f"{1e3 * o.ate_m:.1f}" for o in both]
    cells += [f"{o.cpu_ms:.1f}" for o in both]
    return f"{name:16}" + "".join(f"{cell:>9}" for cell in cells)
