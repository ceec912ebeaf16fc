"""Drift of a stationary camera's pose, by default over an hour of frames.

    python -m benchmarks stationary_drift [--minutes 60] [--seed 1] [--method direct]

The virtual Kinect of config/sequences/still.toml stands still, with rolling shutter, skew, hunting
exposure and fresh noise in each frame. Each minute of frames prints a line: the frames so far and
those without a pose; the distance from the first pose, at most and RMS; the distance of this
minute's mean from that of the first; and the processor time of a frame. An hour of frames takes
less than an hour of one core.
"""

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hard_cases import STILL, case_config
from benchmarks.rendered_sequences import StaticView
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, so3_log
from vo_service.odometry import METHODS, CpuStageTimer, MethodConfig, warm_up

HEAD = (
    f"{'minutes':>7}{'frames':>8}{'lost':>6}{'at most':>10}{'':12}{'rms':>10}{'':12}"
    f"{'drift':>10}{'':12}{'CPU':>8}"
)


@dataclass(frozen=True)
class DriftResult:
    """Drift so far; arrays (2,) are meters and degrees.

    Attributes:
        frames: Number of frames.
        lost: Frames without a pose.
        max_error: Largest distance from the first pose.
        rms: RMS distance from the first pose.
        drift: Distance of the last minute's mean from that of the first.
        cpu_ms: Mean processor time of a frame.
    """

    frames: int
    lost: int
    max_error: Array
    rms: Array
    drift: Array
    cpu_ms: float


def measure_drift(
    method: str, frames: Iterable[RgbdFrame], frames_per_report: int
) -> Iterator[DriftResult]:
    """Track a camera that never moves; yield the drift after each `frames_per_report` frames.

    Args:
        method: The method.
        frames: Frames of a still camera.
        frames_per_report: Frames between two results.
    """
    odometry = METHODS[method](MethodConfig(), CpuStageTimer())
    T_first_world, means = np.eye(4), list[Array]()
    max_error, squares, cpu_s, lost, minute = np.zeros(2), np.zeros(2), 0.0, 0, list[Array]()
    for count, frame in enumerate(frames, 1):
        begin_s = time.thread_time()
        estimate = odometry.estimate(frame)
        cpu_s += time.thread_time() - begin_s
        if estimate.ok:
            if count == lost + 1:
                T_first_world = inverse(estimate.T_world_camera)
            minute.append(_pose_twist(T_first_world @ estimate.T_world_camera))
            size = _twist_size(minute[-1])
            max_error, squares = np.maximum(max_error, size), squares + size**2
        lost += not estimate.ok
        if count % frames_per_report == 0 and minute:
            means.append(np.mean(minute, axis=0))
            minute.clear()
            rms, drift = np.sqrt(squares / (count - lost)), _twist_size(means[-1] - means[0])
            yield DriftResult(count, lost, max_error, rms, drift, 1e3 * cpu_s / count)


def _pose_twist(T: Array) -> Array:
    """Twist (6,) of a small motion, meters and degrees."""
    return np.concatenate([T[:3, 3], np.degrees(so3_log(T[:3, :3]))])


def _twist_size(twist: Array) -> Array:
    """Size (2,) of a twist, meters and degrees."""
    size: Array = np.linalg.norm(twist.reshape(2, 3), axis=1)
    return size


def format_row(minutes: int, result: DriftResult) -> str:
    """One line of the table."""
    pairs = (result.max_error, result.rms, result.drift)
    errors = "".join(f"{1e3 * meters:7.3f} mm {degrees:7.4f} deg" for meters, degrees in pairs)
    return f"{minutes:7}{result.frames:8}{result.lost:6}{errors}{result.cpu_ms:6.2f} ms"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--minutes", type=int, default=60, help="minutes of frames")
    parser.add_argument("--seed", type=int, default=1, help="seed of the room and of the noise")
    parser.add_argument("--method", choices=METHODS, default="direct")


def main(args: argparse.Namespace) -> None:
    """Render the view, track it, and print a line each minute."""
    config = replace(case_config(STILL), seed=args.seed)
    warm_up(args.method, lambda stage: None)
    minute_frames = round(60 * config.rate_hz)
    print(HEAD, flush=True)
    frames = StaticView.render(config).frames(args.minutes * minute_frames)
    for minutes, result in enumerate(measure_drift(args.method, frames, minute_frames), 1):
        print(format_row(minutes, result), flush=True)
