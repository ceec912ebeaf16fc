"""What wheels and a floor tell of the motion to the next frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, adjoint, inverse, rigid_transform, so3_exp, so3_log
from tests.vo_service.fakes import good_estimate, make_frame
from tests.vo_service.leveling.floor_views import mount
from tests.vo_service.odom_frame_steps import update_frame
from vo_service.leveling.leveling import Leveling
from vo_service.odom_frame import OdomFrame
from vo_service.pose_prior import WHEEL_ODOMETRY, combine, floor_prior
from vo_service.wheel_odometry.wheel_odometry import NullWheelOdometry, WheelMotion

MOUNT = mount(0.6)
FORWARD = rigid_transform(so3_exp([0.0, 0.0, 0.1]), (0.05, 0.0, 0.0))
SIGMAS = np.array([3e-3, 2e-3, 2e-3, 4e-3, 4e-3, 5e-3])


@dataclass
class ScriptedWheels(NullWheelOdometry):
    """Wheels that tell one motion."""

    motion: WheelMotion | None = None

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """The motion, whatever the time."""
        return self.motion


def planar_leveling() -> Leveling:
    leveling = Leveling(MOUNT, is_planar=True)
    leveling.start(make_frame(0, 0.0))
    return leveling


def prior_of(wheels: ScriptedWheels, **options: Any) -> Any:
    """The prior of the second frame."""
    odom_frame = OdomFrame(MOUNT, wheels=wheels, **options)
    update_frame(odom_frame, good_estimate(np.eye(4)))
    return odom_frame.add_pose_prior(make_frame(1, 0.033), 1e9 + 0.033).pose_prior


def planar_poses() -> st.SearchStrategy[Array]:
    """Poses of a base on its floor."""
    numbers = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5))
    return numbers.map(lambda n: rigid_transform(so3_exp([0.0, 0.0, n[2]]), (n[0], n[1], 0.0)))


def test_the_motion_of_the_wheels_is_that_of_the_camera_at_its_mount() -> None:
    prior = prior_of(ScriptedWheels(WheelMotion(FORWARD, SIGMAS)))
    np.testing.assert_allclose(MOUNT @ prior.T_last_camera @ inverse(MOUNT), FORWARD, atol=1e-12)
    Ad = adjoint(MOUNT)
    np.testing.assert_allclose(
        Ad @ np.linalg.inv(prior.information) @ Ad.T, np.diag(SIGMAS**2), atol=1e-12
    )
    assert prior.source == WHEEL_ODOMETRY


def test_without_wheels_and_floor_there_is_no_prior() -> None:
    assert prior_of(ScriptedWheels(None)) is None


@given(planar_poses(), planar_poses())
def test_the_floor_does_not_mind_a_planar_motion(before: Array, motion: Array) -> None:
    prior = floor_prior(before @ MOUNT, planar_leveling())
    T_last_camera = inverse(MOUNT) @ motion @ MOUNT
    off = inverse(prior.T_last_camera) @ T_last_camera
    error = np.concatenate([off[:3, 3], so3_log(off[:3, :3])])
    np.testing.assert_allclose(prior.information @ error, 0.0, atol=1e-6)


def test_the_floor_brings_a_tilted_and_lifted_camera_back() -> None:
    off_floor = rigid_transform(so3_exp([0.02, -0.03, 0.7]), (1.0, 2.0, 0.04))
    prior = floor_prior(off_floor @ MOUNT, planar_leveling())
    T_odom_base = off_floor @ MOUNT @ prior.T_last_camera @ inverse(MOUNT)
    np.testing.assert_allclose(T_odom_base[2, :3], [0.0, 0.0, 1.0], atol=1e-9)
    assert abs(T_odom_base[2, 3]) < 1e-9
    assert prior.source == ""


def test_wheels_and_floor_are_weighted_by_their_information() -> None:
    wheels = prior_of(ScriptedWheels(WheelMotion(FORWARD, SIGMAS)))
    lifted = rigid_transform(np.eye(3), (0.0, 0.0, 0.01)) @ MOUNT
    floor = floor_prior(lifted, planar_leveling())
    both = combine(wheels, floor)
    moved = lifted @ both.T_last_camera @ inverse(MOUNT)
    # The wheels keep it 10 mm up with a sigma of 2 mm, the floor takes it down with 3 mm.
    np.testing.assert_allclose(moved[2, 3], 0.01 * 9.0 / 13.0, rtol=0.1)
    np.testing.assert_allclose(moved[0, 3], FORWARD[0, 3], atol=1e-3)
    np.testing.assert_array_equal(both.floor_information, floor.information)


def test_a_planar_base_with_wheels_has_both() -> None:
    prior = prior_of(ScriptedWheels(WheelMotion(FORWARD, SIGMAS)), is_planar=True)
    assert prior.source == WHEEL_ODOMETRY
    assert prior.floor_information.any()
