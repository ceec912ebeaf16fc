"""A sensor's timing: its values, and its change in a camera file."""

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
from drivers.core import InputError
from drivers.core.config import parse_toml
from vo_service.tools.calibration.timing import (
    USUAL_TIMING,
    SensorTiming,
    TimingValue,
    combine,
    file_values,
    make_timing,
    replace_values,
    save_timing,
    select_changes,
    told_timing,
)

UNTOLD = TUM_CALIBRATIONS["1"]
MEASURED = make_timing(0.0272, -0.0021, 0.0022, 0.0035)
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


def test_a_measurement_is_combined_with_the_usual_values() -> None:
    combined = combine(MEASURED, USUAL_TIMING)
    assert combined["readout_s"].value_s == pytest.approx(0.0276, abs=1e-4)
    assert combined["readout_s"].sigma_s == pytest.approx(0.00193, abs=1e-5)
    assert combined["depth_offset_s"].sigma_s == pytest.approx(0.00287, abs=1e-5)


def test_a_kinect_whose_file_tells_nothing_has_the_usual_values() -> None:
    assert told_timing(UNTOLD, is_kinect=True) == USUAL_TIMING
    assert told_timing(UNTOLD) == make_timing(0.0, 0.0, 0.03, 0.01)


def test_a_sigma_of_zero_is_exact() -> None:
    exact = replace(UNTOLD, readout_sigma_s=0.0, depth_offset_sigma_s=0.0)
    assert told_timing(exact, is_kinect=True) == make_timing(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("told", "changes"),
    [
        (
            make_timing(0.029, 0.0, 0.001, 0.005),  # a more certain readout
            {"depth_offset_s": TimingValue(-0.0021, 0.0035)},
        ),
        (
            make_timing(0.019, 0.0, 0.001, 0.001),  # a contradicted readout
            {"readout_s": TimingValue(0.0272, 0.0022)},
        ),
        (MEASURED, MEASURED),
    ],
)
def test_only_what_becomes_more_certain_or_is_contradicted_is_saved(
    told: SensorTiming, changes: SensorTiming
) -> None:
    assert select_changes(told, MEASURED) == changes


def test_a_negative_readout_is_zero() -> None:
    told = make_timing(0.0, 0.0, 0.03, 0.01)
    changes = select_changes(told, make_timing(-0.0004, 0.0, 0.001, 0.001))
    assert changes["readout_s"] == TimingValue(0.0, 0.001)


@given(timings)
def test_other_values_do_not_change(timing: SensorTiming) -> None:
    text = replace_values(format_calibration(CAMERA), file_values(timing))
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
    text = replace_values(
        "# mine\nschema = 1\nwidth = 640 # wide\nreadout_s = 3e-3 # guessed\n"
        "depth_offset_sigma_s = 0.02 # stale\n[depth]\nfx = 5\n",
        file_values(TIMING),
    )
    assert text == (
        "# mine\nschema = 1\nreadout_sigma_s = 0.0011\ndepth_offset_s = -0.0012\n"
        "width = 640 # wide\nreadout_s = 0.0203  # guessed\n"
        "depth_offset_sigma_s = 0.0006  # stale\n[depth]\nfx = 5\n"
    )


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


def test_another_file_is_an_error(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text("schema = 1\ncolor = 'red'\n")
    with pytest.raises(InputError, match=r"other\.toml"):
        save_timing(other, CAMERA, TIMING, "")
    assert other.read_text() == "schema = 1\ncolor = 'red'\n"
