"""``kinect-vo grid``: its options and wrong input; the cells have tests of their own."""

import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.navigation.views import mounted
from vo_service.cli import grid
from vo_service.cli.grid import FILES, GridRequest, _with_mounting, run
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


@pytest.mark.parametrize("name", FILES)
def test_a_map_that_is_there_is_not_replaced(tmp_path: Path, recording: Path, name: str) -> None:
    (tmp_path / name).write_text("precious")
    request = GridRequest(folder=recording, output=tmp_path, camera_height=1.0, camera_tilt=20.0)
    with pytest.raises(InputError, match=f"{name}: exists already"):
        run(request)
    assert (tmp_path / name).read_text() == "precious"


@pytest.mark.parametrize("is_there", [False, True])
def test_a_recording_that_shows_no_place_leaves_no_new_folder(
    blind_recording: Path, tmp_path: Path, kinect_vo: KinectVo, is_there: bool
) -> None:
    if is_there:
        (tmp_path / "map").mkdir()
    place = ("--camera-height", 1.0, "--camera-tilt", 20.0)
    outcome = kinect_vo("grid", blind_recording, tmp_path / "map", *place)
    assert_one_line(outcome, 2, "no floor and no obstacle was seen")
    assert (tmp_path / "map").exists() is is_there


def test_ctrl_c_before_anything_is_seen_is_no_mistake_of_the_recording(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, recording: Path
) -> None:
    interrupt = partial(signal.raise_signal, signal.SIGINT)
    monkeypatch.setattr(grid, "prepare_kernels", lambda *_: interrupt())
    output = tmp_path / "map"
    request = GridRequest(folder=recording, output=output, camera_height=1.0, camera_tilt=20.0)
    assert run(request) == 130
    assert not output.exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--camera-height", "nan"), ("--camera-tilt", "nan"), ("--camera-tilt", "95")],
)
def test_a_place_that_no_camera_has_is_refused(
    kinect_vo: KinectVo, option: str, value: str
) -> None:
    outcome = kinect_vo("grid", "recording", "map", option, value)
    assert outcome.code == 2
    assert f"argument {option}: {value} is not a" in outcome.error_lines
