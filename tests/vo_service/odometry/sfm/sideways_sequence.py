"""A camera that moves sideways, with enough parallax within a few frames."""

from dataclasses import replace
from functools import cache

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.odometry.hand_held_sequence import SHAPE
from tests.vo_service.odometry.synthetic_views import render_corner

# By the fourth frame the parallax of the first with the first reaches three degrees.
FIRST_REGISTERED = 4
FRAMES = 9


def sideways_pose(k: int) -> Array:
    """45 mm sideways and half a degree a frame."""
    return rigid_transform(so3_exp([0.003 * k, -0.008 * k, 0.004 * k]), [0.045 * k, 0.0, 0.01 * k])


@cache
def render_view(k: int) -> RgbdFrame:
    """The k-th frame."""
    return render_corner(sideways_pose(k), k)


def render_views(count: int = FRAMES) -> list[RgbdFrame]:
    """The first frames."""
    return [render_view(k) for k in range(count)]


def remove_depth(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame without depth."""
    return replace(frame, depth_raw=np.zeros(SHAPE, np.uint16))
