"""What it costs to have a camera in a process of its own: CPU time and latency of a frame.

    python -m benchmarks.subprocess_camera_cost [--seconds 10] [--rate 30] [--json]

The same camera is read in this process and then from a process of its own. It copies a 640x480
frame at every tick, as a driver does, and nothing else. CPU times are per frame, after the first
second (starting a process is not counted): `here` is the process that reads, `there` the one that
has the camera. The latency is from when the camera has the frame until the reader has it.
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
    """Of one frame, milliseconds; `missed` frames of the whole run."""

    cpu_reader_ms: float
    cpu_worker_ms: float
    latency_median_ms: float
    latency_p99_ms: float
    missed: int

    @property
    def cpu_ms(self) -> float:
        """Of both processes."""
        return self.cpu_reader_ms + self.cpu_worker_ms


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.subprocess_camera_cost",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to read each")
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    recipe = partial(PreloadedCamera, args.rate)
    isolated = SubprocessCamera("preloaded", Clock.MONOTONIC, recipe, PlaybackMode.REALTIME)
    frames = int(args.seconds * args.rate)
    warm_up = int(WARM_UP_S * args.rate)
    alone, apart = measure(recipe(), warm_up, frames), measure(isolated, warm_up, frames)
    # In this process, "there" is here: its time is counted once.
    alone = CaptureCost(**{**asdict(alone), "cpu_worker_ms": 0.0})
    if args.json:
        print(json.dumps({"in_process": asdict(alone), "isolated": asdict(apart)}))
        return
    print("ms per frame    CPU here  CPU there  CPU in all  latency median     p99  missed")
    for name, cost in (("in process", alone), ("isolated", apart)):
        print(
            f"{name:14}{cost.cpu_reader_ms:10.3f}{cost.cpu_worker_ms:11.3f}{cost.cpu_ms:12.3f}"
            f"{cost.latency_median_ms:16.3f}{cost.latency_p99_ms:8.3f}{cost.missed:8d}"
        )
    extra_ms = apart.cpu_ms - alone.cpu_ms
    print(f"ratio of the CPU time in all: {apart.cpu_ms / alone.cpu_ms:.2f} ({extra_ms:+.3f} ms)")


def measure(camera: RgbdCamera, warm_up: int, frames: int) -> CaptureCost:
    """Read so many frames after the first ones."""
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
