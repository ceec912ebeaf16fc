"""Whether a Kinect that is unplugged and plugged in again and again leaves something behind.

    python -m benchmarks.sensor_leaks [--cycles 200]

The real libfreenect and pyusb on a played Kinect, in a driver's process of their own. What both
processes hold, and what is open at the Kinect, is to be the same after all times as after the first
one; the driver's memory may grow a little at first, as caches fill.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.drivers.freenect.replugging import (
    HeldResources,
    count_resources,
    kinect_in_subprocess,
    replug,
)
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, write_usb_frames

# The images of one time alone would be 12 MB.
MAX_GROWTH_KB = 10_000


def main() -> int:
    """Run and print; 1 if something has leaked."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensor_leaks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cycles", type=int, default=200, help="how often it is unplugged")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        film = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), film, registration=IDENTITY) as kinect:
            kinect.activate()
            kinect.start_delay_s = 0.0
            is_good = measure(kinect, args.cycles)
    print("nothing has leaked" if is_good else "something has LEAKED")
    return 0 if is_good else 1


def measure(kinect: KinectSimulator, cycles: int) -> bool:
    """Print what is held; whether it is the same."""
    begin_s = time.monotonic()
    first, last = measure_growth(kinect, cycles)
    print(f"{cycles} times in {time.monotonic() - begin_s:.0f} s")
    for name, each in (("first", first), ("last", last)):
        handles, abandoned = each.kinect
        print(
            f"{name:6} reader {dict(each.here)}, driver {dict(each.driver)}, "
            f"{each.memory_kb / 1e3:.1f} MB; {handles} handles, {abandoned} transfers abandoned"
        )
    is_same = (first.here, first.driver, first.kinect) == (last.here, last.driver, last.kinect)
    is_small = last.memory_kb - first.memory_kb <= MAX_GROWTH_KB
    return is_same and is_small and (kinect.open_handles, kinect.submitted_transfers) == (0, (0, 0))


def measure_growth(kinect: KinectSimulator, cycles: int) -> tuple[HeldResources, HeldResources]:
    """What is held when it streams for the second time, and after `cycles` times."""
    with kinect_in_subprocess() as camera:
        camera.read(30.0)
        replug(camera, kinect)
        first = count_resources(kinect)
        for _ in range(cycles):
            replug(camera, kinect)
        return first, count_resources(kinect)


if __name__ == "__main__":
    sys.exit(main())
