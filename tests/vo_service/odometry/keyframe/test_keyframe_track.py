"""What is remembered of the keyframe that is followed."""

from dataclasses import replace

import numpy as np

from tests.vo_service.odometry.keyframe.found_motions import KEYFRAME, WAY, found_at
from vo_service.odometry.directions import Directions
from vo_service.odometry.keyframe.certainty import Certainty
from vo_service.odometry.keyframe_odometry import Track

FOUND = found_at(np.zeros(6), np.zeros(6))
SURE = Certainty(np.eye(6), Directions(np.arange(4.0, 10.0), np.eye(6)))


def test_the_clarity_at_first_is_that_of_the_keyframes_first_view() -> None:
    track = Track(KEYFRAME, WAY, np.eye(4))
    assert track.clarity_at_first(FOUND, SURE) == SURE.clarity == 4.0
    assert replace(track, clarity=9.0).clarity_at_first(FOUND, SURE) == 9.0


def test_a_keyframe_that_was_found_again_is_seen_for_the_first_time() -> None:
    track = Track(replace(KEYFRAME), WAY, np.eye(4), clarity=9.0)
    assert track.clarity_at_first(FOUND, SURE) == SURE.clarity
