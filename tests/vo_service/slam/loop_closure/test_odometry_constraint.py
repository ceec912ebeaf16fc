"""Odometry constraints between keyframes."""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.slam.mapper.wall_sequence import make_wall_update
from vo_service.slam.loop_closure.odometry_constraint import (
    ConstraintAccumulator,
    NullConstraintAccumulator,
    OdometryConstraint,
)
from vo_service.types import TrackingState


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
    assert [constraint is not None for constraint in found] == [
        True,
        False,
        False,
        False,
        True,
        False,
    ]


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
