"""CPU time of the Kinect's driver, against a bare loop around libfreenect that copies each image.

    python -m benchmarks.freenect_cost [--seconds 10] [--rounds 3]

All three ways run on the same played Kinect (which plays the USB in the same process, and costs
the same each time), one after another in processes of their own, after two seconds of warming up.
`isolated` counts the driver's process alone, with the ring that it puts frames into.
The ratio is to be at most 1.5.
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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.freenect_cost",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="how long each way runs")
    parser.add_argument("--rounds", type=int, default=3, help="how often; the median counts")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        film = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), film, registration=IDENTITY) as kinect:
            percent: dict[str, list[float]] = {way: [] for way in VARIANTS}
            for _ in range(args.rounds):
                for way, measured in percent.items():
                    measured.append(_measure_percent(way, args.seconds, kinect))
    bare = median(percent["bare"])
    print("way          % of a core   ratio")
    for way, measured in percent.items():
        print(f"{way:12} {median(measured):11.2f} {median(measured) / bare:7.2f}")


def _measure_percent(variant: str, seconds: float, kinect: KinectSimulator) -> float:
    """Share of one core that the driver uses."""
    command = [sys.executable, "-m", "benchmarks.freenect_variants", variant, str(seconds)]
    environment = os.environ | kinect.environment
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return float(run.stdout)


if __name__ == "__main__":
    main()
