"""A plane around a pixel of an inverse depth image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.odometry.depth_planes import fit_plane

WIDTH, HEIGHT = 40, 30


@kernel
def fitted(
    inverse_depth: NDArray[np.float32], column: int, row: int, least_support: float
) -> tuple[float, float, float, float]:
    """Over seven by seven readings, every second pixel; a surface has no step of 0.05 in it."""
    return fit_plane(inverse_depth, column, row, 3, 2, 0.05, least_support)


def plane(w: float, wu: float, wv: float) -> NDArray[np.float32]:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    readings: NDArray[np.float32] = (w + wu * (u - 20) + wv * (v - 15)).astype(np.float32)
    return readings


SLOPES = st.floats(-2e-3, 2e-3)


@settings(max_examples=30)
@given(st.floats(0.3, 1.5), SLOPES, SLOPES)
def test_a_tilted_plane_is_fitted_exactly(w: float, wu: float, wv: float) -> None:
    found = fitted(plane(w, wu, wv), 20, 15, 0.6)
    np.testing.assert_allclose(found, [w, wu, wv, 0.0], atol=3e-7)


def test_a_plane_is_the_same_away_from_the_image_center() -> None:
    w, wu, wv, _ = fitted(plane(0.5, 1e-3, -2e-3), 8, 22, 0.6)
    np.testing.assert_allclose([w, wu, wv], [0.5 - 12e-3 - 14e-3, 1e-3, -2e-3], atol=3e-7)


def test_the_residual_is_the_mean_square_of_the_noise() -> None:
    random = np.random.default_rng(2)
    squares = []
    for _ in range(200):
        noise = random.normal(0.0, 1e-3, (HEIGHT, WIDTH)).astype(np.float32)
        squares.append(fitted(plane(0.5, 1e-3, 0.0) + noise, 20, 15, 0.6)[3])
    # 49 readings, 3 of which the plane follows.
    assert np.mean(squares) == pytest.approx(1e-6 * 46 / 49, rel=0.05)


def test_another_surface_behind_does_not_change_the_plane() -> None:
    image = plane(0.8, 1e-3, 1e-3)
    image[:, 23:] = 0.4
    np.testing.assert_allclose(fitted(image, 20, 15, 0.6), [0.8, 1e-3, 1e-3, 0.0], atol=3e-7)


def test_holes_are_ignored() -> None:
    image = plane(0.8, 1e-3, 1e-3)
    image[::3] = 0.0
    np.testing.assert_allclose(fitted(image, 20, 16, 0.6), [0.801, 1e-3, 1e-3, 0.0], atol=3e-7)


@pytest.mark.parametrize("column", [10, 30])
def test_too_few_samples_of_one_surface_give_no_plane(column: int) -> None:
    image = plane(0.8, 0.0, 0.0)
    image[:, column:] = 0.0
    # Of seven columns those before the edge are left: four of them, or none.
    assert fitted(image, column - 1, 15, 0.5)[0] == pytest.approx(0.8)
    assert fitted(image, column - 1, 15, 0.6) == (0.0, 0.0, 0.0, 0.0)
    assert fitted(image, column, 15, 0.0) == (0.0, 0.0, 0.0, 0.0)


def test_collinear_samples_give_no_plane() -> None:
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    image[15] = 0.7
    assert fitted(image, 20, 15, 0.0) == (0.0, 0.0, 0.0, 0.0)
