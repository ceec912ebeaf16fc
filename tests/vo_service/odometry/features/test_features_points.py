import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import CAMERA, FIRST_CALL_COMPILES, make_frame
from vo_service.odometry.depth_planes import fit_inverse_depth
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.points import FeaturePoints, backproject_features, pair_points

HEIGHT, WIDTH = 60, 80
INSIDE = (st.floats(4.0, WIDTH - 5.51), st.floats(4.0, HEIGHT - 5.51))


def features_at(*position_px: tuple[float, float]) -> Features:
    n = len(position_px)
    zero = np.zeros(n, np.float32)
    return Features(np.array(position_px, np.float32), zero, np.zeros((n, 2), np.float32), zero,
                    zero, np.zeros((n, 64), np.float32))  # fmt: skip


def plane(a: float, b: float, c: float, shape: tuple[int, int] = (HEIGHT, WIDTH)) -> Array:
    """Depth of the plane 1/z = a + b u + c v in every pixel."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    depth: Array = 1.0 / (a + b * u + c * v)
    return depth


def inverse_depth_at(depth_m: Array, x: float, y: float) -> float:
    return float(fit_inverse_depth(depth_m.astype(np.float32), np.array([[x, y]], np.float32))[0])


@FIRST_CALL_COMPILES
@given(*INSIDE, st.floats(0.5, 1.5), st.floats(-0.003, 0.003), st.floats(-0.003, 0.003))
def test_a_plane_is_interpolated_exactly(x: float, y: float, a: float, b: float, c: float) -> None:
    x, y = float(np.float32(x)), float(np.float32(y))
    assert inverse_depth_at(plane(a, b, c), x, y) == pytest.approx(a + b * x + c * y, abs=1e-6)


def test_noise_is_averaged() -> None:
    random = np.random.default_rng(0)
    y, x = np.mgrid[10:230:10, 10:310:10]
    inverse_m = 0.5 + random.normal(0.0, 0.0014, (240, 320))
    position_px = np.column_stack([x.ravel(), y.ravel()]).astype(np.float32)
    found = fit_inverse_depth((1.0 / inverse_m).astype(np.float32), position_px)
    # At the center of a square of 81 readings a plane is as good as their mean: a ninth.
    assert np.std(found - 0.5) == pytest.approx(0.0014 / 9, rel=0.15)


@pytest.mark.parametrize("x", [18.6, 19.4, 20.4])
def test_a_feature_on_a_depth_edge_gives_no_point(x: float) -> None:
    depth_m = plane(0.5, 0.0, 0.0)
    depth_m[:, :20] = 1.2
    assert inverse_depth_at(depth_m, x, 30.0) == 0.0


@pytest.mark.parametrize(("away", "inverse_m"), [(1, 0.0), (2, 0.5)])
def test_a_single_jump_counts_only_right_beside_the_feature(away: int, inverse_m: float) -> None:
    depth_m = plane(0.5, 0.0, 0.0)
    depth_m[30 + away, 20 - away] = 1.2
    assert inverse_depth_at(depth_m, 20.0, 30.0) == pytest.approx(inverse_m, abs=1e-6)


def test_beside_a_depth_edge_only_the_surface_of_the_feature_is_used() -> None:
    depth_m = plane(0.5, 0.001, -0.002)
    expected = 0.5 + 0.001 * 22 - 0.002 * 30
    depth_m[:, :20] = 1.2
    assert inverse_depth_at(depth_m, 22.0, 30.0) == pytest.approx(expected, abs=1e-6)


def test_a_hole_under_the_feature_gives_no_point() -> None:
    depth_m = plane(0.5, 0.0, 0.0)
    depth_m[30, 20] = 0.0
    assert inverse_depth_at(depth_m, 20.0, 30.0) == 0.0
    assert inverse_depth_at(depth_m, 21.0, 30.0) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(("columns", "found"), [(3, True), (4, False)])
def test_too_few_samples_give_no_point(columns: int, found: bool) -> None:
    # Of nine columns, six are two thirds, five are 0.56: less than 0.6.
    depth_m = plane(0.5, 0.0, 0.0)
    depth_m[:, 16 : 16 + columns] = 0.0
    assert (inverse_depth_at(depth_m, 20.0, 30.0) > 0) is found


@pytest.mark.parametrize(
    ("x", "y"), [(3.4, 30.0), (WIDTH - 4.5, 30.0), (20.0, 3.4), (20.0, HEIGHT - 4.5),
                 (-5.0, 30.0), (20.0, 1e6)],
)  # fmt: skip
def test_a_feature_at_the_border_gives_no_point(x: float, y: float) -> None:
    assert inverse_depth_at(plane(0.5, 0.0, 0.0), x, y) == 0.0


def test_an_image_without_depth_gives_no_points() -> None:
    points = backproject_features(features_at((20.0, 30.0)), frame_without_depth())
    assert not points.has_depth.any()
    assert np.all(points.position_m == 0)


def frame_without_depth() -> RgbdFrame:
    shape = (CAMERA.height, CAMERA.width)
    return make_frame(np.zeros(shape, np.uint8), np.zeros(shape))


@FIRST_CALL_COMPILES
@given(st.floats(5.0, 314.0), st.floats(5.0, 234.0), st.floats(0.6, 4.0))
def test_a_point_projects_to_its_feature(x: float, y: float, depth_m: float) -> None:
    shape = (CAMERA.height, CAMERA.width)
    frame = make_frame(np.zeros(shape, np.uint8), np.full(shape, depth_m))
    points = backproject_features(features_at((x, y)), frame)
    pixel = CAMERA.K @ points.position_m[0]
    assert points.has_depth.all()
    assert pixel[:2] / pixel[2] == pytest.approx([x, y], abs=1e-4)
    assert pixel[2] == pytest.approx(depth_m, abs=2e-4)


def test_uncertainty_grows_with_depth_and_along_the_ray_with_its_square() -> None:
    near, far = (points_at_depth(z) for z in (1.0, 3.0))
    assert far.sigma_across_m / near.sigma_across_m == pytest.approx(3.0)
    assert far.sigma_along_m / near.sigma_along_m == pytest.approx(9.0)
    assert near.sigma_along_m[0] == pytest.approx(0.0014)


def points_at_depth(depth_m: float) -> FeaturePoints:
    shape = (CAMERA.height, CAMERA.width)
    frame = make_frame(np.zeros(shape, np.uint8), np.full(shape, depth_m))
    return backproject_features(features_at((100.0, 90.0), (200.0, 50.0)), frame)


def test_pairs_have_both_points_and_the_noise_of_their_difference() -> None:
    near, far = points_at_depth(1.0), points_at_depth(2.0)
    pairs = pair_points(near, far, np.array([[1, 0]], np.int64))
    assert len(pairs) == 1
    assert np.array_equal(pairs.P_camera[0], near.position_m[1])
    assert np.array_equal(pairs.P_reference[0], far.position_m[0])
    assert pairs.sigma_along_m[0] == pytest.approx(0.0014 * np.hypot(1.0, 4.0))


def test_no_pairs_give_no_points() -> None:
    points = points_at_depth(1.0)
    assert len(pair_points(points, points, np.empty((0, 2), np.int64))) == 0
