"""Odometry by the name of its method, by the public interface."""

from pathlib import Path

import numpy as np
import pytest

from drivers import InputError
from drivers.registry import open_camera
from vo_service import METHODS, make_odometry


def test_an_unknown_method_is_an_error_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="method 'slam' is unknown; use one of surf, icp, sfm"):
        make_odometry("slam")


def test_a_number_of_features_out_of_range_is_an_error() -> None:
    with pytest.raises(InputError, match="feature_count 0: must be from 50 to 5000"):
        make_odometry(feature_count=0)


def test_an_unknown_profile_is_an_error_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="profile 'tiny' is unknown; use one of default, small"):
        make_odometry(profile="tiny")


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_first_frame_is_the_origin_of_every_method(recording: Path, method: str) -> None:
    with open_camera(f"tum:{recording}") as camera:
        estimate = make_odometry(method).estimate(next(iter(camera)))
    np.testing.assert_array_equal(estimate.T_world_camera, np.eye(4))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_same_frames_give_the_same_bits(recording: Path, method: str) -> None:
    bits = []
    for _ in range(2):
        odometry = make_odometry(method)
        with open_camera(f"tum:{recording}") as camera:
            estimates = [odometry.estimate(frame) for frame in camera]
        bits.append([(e.T_world_camera.tobytes(), e.covariance.tobytes()) for e in estimates])
    assert bits[0] == bits[1]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["direct", "surf"])
def test_an_odometry_tracks_the_camera(recording: Path, method: str) -> None:
    odometry = make_odometry(method)
    with open_camera(f"tum:{recording}") as camera:
        estimates = [odometry.estimate(frame) for frame in camera]
        assert camera.ground_truth is not None
        truth_m = camera.ground_truth.T_world_camera[-1][:3, 3]
    assert all(estimate.ok for estimate in estimates)
    assert estimates[-1].T_world_camera[:3, 3] == pytest.approx(truth_m, abs=0.01)
