"""Rendered sequences of the virtual Kinect along recorded hand motions, and their realism."""

import argparse
import os
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import cv2
import numpy as np

from benchmarks.harness import PROCESSES, Variants, option
from benchmarks.realism import measure_realism
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, read_trajectory
from drivers.recording.frame_recorder import FrameRecorder
from drivers.synthetic.camera import make_synthetic_camera
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import ShutterTiming, SyntheticConfig
from drivers.synthetic.sensors import RenderedImages
from drivers.tum.writer import TumFolder
from vo_service.odometry.direct.motion import se3_exp

THREADS = 2
PREFETCH_COUNT = 6
T = TypeVar("T")
# What a folder has; a folder without this file is incomplete or not ours.
RECORD = "synthetic.txt"


def make_frame(
    config: SyntheticConfig, seq: int, stamp_s: float, images: RenderedImages
) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images; it arrives at its stamp."""
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=images.color_bgr,
        depth_raw=images.depth_raw,
        depth_factor=config.depth_factor,
        camera=config.camera,
        skew_s=config.timing.skew_s,
        readout_s=config.timing.readout_s,
    )


def prefetch(make: Callable[[int], T], count: int) -> Iterator[T]:
    """Yield `make` of 0 to `count` - 1 in order; threads make the next few ahead."""
    with ThreadPoolExecutor(THREADS) as pool:
        made = deque[Future[T]]()
        for number in range(count):
            made.append(pool.submit(make, number))
            if len(made) > PREFETCH_COUNT:
                yield made.popleft().result()
        yield from (future.result() for future in made)


class GivenPoses(CameraMotion):
    """A camera that is near one of the given poses (N, 4, 4) for each frame.

    Args:
        T_world_camera: The poses.
        rate_hz: Frames per second.
        velocities: (N, 6) twists of the camera in its own axes, m/s and rad/s; at rest if None.
    """

    def __init__(
        self, T_world_camera: Array, rate_hz: float, velocities: Array | None = None
    ) -> None:
        self._poses, self._rate_hz = T_world_camera, rate_hz
        self._velocities = np.zeros((len(T_world_camera), 6)) if velocities is None else velocities

    def poses(self, times_s: Array) -> Array:
        frames = np.clip(np.rint(times_s * self._rate_hz), 0, len(self._poses) - 1).astype(int)
        moved_s = times_s - frames / self._rate_hz
        motions = map(se3_exp, moved_s[:, None] * self._velocities[frames])
        return np.array([self._poses[n] @ T for n, T in zip(frames, motions, strict=True)])

    def clearance_points_m(self, times_s: Array) -> Array:
        return self._poses[:, :3, 3]


@dataclass(frozen=True)
class VirtualRecording:
    """What is rendered: the frames of the virtual Kinect. Subclasses change them.

    Attributes:
        config: Room, motion and sensor.
    """

    config: SyntheticConfig

    def measure(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame as it is recorded."""
        return frame

    def scale_truth(self, truth: Trajectory) -> Trajectory:
        """Return the true trajectory of the recording."""
        return truth


def render_all(
    folder: Path,
    sequences: Mapping[str, SyntheticConfig | VirtualRecording],
    processes: int = os.cpu_count() or 1,
) -> dict[str, Path]:
    """Render missing sequences and those of another configuration; return their folders by name.

    An interrupted sequence is rendered again the next time. The longest is the first.

    Raises:
        InputError: A folder has other contents, or a track cannot be used.
        UserFacingError: The disk is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    recordings = {
        folder / name: VirtualRecording(each) if isinstance(each, SyntheticConfig) else each
        for name, each in sequences.items()
    }
    missing = sorted(
        (item for item in recordings.items() if not is_complete(*item)),
        key=lambda item: -item[1].config.frame_count,
    )
    with ProcessPoolExecutor(
        processes, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    ) as pool:
        futures = {pool.submit(render, *item): item[0] for item in missing}
        try:
            for count, future in enumerate(as_completed(futures), 1):
                future.result()
                print(f"rendered {count} of {len(missing)}: {futures[future]}", file=sys.stderr)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return {name: folder / name for name in sequences}


def is_complete(folder: Path, recording: VirtualRecording) -> bool:
    """Whether a folder has the complete sequence."""
    record = folder / RECORD
    return record.is_file() and record.read_text() == f"{recording}\n"


def render(folder: Path, recording: VirtualRecording) -> None:
    """Render one sequence. Raises as `render_all`."""
    if folder.exists():
        if not (folder / RECORD).is_file():
            raise InputError(f"{folder}: was not written by this program; name another folder")
        shutil.rmtree(folder)
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    once = replace(recording.config, loop=False)
    with (
        TemporaryDirectory() as rendered,
        make_synthetic_camera(once, Path(rendered), threads=1) as camera,
    ):
        assert camera.ground_truth is not None
        truth = recording.scale_truth(camera.ground_truth)
        with FrameRecorder(TumFolder(part, ground_truth=truth)) as writer:
            for frame in camera:
                writer.write(recording.measure(frame))
    (part / RECORD).write_text(f"{recording}\n")
    part.rename(folder)


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


@option("tracks", type=Path, help="folder of trajectories")
@option("output", type=Path, help="folder of the sequences")
@option("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms")
@option("--timing", nargs="+", choices=TIMINGS, default=list(TIMINGS))
@option("--start", type=float, default=START_S, help="start in the track, seconds")
@option(
    "--seconds",
    type=float,
    default=DURATION_S,
    help="duration of each, if the track is long enough",
)
@PROCESSES
def render_tracks(args: argparse.Namespace) -> None:
    """Render virtual rooms along recorded hand motions, as TUM folders with exact ground truth.

    TRACKS is a folder of trajectories in TUM format, NAME-groundtruth.txt, such as those of the TUM
    RGB-D benchmark. Each becomes OUTPUT/NAME-roomSEED-TIMING, with a room for each seed. "ideal" is
    a global shutter; "rolling-12" has a readout of 20 ms and depth 12 ms after color. Otherwise the
    sensor is that of a Kinect. Complete sequences are not rendered again.
    """
    begin_s = time.monotonic()
    configs = make_configs(args.tracks, args.seeds, args.timing, args.start, args.seconds)
    render_all(args.output, configs, args.processes)
    print(f"{len(configs)} sequences in {args.output}, after {time.monotonic() - begin_s:.0f} s")


def make_configs(
    tracks: Path,
    seeds: Sequence[int],
    timings: Sequence[str],
    start_s: float = START_S,
    duration_s: float = DURATION_S,
) -> dict[str, SyntheticConfig]:
    """Make the configurations by name: `duration_s` of each track, or less if it is shorter.

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


VARIANTS: Variants = {
    "render": render_tracks,
    "realism": measure_realism,
}
