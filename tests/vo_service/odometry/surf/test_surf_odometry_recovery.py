"""Recovery of frames that do not fit the last good one."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.hand_held_sequence import BLACK, SHAPE, assert_close, estimate_all
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.views import FeatureView
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.surf.recovery import RecoveredPose, SurfRecovery


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), [0.3 * angle_rad, 0.0, 0.0])


def seen(angle_rad: float, seq: int) -> RgbdFrame:
    return render_corner(turned(angle_rad), seq)


ANGLES_RAD = [0.18 * k for k in range(7)]
BACK_RAD = -0.12


@pytest.fixture(scope="module")
def sweep() -> list[RgbdFrame]:
    """The camera looks away, until nothing of its first view is left."""
    return [seen(angle_rad, seq) for seq, angle_rad in enumerate(ANGLES_RAD)]


@pytest.fixture(scope="module")
def back() -> list[RgbdFrame]:
    """At once it looks back to where it began."""
    return [seen(BACK_RAD, len(ANGLES_RAD) + k) for k in range(6)]


class NoRecovery(SurfRecovery):
    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        return None


def test_a_camera_that_looks_back_is_recovered_by_an_older_view(
    sweep: list[RgbdFrame], back: list[RgbdFrame]
) -> None:
    alone = estimate_all(SurfOdometry(recovery=NoRecovery(SurfParameters())), sweep + back)
    assert not any(e.ok for e in alone[len(sweep) :])
    estimates = estimate_all(SurfOdometry(), sweep + back)
    lost, found = estimates[len(sweep) :], estimates[-1]
    assert [e.ok for e in lost] == [False, True, True, True, True, True]
    assert not any(e.is_reset for e in estimates)
    assert_close(found.T_world_camera, turned(BACK_RAD), 0.01, 0.5)


def test_the_motion_is_relative_to_the_last_good_frame(
    sweep: list[RgbdFrame], back: list[RgbdFrame]
) -> None:
    odometry = SurfOdometry()
    last = estimate_all(odometry, sweep)[-1]
    found = next(e for e in map(odometry.estimate, back) if e.ok)
    T_last_camera = inverse(last.T_world_camera) @ found.T_world_camera
    np.testing.assert_allclose(found.T_reference_camera, T_last_camera, atol=1e-12)
    # The way there is as unsure as all of the way back to the older view, and the step from it.
    assert np.trace(found.covariance) > np.trace(last.covariance)
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    assert np.linalg.norm(
        T_last_camera[:3, 3] - (inverse(turned(ANGLES_RAD[-1])) @ turned(BACK_RAD))[:3, 3]
    ) < (4 * np.sqrt(np.trace(found.covariance[:3, :3])))


def test_tracking_continues_after_recovery(sweep: list[RgbdFrame], back: list[RgbdFrame]) -> None:
    odometry = SurfOdometry()
    estimate_all(odometry, sweep + back)
    following = odometry.estimate(seen(BACK_RAD + 0.03, 13))
    assert following.ok
    assert_close(
        following.T_reference_camera,
        inverse(turned(BACK_RAD)) @ turned(BACK_RAD + 0.03),
        0.004,
        0.2,
    )


def mirrored(frame: RgbdFrame) -> RgbdFrame:
    """An unknown view: SURF does not match mirror images."""
    color, depth = frame.color_bgr[:, ::-1], frame.depth_raw[:, ::-1]
    return replace(frame, color_bgr=color.copy(), depth_raw=depth.copy())


def test_after_a_restart_the_old_views_are_dropped(
    sweep: list[RgbdFrame], back: list[RgbdFrame]
) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=1))
    estimate_all(odometry, sweep)
    lost, fresh = estimate_all(odometry, [mirrored(sweep[2])] * 2)
    assert not lost.ok
    assert fresh.is_reset
    again = odometry.estimate(back[0])
    assert not again.ok
    assert np.array_equal(again.T_world_camera, fresh.T_world_camera)


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_recognized(sweep: list[RgbdFrame], seed: int) -> None:
    random = np.random.default_rng(seed)
    odometry = SurfOdometry()
    estimate_all(odometry, sweep)
    for seq in range(7, 12):
        gray = random.integers(0, 256, (*SHAPE, 1), np.uint8)
        noise = replace(sweep[0], color_bgr=np.repeat(gray, 3, axis=2), stamp_s=seq / 30)
        assert not odometry.estimate(noise).ok


def blurred(angle_rad: float, seq: int) -> RgbdFrame:
    """As it is seen in the middle of a turn by 3.4 degrees while the shutter is open."""
    shots = [seen(angle_rad + off_rad, seq) for off_rad in np.linspace(-0.03, 0.03, 9)]
    color_bgr = np.mean([shot.color_bgr for shot in shots], axis=0).astype(np.uint8)
    return replace(shots[4], color_bgr=color_bgr)


def test_a_constant_rotation_is_tracked_into_a_blurred_image() -> None:
    turn = [*(seen(0.03 * seq, seq) for seq in range(4)), blurred(0.12, 4)]
    alone = estimate_all(SurfOdometry(recovery=NoRecovery(SurfParameters())), turn)[-1]
    found = estimate_all(SurfOdometry(), turn)[-1]
    assert not alone.ok
    assert found.ok
    assert_close(found.T_world_camera, turned(0.12), 0.02, 0.5)


def test_without_increasing_stamps_nothing_is_predicted() -> None:
    turn = [*(seen(0.03 * seq, seq) for seq in range(4)), blurred(0.12, 3)]
    assert not estimate_all(SurfOdometry(), turn)[-1].ok


def test_black_frames_are_lost_and_tracking_continues_afterwards(sweep: list[RgbdFrame]) -> None:
    estimates = estimate_all(SurfOdometry(), [*sweep[:3], BLACK, BLACK, sweep[3]])
    assert [e.ok for e in estimates] == [True, True, True, False, False, True]


def test_a_lower_feature_count_applies_to_the_next_frame(sweep: list[RgbdFrame]) -> None:
    odometry = SurfOdometry()
    assert odometry.feature_count == 1000
    before = odometry.estimate(sweep[0])
    odometry.feature_count = 200
    after = odometry.estimate(sweep[0])
    odometry.feature_count = 300
    raised = odometry.estimate(sweep[0])
    assert before.features > 300
    assert (after.features, raised.features) == (200, 300)
    assert after.ok
    assert raised.ok
