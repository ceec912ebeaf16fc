"""Checks of color-depth skew, the device's clock and gravity."""

import math
from statistics import median

import numpy as np

from drivers.core.geometry import is_gravity
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream import MIN_FRAMES_FOR_RATE

# At 30 frames a second, color and depth of one frame differ by at most half a period.
MAX_SKEW_S = 0.017
MAX_CLOCK_RATE_ERROR = 0.01


class SkewCheck:
    """Check the time between color and depth, whose shutters are not synchronized."""

    name = "skew"
    needs = ("first-frames",)

    def run(self, context: CheckContext) -> Finding:
        skews_s = [abs(sample.skew_s) for sample in context.stream.samples]
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


class ClockRateCheck:
    """Check the rate of the device's stamps against this computer's clock."""

    name = "clock"
    needs = ("first-frames",)

    def run(self, context: CheckContext) -> Finding:
        samples = context.stream.samples
        if len(samples) < MIN_FRAMES_FOR_RATE:
            return unknown(f"{len(samples)} frames are too few to measure a rate")
        arrivals_s = np.array([sample.receive_time_s for sample in samples])
        device_s = [
            sample.device_stamp_s for sample in samples if sample.device_stamp_s is not None
        ]
        owner = "the device's" if len(device_s) == len(samples) else "its"
        stamps_s = device_s if len(device_s) == len(samples) else [s.stamp_s for s in samples]
        rate = float(
            np.polyfit(arrivals_s - arrivals_s[0], np.subtract(stamps_s, stamps_s[0]), 1)[0]
        )
        text = f"{owner} clock runs at {rate:.4f} of this computer's"
        if abs(rate - 1.0) > MAX_CLOCK_RATE_ERROR:
            return failed(
                text,
                "plug the sensor in again; if its stamps still drift, report it",
                rate=round(rate, 6),
            )
        return passed(text, rate=round(rate, 6))


class GravityCheck:
    """Check the accelerometer, if the sensor has one."""

    name = "gravity"
    needs = ("first-frames",)

    def __init__(self, is_expected: bool) -> None:
        """Set whether the sensor has an accelerometer."""
        self._is_expected = is_expected

    def run(self, context: CheckContext) -> Finding:
        vector = context.stream.samples[-1].gravity_m_s2
        if vector is None and self._is_expected:
            return warned(
                "no reading: odom starts level with the camera instead",
                "check the firmware above; on a 1414, plug in the power supply of the motor",
            )
        if vector is None:
            return unknown("not known: this camera has no accelerometer")
        right, down, forward = vector
        length = math.hypot(*vector)
        tilts = [
            *_describe_tilt(forward, down, ("looks {}° down", "looks {}° up")),
            *_describe_tilt(
                right, down, ("is rolled {}° to the right", "is rolled {}° to the left")
            ),
        ]
        text = f"{length:.2f} m/s²; the camera {' and '.join(tilts) or 'is level'}"
        facts = {"gravity_m_s2": list(vector)}
        if not is_gravity(vector):
            return warned(text, "hold the sensor still and run doctor again", **facts)
        return passed(text, **facts)


def _describe_tilt(sideways: float, down: float, templates: tuple[str, str]) -> list[str]:
    """Describe an angle by one of two templates; nothing for less than half a degree."""
    angle_deg = round(math.degrees(math.atan2(sideways, down)))
    positive, negative = templates
    return [(positive if angle_deg > 0 else negative).format(abs(angle_deg))] if angle_deg else []
