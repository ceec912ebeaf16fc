"""Renders virtual rooms along recorded hand motions, as TUM folders with exact ground truth.

    python -m benchmarks mocap_sequences TRACKS OUTPUT [--seeds 11 12] [--timing ideal rolling-12]

TRACKS is a folder of trajectories in TUM format, NAME-groundtruth.txt, such as those of the TUM
RGB-D benchmark. Each becomes OUTPUT/NAME-roomSEED-TIMING, with a room for each seed. "ideal" is a
global shutter; "rolling-12" has a readout of 20 ms and depth 12 ms after color. Otherwise the
sensor is that of a Kinect. Complete sequences are not rendered again.
"""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.rendered_sequences import render_all
from drivers.core.errors import InputError
from drivers.core.geometry import read_trajectory
from drivers.synthetic import ShutterTiming, SyntheticConfig

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
