"""How far a parked camera's pose gets from where it began: by default an hour of it, accelerated.

    python -m benchmarks.stationary_drift [--minutes 60] [--seed 1] [--method direct]

The virtual Kinect of config/sequences/still.toml stands still, rolling shutter, skew and hunting
exposure and all, with fresh noise in each frame. A line each minute of the film, so that a run that
is ended has told what it got: the frames so far and how many of them had no pose; how far the pose
was from the first one, at most and root mean square; how far this minute's mean is from that of the
first; and the processor time of a frame. An hour of film takes less than an hour of one core.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from benchmarks.hard_cases import STILL, case_config
from benchmarks.static_views import StaticView
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, so3_log
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, FeatureConfig
from vo_service.odometry.warm_up import warm_up

HEAD = (
    f"{'minutes':>7}{'frames':>8}{'lost':>6}{'at most':>10}{'':12}{'rms':>10}{'':12}"
    f"{'drift':>10}{'':12}{'CPU':>8}"
)


@dataclass(frozen=True)
class DriftResult:
    """After so many frames; pairs are metres and degrees.

    lost      frames without a pose
    farthest  from the first pose, at most
    rms       from the first pose, root mean square
    drift     from the mean of the first minute to that of the last
    cpu_ms    processor time of a frame, mean
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
    """How a camera that never moves is followed, told after each `frames_per_report` frames."""
    odometry = METHODS[method](FeatureConfig(), CpuStageTimer())
    T_first_world, means = np.eye(4), list[Array]()
    farthest, squares, cpu_s, lost, minute = np.zeros(2), np.zeros(2), 0.0, 0, list[Array]()
    for count, frame in enumerate(frames, 1):
        begun_s = time.thread_time()
        estimate = odometry.estimate(frame)
        cpu_s += time.thread_time() - begun_s
        if estimate.ok:
            if count == lost + 1:
                T_first_world = inverse(estimate.T_world_camera)
            minute.append(_pose_twist(T_first_world @ estimate.T_world_camera))
            size = _twist_size(minute[-1])
            farthest, squares = np.maximum(farthest, size), squares + size**2
        lost += not estimate.ok
        if count % frames_per_report == 0 and minute:
            means.append(np.mean(minute, axis=0))
            minute.clear()
            rms, drift = np.sqrt(squares / (count - lost)), _twist_size(means[-1] - means[0])
            yield DriftResult(count, lost, farthest, rms, drift, 1e3 * cpu_s / count)


def _pose_twist(T: Array) -> Array:
    """(6,) metres and degrees of a small motion."""
    return np.concatenate([T[:3, 3], np.degrees(so3_log(T[:3, :3]))])


def _twist_size(twist: Array) -> Array:
    """Metres and degrees."""
    size: Array = np.linalg.norm(twist.reshape(2, 3), axis=1)
    return size


def format_row(minutes: int, stood: DriftResult) -> str:
    """One line of the table."""
    pairs = (stood.max_error, stood.rms, stood.drift)
    told = "".join(f"{1e3 * metres:7.3f} mm {degrees:7.4f} deg" for metres, degrees in pairs)
    return f"{minutes:7}{stood.frames:8}{stood.lost:6}{told}{stood.cpu_ms:6.2f} ms"


def main() -> int:
    """Render the view, follow it, tell each minute."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stationary_drift",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=int, default=60, help="of film")
    parser.add_argument("--seed", type=int, default=1, help="of the room and of the noise")
    parser.add_argument("--method", choices=METHODS, default="direct")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    config = replace(case_config(STILL), seed=args.seed)
    warm_up(args.method, lambda stage: None)
    a_minute = round(60 * config.rate_hz)
    print(HEAD, flush=True)
    frames = StaticView.render(config).frames(args.minutes * a_minute)
    for minutes, stood in enumerate(measure_drift(args.method, frames, a_minute), 1):
        print(format_row(minutes, stood), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
