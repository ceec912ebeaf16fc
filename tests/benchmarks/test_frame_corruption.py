"""The corruptions of a recording."""

import numpy as np
import pytest

from benchmarks.recovery import (
    CORRUPTIONS,
    FrameCorruption,
    SwingMotion,
    add_swing,
    freeze,
    remove,
    replace_with_noise,
)
from drivers.camera import RgbdFrame
from drivers.core.geometry import rigid_transform
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.surf.odometry import SurfOdometry


@pytest.fixture(scope="module")
def still() -> list[RgbdFrame]:
    """Frames of a stationary camera."""
    return [render_corner(np.eye(4), seq) for seq in range(8)]


def test_pieces_are_evenly_spread_and_the_rest_is_unchanged(still: list[RgbdFrame]) -> None:
    left = FrameCorruption(remove, frames=2, pieces=2).apply(still)
    assert [frame.seq for frame in left] == [0, 3, 4, 7]


@pytest.mark.slow
def test_a_swing_moves_the_view(still: list[RgbdFrame]) -> None:
    swing = SwingMotion((0.04, 0.15, 0.03), rate_hz=1.0, exposure_s=0.0)
    estimates = estimate_all(SurfOdometry(), add_swing(still, swing))
    for frame, estimate in zip(still, estimates, strict=True):
        turned = rigid_transform(swing.rotation_at(frame.stamp_s), np.zeros(3))
        assert estimate.ok
        assert_close(estimate.T_world_camera, turned, 0.01, 0.4)


def test_an_open_shutter_blurs_a_swing(still: list[RgbdFrame]) -> None:
    sharp, blurred = (
        add_swing(still, SwingMotion((0.0, 0.3, 0.0), 1.0, exposure_s))[0]
        for exposure_s in (0.0, 0.03)
    )
    assert np.abs(np.diff(blurred.gray.astype(int))).mean() < 0.7 * (
        np.abs(np.diff(sharp.gray.astype(int))).mean()
    )


def test_frozen_and_noisy_frames_keep_their_stamps(still: list[RgbdFrame]) -> None:
    for spoil in (freeze, replace_with_noise):
        assert [f.stamp_s for f in spoil(still)] == [f.stamp_s for f in still]
    assert_close(
        estimate_all(SurfOdometry(), freeze(still))[-1].T_world_camera, np.eye(4), 1e-9, 1e-6
    )
    assert not any(
        e.ok for e in estimate_all(SurfOdometry(), [still[0], *replace_with_noise(still[1:])])[1:]
    )


def test_every_corruption_leaves_most_of_half_a_minute_intact() -> None:
    for damage in CORRUPTIONS.values():
        assert damage.frames * damage.pieces <= 120
