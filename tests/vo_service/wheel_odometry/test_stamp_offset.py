"""The offset of the wheels' stamps is learned from turns."""

import numpy as np
import pytest

from vo_service.wheel_odometry.stamp_offset import StampOffset

FRAME_S = 1.0 / 30.0


def yaw_rad(stamp_s: float) -> float:
    """The true angle: turns to and fro, and half of the time straight on."""
    phase = stamp_s % 8.0
    return 0.5 * (1.0 - np.cos(2.0 * np.pi * phase / 4.0)) if phase < 4.0 else 0.0


def learn(offset_s: float, *, seconds: float = 40.0, scale: float = 1.03) -> StampOffset:
    """Drive with wheels whose stamps are ahead and whose yaw is scaled."""
    learned, rng = StampOffset(), np.random.default_rng(2)

    def rate(from_s: float, to_s: float) -> float:
        turned = yaw_rad(to_s - offset_s) - yaw_rad(from_s - offset_s)
        return scale * turned / (to_s - from_s)

    for n in range(round(seconds / FRAME_S)):
        begin_s, end_s = n * FRAME_S, (n + 1) * FRAME_S
        seen = yaw_rad(end_s) - yaw_rad(begin_s) + 1e-3 * rng.normal()
        learned.add(begin_s, end_s, seen, end_s + offset_s, rate)
    return learned


@pytest.mark.parametrize("offset_s", [-0.15, -0.05, 0.0, 0.1, 0.15])
def test_the_offset_is_found_within_ten_milliseconds(offset_s: float) -> None:
    assert learn(offset_s).value_s == pytest.approx(offset_s, abs=0.01)


def test_it_is_found_in_the_first_turn() -> None:
    assert learn(0.1, seconds=4.0).value_s == pytest.approx(0.1, abs=0.02)


def test_a_straight_drive_tells_nothing() -> None:
    learned = StampOffset()
    for n in range(300):
        learned.add(n * FRAME_S, (n + 1) * FRAME_S, 0.002, 1e9, lambda from_s, to_s: 0.0)
    assert learned.value_s == 0.0


def test_slip_is_no_offset() -> None:
    learned = learn(0.05)
    before_s = learned.value_s
    learned.add(100.0, 100.03, 0.03, 1e9, lambda from_s, to_s: to_s - 98.0)
    assert learned.value_s == before_s
