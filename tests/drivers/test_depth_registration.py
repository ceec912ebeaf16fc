"""Depth of a camera of its own, registered in software."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from drivers.calibration import DepthCameraCalibration, RigidTransform
from drivers.camera import MAX_DEPTH_VALUE, PinholeCamera
from drivers.core import InputError
from drivers.core.geometry import Array, quaternion_from_rotation, rigid_transform, so3_exp
from drivers.rectify import SoftwareRegistration

COLOR = PinholeCamera(160, 120, 131.0, 131.5, 80.2, 59.1)
SAME = RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
# The depth camera sits 2.5 cm to the left of the color camera.
BESIDE = RigidTransform((-0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def table(camera: PinholeCamera, pose: RigidTransform) -> DepthCameraCalibration:
    return DepthCameraCalibration(
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        T_color_depth=pose,
        width=camera.width,
        height=camera.height,
    )


def pose_of(T: Array) -> RigidTransform:
    x, y, z = (float(value) for value in T[:3, 3])
    qx, qy, qz, qw = (float(value) for value in quaternion_from_rotation(T[:3, :3]))
    return RigidTransform((x, y, z), (qx, qy, qz, qw))


def rays(camera: PinholeCamera) -> Array:
    """(height, width, 3) directions with z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, u * 0 + 1], axis=-1)


def plane_depth_m(camera: PinholeCamera, T_plane_camera: Array, plane: Array) -> Array:
    """Depth of the plane n.X = 1, given as n in its own frame, at every pixel."""
    R, t = T_plane_camera[:3, :3], T_plane_camera[:3, 3]
    return (1.0 - plane @ t) / (rays(camera) @ R.T @ plane)


def units(depth_m: Array, factor: float = 1000.0) -> NDArray[np.uint16]:
    return np.rint(depth_m * factor).astype(np.uint16)


@settings(max_examples=20)
@given(
    depth=arrays(
        np.uint16,
        (COLOR.height, COLOR.width),
        elements=st.integers(0, MAX_DEPTH_VALUE - 1),
        fill=st.just(1500),
    )
)
def test_a_depth_camera_that_is_the_color_camera_changes_nothing(depth: NDArray[np.uint16]) -> None:
    registration = SoftwareRegistration(COLOR, table(COLOR, SAME), 1000.0)
    np.testing.assert_array_equal(registration.register(depth), depth)


small = st.floats(-1.0, 1.0)


@given(
    offset=st.tuples(small, small, small),
    turn=st.tuples(small, small, small),
    tilt=st.tuples(small, small),
    distance_m=st.floats(0.6, 4.0),
    # Between them, with pixels of one size, cracks are a pixel wide and stay open.
    focal=st.floats(0.7, 0.95) | st.floats(1.1, 1.3),
    factor=st.sampled_from([1000.0, 5000.0, 10000.0]),
    scale=st.floats(0.9, 1.1),
)
def test_plane_has_the_depth_seen_by_the_color_camera(
    offset: tuple[float, float, float],
    turn: tuple[float, float, float],
    tilt: tuple[float, float],
    distance_m: float,
    focal: float,
    factor: float,
    scale: float,
) -> None:
    T_color_depth = rigid_transform(so3_exp(0.02 * np.array(turn)), 0.03 * np.array(offset))
    eye = PinholeCamera(176, 132, COLOR.fx * focal, COLOR.fy * focal, 87.0, 66.0)
    plane = np.array([0.3 * tilt[0], 0.3 * tilt[1], 1.0]) / distance_m
    read_m = plane_depth_m(eye, T_color_depth, plane) / scale
    depth = replace(table(eye, pose_of(T_color_depth)), scale=scale)
    registration = SoftwareRegistration(COLOR, depth, factor)
    truth_m = plane_depth_m(COLOR, np.eye(4), plane)
    # Of a plane that is far away at one side, 16 bits hold no more at this factor.
    assume(factor * max(read_m.max(), truth_m.max()) < np.iinfo(np.uint16).max)
    registered = registration.register(units(read_m, factor))
    # A reading lands on the nearest pixel, and is spread where pixels are finer: how much does
    # depth change on the way?
    steepest_m = np.max(np.abs(np.gradient(truth_m))) * (1.5 if focal >= 1.0 else 3.0)
    error_m = np.abs(registered / registration.depth_factor - truth_m)[registered > 0]
    assert error_m.max() < steepest_m + 1.5 / factor
    middle = registered[30:90, 40:120]
    assert np.mean(middle == 0) < 0.02


def test_near_surfaces_occlude_far_ones_and_leave_a_shadow() -> None:
    depth = np.full((COLOR.height, COLOR.width), 3000, np.uint16)
    depth[:, 70:90] = 600
    row = SoftwareRegistration(COLOR, table(COLOR, BESIDE), 1000.0).register(depth)[60]
    moved_far, moved_near = round(131 * 0.025 / 3.0), round(131 * 0.025 / 0.6)
    assert set(row.tolist()) == {0, 600, 3000}
    assert np.all(row[70 - moved_near : 90 - moved_near] == 600)
    assert np.all(row[90 - moved_near : 90 - moved_far] == 0)
    assert np.all(row[: 70 - moved_near] == 3000)


def test_holes_stay_holes() -> None:
    depth = np.zeros((COLOR.height, COLOR.width), np.uint16)
    registered = SoftwareRegistration(COLOR, table(COLOR, BESIDE), 1000.0).register(depth)
    assert registered.dtype == np.uint16
    assert not registered.any()


def test_coarse_depth_fills_the_finer_color_image() -> None:
    half = PinholeCamera(80, 60, COLOR.fx / 2, COLOR.fy / 2, COLOR.cx / 2, COLOR.cy / 2)
    depth = np.full((60, 80), 2000, np.uint16)
    registered = SoftwareRegistration(COLOR, table(half, SAME), 1000.0).register(depth)
    assert registered.shape == (120, 160)
    assert np.all(registered[2:-2, 2:-2] == 2000)


def test_distortion_of_the_depth_camera_is_removed() -> None:
    distortion = (0.4, -0.3, 0.002, -0.002, 0.1)
    plane = np.array([0.3, -0.2, 1.0]) / 1.5
    v, u = np.mgrid[:120, :160].astype(np.float64)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    seen = cv2.undistortPoints(pixels, COLOR.K, np.array(distortion)).reshape(120, 160, 2)
    distorted_m = 1.0 / (seen @ plane[:2] + plane[2])
    depth = replace(table(COLOR, SAME), distortion=distortion)
    registered = SoftwareRegistration(COLOR, depth, 1000.0).register(units(distorted_m))
    truth_m = plane_depth_m(COLOR, np.eye(4), plane)
    has_depth = registered > 0
    error_m = np.abs(registered / 1000.0 - truth_m)[has_depth]
    # What is left is half a pixel of a steep plane.
    assert error_m.max() < np.max(np.abs(np.gradient(truth_m))) + 0.001
    assert np.mean(np.abs(distorted_m - truth_m)[has_depth]) > 4 * np.mean(error_m)
    assert has_depth[20:100, 20:140].all()


def test_readings_out_of_range_are_dropped() -> None:
    back = RigidTransform((0.0, 0.0, -0.05), (0.0, 0.0, 0.0, 1.0))
    forth = RigidTransform((0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 1.0))
    for pose, reading in ((back, 40), (forth, 65500)):
        depth = np.full((COLOR.height, COLOR.width), reading, np.uint16)
        registered = SoftwareRegistration(COLOR, table(COLOR, pose), 1000.0).register(depth)
        assert not registered.any()


def test_depth_camera_that_looks_away_is_rejected() -> None:
    behind = RigidTransform((0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    with pytest.raises(InputError, match="turns the depth camera away"):
        SoftwareRegistration(COLOR, table(COLOR, behind), 1000.0)
