"""Our TSDF fusion compared with OpenCV's volumes, on the virtual room with true poses.

    python -m benchmarks.fusion [--seconds 10] [--seed 1] [--scale 1.0] [--json]

Each method runs in a separate process on one thread. Times are CPU times, the median over the
frames. Memory is the growth of the process with map and surface, without images. Distances are from
every point of the surface to the nearest true one. OpenCV's dense volumes allocate their memory at
the start and are limited to a box, here around the room; at 10 mm they would take 8 times the
memory of 20 mm.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from benchmarks.fusion_volumes import (
    FusionVolume,
    OpenCvDenseVolume,
    OpenCvHashVolume,
    ServiceVolume,
)
from benchmarks.surface_error import distances_m, make_solids
from benchmarks.virtual_room import render_with_truth, scaled_camera
from drivers.camera import RgbdFrame
from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from drivers.synthetic.config import SyntheticConfig

MAX_POINTS = 200_000
# For each: whether the surface has colors and triangles, and what limits its memory.
CANDIDATES: Mapping[str, tuple[Callable[[], FusionVolume], str]] = {
    "ours, 10 mm": (partial(ServiceVolume, 0.01), "colors, triangles, bounded"),
    "cv2 HashTSDF, 10 mm": (partial(OpenCvHashVolume, 0.01), "points, no colors, grows"),
    "ours, 20 mm": (partial(ServiceVolume, 0.02), "colors, triangles, bounded"),
    "cv2 HashTSDF, 20 mm": (partial(OpenCvHashVolume, 0.02), "points, no colors, grows"),
    "cv2 ColorTSDF, 20 mm": (partial(OpenCvDenseVolume, 0.02), "colors, points, a fixed box"),
}


@dataclass(frozen=True)
class FusionResult:
    """Result of one fusion method; lengths in millimeters."""

    add_ms: float
    slowest_ms: float
    fetch_s: float
    memory_mb: float
    points: int
    median_mm: float
    p90_mm: float
    p99_mm: float
    has: str


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fusion",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0, help="image size: 0.5 = 320 x 240")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")
    args = parser.parse_args()
    config = SyntheticConfig(
        seed=args.seed, duration_s=args.seconds, camera=scaled_camera(args.scale)
    )
    try:
        for _ in render_with_truth(config):  # rendered once, before anything is measured
            break
        with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as processes:
            for name in CANDIDATES:
                result = processes.apply(measure, (name, config))
                print(
                    json.dumps({"name": name} | asdict(result))
                    if args.json
                    else format_row(name, result)
                )
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def measure(name: str, config: SyntheticConfig) -> FusionResult:
    """Fuse the whole sequence and extract the surface."""
    cv2.setNumThreads(1)
    make, has = CANDIDATES[name]
    _fuse(make(), islice(render_with_truth(config), 1))  # compiles the kernels
    before_mb = _private_memory_mb()
    volume = make()
    add_ms, fetch_s, points_m = _fuse(volume, render_with_truth(config))
    memory_mb = _private_memory_mb() - before_mb
    del volume
    off_mm = 1e3 * distances_m(points_m[:: 1 + len(points_m) // MAX_POINTS], make_solids(config))
    return FusionResult(
        add_ms=float(np.median(add_ms)),
        slowest_ms=max(add_ms),
        fetch_s=fetch_s,
        memory_mb=memory_mb,
        points=len(points_m),
        median_mm=float(np.median(off_mm)),
        p90_mm=float(np.percentile(off_mm, 90)),
        p99_mm=float(np.percentile(off_mm, 99)),
        has=has,
    )


def format_row(name: str, result: FusionResult) -> str:
    """Format a line of text."""
    return (
        f"{name:20}  {result.add_ms:6.1f} ms a frame, {result.slowest_ms:6.1f} the slowest, fetch "
        f"{result.fetch_s:5.2f} s  {result.memory_mb:6.0f} MB  {result.points:8d} points, off by "
        f"{result.median_mm:5.1f} (median) {result.p90_mm:5.1f} (90 %) {result.p99_mm:6.1f} mm "
        f"(99 %)  {result.has}"
    )


def _fuse(
    volume: FusionVolume, frames: Iterable[tuple[RgbdFrame, Array]]
) -> tuple[list[float], float, Array]:
    """Return milliseconds of each frame, seconds for the surface, and its points (N, 3)."""
    add_ms = []
    for frame, T_world_camera in frames:
        frame.depth_m  # noqa: B018 (derived before the clock starts)
        begin_s = time.thread_time()
        volume.add(frame, T_world_camera)
        add_ms.append(1e3 * (time.thread_time() - begin_s))
    begin_s = time.thread_time()
    points_m = volume.points_m()
    return add_ms, time.thread_time() - begin_s, points_m


def _private_memory_mb() -> float:
    """Memory of this process that is not shared with files."""
    status = Path("/proc/self/status").read_text()
    kilobytes = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    return float(kilobytes.split()[1]) / 1e3


if __name__ == "__main__":
    sys.exit(main())
