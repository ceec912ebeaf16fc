"""Renders virtual rooms along recorded hand motions, as TUM folders with exact ground truth.

    python -m benchmarks rendered_sequences TRACKS OUTPUT [--seeds 11 12] [--timing ideal]

TRACKS is a folder of trajectories in TUM format, NAME-groundtruth.txt, such as those of the TUM
RGB-D benchmark. Each becomes OUTPUT/NAME-roomSEED-TIMING, with a room for each seed. "ideal" is a
global shutter; "rolling-12" has a readout of 20 ms and depth 12 ms after color. Otherwise the
sensor is that of a Kinect. Complete sequences are not rendered again.
"""

import argparse
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.rendered_views import THREADS, make_frame, prefetch
from benchmarks.tracking import read_all_frames
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import read_trajectory
from drivers.synthetic import MotionKind, ShutterTiming, SyntheticConfig
from drivers.synthetic.camera import RenderOptions, SyntheticCamera
from drivers.synthetic.renderer import NoiselessFrame, Renderer, make_renderer
from drivers.synthetic.sensors import gain_at
from drivers.tum.writer import TumWriter

# The configuration of a folder; a folder without this file is incomplete or not ours.
CONFIG_RECORD = "synthetic.txt"
# Period of the exposure's hunting.
PERIOD_S = 20.0
# Size of the pool of noise; random offsets make all frames differ.
POOL_SIZE = 1 << 24


def render_all(
    sequences: Mapping[Path, SyntheticConfig], print_line: Callable[[str], None], processes: int
) -> None:
    """Render missing sequences and those of another configuration.

    An interrupted sequence is rendered again the next time.

    Args:
        sequences: The configuration of each folder.
        print_line: Prints progress.
        processes: Rendering processes.

    Raises:
        InputError: A folder has other contents, or a track cannot be used.
        UserFacingError: The disk is full.
    """
    missing = {
        folder: config for folder, config in sequences.items() if not is_complete(folder, config)
    }
    if not missing:
        return
    spawn = get_context("spawn")
    with ProcessPoolExecutor(
        processes, spawn, initializer=cv2.setNumThreads, initargs=(1,)
    ) as pool:
        futures = {
            pool.submit(render, folder, config): folder for folder, config in missing.items()
        }
        try:
            for count, future in enumerate(as_completed(futures), 1):
                future.result()
                print_line(f"rendered {count} of {len(missing)}: {futures[future]}")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def is_complete(folder: Path, config: SyntheticConfig) -> bool:
    """Whether a folder has the complete sequence of this configuration."""
    record = folder / CONFIG_RECORD
    return record.is_file() and record.read_text() == f"{config}\n"


def render(folder: Path, config: SyntheticConfig) -> None:
    """Render one sequence. Raises as `render_all`."""
    if folder.exists():
        if not (folder / CONFIG_RECORD).is_file():
            raise InputError(f"{folder}: was not written by this program; name another folder")
        shutil.rmtree(folder)
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    once = replace(config, loop=False)
    with SyntheticCamera(once, PlaybackMode.LOCKSTEP, RenderOptions(threads=1)) as camera:
        _write(camera, part)
    (part / CONFIG_RECORD).write_text(f"{config}\n")
    part.rename(folder)


def _write(camera: SyntheticCamera, folder: Path) -> None:
    with TumWriter(folder, ground_truth=camera.ground_truth) as writer:
        for frame in read_all_frames(camera):
            writer.write(frame)


class PooledNoise(np.random.Generator):
    """Normal noise from random offsets in a pool that is drawn once; three times as fast."""

    def __init__(self, pool: NDArray[np.float32], seed: list[int]) -> None:
        super().__init__(np.random.PCG64(seed))
        self._pool = pool

    def standard_normal(  # type: ignore[override]
        self, size: tuple[int, ...], dtype: Any = np.float32
    ) -> NDArray[np.float32]:
        """As of any generator, but always float32 and read-only."""
        count = int(np.prod(size))
        start = int(self.integers(len(self._pool) - count))
        return self._pool[start : start + count].reshape(size)


@dataclass(frozen=True)
class StaticView:
    """The view of a stationary virtual Kinect, with fresh noise and exposure in each frame."""

    config: SyntheticConfig
    renderer: Renderer
    noiseless: NoiselessFrame
    pool: NDArray[np.float32]

    @classmethod
    def render(cls, config: SyntheticConfig) -> "StaticView":
        """Render the first frame of `config` without noise."""
        still = replace(config, motion=MotionKind.STILL, duration_s=PERIOD_S)
        renderer = make_renderer(still, THREADS)
        pool = np.random.default_rng([config.seed, 8]).standard_normal(POOL_SIZE, dtype=np.float32)
        pool.flags.writeable = False
        return cls(still, renderer, renderer.render_noiseless(0), pool)

    def frame(self, seq: int) -> RgbdFrame:
        """Make frame `seq`; its bytes are the same in every run."""
        config, stamp_s = self.config, seq / self.config.rate_hz
        sight = replace(self.noiseless, gain=gain_at(config.color, stamp_s, PERIOD_S))
        images = self.renderer.apply_sensor_noise(
            sight, PooledNoise(self.pool, [config.seed, 9, seq])
        )
        return make_frame(config, seq, stamp_s, images)

    def frames(self, count: int) -> Iterator[RgbdFrame]:
        """Yield the first `count` frames; a few are made ahead."""
        return prefetch(self.frame, count)


TRACK_SUFFIX = "-groundtruth.txt"
SEEDS = (11, 12, 13)
TIMINGS = {
    "ideal": ShutterTiming(0.0, 0.0),
    "rolling--12": ShutterTiming(0.020, -0.012),
    "rolling-0": ShutterTiming(0.020, 0.0),
    "rolling-12": ShutterTiming(0.020, 0.012),
}
# From there on freiburg1's xyz, rpy and desk all move fast.
START_S, DURATION_S = 12.0, 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("tracks", type=Path, help="folder of trajectories")
    parser.add_argument("output", type=Path, help="folder of the sequences")
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms")
    parser.add_argument("--timing", nargs="+", choices=TIMINGS, default=list(TIMINGS))
    parser.add_argument("--start", type=float, default=START_S, help="start in the track, seconds")
    parser.add_argument(
        "--seconds",
        type=float,
        default=DURATION_S,
        help="duration of each, if the track is long enough",
    )
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)


def main(args: argparse.Namespace) -> None:
    """Render."""
    begin_s = time.monotonic()
    configs = make_configs(args.tracks, args.seeds, args.timing, args.start, args.seconds)
    sequences = {args.output / name: config for name, config in configs.items()}
    args.output.mkdir(parents=True, exist_ok=True)
    render_all(sequences, lambda line: print(line, flush=True), args.processes)
    print(f"{len(sequences)} sequences in {args.output}, after {time.monotonic() - begin_s:.0f} s")


def make_configs(
    tracks: Path,
    seeds: Sequence[int],
    timings: Sequence[str],
    start_s: float = START_S,
    duration_s: float = DURATION_S,
) -> dict[str, SyntheticConfig]:
    """Make the configurations by name: `duration_s` of each track, or less if it is shorter.

    Args:
        tracks: Folder of the trajectories.
        seeds: Seeds of the rooms.
        timings: Names of the timings.
        start_s: Start in each track, s.
        duration_s: Length, s.

    Raises:
        InputError: There are no tracks, one is broken, or one ends before `start_s`.
    """
    files = sorted(tracks.glob(f"*{TRACK_SUFFIX}"))
    if not files:
        raise InputError(f"{tracks}: has no *{TRACK_SUFFIX}; name a folder of TUM trajectories")
    return {
        f"{file.name.removesuffix(TRACK_SUFFIX)}-room{seed}-{timing}": SyntheticConfig(
            seed=seed,
            track=file.resolve(),
            track_start_s=start_s,
            duration_s=min(duration_s, _remaining_s(file, start_s)),
            timing=TIMINGS[timing],
        )
        for file in files
        for seed in seeds
        for timing in timings
    }


def _remaining_s(track: Path, start_s: float) -> float:
    stamps_s = read_trajectory(track).stamps_s
    length_s = float(stamps_s[-1] - stamps_s[0])
    if length_s <= start_s:
        raise InputError(f"{track}: ends after {length_s:g} s; start earlier than at {start_s:g} s")
    return length_s - start_s
