"""Moving objects, seen by a stationary camera."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core import InputError
from drivers.core.geometry import inverse
from drivers.synthetic.config import (
    DynamicObjectConfig,
    DynamicObjectKind,
    MotionKind,
    ShutterTiming,
    SyntheticConfig,
)
from drivers.synthetic.dynamic_objects import make_dynamic_objects
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.room import ROOM_HEIGHT_M

pytestmark = pytest.mark.slow

SMALL = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)
# It enters from the left, is in the middle after a second, and is about to leave after 1.5.
PARCEL = DynamicObjectConfig(
    DynamicObjectKind.PARCEL, 0.5, 1.5, (0.3, 0.3, 0.02), 1.0, (-1.5, 0.0), (1.5, 0.0)
)
PERSON = DynamicObjectConfig(DynamicObjectKind.PERSON, 0.0, 2.0)


STILL = replace(
    SyntheticConfig.ideal(),
    camera=SMALL,
    texel_m=0.02,
    motion=MotionKind.STILL,
    movers=(PARCEL,),
    duration_s=2.0,
    rate_hz=10.0,
)
RendererFactory = Callable[[SyntheticConfig], Renderer]


@pytest.fixture(scope="module")
def shared_renderer() -> RendererFactory:
    """Make renderers of one room with the parcel in it, for any sensor."""
    path = make_motion(STILL, ROOM_HEIGHT_M)
    room = RoomModel.build(STILL, path, threads=2)
    return lambda variant: Renderer(variant, path, room)


def changed(renderer: Renderer, index: int) -> NDArray[np.bool_]:
    """Pixels that show another surface than in the first frame."""
    result: NDArray[np.bool_] = renderer.render(index).depth_raw != renderer.render(0).depth_raw
    return result


def test_it_fills_the_view_by_its_size_and_then_leaves(shared_renderer: RendererFactory) -> None:
    renderer = shared_renderer(STILL)
    seen = changed(renderer, 10)
    x, y = (0.3 * SMALL.fx / 1.0 / size for size in (128, 96))
    assert seen.mean() == pytest.approx(x * y, rel=0.25)
    assert seen[48, 64]
    depth_m = renderer.render(10).depth_raw[48, 64] / STILL.depth_factor
    assert depth_m == pytest.approx(1.0, abs=0.08)  # the camera looks down on an upright face
    assert changed(renderer, 14).any()
    assert not changed(renderer, 16).any()


def test_it_differs_in_color_from_what_it_occludes(shared_renderer: RendererFactory) -> None:
    renderer = shared_renderer(STILL)
    seen = changed(renderer, 10)
    with_it, without = (renderer.render(index).color_bgr for index in (10, 0))
    assert np.any(with_it != without, axis=2)[seen].mean() > 0.9
    assert with_it[seen].std() > 15


def test_a_rolling_shutter_sees_it_in_each_row_at_its_own_instant(
    shared_renderer: RendererFactory,
) -> None:
    rolling = replace(STILL, timing=ShutterTiming(readout_s=0.095, skew_s=0.0))
    per_row = replace(STILL, rate_hz=2000.0)
    rolled, whole = shared_renderer(rolling).render(10), shared_renderer(per_row)
    for row in (34, 60):
        instant = whole.render(2000 + 2 * row - 95)
        np.testing.assert_array_equal(rolled.depth_raw[row], instant.depth_raw[row])
        np.testing.assert_array_equal(rolled.color_bgr[row], instant.color_bgr[row])
    assert np.any(rolled.depth_raw[34] != whole.render(2000).depth_raw[34])


def test_it_alone_is_blurred_where_the_camera_stands_still(
    shared_renderer: RendererFactory,
) -> None:
    slow = replace(STILL, color=replace(STILL.color, exposure_s=0.05))
    sharp, blurred = (shared_renderer(config) for config in (STILL, slow))
    differs = np.any(sharp.render(10).color_bgr != blurred.render(10).color_bgr, axis=2)
    assert differs[changed(sharp, 10)].mean() > 0.5
    assert not differs[:, :30].any()
    np.testing.assert_array_equal(sharp.render(10).depth_raw, blurred.render(10).depth_raw)


def test_a_person_stands_on_the_floor_before_the_camera() -> None:
    config = replace(STILL, movers=(PERSON,))
    path = make_motion(config, ROOM_HEIGHT_M)
    (body,) = make_dynamic_objects(config, path)
    lowest = min(s.T_world_solid[2, 3] - s.half_m[2] for s in body.solids_at_midpoint)
    highest = max(s.T_world_solid[2, 3] + s.half_m[2] for s in body.solids_at_midpoint)
    assert lowest == pytest.approx(0.0, abs=1e-9)
    assert highest == pytest.approx(1.75, rel=0.01)
    T_camera_body = inverse(path.poses(np.zeros(1))[0]) @ body.poses(np.ones(1))[0]
    assert T_camera_body[0, 3] == pytest.approx(0.0, abs=1e-9)
    assert T_camera_body[2, 3] > 0.5
    assert T_camera_body[2, 1] > 0.8  # its back is turned away from the camera


def test_an_end_before_the_beginning_is_rejected() -> None:
    with pytest.raises(InputError, match="end_s must be after begin_s"):
        replace(PARCEL, end_s=0.0)
