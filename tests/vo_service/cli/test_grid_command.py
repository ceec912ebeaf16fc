"""``kinect-vo grid``: its options and wrong input; the cells have tests of their own."""

from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError
from tests.vo_service.navigation.views import mounted
from vo_service.cli.grid import GridRequest, _with_mounting, run
from vo_service.config import Config


def test_the_options_place_the_camera(tmp_path: Path) -> None:
    request = GridRequest(
        folder=tmp_path, output=tmp_path / "map", camera_height=1.2, camera_tilt=25.0
    )
    T_base_camera = _with_mounting(Config(), request).T_base_camera.T_base_camera
    np.testing.assert_allclose(T_base_camera, mounted(1.2, 25.0), atol=1e-12)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(None, None), (0.0, 10.0), (1.2, -30.0)])
def test_a_mounting_that_cannot_work_is_refused(
    tmp_path: Path, height_m: float | None, tilt_deg: float | None
) -> None:
    request = GridRequest(
        folder=tmp_path, output=tmp_path / "map", camera_height=height_m, camera_tilt=tilt_deg
    )
    with pytest.raises(InputError, match="--camera-height and --camera-tilt"):
        run(request)
    assert not (tmp_path / "map").exists()
