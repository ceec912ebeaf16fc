"""Implausible intrinsics and depth are named with the plausible value; real recordings are not."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, PlaybackMode
from drivers.core import InputError
from drivers.plausibility import (
    KINECT_STEP_PER_M,
    PlausibilityCheck,
    find_intrinsics_error,
    find_unit_fault,
    measure_depth_step,
)
from drivers.playback.camera import RecordingCamera
from drivers.playback.frame_reader import log_implausible
from drivers.playback.recording_formats import open_recording
from tests.drivers.conftest import FolderMaker, make_frame

KINECT = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
DATA = os.environ.get("KINECT_VO_DATA")
RECORDINGS = sorted(Path(DATA).glob("*/camera.toml")) if DATA else []
needs_data = pytest.mark.skipif(not RECORDINGS, reason="KINECT_VO_DATA names no recordings")


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"fx": 3.6}, "fx"),  # millimeters
        ({"fy": 0.8}, "fy"),  # a fraction of the height
        ({"fx": 5250.0}, "fx"),
        ({"cx": 0.5}, "cx"),  # a fraction of the width
        ({"cx": 960.0}, "cx"),  # of larger images
        ({"cy": -3.0}, "cy"),
    ],
)
def test_impossible_intrinsics_are_named_with_a_plausible_value(
    changes: dict[str, Any], key: str
) -> None:
    error = find_intrinsics_error(replace(KINECT, **changes))
    assert error is not None
    assert error[0] == key
    assert {"fx": "about 525", "fy": "about 525", "cx": "about 320", "cy": "about 240"}[
        key
    ] in error[1]


@pytest.mark.parametrize(
    "camera",
    [KINECT, PinholeCamera(540, 360, 495.6, 495.5, 269.5, 169.2), PinholeCamera(8, 6, 8, 8, 3, 2)],
)
def test_usual_intrinsics_are_possible(camera: PinholeCamera) -> None:
    assert find_intrinsics_error(camera) is None


def test_a_camera_file_in_millimeters_is_refused_with_file_line_and_key(
    make_folder: FolderMaker,
) -> None:
    folder = make_folder()
    file = folder / "camera.toml"
    file.write_text(file.read_text().replace("fx = 60.0", "fx = 3.6"))
    with pytest.raises(InputError, match=r"camera.toml:4: key `fx`: 3.6 pixels .*about 52"):
        open_recording(folder)


def kinect_depth_m(farthest_m: float = 4.0) -> NDArray[np.float64]:
    """A slope from 0.8 m, at the distances that a Kinect can measure."""
    depth_m = np.linspace(0.8, farthest_m, 640 * 480).reshape(480, 640)
    return 1.0 / (np.rint(1.0 / depth_m / KINECT_STEP_PER_M) * KINECT_STEP_PER_M)


def histogram_of(depth_m: NDArray[np.float64], factor: float) -> NDArray[np.int64]:
    values = np.rint(depth_m * factor).astype(np.int64).ravel()
    return np.bincount(values[values < 65536], minlength=65536)


@pytest.mark.parametrize("factor", [1000.0, 5000.0])
def test_the_steps_of_a_kinect_are_measured(factor: float) -> None:
    step_per_m = measure_depth_step(histogram_of(kinect_depth_m(), factor), factor)
    assert step_per_m == pytest.approx(KINECT_STEP_PER_M, rel=0.03)


def test_a_sensor_with_equal_steps_has_none_of_a_kinect() -> None:
    depth_m = np.linspace(0.3, 1.2, 640 * 480)
    assert measure_depth_step(histogram_of(depth_m, 1000.0), 1000.0) is None


@pytest.mark.parametrize("has_steps", [True, False])
@pytest.mark.parametrize(("stored", "read"), [(1000.0, 5000.0), (5000.0, 1000.0)])
def test_depth_in_another_unit_is_named_with_the_plausible_factor(
    stored: float, read: float, has_steps: bool
) -> None:
    depth_m = kinect_depth_m() if has_steps else np.linspace(0.8, 4.0, 640 * 480)
    histogram = histogram_of(depth_m, stored)
    assert find_unit_fault(histogram, stored) == ""
    assert f"depth_factor = {stored:g} in a camera file would give 2.4 m" in find_unit_fault(
        histogram, read
    )


def test_steps_of_a_kinect_show_that_a_far_wall_is_no_wrong_unit() -> None:
    histogram = histogram_of(kinect_depth_m(9.5) + 0.0, 1000.0)
    far = np.where(np.arange(65536) > 4000, histogram, 0)
    assert find_unit_fault(far, 1000.0) == ""


def test_holes_stored_as_a_large_value_are_named_once(
    make_folder: FolderMaker, caplog: pytest.LogCaptureFixture
) -> None:
    camera = RecordingCamera(make_folder(), None, PlaybackMode.LOCKSTEP)
    depth = np.full((48, 64), 1500, np.uint16)
    depth[:20] = 60000
    check = PlausibilityCheck(camera)
    for seq in range(100):
        check.add(make_frame(seq, depth_raw=depth, depth_factor=1000.0))
    (line,) = caplog.messages
    assert line == check.warning
    assert "42% of the depth is beyond 10 m, most often the value 60000" in line


def test_a_crop_is_a_warning(make_folder: FolderMaker) -> None:
    folder = make_folder()
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        check = PlausibilityCheck(camera)
        check.add(make_frame(camera=PinholeCamera(64, 48, 60.0, 60.0, 10.0, 23.5)))
    assert f"camera file {folder / 'camera.toml'}: cx = 10 is far from the center" in check.warning


def test_65535_is_no_reading() -> None:
    depth = np.full((48, 64), 65535, np.uint16)
    depth[0, 0] = 1500
    frame = make_frame(depth_raw=depth)
    assert frame.depth_raw.max() == 1500
    assert np.count_nonzero(frame.depth_m) == 1
    assert depth.max() == 65535  # readers share the array


@needs_data
@pytest.mark.parametrize("file", RECORDINGS, ids=lambda file: file.parent.name)
def test_real_recordings_are_plausible(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    log_implausible(open_recording(file.parent))
    assert caplog.messages == []


@needs_data
@pytest.mark.parametrize("file", RECORDINGS, ids=lambda file: file.parent.name)
def test_real_recordings_in_another_unit_are_named(
    file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = file.read_text()
    stored, read = ("1000", "5000") if "depth_factor = 1000" in text else ("5000", "1000")
    other = tmp_path / "other.toml"
    other.write_text(text.replace(f"depth_factor = {stored}", f"depth_factor = {read}"))
    log_implausible(open_recording(file.parent, other))
    (line,) = caplog.messages
    assert f"depth_factor = {read} (camera file {other}) gives a median depth of" in line
    assert f"depth_factor = {stored} in a camera file would give" in line
