"""The pose of a planar base: exactly on its floor, whatever the camera says."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.fakes import good_estimate
from tests.vo_service.leveling.floor_views import mount
from tests.vo_service.odom_frame_steps import run_steps, update_frame
from vo_service.odom_frame import OdomFrame, project_to_floor

MOUNT = mount(0.6)


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 6))
def test_z_roll_and_pitch_of_a_planar_base_are_exactly_zero(numbers: tuple[float, ...]) -> None:
    step = rigid_transform(so3_exp(numbers[3:]), numbers[:3])
    for update in run_steps(OdomFrame(MOUNT, is_planar=True), [step, step]):
        T = update.T_odom_base
        assert T[2, 3] == 0.0
        np.testing.assert_array_equal(T[2, :3], [0.0, 0.0, 1.0])
        np.testing.assert_array_equal(T[:2, 2], 0.0)
        np.testing.assert_array_equal(update.twist[[2, 3, 4]], 0.0)
        assert np.all(np.linalg.eigvalsh(update.pose_covariance) > 0.0)
        assert update.pose_covariance[2, 2] == 1e-6


def test_a_planar_motion_is_kept() -> None:
    step = mount(0.6)
    T_base = rigid_transform(so3_exp([0.0, 0.0, 0.3]), (0.5, 0.1, 0.0))
    moved = np.linalg.inv(step) @ T_base @ step
    found = run_steps(OdomFrame(MOUNT, is_planar=True), [moved])[-1]
    np.testing.assert_allclose(found.T_odom_base, T_base, atol=1e-12)
    np.testing.assert_allclose(found.T_odom_camera, T_base @ MOUNT, atol=1e-12)


def test_a_reset_to_a_tilted_pose_is_projected_onto_the_floor() -> None:
    odom_frame = OdomFrame(MOUNT, is_planar=True)
    tilted = rigid_transform(so3_exp([0.1, 0.2, 0.7]), (1.0, 2.0, 3.0))
    odom_frame.reset(tilted)
    found: Array = update_frame(odom_frame, good_estimate(np.eye(4))).T_odom_base
    np.testing.assert_allclose(found, project_to_floor(tilted), atol=1e-12)
    assert found[2, 3] == 0.0
