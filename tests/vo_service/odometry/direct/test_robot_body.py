"""The robot's own body in view is found by its rest in the image, and gives no points."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    CAMERA,
    WALL,
    MovingCamera,
    add_noise,
    render_view,
)
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import DYNAMIC_BLOCK_PX
from vo_service.odometry.direct.points import Points, select_points
from vo_service.odometry.direct.robot_body import RobotBody

# Rows of the image that show the body.
TOP_PX = 184
BODY_M = 0.45
BODY_ROWS = np.arange(240 // DYNAMIC_BLOCK_PX) * DYNAMIC_BLOCK_PX >= TOP_PX
PAINT = np.kron(np.random.default_rng(3).integers(40, 200, (60, 80)), np.ones((4, 4)))


def aside(by_m: float) -> Array:
    return rigid_transform(np.eye(3), [by_m, 0.0, 0.0])


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), np.zeros(3))


def view_from(T: Array, seed: int = 0) -> RgbdFrame:
    return add_noise(render_view(MovingCamera(T_world_start=T)), seed)


def with_body(frame: RgbdFrame, contrast: float = 1.0) -> RgbdFrame:
    color, depth = frame.color_bgr.copy(), frame.depth_raw.copy()
    paint = 120.0 + contrast * (PAINT - 120.0)
    color[TOP_PX:] = paint[TOP_PX:, :, None].astype(np.uint8)
    depth[TOP_PX:] = round(BODY_M * frame.depth_factor)
    return replace(frame, color_bgr=color, depth_raw=depth)


def as_keyframe(frame: RgbdFrame, T: Array) -> DirectKeyframe:
    return make_keyframe(frame, build_image_pyramid(frame), T, zero_motion(), ALL_STATIC)


def body_after(frames: list[RgbdFrame], poses: list[Array]) -> RobotBody:
    """The body after keyframes, each compared with the one before."""
    body = RobotBody()
    for n in range(1, len(frames)):
        keyframe = as_keyframe(frames[n - 1], poses[n - 1])
        T_keyframe_camera = inverse(poses[n - 1]) @ poses[n]
        body = body.update(build_image_pyramid(frames[n]), keyframe, T_keyframe_camera)
    return body


WALK = [aside(0.25 * n) for n in range(3)]


@pytest.mark.parametrize("poses", [WALK, [turned(0.15 * n) for n in range(3)]])
def test_texture_that_stays_while_the_camera_moves_is_the_body(poses: list[Array]) -> None:
    body = body_after([with_body(view_from(T, n)) for n, T in enumerate(poses)], poses)
    assert body.blocks is not None
    assert body.blocks[BODY_ROWS].mean() > 0.95
    # The margin is one row of 23.
    assert body.blocks[~BODY_ROWS].mean() < 0.06


def test_a_smooth_shade_is_the_body_if_its_depth_stays() -> None:
    """It looks the same a few pixels further, where a camera that moves forward would see it."""
    shade = np.zeros((240, 320, 3), np.uint8)
    shade[TOP_PX:] = np.linspace(40, 208, 240 - TOP_PX)[:, None, None].astype(np.uint8)
    poses = [rigid_transform(np.eye(3), [0.0, 0.0, 0.15 * n]) for n in range(3)]
    frames = [with_body(view_from(T, n)) for n, T in enumerate(poses)]
    shaded = [replace(each, color_bgr=np.where(shade, shade, each.color_bgr)) for each in frames]
    blocks = body_after(shaded, poses).blocks
    assert blocks is not None
    assert blocks[BODY_ROWS].mean() > 0.9


def test_one_keyframe_is_too_few_to_tell() -> None:
    body = body_after([with_body(view_from(T, n)) for n, T in enumerate(WALK[:2])], WALK[:2])
    assert body.blocks is None


@pytest.mark.parametrize("poses", [WALK, [turned(0.15 * n) for n in range(3)], [np.eye(4)] * 3])
def test_a_room_is_not_the_body(poses: list[Array]) -> None:
    assert body_after([view_from(T, n) for n, T in enumerate(poses)], poses).blocks is None


def test_a_plain_surface_at_one_depth_may_be_a_floor() -> None:
    frames = [with_body(view_from(T, n), contrast=0.0) for n, T in enumerate(WALK)]
    assert body_after(frames, WALK).blocks is None


def test_stripes_along_the_motion_are_not_the_body() -> None:
    stripes = np.zeros((240, 320, 3), np.uint8)
    stripes[np.arange(240) % 16 < 8] = 200
    room = [add_noise(render_view(MovingCamera(T_world_start=T), planes=(WALL,)), 0) for T in WALK]
    assert body_after([replace(frame, color_bgr=stripes) for frame in room], WALK).blocks is None


def test_a_camera_that_stands_still_tells_nothing() -> None:
    frames = [with_body(view_from(np.eye(4), n)) for n in range(3)]
    assert body_after(frames, [np.eye(4)] * 3).blocks is None


@pytest.mark.parametrize("has_gone_before", [True, False])
def test_where_the_room_is_seen_again_is_no_body(has_gone_before: bool) -> None:
    poses = [aside(0.25 * n) for n in range(4)]
    frames = [with_body(view_from(T, n)) for n, T in enumerate(poses[:3])]
    body = body_after(frames, poses[:3])
    keyframe = as_keyframe(view_from(poses[2]) if has_gone_before else frames[2], poses[2])
    images = build_image_pyramid(view_from(poses[3]))
    assert body.update(images, keyframe, inverse(poses[2]) @ poses[3]).blocks is None


def test_images_of_another_size_start_anew() -> None:
    body = body_after([with_body(view_from(T, n)) for n, T in enumerate(WALK)], WALK)
    small = render_view(camera=PinholeCamera(160, 120, 145.0, 145.0, 79.5, 59.5))
    keyframe = as_keyframe(view_from(np.eye(4)), np.eye(4))
    assert body.update(build_image_pyramid(small), keyframe, WALK[1]).blocks is None


def points_on_body(levels: Sequence[Points]) -> int:
    count = 0
    for level in levels:
        _, y, z = level.position_m
        count += int((CAMERA.fy * y / z + CAMERA.cy > TOP_PX).sum())
    return count


def selected_points(frame: RgbdFrame, body: RobotBody) -> Sequence[Points]:
    images = build_image_pyramid(frame, body_blocks=body.blocks)
    return select_points(images, zero_motion(), ALL_STATIC)


def test_no_points_are_taken_from_the_body() -> None:
    frames = [with_body(view_from(T, n)) for n, T in enumerate(WALK)]
    assert points_on_body(selected_points(frames[2], RobotBody())) > 200
    assert points_on_body(selected_points(frames[2], body_after(frames, WALK))) == 0


def test_the_odometry_finds_the_body_while_it_moves() -> None:
    odometry = DirectOdometry()
    for n in range(60):
        frame = with_body(view_from(aside(0.015 * n), n))
        assert odometry.estimate(frame.restamped(n / 30)).ok
    assert odometry.active_keyframe is not None
    images = odometry.active_keyframe.images
    assert points_on_body(select_points(images, zero_motion(), ALL_STATIC)) == 0
    assert odometry.T_world_camera[0, 3] == pytest.approx(0.885, abs=0.02)
