import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    render_view,
    series_exponential,
)
from vo_service.odometry.direct.alignment import (
    PointPyramid,
    initial_residual_model,
    sample_points,
    uniform_weights,
)
from vo_service.odometry.direct.factor import jacobian
from vo_service.odometry.direct.gauss_newton import (
    MotionPrior,
    accumulate,
    add_motion_prior,
    expand_rolling_shutter,
    prior_information,
)
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.points import select_points
from vo_service.odometry.direct.residuals import (
    fit_residual_model,
    weigh_samples,
)
from vo_service.odometry.direct.samples import Samples

FEW = settings(max_examples=30)

MOTIONS = arrays(np.float64, 9, elements=st.floats(-1.0, 1.0, allow_subnormal=False))


@FEW
@given(MOTIONS, st.floats(1.0, 60.0), st.integers(0, 1000))
def test_the_prior_is_the_squared_difference_of_motion_and_prediction(
    off: Array, rate_hz: float, seed: int
) -> None:
    """Its value is sum P (off + e - rate d)^2 for a step d of the pose and e of the motion.

    The acceleration is coupled only with itself.
    """
    random = np.random.default_rng(seed)
    information, step = random.uniform(1.0, 100.0, 9), random.normal(size=15)
    H, g = np.zeros((15, 15)), np.zeros(15)
    prior = MotionPrior(np.eye(4), rate_hz, np.zeros(9), information)
    add_motion_prior(H, g, off, np.zeros(9), prior_information(prior))
    value = step @ H @ step + 2 * g @ step + information @ off**2
    apart = off + step[6:]
    apart[:6] -= rate_hz * step[:6]
    assert value == pytest.approx(information @ apart**2, rel=1e-6)
    np.testing.assert_array_equal(H, H.T)


READOUT_S, SKEW_S = 0.03, 0.012

IMAGES = build_image_pyramid(render_view(readout_s=READOUT_S, skew_s=SKEW_S))

POINTS: PointPyramid = select_points(IMAGES, zero_motion(), ALL_STATIC)

SMALL = 1e-4

EVERY_DIRECTION = list(np.eye(6))


def jacobians(gradient: Array) -> Array:
    """(N, 6) Jacobians."""
    return np.array(
        [jacobian(POINTS[0].position_m, gradient, n, 1.0) for n in range(gradient.shape[1])]
    )


def change(column: str, direction: Array) -> Array:
    """(N,) how readings change as the keyframe's points move a little, by differences."""
    there, back = (
        sample_points(POINTS, IMAGES, series_exponential(s * SMALL * direction), zero_motion(), 0)
        for s in (1, -1)
    )
    return np.asarray((getattr(there, column) - getattr(back, column)) / (2 * SMALL))


@pytest.mark.parametrize("direction", EVERY_DIRECTION)
def test_depth_changes_as_its_jacobian_predicts(direction: Array) -> None:
    rows, counts = jacobians(POINTS[0].depth_gradient), POINTS[0].has_shape
    predicted, true = rows @ direction, change("depth_residual", direction)
    counts = counts & np.isfinite(true)
    off = np.abs(predicted - true)[counts]
    assert np.median(off) < 0.03 * np.abs(true[counts]).max()


@pytest.mark.parametrize("direction", EVERY_DIRECTION)
def test_brightness_changes_as_its_jacobian_predicts(direction: Array) -> None:
    rows, counts = jacobians(POINTS[0].brightness_gradient), POINTS[0].has_texture
    predicted, true = rows @ direction, change("brightness", direction)
    counts = counts & np.isfinite(true)
    # The Jacobian has a slope over two pixels, the difference one between two.
    assert np.corrcoef(predicted[counts], true[counts])[0, 1] > 0.9
    assert np.polyfit(predicted[counts], true[counts], 1)[0] == pytest.approx(1.0, abs=0.2)


def sum_up(samples: Samples, cell_weights: Array) -> Array:
    weighted = weigh_samples(POINTS[0], samples, cell_weights)
    return accumulate(POINTS[0], samples, weighted, initial_residual_model(IMAGES, POINTS[0]))


def system(T: Array, points_motion: Array) -> tuple[Array, Array]:
    samples = sample_points(POINTS, IMAGES, T, points_motion, 0)
    bands = sum_up(samples, uniform_weights())
    return expand_rolling_shutter(bands, READOUT_S, SKEW_S)


def test_information_is_symmetric_and_positive() -> None:
    H, g = system(series_exponential(np.full(6, 2e-3)), BRISK.motion)
    np.testing.assert_array_equal(H, H.T)
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.trace(H)
    assert np.linalg.eigvalsh(H[:6, :6]).min() > 0
    assert np.all(np.isfinite(g))


@pytest.mark.parametrize("direction", EVERY_DIRECTION)
def test_the_vector_changes_by_the_information_as_the_pose_does(direction: Array) -> None:
    H, _ = system(np.eye(4), zero_motion())
    (_, there), (_, back) = (
        system(series_exponential(s * SMALL * direction), zero_motion()) for s in (1, -1)
    )
    assert_alike(H[:, :6] @ direction, (there - back) / (2 * SMALL), H)


@pytest.mark.parametrize("direction", list(np.eye(9)))
def test_the_vector_changes_by_the_information_as_the_motion_does(direction: Array) -> None:
    H, _ = system(np.eye(4), zero_motion())
    # An acceleration has less effect than a velocity.
    step = 1.0 if direction[6:].any() else 0.01
    (_, there), (_, back) = (system(np.eye(4), s * step * direction) for s in (1, -1))
    assert_alike(H[:, 6:] @ direction, (there - back) / (2 * step), H)


def assert_alike(predicted: Array, true: Array, H: Array) -> None:
    """Compare in units of each direction's information; slopes have errors of some percent."""
    known = np.sqrt(np.maximum(np.diag(H), 1e-9 * np.trace(H)))
    off = np.linalg.norm((predicted - true) / known)
    assert off < 0.25 * np.linalg.norm(predicted / known)


def test_with_a_global_shutter_the_velocity_has_no_effect() -> None:
    samples = sample_points(POINTS, IMAGES, np.eye(4), zero_motion(), 0)
    H, g = expand_rolling_shutter(sum_up(samples, uniform_weights()), 0.0, 0.0)
    assert H[:6, :6].any()
    assert not H[:, 6:].any()
    assert not g[6:].any()


def test_cells_without_weight_have_no_effect() -> None:
    samples = sample_points(POINTS, IMAGES, np.eye(4), zero_motion(), 0)
    nothing = sum_up(samples, 0.0 * uniform_weights())
    by_depth, by_brightness = uniform_weights(), uniform_weights()
    by_depth[0] = by_brightness[1] = 0.0
    either = [sum_up(samples, weights).sum(axis=0) for weights in (by_depth, by_brightness)]
    both = sum_up(samples, uniform_weights()).sum(axis=0)
    assert not nothing.any()
    np.testing.assert_allclose(either[0] + either[1], both, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_brightness_and_sigmas_are_estimated(seed: int) -> None:
    random = np.random.default_rng(seed)
    samples = sample_points(POINTS, IMAGES, np.eye(4), zero_motion(), 0)
    n = len(POINTS[0].brightness)
    samples.brightness[:] = 1.3 * POINTS[0].brightness + random.normal(0.0, 5.0, n)
    samples.depth_residual[:] = random.normal(0.0, 2e-3, n)
    wrong = random.uniform(size=n) < 0.05
    samples.brightness[wrong] = 255.0
    weighted = weigh_samples(POINTS[0], samples, uniform_weights())
    residual_model = initial_residual_model(IMAGES, POINTS[0])
    for _ in range(20):
        residual_model = fit_residual_model(POINTS[0], weighted, residual_model)
    assert residual_model.gain == pytest.approx(1.3, abs=0.04)
    # The variance of Student's t is larger than its squared sigma.
    assert 3.0 < residual_model.sigma_brightness < 6.5
    assert 1.2e-3 < residual_model.sigma_depth < 2.3e-3


@pytest.mark.parametrize(("readings_each", "is_enough"), [(49, False), (50, True)])
def test_too_few_samples_change_nothing(readings_each: int, is_enough: bool) -> None:
    both = POINTS[0].has_texture & POINTS[0].has_shape
    chosen = both & (np.cumsum(both) <= readings_each)
    of_all = sample_points(POINTS, IMAGES, np.eye(4), zero_motion(), 0)
    samples = Samples._make(each[chosen] for each in of_all)
    points = POINTS[0].select(chosen)
    assert np.isfinite([samples.brightness, samples.depth_residual]).all()
    initial = initial_residual_model(IMAGES, POINTS[0])
    weighted = weigh_samples(points, samples, uniform_weights())
    residual_model = fit_residual_model(points, weighted, initial)
    assert (residual_model.sigma_brightness != initial.sigma_brightness) is is_enough
    assert (residual_model.sigma_depth != initial.sigma_depth) is is_enough
