"""A new keyframe has no points on dynamic objects, and all points on static ones."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    CAMERA,
    MovingCamera,
    add_noise,
    render_view,
)
from tests.vo_service.odometry.direct.tracking_results import MOTION
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.dynamic_points import remove_dynamic_points
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import (
    DirectKeyframe,
    LocalMap,
    make_keyframe,
)
from vo_service.odometry.direct.keyframe_selection import TrackedFrame, select
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.quality import TrackingResult

ROWS = slice(60, 160)
THING_M = 0.6
ASIDE_M = 0.1
# Displacement of the object in the image of a camera that has moved aside.
PARALLAX_PX = round(CAMERA.fx * ASIDE_M / THING_M)


def aside(by_m: float) -> Array:
    return rigid_transform(np.eye(3), [by_m, 0.0, 0.0])


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), np.zeros(3))


def with_object(frame: RgbdFrame, left: int, right: int) -> RgbdFrame:
    color, depth = frame.color_bgr.copy(), frame.depth_raw.copy()
    color[ROWS, left:right] = np.roll(color, 90, axis=1)[ROWS, left:right]
    depth[ROWS, left:right] = round(THING_M * frame.depth_factor)
    return replace(frame, color_bgr=color, depth_raw=depth)


def keyframe_at(T: Array, thing: tuple[int, int] = (0, 0), seed: int = 0) -> DirectKeyframe:
    frame = add_noise(with_object(render_view(MovingCamera(T_world_start=T)), *thing), seed)
    return make_keyframe(frame, build_image_pyramid(frame), T, zero_motion(), ALL_STATIC)


def parts_kept(keyframe: DirectKeyframe, others: list[DirectKeyframe]) -> tuple[float, float]:
    """Largest share of kept points on the object, smallest share of the others, of any level."""
    kept = remove_dynamic_points(keyframe, others)
    of_thing, of_room = [], []
    for before, after in zip(keyframe.points, kept.points, strict=True):
        is_thing = [each.position_m[2] < THING_M + 0.05 for each in (before, after)]
        of_thing.append(float(is_thing[1].sum() / max(int(is_thing[0].sum()), 1)))
        of_room.append(float((~is_thing[1]).sum() / (~is_thing[0]).sum()))
    return max(of_thing), min(of_room)


EMPTY = keyframe_at(np.eye(4))


@pytest.mark.parametrize("T", [np.eye(4), aside(ASIDE_M), turned(0.1)])
def test_an_object_in_front_of_a_seen_wall_is_removed(T: Array) -> None:
    of_thing, of_room = parts_kept(keyframe_at(T, (150, 230), 1), [EMPTY])
    assert of_thing == 0.0
    assert of_room > 0.8


@pytest.mark.parametrize("T", [np.eye(4), aside(0.2), turned(0.2), turned(-0.2)])
def test_a_static_room_is_kept(T: Array) -> None:
    _, of_room = parts_kept(keyframe_at(T, seed=1), [EMPTY])
    assert of_room > 0.97


def test_a_static_object_is_kept_though_it_occludes_other_parts_of_the_wall() -> None:
    before = keyframe_at(np.eye(4), (150, 230))
    moved_on = keyframe_at(aside(ASIDE_M), (150 - PARALLAX_PX, 230 - PARALLAX_PX), 1)
    of_thing, of_room = parts_kept(moved_on, [before])
    assert of_thing > 0.9
    assert of_room > 0.9


def test_an_object_from_outside_must_first_be_seen_by_another_keyframe() -> None:
    coming = keyframe_at(turned(0.2), (270, 320), 1)
    assert parts_kept(coming, [EMPTY])[0] == 0.0
    of_thing, of_room = parts_kept(keyframe_at(turned(0.2), (270, 320), 2), [EMPTY, coming])
    assert of_thing > 0.9
    assert of_room > 0.95


def test_an_object_that_was_there_first_is_accepted() -> None:
    came, still_there = (keyframe_at(np.eye(4), (150, 230), seed) for seed in (1, 2))
    assert parts_kept(still_there, [EMPTY, came])[0] == 0.0
    assert parts_kept(still_there, [came])[0] > 0.9


def test_all_points_are_kept_if_other_keyframes_see_little_of_the_view() -> None:
    elsewhere = keyframe_at(turned(2.0))
    assert remove_dynamic_points(EMPTY, [elsewhere]) is EMPTY
    assert remove_dynamic_points(EMPTY, []) is EMPTY


def test_a_camera_with_smaller_images_after_reconnecting_is_compared() -> None:
    small = PinholeCamera(160, 120, 145.0, 145.0, 79.5, 59.5)
    frame = add_noise(render_view(camera=small), 1)
    half = make_keyframe(frame, build_image_pyramid(frame), np.eye(4), zero_motion(), ALL_STATIC)
    assert parts_kept(half, [EMPTY])[1] > 0.9


def test_a_new_keyframe_has_no_points_on_the_dynamic_object() -> None:
    frame = add_noise(with_object(render_view(), 150, 230), 1)
    images, local_map = build_image_pyramid(frame), LocalMap()
    local_map.reset(EMPTY)
    align_frame = align(EMPTY.points, images, np.eye(4), STATIC_PRIOR, 1.0, uniform_weights())
    found = TrackingResult(EMPTY, align_frame, STATIC_PRIOR)
    chosen = select(TrackedFrame(frame, images, found, MOTION, is_well_constrained=True), local_map)
    assert chosen.frame.depth_raw is frame.depth_raw
    assert local_map.keyframes == [EMPTY, chosen]
    for level in chosen.points:
        assert len(level.brightness) > 0
        assert not np.any(level.position_m[2] < THING_M + 0.05)
