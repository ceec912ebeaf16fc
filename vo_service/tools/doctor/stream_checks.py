"""Checks of the frames: rate, losses, skew, timing, the device's clock and gravity."""

import math
from collections.abc import Sequence
from statistics import median

import numpy as np

from drivers.camera import TimingSource
from drivers.core.geometry import (
    R_BODY_OPTICAL,
    T_BODY_CAMERA,
    is_gravity,
    quaternion_from_rotation,
)
from vo_service.odom_frame import align_to_up
from vo_service.tools.calibration.timing import (
    CONTRADICTION_SIGMAS,
    SensorTiming,
    remembered_as_timing,
    timing_by_prior,
)
from vo_service.tools.doctor.check import SENSORS, CameraKind, CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream_probe import StreamSample

REPLUG_FIX = "check its cable and power supply: unplug both, wait ten seconds, plug them in again"
OWN_CONTROLLER_FIX = "give the sensor a USB controller of its own, no hub, and a shorter cable"
VERBOSE_FIX = "run it with --verbose for details; check that the computer is not too busy"
SENSOR_HZ, MIN_RATE_FRACTION = 30.0, 0.9
MAX_LOSS_FRACTION = 0.01
MIN_FRAMES_FOR_RATE = 10
# At 30 frames a second, color and depth of one frame differ by at most half a period.
MAX_SKEW_S = 0.017
MAX_CLOCK_RATE_ERROR = 0.01
# What precedes the path in the source of the intrinsics.
CAMERA_FILE_PREFIX = "camera file "


def check_first_frames(context: CheckContext) -> Finding:
    """Check that frames arrive. Opens the camera and reads frames for the later checks, too."""
    stream = context.stream
    if stream.first_frame_s is None:
        return _no_frame_finding(stream)
    camera, source = stream.frames[0].camera, stream.intrinsics_source
    return passed(
        f"color and depth, {camera.width}x{camera.height}, after {stream.first_frame_s:.1f} s"
        + (f"; intrinsics: {source}" if source else ""),
        after_s=round(stream.first_frame_s, 3),
        intrinsics=source,
    )


def _no_frame_finding(stream: StreamSample) -> Finding:
    lost, skipped = stream.counters.lost_packets, stream.counters.skipped
    if lost and skipped:
        return failed(
            f"all {skipped} frames were discarded, because packets were lost ({lost})",
            OWN_CONTROLLER_FIX,
            lost_packets=lost,
            skipped_frames=skipped,
        )
    return failed(*_split_error(stream.error or "the recording has no frame"))


def _split_error(error: str) -> tuple[str, str]:
    """Split an error into text and advice; what the driver does by itself is not advice."""
    text, _, advice = error.rpartition("; ")
    has_advice = text and not advice.startswith("it is opened again")
    return (text, advice) if has_advice else (text or advice, REPLUG_FIX)


def check_plausibility(context: CheckContext) -> Finding:
    """Check that intrinsics and depth can be those of an RGB-D camera."""
    if context.stream.implausible:
        return warned(*_split_error(context.stream.implausible))
    return passed("intrinsics and depth are plausible")


def check_frame_rate(context: CheckContext) -> Finding:
    """Check that frames arrive to the end; those of a sensor at its rate."""
    stream = context.stream
    samples = stream.frames
    facts = {"frames": len(samples), "dropped": stream.counters.dropped}
    if stream.error:
        text, advice = _split_error(stream.error)
        return failed(f"stopped after {len(samples)} frames: {text}", advice, **facts)
    if len(samples) < MIN_FRAMES_FOR_RATE:
        return unknown(f"{len(samples)} frames are too few to measure a rate")
    rate_hz = (len(samples) - 1) / (samples[-1].receive_time_s - samples[0].receive_time_s)
    text = f"{rate_hz:.1f} frames a second over {len(samples)} frames"
    if context.requested.kind in SENSORS and rate_hz < MIN_RATE_FRACTION * SENSOR_HZ:
        return failed(
            f"{text}; the sensor makes {SENSOR_HZ:g}",
            "add light or set auto_exposure = false; check that the computer is not busy "
            "with other programs",
            rate_hz=round(rate_hz, 2),
            **facts,
        )
    return passed(text, rate_hz=round(rate_hz, 2), **facts)


def check_lost_packets(context: CheckContext) -> Finding:
    """Check that few packets are lost; a frame with lost packets is discarded."""
    counters, frames = context.stream.counters, len(context.stream.frames)
    facts = {"lost_packets": counters.lost_packets, "skipped_frames": counters.skipped}
    skipped_fraction = counters.skipped / (counters.skipped + frames)
    is_excessive = skipped_fraction > MAX_LOSS_FRACTION
    if counters.lost_packets == 0 and not is_excessive:
        return passed(f"none in {frames} frames", **facts)
    if counters.lost_packets == 0:
        return warned(f"none, but {counters.skipped} frames were discarded", VERBOSE_FIX, **facts)
    finding = failed if is_excessive else warned
    return finding(
        f"{counters.lost_packets} packets lost, {counters.skipped} frames discarded "
        f"({skipped_fraction:.1%})",
        OWN_CONTROLLER_FIX,
        **facts,
    )


def check_skew(context: CheckContext) -> Finding:
    """Check the time between color and depth, whose shutters are not synchronized."""
    skews_s = [abs(sample.skew_s) for sample in context.stream.frames]
    typical_s, largest_s = median(skews_s), max(skews_s)
    facts = {"median_ms": round(typical_s * 1e3, 3), "largest_ms": round(largest_s * 1e3, 3)}
    text = f"depth and color {typical_s * 1e3:.1f} ms apart, at most {largest_s * 1e3:.1f} ms"
    if typical_s > MAX_SKEW_S:
        return warned(
            f"{text}; half a frame is {MAX_SKEW_S * 1e3:.0f} ms",
            "move the camera slowly, or plug it in again: the skew changes each time",
            **facts,
        )
    return passed(text, **facts)


def check_timing(context: CheckContext) -> Finding:
    """Check what the camera file tells of the sensor's timing against what services learned."""
    sample = context.stream.frames[-1]
    told = timing_by_prior(sample.readout_s, 0.0, sample.timing_prior)
    source = TimingSource.CAMERA_FILE
    if sample.timing_prior is not None:
        source = sample.timing_prior.source
    text = f"{_describe_timing(told)} ({source})"
    remembered = context.find_learned().get(sample.serial) if sample.serial else None
    if remembered is None:
        return passed(f"{text}; nothing learned of this sensor yet", source=source.value)
    learned = remembered_as_timing(remembered)
    both = f"{text}; learned: {_describe_timing(learned)}"
    is_contradicted = any(told[key].contradicts(value) for key, value in learned.items())
    if source is TimingSource.CAMERA_FILE and is_contradicted:
        file = context.stream.intrinsics_source.removeprefix(CAMERA_FILE_PREFIX)
        return warned(
            f"the camera file contradicts what was learned: {both}",
            f"kinect-vo calibrate --save-learned --serial {sample.serial} --camera-file {file}"
            "; or measure it with kinect-vo calibrate --timing",
            source=source.value,
        )
    return passed(both, source=source.value)


def _describe_timing(timing: SensorTiming) -> str:
    return f"readout {timing['readout_s']}, depth offset {timing['depth_offset_s']}"


def check_focal_length(context: CheckContext) -> Finding:
    """Compare the focal length of the frames with what services learned, from their poses.

    That brightness and depth disagree on it is information only: it happens with real sensors, and
    its cause is not known.
    """
    sample, source = context.stream.frames[-1], context.stream.intrinsics_source
    fx = sample.camera.fx
    text = f"{fx:.1f} px" + (f" ({source})" if source else "")
    sensor = context.find_learned().get(sample.serial) if sample.serial else None
    if sensor is None or sensor.focal_length is None:
        return passed(f"{text}; nothing learned of this sensor yet", fx=fx)
    learned = sensor.focal_length
    learned_px, sigma_px = learned.fx * learned.scale, learned.fx * learned.prior_sigma
    text += (
        f"; learned: {learned_px:.1f} ± {sigma_px:.1f} px; "
        f"by depth {learned.disagreement:+.1%} against brightness"
    )
    facts = {
        "fx": fx,
        "learned_fx": round(learned_px, 2),
        "learned_sigma": round(sigma_px, 2),
        "disagreement": round(learned.disagreement, 4),
    }
    is_contradicted = abs(learned_px - fx) > CONTRADICTION_SIGMAS * sigma_px
    if not is_contradicted or not source.startswith(CAMERA_FILE_PREFIX):
        return passed(text, **facts)
    file = source.removeprefix(CAMERA_FILE_PREFIX)
    return warned(
        f"the camera file contradicts what was learned: {text}",
        "calibrate it with a printed board (kinect-vo calibrate), or run kinect-vo calibrate "
        f"--save-learned --serial {sample.serial} --camera-file {file}",
        **facts,
    )


def check_clock_rate(context: CheckContext) -> Finding:
    """Check the rate of the device's stamps against this computer's clock."""
    samples = context.stream.frames
    if len(samples) < MIN_FRAMES_FOR_RATE:
        return unknown(f"{len(samples)} frames are too few to measure a rate")
    arrivals_s = np.array([sample.receive_time_s for sample in samples])
    device_s = [sample.device_stamp_s for sample in samples if sample.device_stamp_s is not None]
    owner = "the device's" if len(device_s) == len(samples) else "its"
    stamps_s = device_s if len(device_s) == len(samples) else [s.stamp_s for s in samples]
    rate = float(np.polyfit(arrivals_s - arrivals_s[0], np.subtract(stamps_s, stamps_s[0]), 1)[0])
    text = f"{owner} clock runs at {rate:.4f} of this computer's"
    if abs(rate - 1.0) > MAX_CLOCK_RATE_ERROR:
        return failed(
            text,
            "plug the sensor in again; if its stamps still drift, report it",
            rate=round(rate, 6),
        )
    return passed(text, rate=round(rate, 6))


def check_gravity(context: CheckContext) -> Finding:
    """Check the accelerometer, which a Kinect has."""
    vector = context.stream.frames[-1].gravity_m_s2
    if vector is None and context.requested.kind is CameraKind.KINECT:
        return warned(
            "no reading: odom starts level with the camera instead",
            "check the firmware above; on a 1414, plug in the power supply of the motor",
        )
    if vector is None:
        return unknown("not known: this camera has no accelerometer")
    text = f"{math.hypot(*vector):.2f} m/s²; the camera {_describe_tilt(vector)}"
    facts = {"gravity_m_s2": list(vector)}
    if not is_gravity(vector):
        return warned(text, "hold the sensor still and run doctor again", **facts)
    return passed(text, **facts)


def check_floor(context: CheckContext) -> Finding:
    """Measure the mount of the camera by the floor in view: its height and its tilt."""
    floors = context.stream.floors
    if not floors:
        return unknown(
            "not in view; for the mount of a robot's camera, show it two meters of floor"
        )
    height_m = median(floor.height_m for floor in floors)
    up = np.median([floor.up for floor in floors], axis=0)
    T_base_camera = align_to_up(R_BODY_OPTICAL @ up) @ T_BODY_CAMERA
    quaternion_xyzw = quaternion_from_rotation(T_base_camera[:3, :3]).round(4).tolist()
    return passed(
        f"{height_m:.2f} m below the camera, which {_describe_tilt((-up).tolist())}; in "
        f"T_base_camera: quaternion_xyzw = {quaternion_xyzw}",
        height_m=round(height_m, 3),
        quaternion_xyzw=quaternion_xyzw,
    )


def _describe_tilt(down: Sequence[float]) -> str:
    """Describe the tilt of a camera by the downward direction in its axes, in whole degrees."""
    to_right, to_bottom, forward = down
    pitch_deg = round(math.degrees(math.atan2(forward, to_bottom)))
    roll_deg = round(math.degrees(math.atan2(to_right, to_bottom)))
    tilts = []
    if pitch_deg:
        tilts.append(f"looks {abs(pitch_deg)}° {'down' if pitch_deg > 0 else 'up'}")
    if roll_deg:
        side = "right" if roll_deg > 0 else "left"
        tilts.append(f"is rolled {abs(roll_deg)}° to the {side}")
    return " and ".join(tilts) or "is level"
