"""Which frames become keyframes, and the odometry between two of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.slam.mapper.wall_sequence import make_wall_update
from vo_service.slam.keyframe_selection import (
    STEP_M,
    STEP_RAD,
    ConstraintAccumulator,
    KeyframeSelector,
    NullConstraintAccumulator,
    OdometryConstraint,
    pose_distance_steps,
)
from vo_service.types.odometry_update import TrackingState


def turned(angle_rad: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return rigid_transform(so3_exp(np.array([0.0, angle_rad, 0.0])), np.zeros(3))


def test_a_frame_is_selected_when_the_camera_has_moved_a_step() -> None:
    selector = KeyframeSelector()
    accepted = [selector.accepts(make_wall_update(seq, 0.06 * seq)) for seq in range(7)]
    assert accepted == [True, False, False, True, False, False, True]


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


def constraints_at(
    *xs_m: float, accumulator: ConstraintAccumulator | None = None, epoch: int = 0
) -> list[OdometryConstraint | None]:
    """Constraints of frames along the wall at 30 Hz."""
    accumulator = accumulator or ConstraintAccumulator()
    return [
        accumulator.update(make_wall_update(seq, x_m, epoch=epoch)) for seq, x_m in enumerate(xs_m)
    ]


def test_a_keyframe_is_thirty_centimeters_from_the_last() -> None:
    found = constraints_at(0.0, 0.1, 0.2, 0.29, 0.31, 0.4)
    assert [n for n, constraint in enumerate(found) if constraint is not None] == [0, 4]


def test_a_constraint_has_its_length_velocity_and_covariance() -> None:
    first, *_, last = constraints_at(0.0, 0.1, 0.2, 0.31)
    assert first is not None
    assert last is not None
    assert first.length_m == 0.0
    assert np.isclose(last.length_m, 0.31)
    assert np.allclose(last.velocity, [0.11 * 30, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    assert np.trace(last.covariance) > np.trace(first.covariance)


def test_a_constraint_starts_at_the_last_keyframe() -> None:
    _, *found = filter(None, constraints_at(0.0, 0.1, 0.2, 0.31, 0.41, 0.51, 0.62))
    first, second = found
    assert np.isclose(second.length_m, first.length_m)
    assert np.allclose(second.covariance, first.covariance)


def test_a_rotating_camera_has_an_angular_velocity() -> None:
    turn_rad = np.array([0.01, 0.4, -0.02])
    turned = rigid_transform(so3_exp(turn_rad), np.zeros(3))
    accumulator = ConstraintAccumulator()
    accumulator.update(make_wall_update(0))
    constraint = accumulator.update(replace(make_wall_update(1), T_world_camera=turned))
    assert constraint is not None
    assert np.allclose(constraint.velocity, [0.0, 0.0, 0.0, *(30 * turn_rad)])


def test_after_a_gap_the_velocity_is_unknown() -> None:
    accumulator = ConstraintAccumulator()
    accumulator.update(make_wall_update(0))
    for seq in range(1, 9):  # no pose to go by: the last one is held
        assert accumulator.update(make_wall_update(seq, state=TrackingState.LOST)) is None
    constraint = accumulator.update(make_wall_update(9, 0.4))
    assert constraint is not None
    assert not constraint.velocity.any()
    assert np.isclose(constraint.length_m, 0.4)


def test_a_new_epoch_starts_a_new_constraint() -> None:
    accumulator = ConstraintAccumulator()
    (very_first, _) = constraints_at(0.0, 0.1, accumulator=accumulator)
    (first,) = constraints_at(5.0, accumulator=accumulator, epoch=1)
    assert very_first is not None
    assert first is not None
    assert first.length_m == 0.0
    assert np.array_equal(first.covariance, very_first.covariance)
    assert not first.velocity.any()


def test_untracked_frames_are_no_keyframes() -> None:
    assert ConstraintAccumulator().update(make_wall_update(0, state=TrackingState.DEGRADED)) is None
    assert ConstraintAccumulator().update(make_wall_update(0, state=TrackingState.LOST)) is None
    NullConstraintAccumulator().force_keyframe()
    assert constraints_at(0.0)[0] is not None


def test_after_a_reset_the_next_frame_is_a_keyframe() -> None:
    accumulator = ConstraintAccumulator()
    assert constraints_at(0.0, 0.0, accumulator=accumulator)[1] is None
    accumulator.force_keyframe()
    assert constraints_at(0.0, accumulator=accumulator)[0] is not None
