"""The frame timing and the clock of a simulated Kinect."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.simulators.fixtures import FRAME_COUNT, SimulateKinect, pattern_frame
from tests.simulators.freenect_probe import FreenectProbe, capture_kinect
from tests.simulators.kinect_simulator import LoopMode
from tests.simulators.raw_depth import mm_to_raw
from tests.simulators.usb_frames import write_usb_frames

pytestmark = pytest.mark.usefixtures("real_libfreenect")
TICKS_A_FRAME = 2_000_000


def test_its_clock_restarts_when_it_is_plugged_in(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.start_ticks = 5000
    capture_kinect(kinect, frames=4)
    kinect.unplug()
    kinect.plug()
    assert capture_kinect(kinect, frames=1).depth.stamps[0] == 5000


def test_its_clock_goes_on_when_streams_are_restarted(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    before = capture_kinect(kinect, frames=4).depth.stamps[-1]
    after = capture_kinect(kinect, frames=1).depth.stamps[0]
    assert after > before
    assert (after - before) % TICKS_A_FRAME == 0


def test_a_slower_rate_has_longer_frames(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.rate = 15
    probe = capture_kinect(kinect, frames=3)
    assert probe.depth.stamps[1] - probe.depth.stamps[0] == 2 * TICKS_A_FRAME


@pytest.mark.parametrize(
    ("loop", "shown"),
    [(LoopMode.REPEAT, [0, 1, 0, 1, 0]), (LoopMode.THERE_AND_BACK, [0, 1, 1, 0, 0])],
)
def test_frames_are_looped(
    simulate_kinect: SimulateKinect, tmp_path: Path, loop: LoopMode, shown: list[int]
) -> None:
    frames = write_usb_frames(tmp_path, [pattern_frame(0), pattern_frame(1)])
    kinect = simulate_kinect(frames)
    kinect.loop = loop
    images = capture_kinect(kinect, frames=5).depth.images
    expected = [mm_to_raw(pattern_frame(seq)[1]) for seq in shown]
    assert all(np.array_equal(*pair) for pair in zip(images, expected, strict=False))


def test_frames_that_are_played_once_end(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.loop = LoopMode.ONCE
    kinect.activate()
    with FreenectProbe() as probe:
        probe.start()
        probe.capture(FRAME_COUNT)
        probe.capture(FRAME_COUNT + 1, limit_s=0.1)
    assert len(probe.depth.stamps) == len(probe.video.stamps) == FRAME_COUNT
    assert kinect.frames_sent == (FRAME_COUNT, FRAME_COUNT)


def test_after_a_rewind_it_restarts(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    capture_kinect(kinect, frames=3)
    kinect.rewind()
    probe = capture_kinect(kinect, frames=1)
    assert np.array_equal(probe.depth.images[0], mm_to_raw(pattern_frame(0)[1]))


def test_a_program_that_is_late_loses_packets(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.waits_for_reader = False
    kinect.activate()
    with FreenectProbe() as probe:
        probe.start()
        probe.capture(3)
        time.sleep(0.1)  # three frames late on the bus
        probe.capture(6)
    assert any("Lost" in line for line in probe.log)


def test_the_bus_may_wait_for_a_program_that_is_late(simulate_kinect: SimulateKinect) -> None:
    simulate_kinect().activate()
    with FreenectProbe() as probe:
        probe.start()
        probe.capture(3)
        time.sleep(0.2)  # late on the bus; there is no event to wait for
        probe.capture(9)
    assert probe.depth.stamps[:9] == [TICKS_A_FRAME * seq for seq in range(9)]
