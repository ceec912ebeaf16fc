"""The checks of the frames."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.camera import CameraCounters, TimingPrior, TimingSource
from drivers.core.geometry import rotation_from_quaternion
from tests.vo_service.learned_updates import LEARNED, SERIAL
from tests.vo_service.leveling.floor_views import floor_depth, make_view, mount
from tests.vo_service.tools.doctor.doctor_fakes import (
    PERIOD_S,
    make_capture,
    make_context,
    make_samples,
)
from vo_service.leveling.floor_plane import FloorPlane
from vo_service.sensor_memory import RememberedFocalLength, RememberedSensor
from vo_service.tools.doctor.check import CheckContext
from vo_service.tools.doctor.finding import CheckVerdict, Finding
from vo_service.tools.doctor.stream_checks import (
    check_clock_rate,
    check_first_frames,
    check_floor,
    check_focal_length,
    check_frame_rate,
    check_gravity,
    check_lost_packets,
    check_plausibility,
    check_skew,
    check_timing,
)
from vo_service.tools.doctor.stream_probe import StreamSample, find_floor

CHECKS = (
    check_first_frames,
    check_plausibility,
    check_frame_rate,
    check_lost_packets,
    check_skew,
    check_clock_rate,
    check_gravity,
    check_timing,
)


CheckFunction = Callable[[CheckContext], Finding]


def run_check(
    check: CheckFunction,
    stream: StreamSample,
    learned: Mapping[str, RememberedSensor] | None = None,
    source: str = "freenect",
) -> Finding:
    """Run one check on a stream."""
    context = make_context(stream=stream, source=source)
    return check(replace(context, find_learned=lambda: learned or {}))


def with_frames(**changes: Callable[[int], Any]) -> StreamSample:
    """Make a good camera's stream with changed fields."""
    return make_capture(make_samples(60, **changes))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_good_camera_passes(check: CheckFunction) -> None:
    assert run_check(check, make_capture()).verdict is CheckVerdict.PASS


def test_the_first_frames_are_reported_with_their_size_and_intrinsics() -> None:
    finding = run_check(check_first_frames, make_capture())
    assert finding.text == "color and depth, 640x480, after 1.2 s; intrinsics: factory"


@pytest.mark.parametrize(
    ("stream", "text", "fix"),
    [
        (
            make_capture([], error="no depth came; use another USB port"),
            "no depth came",
            "use another USB port",
        ),
        (
            make_capture([], error="no frame within 30 s"),
            "no frame within 30 s",
            "check its cable and power supply",
        ),
        (
            make_capture([], error="it sends nothing", skipped=58, lost_packets=290),
            "all 58 frames were discarded, because packets were lost (290)",
            "give the sensor a USB controller of its own",
        ),
        (StreamSample(counters=CameraCounters()), "the recording has no frame", ""),
    ],
)
def test_without_a_frame_the_error_and_its_advice_are_reported(
    stream: StreamSample, text: str, fix: str
) -> None:
    finding = run_check(check_first_frames, stream)
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, text)
    assert finding.fix.startswith(fix)


@pytest.mark.parametrize(
    ("stream", "text", "fix"),
    [
        (
            make_capture(error="unplugged; plug it in again"),
            "stopped after 60 frames: unplugged",
            "plug it in again",
        ),
        (  # what the driver does by itself is no advice
            make_capture(error="no depth for 1 s; it is opened again"),
            "stopped after 60 frames: no depth for 1 s",
            "check its cable",
        ),
        (
            with_frames(receive_time_s=lambda k: k / 20),
            "20.0 frames a second over 60 frames; the sensor makes 30",
            "",
        ),
    ],
)
def test_a_stream_that_stops_or_is_slow_fails(stream: StreamSample, text: str, fix: str) -> None:
    finding = run_check(check_frame_rate, stream)
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, text)
    assert finding.fix.startswith(fix)


def test_a_recording_may_have_any_rate() -> None:
    slow = with_frames(receive_time_s=lambda k: k / 3)
    assert run_check(check_frame_rate, slow, source="tum:desk").verdict is CheckVerdict.PASS


@pytest.mark.parametrize(
    ("skipped", "verdict"),
    [(0, CheckVerdict.WARNING), (1, CheckVerdict.FAIL), (20, CheckVerdict.FAIL)],
)
def test_lost_packets_count_by_the_discarded_frames(skipped: int, verdict: CheckVerdict) -> None:
    finding = run_check(check_lost_packets, make_capture(skipped=skipped, lost_packets=40))
    assert finding.verdict is verdict
    assert finding.facts == {"lost_packets": 40, "skipped_frames": skipped}


@pytest.mark.parametrize(("skipped", "verdict"), [(0, "pass"), (1, "pass"), (30, "warning")])
def test_frames_without_a_partner_are_no_lost_packets(skipped: int, verdict: str) -> None:
    stream = make_capture(make_samples(120), skipped=skipped)
    assert run_check(check_lost_packets, stream).verdict == verdict


def test_implausible_depth_is_a_warning_with_the_plausible_value() -> None:
    text = "desk: depth_factor = 5000 gives a median depth of 0.4 m; 1000 would give 2 m"
    finding = run_check(check_plausibility, replace(make_capture(), implausible=text))
    assert (finding.verdict, finding.fix) == (CheckVerdict.WARNING, "1000 would give 2 m")


def test_a_skew_beyond_half_a_frame_is_a_warning() -> None:
    finding = run_check(check_skew, with_frames(skew_s=lambda k: -0.021))
    assert finding.verdict is CheckVerdict.WARNING
    assert "21.0 ms apart" in finding.text


@pytest.mark.parametrize(
    ("offset_s", "source", "verdict"),
    [
        (0.003, TimingSource.CAMERA_FILE, CheckVerdict.WARNING),
        (-0.002, TimingSource.CAMERA_FILE, CheckVerdict.PASS),
        (0.003, TimingSource.SENSOR, CheckVerdict.PASS),
    ],
)
def test_a_camera_file_that_contradicts_what_was_learned_is_a_warning(
    offset_s: float, source: TimingSource, verdict: CheckVerdict
) -> None:
    told = TimingPrior(offset_s, 0.001, 0.0005, source)
    stream = with_frames(timing_prior=lambda k: told)
    finding = run_check(check_timing, stream, {SERIAL: LEARNED})
    assert finding.verdict is verdict
    assert f"depth offset {1e3 * offset_s:.1f} ± 0.5 ms ({source})" in finding.text
    assert "learned: readout 30.5 ± 1.2 ms, depth offset -2.7 ± 0.6 ms" in finding.text
    if verdict is CheckVerdict.WARNING:
        assert f"--save-learned --serial {SERIAL} --camera-file" in finding.fix


def test_another_sensor_has_nothing_learned() -> None:
    stream = with_frames(serial=lambda k: "B2")
    finding = run_check(check_timing, stream, {SERIAL: LEARNED})
    assert finding.text.endswith("(usual for the sensor); nothing learned of this sensor yet")


@pytest.mark.parametrize(
    ("source", "scale", "verdict"),
    [
        ("camera file c.toml", 1.04, CheckVerdict.WARNING),
        ("camera file c.toml", 1.02, CheckVerdict.PASS),
        ("factory", 1.04, CheckVerdict.PASS),
    ],
)
def test_a_camera_file_that_contradicts_the_learned_focal_length_is_a_warning(
    source: str, scale: float, verdict: CheckVerdict
) -> None:
    learned = RememberedFocalLength(525.0, scale, 0.006, -0.08)
    stream = replace(make_capture(), intrinsics_source=source)
    sensor = replace(LEARNED, focal_length=learned)
    finding = run_check(check_focal_length, stream, {SERIAL: sensor})
    assert finding.verdict is verdict
    assert f"learned: {525 * scale:.1f} ± 5.2 px; by depth -8.0% against" in finding.text
    if verdict is CheckVerdict.WARNING:
        assert f"--save-learned --serial {SERIAL} --camera-file c.toml" in finding.fix


def test_a_focal_length_is_not_learned_until_it_is_certain() -> None:
    finding = run_check(check_focal_length, make_capture(), {SERIAL: LEARNED})
    assert finding.text == "525.0 px (factory); nothing learned of this sensor yet"


@pytest.mark.parametrize(
    ("rate", "verdict"), [(1.001, CheckVerdict.PASS), (1.03, CheckVerdict.FAIL)]
)
def test_the_devices_clock_is_compared_with_ours(rate: float, verdict: CheckVerdict) -> None:
    finding = run_check(check_clock_rate, with_frames(device_stamp_s=lambda k: rate * k * PERIOD_S))
    assert finding.verdict is verdict
    assert finding.facts["rate"] == pytest.approx(rate, abs=1e-6)


def test_without_a_device_clock_the_stamps_are_compared_with_ours() -> None:
    stream = with_frames(device_stamp_s=lambda k: None, stamp_s=lambda k: 0.5 * k * PERIOD_S)
    finding = run_check(check_clock_rate, stream)
    assert (finding.verdict, finding.facts["rate"]) == (CheckVerdict.FAIL, pytest.approx(0.5))


@pytest.mark.parametrize(
    "check", [check_frame_rate, check_clock_rate], ids=lambda check: check.__name__
)
def test_few_frames_give_no_rate(check: CheckFunction) -> None:
    assert run_check(check, make_capture(make_samples(3))).verdict is CheckVerdict.UNKNOWN


@pytest.mark.parametrize(
    ("gravity_m_s2", "text"),
    [
        ((0.0, 9.81, 0.0), "9.81 m/s²; the camera is level"),
        ((0.0, 8.5, 4.9), "looks 30° down"),
        ((0.0, 8.5, -4.9), "looks 30° up"),
        ((4.9, 8.5, 0.0), "rolled 30° to the right"),
        ((-4.9, 8.5, 0.0), "rolled 30° to the left"),
    ],
)
def test_gravity_gives_the_cameras_tilt(
    gravity_m_s2: tuple[float, float, float], text: str
) -> None:
    finding = run_check(check_gravity, with_frames(gravity_m_s2=lambda k: gravity_m_s2))
    assert finding.verdict is CheckVerdict.PASS
    assert text in finding.text


def test_a_push_is_not_gravity_and_only_an_accelerometer_must_measure_it() -> None:
    pushed = with_frames(gravity_m_s2=lambda k: (0.0, 14.0, 0.0))
    assert run_check(check_gravity, pushed).verdict is CheckVerdict.WARNING
    stream = with_frames(gravity_m_s2=lambda k: None)
    assert run_check(check_gravity, stream).verdict is CheckVerdict.WARNING
    assert run_check(check_gravity, stream, source="openni2").verdict is CheckVerdict.UNKNOWN


def test_the_floor_in_view_tells_the_mount_of_the_camera() -> None:
    assert run_check(check_floor, with_frames()).verdict is CheckVerdict.UNKNOWN
    down_rad = math.radians(12.0)
    floor = FloorPlane(np.array([0.0, -math.cos(down_rad), -math.sin(down_rad)]), 0.62, 500)
    finding = run_check(check_floor, replace(with_frames(), floors=(floor,) * 6))
    assert finding.verdict is CheckVerdict.PASS
    assert finding.text.startswith("0.62 m below the camera, which looks 12° down; in T_base_")
    quaternion_xyzw: Any = finding.facts["quaternion_xyzw"]
    R_base_camera = rotation_from_quaternion(quaternion_xyzw)
    np.testing.assert_allclose(R_base_camera @ floor.up, [0.0, 0.0, 1.0], atol=1e-3)


@pytest.mark.parametrize("has_gravity", [True, False])
def test_the_floor_is_found_with_and_without_an_accelerometer(has_gravity: bool) -> None:
    up = mount(0.8, 0.4)[2, :3]
    frame = make_view(floor_depth(up, 0.8), up=up if has_gravity else None)
    floor = find_floor(frame)
    assert floor is not None
    assert floor.height_m == pytest.approx(0.8, abs=0.01)
