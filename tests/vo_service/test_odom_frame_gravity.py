"""Which way is up: `odom` from gravity, and what must not change with it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import (
    R_BODY_OPTICAL,
    T_BODY_CAMERA,
    Array,
    Vector,
    rigid_transform,
    so3_exp,
)
from tests.vo_service.fakes import failed_estimate, good_estimate, make_frame
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.types.estimate import Estimate
from vo_service.types.level import LevelSource
from vo_service.types.odometry_update import OdometryUpdate

RATE_HZ = 30.0
LEVEL: Vector = (0.0, 9.80665, 0.0)
NOSE_DOWN: Vector = (0.0, 8.0, 5.7)
AHEAD = rigid_transform(R_BODY_OPTICAL, [0.3, 0.0, 0.0])
AWRY = rigid_transform(R_BODY_OPTICAL @ so3_exp([0.3, -0.2, 0.5]), [0.2, -0.1, 0.4])


def ahead(metres: float) -> Array:
    return rigid_transform(np.eye(3), [0.0, 0.0, metres])


def update(
    tracker: OdomFrame, estimate: Estimate, seq: int = 0, gravity_m_s2: Vector | None = None
) -> OdometryUpdate:
    seen = replace(make_frame(seq, seq / RATE_HZ), gravity_m_s2=gravity_m_s2)
    return tracker.update(StampedFrame(seen, 1e9 + seq / RATE_HZ), estimate, {}, 0.01)


def turns() -> st.SearchStrategy[Array]:
    """Rotations, all about any axis."""
    return st.tuples(*[st.floats(-3.1, 3.1)] * 3).map(so3_exp)


@given(turns(), st.sampled_from([T_BODY_CAMERA, AHEAD, AWRY]))
def test_odom_points_against_gravity(R: Array, mounting: Array) -> None:
    x, y, z = (9.7 * R[2]).tolist()
    found = update(OdomFrame(mounting), good_estimate(np.eye(4)), 0, (x, y, z)).T_odom_base
    gravity_in_odom = found[:3, :3] @ mounting[:3, :3] @ (x, y, z)
    np.testing.assert_allclose(gravity_in_odom, [0.0, 0.0, -9.7], atol=1e-9)
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
    # Yaw 0, roll and pitch within their ranges: x of the base has no part to the left.
    assert found[0, 0] > -1e-12
    np.testing.assert_allclose(found[1, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], 0.0, atol=1e-12)


@pytest.mark.parametrize("up_or_down", [1.0, -1.0])
def test_a_camera_that_looks_straight_down_or_up_has_a_valid_odom(up_or_down: float) -> None:
    found = update(
        OdomFrame(), good_estimate(np.eye(4)), 0, (0.0, 0.0, 9.8 * up_or_down)
    ).T_odom_base
    np.testing.assert_allclose(found[:3, 0], [0.0, 0.0, -up_or_down], atol=1e-12)
    assert np.all(np.isfinite(found))


@given(turns())
def test_a_level_start_equals_a_start_without_gravity(R: Array) -> None:
    step = rigid_transform(R, [0.1, -0.2, 0.3])
    with_gravity, without_gravity = OdomFrame(), OdomFrame()
    for tracker, gravity in ((with_gravity, LEVEL), (without_gravity, None)):
        update(tracker, good_estimate(np.eye(4)), 0, gravity)
    a, b = (
        update(tracker, good_estimate(step, step), 1) for tracker in (with_gravity, without_gravity)
    )
    np.testing.assert_array_equal(a.T_odom_base, b.T_odom_base)
    np.testing.assert_array_equal(a.pose_covariance, b.pose_covariance)
    assert (with_gravity.leveling.level.source, without_gravity.leveling.level.source) == (
        LevelSource.ACCELEROMETER,
        LevelSource.ASSUMED,
    )


def test_a_tilted_camera_that_moves_forward_gets_lower() -> None:
    tracker = OdomFrame()
    update(tracker, good_estimate(np.eye(4)), 0, NOSE_DOWN)
    found = update(tracker, good_estimate(ahead(1.0), ahead(1.0)), 1)
    down = np.arctan2(NOSE_DOWN[2], NOSE_DOWN[1])
    np.testing.assert_allclose(found.T_odom_base[:3, 3], [np.cos(down), 0.0, -np.sin(down)])
    np.testing.assert_array_equal(found.T_world_camera, ahead(1.0))  # files know no gravity
    np.testing.assert_allclose(found.twist[:3], [RATE_HZ, 0.0, 0.0], atol=1e-12)  # nor the twist


def test_the_covariance_is_rotated_with_odom() -> None:
    level, tilted = OdomFrame(), OdomFrame()
    for tracker, gravity in ((level, LEVEL), (tilted, NOSE_DOWN)):
        update(tracker, good_estimate(np.eye(4)), 0, gravity)
    a, b = (
        update(tracker, good_estimate(ahead(1.0), ahead(1.0)), 1) for tracker in (level, tilted)
    )
    turned = np.kron(np.eye(2), b.T_odom_base[:3, :3] @ a.T_odom_base[:3, :3].T)
    np.testing.assert_allclose(b.pose_covariance, turned @ a.pose_covariance @ turned.T, atol=1e-15)


def test_later_gravity_changes_nothing() -> None:
    tracker, plain = OdomFrame(), OdomFrame()
    estimates = [
        good_estimate(np.eye(4)),
        failed_estimate(),
        replace(good_estimate(ahead(0.5)), is_reset=True),
        failed_estimate(),
    ]
    for seq, estimate in enumerate(estimates):
        found = update(tracker, estimate, seq, NOSE_DOWN if seq == 0 else (9.0, 3.0, -1.0))
        expected = update(plain, estimate, seq, NOSE_DOWN if seq == 0 else None)
        np.testing.assert_array_equal(found.T_odom_base, expected.T_odom_base)
    tracker.start_epoch("clock_step")
    found = update(tracker, failed_estimate(), 9, LEVEL)
    np.testing.assert_array_equal(found.T_odom_base, expected.T_odom_base)
    assert tracker.leveling.level.source is LevelSource.ACCELEROMETER


def test_the_first_good_frame_aligns_odom_with_gravity() -> None:
    tracker = OdomFrame()
    update(tracker, failed_estimate(), 0, LEVEL)
    found = update(tracker, good_estimate(np.eye(4)), 1, NOSE_DOWN).T_odom_base
    np.testing.assert_allclose(found[2, 0], -NOSE_DOWN[2] / np.hypot(*NOSE_DOWN[1:]))


def test_a_first_good_frame_without_gravity_counts_as_level() -> None:
    tracker = OdomFrame()
    update(tracker, good_estimate(np.eye(4)), 0)
    found = update(tracker, good_estimate(np.eye(4)), 1, NOSE_DOWN)
    np.testing.assert_array_equal(found.T_odom_base, np.eye(4))
    assert tracker.leveling.level.source is LevelSource.ASSUMED
