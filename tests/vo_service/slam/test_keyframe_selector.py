"""Keyframe selection."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.slam.mapper.wall_sequence import make_wall_update
from vo_service.slam.keyframe_selector import (
    STEP_M,
    STEP_RAD,
    KeyframeSelector,
    pose_distance_steps,
)
from vo_service.types import TrackingState


def turned(angle_rad: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return rigid_transform(so3_exp(np.array([0.0, angle_rad, 0.0])), np.zeros(3))


def test_a_frame_is_selected_when_the_camera_has_moved_a_step() -> None:
    selector = KeyframeSelector()
    accepted = [selector.accepts(make_wall_update(seq, 0.06 * seq)) for seq in range(7)]
    assert accepted == [True, False, False, True, False, False, True]


def test_a_rotation_counts_like_a_translation() -> None:
    selector = KeyframeSelector()
    assert selector.accepts(make_wall_update(0))
    assert not selector.accepts(
        replace(make_wall_update(1), T_world_camera=turned(math.radians(9.0)))
    )
    assert selector.accepts(replace(make_wall_update(2), T_world_camera=turned(math.radians(11.0))))


@pytest.mark.parametrize("state", [TrackingState.LOST, TrackingState.DEGRADED])
def test_a_pose_that_is_not_tracking_is_not_selected(state: TrackingState) -> None:
    selector = KeyframeSelector()
    assert not selector.accepts(make_wall_update(0, state=state))
    assert selector.accepts(make_wall_update(1))


def test_the_first_good_frame_of_an_epoch_is_selected() -> None:
    selector = KeyframeSelector()
    assert selector.accepts(make_wall_update(0))
    assert not selector.accepts(make_wall_update(1, epoch=1, state=TrackingState.LOST))
    assert selector.accepts(make_wall_update(2, epoch=1))


def test_after_a_removal_the_place_is_selected_again() -> None:
    selector = KeyframeSelector()
    assert selector.accepts(make_wall_update(0))
    selector.reset()
    assert selector.accepts(make_wall_update(1))


@given(st.floats(0.0, 5.0), st.floats(0.0, 3.0))
def test_steps_are_the_larger_of_distance_and_rotation(path_m: float, angle_rad: float) -> None:
    there = turned(angle_rad)
    there[0, 3] = path_m
    expected = max(path_m / STEP_M, angle_rad / STEP_RAD)
    assert pose_distance_steps(np.eye(4), there) == pytest.approx(expected, abs=1e-6)
