"""The velocity at a view follows from the poses around it."""

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform
from vo_service.odometry.direct.image_pyramid import ImageTiming
from vo_service.odometry.direct.view_history import TrackedView, ViewHistory

SPEED_M_S = 0.3
VELOCITY = np.array([SPEED_M_S, 0.0, 0.0, 0.0, 0.0, 0.0])


def view_at(stamp_s: float) -> TrackedView:
    T_world_camera = rigid_transform(np.eye(3), [SPEED_M_S * stamp_s, 0.0, 0.0])
    return TrackedView(stamp_s, ImageTiming(0.0, 0.0), np.zeros(3), T_world_camera)


def add_views(history: ViewHistory, stamps_s: list[float]) -> list[Array]:
    """Velocities that became known."""
    views = [history.add(view_at(stamp_s), []) for stamp_s in stamps_s]
    return [view.velocity for view in views if view is not None and view.velocity is not None]


def test_the_velocity_is_known_two_views_later() -> None:
    assert add_views(ViewHistory(), [0.0, 0.03, 0.07, 0.1]) == []
    (velocity,) = add_views(ViewHistory(), [0.0, 0.03, 0.07, 0.1, 0.13])
    np.testing.assert_allclose(velocity, VELOCITY, atol=1e-12)


@pytest.mark.parametrize("interval_s", [0.0, 1e-6, -0.03, 1.0])
def test_no_velocity_is_formed_over_an_impossible_interval(interval_s: float) -> None:
    history = ViewHistory()
    add_views(history, [0.0, 0.03, 0.06, 0.09])
    after_s = 0.09 + interval_s
    (velocity,) = add_views(history, [after_s + 0.03 * k for k in range(5)])
    np.testing.assert_allclose(velocity, VELOCITY, atol=1e-9)


def test_views_that_nobody_needs_are_forgotten() -> None:
    history = ViewHistory()
    add_views(history, [0.03 * k for k in range(100)])
    assert history.find(0.0) is None
    assert history.find(0.03 * 99) is not None
