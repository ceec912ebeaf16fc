"""What the doctor says of the frames that came."""

from collections.abc import Callable
from typing import Any

import pytest

from drivers.camera import CameraCounters
from tests.vo_service.tools.doctor.doctor_fakes import (
    PERIOD_S,
    make_capture,
    make_context,
    make_samples,
)
from vo_service.tools.doctor.finding import Check, CheckVerdict, Finding
from vo_service.tools.doctor.stream import FirstFramesCheck, FrameRateCheck, LostPacketsCheck
from vo_service.tools.doctor.stream_probe import StreamSample
from vo_service.tools.doctor.timing import ClockRateCheck, GravityCheck, SkewCheck

CHECKS = (
    FirstFramesCheck(),
    FrameRateCheck(30.0),
    LostPacketsCheck(),
    SkewCheck(),
    ClockRateCheck(),
    GravityCheck(True),
)


def judged(check: Check, seen: StreamSample) -> Finding:
    """One check's finding."""
    return check.run(make_context(seen=seen))


def with_frames(**changes: Callable[[int], Any]) -> StreamSample:
    """A good camera's frames, changed in one thing."""
    return make_capture(make_samples(60, **changes))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_a_good_camera_passes(check: Check) -> None:
    assert judged(check, make_capture()).verdict is CheckVerdict.PASS


def test_no_frame_says_why_and_what_to_do() -> None:
    finding = judged(
        FirstFramesCheck(), make_capture([], trouble="no depth came; use another USB port")
    )
    assert finding.verdict is CheckVerdict.FAIL
    assert (finding.text, finding.fix) == ("no depth came", "use another USB port")


def test_no_frame_without_advice_is_advised() -> None:
    finding = judged(FirstFramesCheck(), make_capture([], trouble="no frame within 30 s"))
    assert finding.text == "no frame within 30 s"
    assert finding.fix.startswith("check its cable and power supply")


def test_a_stream_that_stops_is_said_with_its_frames() -> None:
    finding = judged(FrameRateCheck(30.0), make_capture(trouble="unplugged; plug it in again"))
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text == "stopped after 60 frames: unplugged"
    assert finding.fix == "plug it in again"


def test_too_few_frames_a_second_fail() -> None:
    finding = judged(FrameRateCheck(30.0), with_frames(receive_time_s=lambda k: k / 20))
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text == "20.0 frames a second over 60 frames, of 30"


def test_a_recording_may_have_any_rate() -> None:
    slow = with_frames(receive_time_s=lambda k: k / 3)
    assert judged(FrameRateCheck(0.0), slow).verdict is CheckVerdict.PASS


@pytest.mark.parametrize(
    ("skipped", "verdict"),
    [(0, CheckVerdict.WARNING), (1, CheckVerdict.FAIL), (20, CheckVerdict.FAIL)],
)
def test_lost_packets_weigh_by_the_frames_they_cost(skipped: int, verdict: CheckVerdict) -> None:
    finding = judged(LostPacketsCheck(), make_capture(skipped=skipped, lost_packets=40))
    assert finding.verdict is verdict
    assert finding.facts == {"lost_packets": 40, "skipped_frames": skipped}


@pytest.mark.parametrize(("skipped", "verdict"), [(0, "pass"), (1, "pass"), (30, "warning")])
def test_frames_without_a_partner_are_no_lost_packets(skipped: int, verdict: str) -> None:
    seen = make_capture(make_samples(120), skipped=skipped)
    assert judged(LostPacketsCheck(), seen).verdict == verdict


def test_a_skew_beyond_half_a_frame_is_a_warning() -> None:
    finding = judged(SkewCheck(), with_frames(skew_s=lambda k: -0.021))
    assert finding.verdict is CheckVerdict.WARNING
    assert "21.0 ms apart" in finding.text


@pytest.mark.parametrize(
    ("rate", "verdict"), [(1.001, CheckVerdict.PASS), (1.03, CheckVerdict.FAIL)]
)
def test_the_devices_clock_is_held_against_ours(rate: float, verdict: CheckVerdict) -> None:
    finding = judged(ClockRateCheck(), with_frames(device_stamp_s=lambda k: rate * k * PERIOD_S))
    assert finding.verdict is verdict
    assert finding.facts["rate"] == pytest.approx(rate, abs=1e-6)


def test_without_a_device_clock_the_stamps_are_held_against_ours() -> None:
    seen = with_frames(device_stamp_s=lambda k: None, stamp_s=lambda k: 0.5 * k * PERIOD_S)
    finding = judged(ClockRateCheck(), seen)
    assert (finding.verdict, finding.facts["rate"]) == (CheckVerdict.FAIL, pytest.approx(0.5))


@pytest.mark.parametrize(
    "check", [FrameRateCheck(30.0), ClockRateCheck()], ids=lambda check: check.name
)
def test_a_handful_of_frames_tells_no_rate(check: Check) -> None:
    assert judged(check, make_capture(make_samples(3))).verdict is CheckVerdict.UNKNOWN


@pytest.mark.parametrize(
    ("gravity_m_s2", "told"),
    [
        ((0.0, 9.81, 0.0), "9.81 m/s²; the camera is level"),
        ((0.0, 8.5, 4.9), "looks 30° down"),
        ((0.0, 8.5, -4.9), "looks 30° up"),
        ((4.9, 8.5, 0.0), "rolled 30° to the right"),
        ((-4.9, 8.5, 0.0), "rolled 30° to the left"),
    ],
)
def test_gravity_tells_how_the_camera_is_held(
    gravity_m_s2: tuple[float, float, float], told: str
) -> None:
    finding = judged(GravityCheck(True), with_frames(gravity_m_s2=lambda k: gravity_m_s2))
    assert finding.verdict is CheckVerdict.PASS
    assert told in finding.text


def test_a_push_is_not_gravity() -> None:
    finding = judged(GravityCheck(True), with_frames(gravity_m_s2=lambda k: (0.0, 14.0, 0.0)))
    assert finding.verdict is CheckVerdict.WARNING


def test_no_gravity_matters_only_where_there_is_an_accelerometer() -> None:
    seen = with_frames(gravity_m_s2=lambda k: None)
    assert judged(GravityCheck(True), seen).verdict is CheckVerdict.WARNING
    assert judged(GravityCheck(False), seen).verdict is CheckVerdict.UNKNOWN


def test_where_the_intrinsics_come_from_is_said() -> None:
    finding = judged(FirstFramesCheck(), make_capture())
    assert finding.text == "color and depth, 640x480, after 1.2 s; intrinsics: factory"


def test_an_empty_recording_is_no_crash() -> None:
    finding = judged(FirstFramesCheck(), StreamSample(counters=CameraCounters()))
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, "the recording has no frame")


def test_frames_that_are_all_torn_are_no_mystery() -> None:
    seen = make_capture([], trouble="it sends nothing", skipped=58, lost_packets=290)
    finding = judged(FirstFramesCheck(), seen)
    assert finding.text == "all 58 frames lost packets (290) and were thrown away"
    assert "USB controller of its own" in finding.fix


def test_what_the_driver_does_by_itself_is_no_advice() -> None:
    finding = judged(
        FrameRateCheck(30.0), make_capture(trouble="no depth for 1 s; it is opened again")
    )
    assert finding.text.endswith("no depth for 1 s")
    assert finding.fix.startswith("check its cable")
