import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.rectify import Undistorter

CAMERA = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3)
FREIBURG1 = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
BARREL = (-0.3, 0.1, 0.0, 0.0, 0.0)
PINCUSHION = (0.3, 0.0, 0.0, 0.0, 0.0)  # sees less than the pinhole: corners stay empty


def source_pixels(distortion: tuple[float, ...]) -> NDArray[np.float64]:
    """(480, 640, 2): where Brown's model puts each pixel of the pinhole, from its formula."""
    k1, k2, p1, p2, k3 = distortion
    v, u = np.mgrid[0:480, 0:640].astype(np.float64)
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.dstack([xd * CAMERA.fx + CAMERA.cx, yd * CAMERA.fy + CAMERA.cy])


def far_from_ties(pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    far: NDArray[np.bool_] = np.all(np.abs(pixels - np.floor(pixels) - 0.5) > 1e-3, axis=2)
    return far


def test_without_distortion_images_pass_untouched() -> None:
    lens = Undistorter(CAMERA, (0.0,) * 5)
    color, depth = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.uint16)
    assert lens.undistort_color(color) is color
    assert lens.undistort_depth(depth) is depth


def test_depth_is_the_reading_of_the_nearest_pixel_or_none() -> None:
    depth = np.random.default_rng(0).integers(1, 65536, (480, 640), dtype=np.uint16)
    for distortion in (FREIBURG1, PINCUSHION):
        undistorted = Undistorter(CAMERA, distortion).undistort_depth(depth)
        pixels = source_pixels(distortion)
        u, v = np.rint(pixels).astype(int).transpose(2, 0, 1)
        inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480)
        expected = np.where(inside, depth[v.clip(0, 479), u.clip(0, 639)], 0)
        sure = far_from_ties(pixels)
        np.testing.assert_array_equal(undistorted[sure], expected[sure])


def test_depth_is_never_blended_across_an_edge() -> None:
    depth = np.full((480, 640), 5000, np.uint16)
    depth[:, 320:] = 20000
    depth[200:280, 100:200] = 0
    undistorted = Undistorter(CAMERA, FREIBURG1).undistort_depth(depth)
    assert set(np.unique(undistorted)) == {0, 5000, 20000}


def test_color_is_bilinear() -> None:
    v, u = np.mgrid[0:480, 0:640]
    ramp = np.dstack([u / 4, v / 4, (u + v) / 8]).round().astype(np.uint8)
    undistorted = Undistorter(CAMERA, FREIBURG1).undistort_color(ramp)
    pixels = source_pixels(FREIBURG1)
    u, v = pixels.transpose(2, 0, 1)
    inside = (u > 1) & (u < 638) & (v > 1) & (v < 478)
    expected = np.dstack([u / 4, v / 4, (u + v) / 8])
    assert np.abs(undistorted - expected)[inside].max() < 1.6


def test_pixels_from_outside_are_black_and_without_reading() -> None:
    lens = Undistorter(CAMERA, PINCUSHION)
    assert not lens.undistort_color(np.full((480, 640, 3), 255, np.uint8))[0, 0].any()
    assert lens.undistort_depth(np.full((480, 640), 5000, np.uint16))[0, 0] == 0


def test_a_straight_line_seen_through_the_lens_is_straight_again() -> None:
    points = np.array([[[u, 100.0]] for u in range(20, 621, 20)])
    rays = np.dstack([(points - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones((31, 1))])
    seen, _ = cv2.projectPoints(
        rays.reshape(-1, 3), np.zeros(3), np.zeros(3), CAMERA.K, np.array(BARREL)
    )
    image = np.zeros((480, 640, 3), np.uint8)
    for u, v in seen.reshape(-1, 2):
        cv2.circle(image, (round(u * 16), round(v * 16)), 48, (255, 255, 255), -1, cv2.LINE_AA, 4)
    undistorted = Undistorter(CAMERA, BARREL).undistort_color(image)[..., 0].astype(float)
    rows = (undistorted * np.arange(480)[:, None]).sum(axis=0)[20:621:20] / undistorted.sum(axis=0)[
        20:621:20
    ]
    assert np.abs(rows - 100.0).max() < 0.3
