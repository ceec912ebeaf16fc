"""Motions in the plane: properties of the group, its exponential and interpolation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import inverse
from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist, planar_part

meters = st.floats(-100.0, 100.0)
angles = st.floats(-3.1, 3.1)
poses = st.builds(PlanarPose, meters, meters, angles)
twists = st.builds(PlanarTwist, meters, meters, angles)


def assert_same(one: PlanarPose, other: PlanarPose) -> None:
    assert one.transform() == pytest.approx(other.transform(), abs=1e-9)


@given(poses, poses)
def test_motions_are_those_of_4x4_transforms(one: PlanarPose, other: PlanarPose) -> None:
    T_one_other = inverse(one.transform()) @ other.transform()
    assert_same(one.motion_to(other), planar_part(T_one_other))
    assert_same(one.then(one.motion_to(other)), other)


@given(twists)
def test_the_velocity_of_a_motion_is_the_twist_that_made_it(twist: PlanarTwist) -> None:
    assert twist.motion(0.5).velocity(0.5) == pytest.approx(twist, abs=1e-7)


@given(twists, st.floats(0.0, 1.0))
def test_interpolation_is_a_drive_at_constant_twist(twist: PlanarTwist, share: float) -> None:
    start = PlanarPose(1.0, 2.0, 3.0)
    end = start.then(twist.motion(1.0))
    assert_same(start.toward(end, share), start.then(twist.motion(share)))


@given(poses, poses, poses, st.floats(0.0, 1.0))
def test_interpolation_does_not_depend_on_the_frame(
    frame: PlanarPose, one: PlanarPose, other: PlanarPose, share: float
) -> None:
    inside = frame.then(one.toward(other, share))
    assert_same(frame.then(one).toward(frame.then(other), share), inside)


@given(poses, poses)
def test_interpolation_begins_and_ends_at_the_poses(one: PlanarPose, other: PlanarPose) -> None:
    assert_same(one.toward(other, 0.0), one)
    assert_same(one.toward(other, 1.0), other)


def test_a_turn_through_the_end_of_the_angles_goes_the_short_way() -> None:
    one, other = PlanarPose(0.0, 0.0, 3.1), PlanarPose(0.0, 0.0, -3.1)
    half = one.toward(other, 0.5)
    assert abs(half.yaw_rad) == pytest.approx(math.pi)


def test_a_quarter_of_a_circle() -> None:
    motion = PlanarTwist(math.pi / 2, 0.0, math.pi / 2).motion(1.0)
    assert motion == pytest.approx((1.0, 1.0, math.pi / 2))
    assert np.allclose(motion.transform()[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
