"""CPU time of the Kinect driver, compared with a bare libfreenect loop that copies each image.

    python -m benchmarks freenect_cost [--seconds 10] [--rounds 3]

All three variants run on the same simulated Kinect, one after another in separate processes, after
two seconds of warm-up. The simulator runs in the same process and costs the same each time.
`isolated` counts only the driver's process, with its frame ring. The ratio should be at most 1.5.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.freenect_variants import VARIANTS
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, write_usb_frames


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each variant")
    parser.add_argument(
        "--rounds", type=int, default=3, help="runs of each variant; the median counts"
    )


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        frames = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), frames, registration=IDENTITY) as kinect:
            percent: dict[str, list[float]] = {variant: [] for variant in VARIANTS}
            for _ in range(args.rounds):
                for variant, measured in percent.items():
                    measured.append(_measure_percent(variant, args.seconds, kinect))
    bare = median(percent["bare"])
    print("variant      % of a core   ratio")
    for variant, measured in percent.items():
        print(f"{variant:12} {median(measured):11.2f} {median(measured) / bare:7.2f}")


def _measure_percent(variant: str, seconds: float, kinect: KinectSimulator) -> float:
    """Measure the share of one core that the driver uses."""
    command = [sys.executable, "-m", "benchmarks.freenect_variants", variant, str(seconds)]
    environment = os.environ | kinect.environment
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return float(run.stdout)
