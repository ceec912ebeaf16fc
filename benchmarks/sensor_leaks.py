"""Resource leaks when a Kinect is unplugged and plugged in many times.

    python -m benchmarks.sensor_leaks [--cycles 200]

The real libfreenect and pyusb use a simulated Kinect in a driver's process. The resources of both
processes and the open handles of the Kinect must be the same after all cycles as after the first.
The driver's memory may grow a little at first, as caches fill.
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

# A leak of the images of one cycle would be 12 MB.
MAX_GROWTH_KB = 10_000


def main() -> int:
    """Run and print; return 1 if something leaks."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensor_leaks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cycles", type=int, default=200, help="number of times it is unplugged")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        frames = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), frames, registration=IDENTITY) as kinect:
            kinect.activate()
            kinect.start_delay_s = 0.0
            is_good = measure(kinect, args.cycles)
    print("no leaks" if is_good else "LEAKS")
    return 0 if is_good else 1


def measure(kinect: KinectSimulator, cycles: int) -> bool:
    """Print the resources; return whether they are the same after all cycles."""
    begin_s = time.monotonic()
    first, last = measure_growth(kinect, cycles)
    print(f"{cycles} cycles in {time.monotonic() - begin_s:.0f} s")
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
    """Return the resources when it streams for the second time, and after `cycles` times."""
    with kinect_in_subprocess() as camera:
        camera.read(30.0)
        replug(camera, kinect)
        first = count_resources(kinect)
        for _ in range(cycles):
            replug(camera, kinect)
        return first, count_resources(kinect)


if __name__ == "__main__":
    sys.exit(main())
