"""Odometry by the name of its method, by the public interface."""

from pathlib import Path
from typing import Any

import pytest

from drivers import InputError
from drivers.registry import open_camera
from vo_service import make_odometry


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "slam"}, "method 'slam' is unknown; use one of surf, icp, sfm"),
        ({"feature_count": 0}, "feature_count 0: must be from 50 to 5000"),
        ({"profile": "tiny"}, "profile 'tiny' is unknown; use one of default, small"),
    ],
)
def test_a_wrong_option_is_an_error_with_what_is_right(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_odometry(**options)


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
