"""Sequence numbers and stamps across restarts, and the delays between retries."""

from dataclasses import replace
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Clock, PlaybackMode
from drivers.core.rate_limits import ExponentialBackoff
from drivers.subprocess_camera.messages import Timeouts
from drivers.subprocess_camera.sequencing import make_sequencer
from tests.drivers.subprocess_camera.scripted_cameras import make_pattern_frame

FRAME = make_pattern_frame(0, 0.0)
LIVE = Clock.MONOTONIC, PlaybackMode.REALTIME


@given(st.lists(st.tuples(st.integers(0, 50), st.floats(0.0, 100.0))))
def test_numbers_and_stamps_of_a_live_camera_always_increase(
    given_frames: list[tuple[int, float]],
) -> None:
    sequencer = make_sequencer(*LIVE)
    results = [sequencer(replace(FRAME, seq=seq, stamp_s=stamp_s)) for seq, stamp_s in given_frames]
    delivered = [frame for frame in results if frame is not None]
    assert all(a.seq < b.seq and a.stamp_s < b.stamp_s for a, b in pairwise(delivered))
    assert {frame.stamp_s for frame in delivered} <= {stamp_s for _, stamp_s in given_frames}


def test_gaps_are_kept_and_a_restarted_count_continues_from_the_last_number() -> None:
    sequencer = make_sequencer(*LIVE)
    seqs = [4, 5, 9, 0, 1, 5, 0]
    results = [sequencer(replace(FRAME, seq=seq, stamp_s=float(k))) for k, seq in enumerate(seqs)]
    assert [frame and frame.seq for frame in results] == [4, 5, 9, 10, 11, 15, 16]


def test_a_recording_keeps_its_numbers_and_stamps() -> None:
    for playback_mode in PlaybackMode:
        sequencer = make_sequencer(Clock.RECORDED, playback_mode)
        for seq, stamp_s in ((7, 3.0), (2, 1.0)):
            frame = sequencer(replace(FRAME, seq=seq, stamp_s=stamp_s))
            assert frame is not None
            assert (frame.seq, frame.stamp_s) == (seq, stamp_s)


def test_retry_delays_grow_to_their_limit_and_restart_after_success() -> None:
    back_off = ExponentialBackoff(Timeouts().initial_retry_s, Timeouts().max_retry_s)
    assert [back_off.next_s() for _ in range(6)] == [0.2, 0.4, 0.8, 1.5, 1.5, 1.5]
    back_off.reset()
    assert back_off.next_s() == 0.2
