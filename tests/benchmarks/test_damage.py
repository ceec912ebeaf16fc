"""The ways to spoil a recording do what they say, so that what is measured with them is so."""

import numpy as np
import pytest

from benchmarks.damage import DAMAGES, Damage, Swing, frozen, missing, noise, swung
from drivers.camera import RgbdFrame
from drivers.geometry import rigid_transform
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from tests.vo_service.odometry.walk import assert_close, follow
from vo_service.odometry.surf_odometry import SurfOdometry


@pytest.fixture(scope="module")
def still() -> list[RgbdFrame]:
    """A camera that does not move."""
    return [view_of_a_corner(np.eye(4), seq) for seq in range(8)]


def test_pieces_are_spread_evenly_and_the_rest_is_left_alone(still: list[RgbdFrame]) -> None:
    left = Damage(missing, frames=2, pieces=2).strike(still)
    assert [frame.seq for frame in left] == [0, 3, 4, 7]


@pytest.mark.slow
def test_a_swung_camera_sees_what_it_would_see(still: list[RgbdFrame]) -> None:
    swing = Swing((0.04, 0.15, 0.03), rate_hz=1.0, exposure_s=0.0)
    estimates = follow(SurfOdometry(), swung(still, swing))
    for frame, estimate in zip(still, estimates, strict=True):
        turned = rigid_transform(swing.at(frame.stamp_s), np.zeros(3))
        assert estimate.ok
        assert_close(estimate.T_world_camera, turned, 0.01, 0.4)


def test_an_open_shutter_blurs_a_swing(still: list[RgbdFrame]) -> None:
    sharp, blurred = (
        swung(still, Swing((0.0, 0.3, 0.0), 1.0, exposure_s))[0] for exposure_s in (0.0, 0.03)
    )
    assert np.abs(np.diff(blurred.grey.astype(int))).mean() < 0.7 * (
        np.abs(np.diff(sharp.grey.astype(int))).mean()
    )


def test_frozen_and_noisy_frames_keep_their_stamps(still: list[RgbdFrame]) -> None:
    for spoil in (frozen, noise):
        assert [f.stamp_s for f in spoil(still)] == [f.stamp_s for f in still]
    assert_close(follow(SurfOdometry(), frozen(still))[-1].T_world_camera, np.eye(4), 1e-9, 1e-6)
    assert not any(e.ok for e in follow(SurfOdometry(), [still[0], *noise(still[1:])])[1:])


def test_every_damage_leaves_most_of_half_a_minute_intact() -> None:
    for damage in DAMAGES.values():
        assert damage.frames * damage.pieces <= 120
