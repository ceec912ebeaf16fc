"""Pieces of a recording with a fault or a swing."""

import numpy as np
import pytest

from benchmarks.corruptions import CORRUPTIONS, Corruption, SwingMotion, rotate
from drivers.camera import RgbdFrame
from drivers.core.geometry import rigid_transform
from drivers.faulty_camera import Fault, FaultKind
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.surf.odometry import SurfOdometry


@pytest.fixture(scope="module")
def still() -> list[RgbdFrame]:
    """Frames of a stationary camera."""
    return [render_corner(np.eye(4), seq) for seq in range(8)]


def test_pieces_are_evenly_spread_and_the_rest_is_unchanged(still: list[RgbdFrame]) -> None:
    missing = Corruption(FaultKind.DROPPED, frames=2, pieces=2)
    assert missing.first_frames(8) == [1, 5]
    assert missing.faults(8)[1] == Fault(FaultKind.DROPPED, 5, 2)
    swung = Corruption(SwingMotion((0.0, 0.3, 0.0), 1.0, 0.0), 2, 2).swing(still, 8)
    unchanged = [frame is before for frame, before in zip(swung, still, strict=True)]
    assert unchanged == [n not in (1, 2, 5, 6) for n in range(8)]


@pytest.mark.slow
def test_a_swing_moves_the_view(still: list[RgbdFrame]) -> None:
    swing = SwingMotion((0.04, 0.15, 0.03), rate_hz=1.0, exposure_s=0.0)
    estimates = estimate_all(SurfOdometry(), [rotate(f, swing, f.stamp_s) for f in still])
    for frame, estimate in zip(still, estimates, strict=True):
        turned = rigid_transform(swing.rotation_at(frame.stamp_s), np.zeros(3))
        assert estimate.ok
        assert_close(estimate.T_world_camera, turned, 0.01, 0.4)


def test_an_open_shutter_blurs_a_swing(still: list[RgbdFrame]) -> None:
    sharp, blurred = (
        rotate(still[0], SwingMotion((0.0, 0.3, 0.0), 1.0, exposure_s), 0.0)
        for exposure_s in (0.0, 0.03)
    )
    assert np.abs(np.diff(blurred.gray.astype(int))).mean() < 0.7 * (
        np.abs(np.diff(sharp.gray.astype(int))).mean()
    )


def test_every_corruption_leaves_most_of_half_a_minute_intact() -> None:
    for damage in CORRUPTIONS.values():
        assert damage.frames * damage.pieces <= 120
