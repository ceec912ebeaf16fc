"""The virtual depth cameras: noise, holes and edges of each kind."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.rendered_sequences import render
from benchmarks.tracking import open_frames_with_truth
from benchmarks.virtual_sensors import (
    SensorKind,
    make_sensor,
    measure_near_range,
    measure_stereo,
    measure_time_of_flight,
)
from drivers.camera import PinholeCamera

GRAY = np.full((120, 160), 128, np.uint8)


def plane(depth_m: float) -> np.ndarray:
    return np.full((120, 160), depth_m, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.mark.parametrize("depth_m", [1.0, 3.0])
def test_stereo_noise_grows_with_the_square_of_the_depth(depth_m: float) -> None:
    textured = rng().integers(0, 255, GRAY.shape, np.uint8)
    measured_m = measure_stereo(plane(depth_m), textured, 5e-3, rng())
    error_m = measured_m[measured_m > 0] - depth_m
    assert error_m.std() == pytest.approx(5e-3 * depth_m**2, rel=0.2)


def test_stereo_has_holes_where_there_is_no_texture() -> None:
    measured_m = measure_stereo(plane(1.0), GRAY, 5e-3, rng())
    assert 0.05 < np.mean(measured_m == 0) < 0.4


def test_near_range_has_a_grid_of_holes_one_pixel_wide() -> None:
    measured_m = measure_near_range(plane(0.5), GRAY, 5e-3, rng())
    is_hole = measured_m == 0
    columns = is_hole.all(axis=0)
    assert 0.1 < np.mean(columns) < 0.3
    assert not np.any(columns[1:] & columns[:-1])


def test_time_of_flight_noise_is_larger_on_a_dark_surface() -> None:
    dark = np.full_like(GRAY, 30)
    bright_m, dark_m = (measure_time_of_flight(plane(2.0), g, 3e-3, rng()) for g in (GRAY, dark))
    assert dark_m[dark_m > 0].std() > 1.5 * bright_m[bright_m > 0].std()


def test_time_of_flight_measures_between_two_surfaces_at_their_edge() -> None:
    step_m = plane(1.0)
    step_m[:, 80:] = 2.0
    measured_m = measure_time_of_flight(step_m, GRAY, 2e-3, rng())
    assert np.any((measured_m > 1.2) & (measured_m < 1.8))


def test_the_kinds_take_turns_and_a_seed_gives_the_same_sensor() -> None:
    assert {make_sensor(seed).kind for seed in range(4)} == set(SensorKind)
    assert make_sensor(5) == make_sensor(5)


@pytest.mark.slow
def test_a_near_scene_is_rendered_with_its_truth_in_the_same_scale(
    tmp_path: Path,
) -> None:
    camera = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)
    sensor = make_sensor(2)
    config = replace(sensor.config, camera=camera, duration_s=0.2, texel_m=0.05)
    render(tmp_path / "near", replace(sensor, config=config))
    with open_frames_with_truth(tmp_path / "near") as (frames, _):
        depths_m = np.concatenate([frame.depth_m[frame.depth_m > 0] for frame in frames])
    assert 0.15 <= depths_m.min() < depths_m.max() <= 1.2
