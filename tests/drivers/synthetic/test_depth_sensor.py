from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.synthetic.config import DepthSensorModel
from drivers.synthetic.sensors import measure_depth, register_depth

QUIET = DepthSensorModel(
    shadows=False, disparity_step_px=0, disparity_sigma_px=0, lateral_sigma_px=0
)
FREIBURG1 = np.array([0.2624, -0.9531, -0.0054, 0.0026, 1.1633])
COLOR = (525.0, 525.0, 319.5, 239.5)
INFRARED = (580.0, 319.5, 239.5)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def flat(z_m: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.full((480, 640), z_m, dtype=np.float32)


def test_without_faults_it_reads_the_truth() -> None:
    np.testing.assert_allclose(measure_depth(flat(1.7), QUIET, rng()), 1.7, rtol=1e-6)


def test_disparity_comes_in_eighths_of_a_pixel() -> None:
    slope = (1 / np.linspace(1 / 4.5, 1 / 0.8, 640)).astype(np.float32) * flat(1.0)
    read_m = measure_depth(slope, replace(QUIET, disparity_step_px=1 / 8), rng())
    eighths = 8 * 580 * 0.075 / read_m
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-4)
    assert len(np.unique(read_m)) == pytest.approx(8 * 43.5 * (1 / 0.8 - 1 / 4.5), abs=2)


def test_noise_grows_with_the_square_of_distance() -> None:
    noisy = replace(QUIET, disparity_sigma_px=0.05)
    sigma = [float(np.std(measure_depth(flat(z), noisy, rng()))) for z in (1.0, 2.0, 4.0)]
    assert sigma[0] == pytest.approx(0.05 / 43.5, rel=0.05)
    assert sigma[1] / sigma[0] == pytest.approx(4.0, rel=0.05)
    assert sigma[2] / sigma[0] == pytest.approx(16.0, rel=0.05)


def test_nothing_is_read_out_of_range() -> None:
    for z_m, seen in ((0.45, False), (0.55, True), (4.95, True), (5.05, False)):
        assert np.all((measure_depth(flat(z_m), QUIET, rng()) > 0) == seen)


def test_the_projector_s_shadow_lies_left_of_what_is_nearer() -> None:
    """Its width is the difference of the disparities: 43.5 px m (1 / 1 m - 1 / 2 m)."""
    scene = flat(2.0)
    scene[:, 300:400] = 1.0
    hidden = measure_depth(scene, replace(QUIET, shadows=True), rng()) == 0
    assert not hidden[:, 300:].any()
    assert not hidden[:, :277].any()
    assert hidden[:, 279:299].all()


def test_edges_are_ragged_and_flat_surfaces_are_not() -> None:
    scene = flat(2.0)
    scene[:, 320:] = 1.0
    frayed = measure_depth(scene, replace(QUIET, lateral_sigma_px=0.7), rng())
    assert len(np.unique((frayed == 1.0).sum(axis=1))) > 2
    np.testing.assert_array_equal(frayed[:, :310], scene[:, :310])


@pytest.mark.parametrize("distortion", [np.zeros(5), FREIBURG1])
def test_a_reading_is_registered_where_its_point_falls(
    distortion: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> None:
    for u, v, z_m in ((100, 80, 0.7), (320, 240, 1.5), (560, 400, 3.0)):
        read = np.zeros((480, 640), dtype=np.float32)
        read[v, u] = z_m
        point = np.array([(u - 319.5) / 580 * z_m, (v - 239.5) / 580 * z_m, z_m])
        K = np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]])
        at, _ = cv2.projectPoints(point[None], np.zeros(3), np.array([-0.025, 0, 0]), K, distortion)
        column, row = np.rint(at.ravel()).astype(int)
        registered = register_depth(read, INFRARED, COLOR, distortion, 0.025, 1000.0)
        assert registered[row, column] == round(z_m * 1000)
        assert np.count_nonzero(registered) == 1


def test_where_two_readings_fall_on_one_pixel_the_nearer_wins() -> None:
    """At 0.5 m the infrared camera's parallax is 21 px larger than at 1 m: both hit column 290."""
    read = np.zeros((480, 640), dtype=np.float32)
    hits: dict[int, dict[float, int]] = {}
    for column in range(290, 340):
        for z_m in (0.5, 1.0):
            x = (column - 319.5) / 580 - 0.025 / z_m
            hits.setdefault(int(np.floor(525 * x + 320)), {})[z_m] = column
    both = next(columns for columns in hits.values() if len(columns) == 2)
    for z_m, column in both.items():
        read[240, column] = z_m
    registered = register_depth(read, INFRARED, COLOR, np.zeros(5), 0.025, 1000.0)
    assert registered[registered > 0].tolist() == [500]
