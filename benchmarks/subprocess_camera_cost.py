"""Cost of a subprocess camera: CPU time and latency of a frame.

    python -m benchmarks.subprocess_camera_cost [--seconds 10] [--rate 30] [--json]

The same camera is read in this process and then through a subprocess. Like a driver, it copies a
640x480 frame at every tick. CPU times are per frame, without the first second: `reader` is the
process that reads, `worker` the one with the camera. The latency is from when the camera has a
frame until the reader has it.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import time
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from benchmarks.preloaded_camera import PreloadedCamera
from drivers.camera import Clock, PlaybackMode, RgbdCamera
from drivers.subprocess_camera.camera import SubprocessCamera

READ_TIMEOUT_S = 30.0
WARM_UP_S = 1.0


@dataclass(frozen=True)
class CaptureCost:
    """Cost of one frame in milliseconds, and the missed frames of the whole run."""

    cpu_reader_ms: float
    cpu_worker_ms: float
    latency_median_ms: float
    latency_p99_ms: float
    missed: int

    @property
    def cpu_ms(self) -> float:
        """CPU time of both processes."""
        return self.cpu_reader_ms + self.cpu_worker_ms


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.subprocess_camera_cost",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each run")
    parser.add_argument("--rate", type=float, default=30.0, help="frames per second")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    recipe = partial(PreloadedCamera, args.rate)
    isolated = SubprocessCamera("preloaded", Clock.MONOTONIC, recipe, PlaybackMode.REALTIME)
    frames = int(args.seconds * args.rate)
    warm_up = int(WARM_UP_S * args.rate)
    in_process, isolated_cost = (
        measure(recipe(), warm_up, frames),
        measure(isolated, warm_up, frames),
    )
    # In this process reader and worker are the same: its time is counted once.
    in_process = CaptureCost(**{**asdict(in_process), "cpu_worker_ms": 0.0})
    if args.json:
        print(json.dumps({"in_process": asdict(in_process), "isolated": asdict(isolated_cost)}))
        return
    print("ms per frame      reader     worker   total CPU  latency median     p99  missed")
    for name, cost in (("in process", in_process), ("isolated", isolated_cost)):
        print(
            f"{name:14}{cost.cpu_reader_ms:10.3f}{cost.cpu_worker_ms:11.3f}{cost.cpu_ms:12.3f}"
            f"{cost.latency_median_ms:16.3f}{cost.latency_p99_ms:8.3f}{cost.missed:8d}"
        )
    extra_ms = isolated_cost.cpu_ms - in_process.cpu_ms
    ratio = isolated_cost.cpu_ms / in_process.cpu_ms
    print(f"ratio of the total CPU time: {ratio:.2f} ({extra_ms:+.3f} ms)")


def measure(camera: RgbdCamera, warm_up: int, frames: int) -> CaptureCost:
    """Measure `frames` frames after `warm_up` frames."""
    with camera:
        for _ in range(warm_up):
            first = camera.read(READ_TIMEOUT_S)
        begin_s, last, latencies_s = time.process_time(), first, []
        for _ in range(frames):
            last = camera.read(READ_TIMEOUT_S)
            latencies_s.append(time.monotonic() - last.receive_time_s)
        here_s = time.process_time() - begin_s
    there_s = (last.device_stamp_s or 0.0) - (first.device_stamp_s or 0.0)
    median_s, p99_s = np.percentile(latencies_s, [50, 99])
    return CaptureCost(
        cpu_reader_ms=here_s / frames * 1e3,
        cpu_worker_ms=there_s / frames * 1e3,
        latency_median_ms=float(median_s) * 1e3,
        latency_p99_ms=float(p99_s) * 1e3,
        missed=last.seq - first.seq - frames,
    )


if __name__ == "__main__":
    main()
