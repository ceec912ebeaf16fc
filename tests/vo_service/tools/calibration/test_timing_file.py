"""Change of the timing in a camera file."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.calibration import (
    TUM_CALIBRATIONS,
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
    format_calibration,
    read_calibration,
)
from drivers.core.config import parse_toml
from drivers.core.errors import InputError, UserFacingError
from vo_service.tools.calibration.timing import SensorTiming, make_timing
from vo_service.tools.calibration.timing_file import replace_timing, save_timing

CAMERA = replace(
    TUM_CALIBRATIONS["1"],
    readout_s=0.01,
    depth=DepthCameraCalibration(
        580.0, 580.0, 320.0, 240.0, RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    ),
)
TIMING = make_timing(0.0203, -0.0012, 0.0011, 0.0006)
sigmas = st.floats(0.0, 0.05)
timings = st.builds(make_timing, st.floats(0.0, 0.05), st.floats(-0.05, 0.05), sigmas, sigmas)


@given(timings)
def test_other_values_do_not_change(timing: SensorTiming) -> None:
    text = replace_timing(format_calibration(CAMERA), timing)
    readout, offset = timing["readout_s"], timing["depth_offset_s"]
    changed = replace(
        CAMERA,
        readout_s=readout.value_s,
        readout_sigma_s=readout.sigma_s,
        depth_offset_s=offset.value_s,
        depth_offset_sigma_s=offset.sigma_s,
    )
    assert parse_toml(text, "camera.toml", CameraCalibration) == changed


def test_comments_and_order_stay_and_missing_keys_follow_the_schema() -> None:
    text = replace_timing(
        "# mine\nschema = 1\nwidth = 640 # wide\nreadout_s = 3e-3 # guessed\n"
        "depth_offset_sigma_s = 0.02 # stale\n[depth]\nfx = 5\n",
        TIMING,
    )
    assert text == (
        "# mine\nschema = 1\nreadout_sigma_s = 0.0011\ndepth_offset_s = -0.0012\n"
        "width = 640 # wide\nreadout_s = 0.0203  # guessed\n"
        "depth_offset_sigma_s = 0.0006  # stale\n[depth]\nfx = 5\n"
    )


def test_an_existing_file_is_kept_as_a_backup(tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(format_calibration(CAMERA))
    backup = save_timing(file, CAMERA, TIMING, "heading")
    assert backup is not None
    assert read_calibration(backup) == CAMERA
    assert read_calibration(file).readout_s == 0.0203


def test_a_new_file_has_the_fallback_camera(tmp_path: Path) -> None:
    file = tmp_path / "new.toml"
    assert save_timing(file, CAMERA, TIMING, "found today") is None
    assert file.read_text().startswith("# found today\n")
    assert read_calibration(file) == replace(
        CAMERA,
        readout_s=0.0203,
        readout_sigma_s=0.0011,
        depth_offset_s=-0.0012,
        depth_offset_sigma_s=0.0006,
    )


def test_another_file_or_a_full_disk_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other.toml"
    other.write_text("schema = 1\ncolor = 'red'\n")
    with pytest.raises(InputError, match=r"other\.toml"):
        save_timing(other, CAMERA, TIMING, "")
    assert other.read_text() == "schema = 1\ncolor = 'red'\n"

    def raise_disk_full(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("vo_service.tools.calibration.output_files.atomic_write", raise_disk_full)
    with pytest.raises(UserFacingError, match="the disk is full"):
        save_timing(tmp_path / "new.toml", CAMERA, TIMING, "")
