"""When a played Kinect shows which frame, and what its clock says."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.stand_ins.depth_scale import raw_of_mm
from tests.stand_ins.fixtures import FILM_FRAMES, PlayKinect, pattern
from tests.stand_ins.freenect_probe import FreenectProbe, watch_kinect
from tests.stand_ins.played_kinect import Loop
from tests.stand_ins.wire_film import wire_film

pytestmark = pytest.mark.usefixtures("real_libfreenect")
TICKS_A_FRAME = 2_000_000


def test_stamps_count_on_across_the_end_of_their_32_bits(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.start_ticks = 2**32 - 3 * TICKS_A_FRAME
    probe = watch_kinect(kinect, frames=6)
    for seen in (probe.depth, probe.video):
        unwrapped = [(stamp - kinect.start_ticks) % 2**32 for stamp in seen.stamps]
        assert unwrapped == [TICKS_A_FRAME * seq for seq in range(len(unwrapped))]
    assert min(probe.depth.stamps) < TICKS_A_FRAME


def test_colour_may_come_later_and_says_so(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.colour_offset_s = 0.010
    probe = watch_kinect(kinect, frames=3)
    assert probe.video.stamps[0] - probe.depth.stamps[0] == 600_000


def test_its_clock_begins_anew_when_it_is_plugged_in(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.start_ticks = 5000
    watch_kinect(kinect, frames=4)
    kinect.unplug()
    kinect.plug()
    assert watch_kinect(kinect, frames=1).depth.stamps[0] == 5000


def test_its_clock_goes_on_when_streams_are_restarted(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    before = watch_kinect(kinect, frames=4).depth.stamps[-1]
    after = watch_kinect(kinect, frames=1).depth.stamps[0]
    assert after > before
    assert (after - before) % TICKS_A_FRAME == 0


def test_its_clock_may_run_fast(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.clock_error_ppm = 1000
    probe = watch_kinect(kinect, frames=6)
    assert probe.depth.stamps[5] - probe.depth.stamps[0] == 5 * 2_002_000


def test_a_slower_rate_has_longer_frames(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.rate = 15
    probe = watch_kinect(kinect, frames=3)
    assert probe.depth.stamps[1] - probe.depth.stamps[0] == 2 * TICKS_A_FRAME


@pytest.mark.parametrize(
    ("loop", "shown"),
    [(Loop.AROUND, [0, 1, 0, 1, 0]), (Loop.THERE_AND_BACK, [0, 1, 1, 0, 0])],
)
def test_a_film_is_looped(
    play_kinect: PlayKinect, tmp_path: Path, loop: Loop, shown: list[int]
) -> None:
    film = wire_film(tmp_path, [pattern(0), pattern(1)])
    kinect = play_kinect(film)
    kinect.loop = loop
    images = watch_kinect(kinect, frames=5).depth.images
    expected = [raw_of_mm(pattern(seq)[1]) for seq in shown]
    assert all(np.array_equal(*pair) for pair in zip(images, expected, strict=False))


def test_a_film_that_is_shown_once_ends(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.loop = Loop.ONCE
    kinect.load()
    with FreenectProbe() as probe:
        probe.start()
        probe.watch(FILM_FRAMES)
        probe.watch(FILM_FRAMES + 1, limit_s=0.1)
    assert len(probe.depth.stamps) == len(probe.video.stamps) == FILM_FRAMES
    assert kinect.frames_sent == (FILM_FRAMES, FILM_FRAMES)


def test_after_a_rewind_it_begins_anew(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    watch_kinect(kinect, frames=3)
    kinect.rewind()
    probe = watch_kinect(kinect, frames=1)
    assert np.array_equal(probe.depth.images[0], raw_of_mm(pattern(0)[1]))


def test_a_program_that_is_late_loses_packets(play_kinect: PlayKinect) -> None:
    kinect = play_kinect()
    kinect.patient = False
    kinect.load()
    with FreenectProbe() as probe:
        probe.start()
        probe.watch(3)
        time.sleep(0.1)  # three frames late by the bus's own clock
        probe.watch(6)
    assert any("Lost" in line for line in probe.log)


def test_the_bus_may_wait_for_a_program_that_is_late(play_kinect: PlayKinect) -> None:
    play_kinect().load()
    with FreenectProbe() as probe:
        probe.start()
        probe.watch(3)
        time.sleep(0.2)  # late by the bus's own clock: nothing tells that it waits
        probe.watch(9)
    assert probe.depth.stamps[:9] == [TICKS_A_FRAME * seq for seq in range(9)]
