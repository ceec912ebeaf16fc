"""Accuracy of `calibrate --timing` on virtual rooms along recorded hand motions.

    python -m benchmarks timing_calibration TRACKS OUTPUT [--only NAME ...]

TRACKS is a folder of trajectories in TUM format, NAME-groundtruth.txt, of the TUM RGB-D benchmark's
freiburg1 desk, rpy and xyz. The sequences are rendered into OUTPUT; complete ones are not rendered
again. Their stamps say that depth was taken with color, so the whole skew must be estimated. It
prints a table; "late" is how much later than color depth was taken.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.rendered_sequences import render_all
from benchmarks.tracking import read_all_frames
from drivers.recording_camera import RecordingCamera
from drivers.synthetic import MotionKind, ShutterTiming, SyntheticConfig
from vo_service.tools.calibration.timing_measurement import TimingMeasurement

ROW = "| {:<10} | {:>11} | {:>14} | {:>8} | {:>14} | {:>7} |"


@dataclass(frozen=True)
class TimingCase:
    """A sequence along a track or with a virtual motion; its seed and length."""

    readout_ms: float
    skew_ms: float
    seed: int
    track: str = ""
    start_s: float = 0.0
    motion: MotionKind = MotionKind.HAND_HELD
    duration_s: float = 20.0

    def config(self, tracks: Path) -> SyntheticConfig:
        """Make the configuration of the virtual Kinect, with all sensor faults."""
        file = (tracks / f"{self.track}-groundtruth.txt").resolve()
        return SyntheticConfig(
            seed=self.seed,
            duration_s=self.duration_s,
            track=file if self.track else None,
            track_start_s=self.start_s,
            motion=self.motion,
            timing=ShutterTiming(self.readout_ms / 1e3, self.skew_ms / 1e3),
        )


CASES = {
    "desk": TimingCase(10.0, -8.0, 21, "fr1_desk", 2.0),
    "desk-2": TimingCase(15.0, 5.0, 22, "fr1_desk", 2.0),
    "desk-3": TimingCase(30.0, 12.0, 24, "fr1_desk", 2.0),
    "rpy": TimingCase(25.0, 0.0, 23, "fr1_rpy", 4.0),
    "rpy-2": TimingCase(20.0, 10.0, 27, "fr1_rpy", 4.0),
    "xyz": TimingCase(0.0, 0.0, 25, "fr1_xyz", 4.0),
    "hand-held": TimingCase(20.0, 10.0, 26),
    "slow": TimingCase(20.0, 10.0, 28, motion=MotionKind.SMOOTH, duration_s=8.0),
    "still": TimingCase(20.0, 10.0, 29, motion=MotionKind.STILL, duration_s=10.0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("tracks", type=Path, help="folder of trajectories")
    parser.add_argument("output", type=Path, help="folder of the sequences")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)


def main(args: argparse.Namespace) -> None:
    """Render, measure and print."""
    args.output.mkdir(parents=True, exist_ok=True)
    sequences = {args.output / name: CASES[name].config(args.tracks) for name in args.only}
    render_all(sequences, lambda line: print(line, file=sys.stderr), args.processes)
    print(ROW.format("sequence", "readout, ms", "estimate", "late, ms", "estimate", "CPU, s"))
    print("|---|---|---|---|---|---|")
    for name in args.only:
        print(_row(name, CASES[name], args.output / name), flush=True)


def _row(name: str, case: TimingCase, folder: Path) -> str:
    begin_s = time.process_time()
    measurement = TimingMeasurement()
    with RecordingCamera(folder) as camera:
        for frame in read_all_frames(camera):
            measurement.process(replace(frame, skew_s=0.0))
    readout, late = (str(value).removesuffix(" ms") for value in measurement.timing.values())
    spent_s = time.process_time() - begin_s
    return ROW.format(
        name, f"{case.readout_ms:g}", readout, f"{case.skew_ms:g}", late, f"{spent_s:.0f}"
    )
