"""Checks whether complete frames arrive at the expected rate."""

from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream_probe import StreamSample

REPLUG_FIX = "check its cable and power supply: unplug both, wait ten seconds, plug them in again"
OWN_CONTROLLER_FIX = "give the sensor a USB controller of its own, no hub, and a shorter cable"
VERBOSE_FIX = "run it with --verbose for details; check that the computer is not too busy"
MIN_RATE_FRACTION = 0.9
MAX_LOSS_FRACTION = 0.01
MIN_FRAMES_FOR_RATE = 10


class FirstFramesCheck:
    """Check that frames arrive. Opens the camera and reads frames for the later checks, too."""

    name = "first-frames"

    def __init__(self, *needs: str) -> None:
        self.needs = needs

    def run(self, context: CheckContext) -> Finding:
        stream = context.stream
        if stream.first_frame_s is None or stream.size is None:
            return _no_frame_finding(stream)
        width, height = stream.size
        source = stream.intrinsics_source
        return passed(
            f"color and depth, {width}x{height}, after {stream.first_frame_s:.1f} s"
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


class FrameRateCheck:
    """Check that frames arrive to the end, at the sensor's rate."""

    name = "frame-rate"
    needs = ("first-frames",)

    def __init__(self, nominal_hz: float) -> None:
        """Set the sensor's frame rate; 0 for a source with any rate."""
        self._nominal_hz = nominal_hz

    def run(self, context: CheckContext) -> Finding:
        stream = context.stream
        samples = stream.samples
        facts = {"frames": len(samples), "dropped": stream.counters.dropped}
        if stream.error:
            text, advice = _split_error(stream.error)
            return failed(f"stopped after {len(samples)} frames: {text}", advice, **facts)
        if len(samples) < MIN_FRAMES_FOR_RATE:
            return unknown(f"{len(samples)} frames are too few to measure a rate")
        rate_hz = (len(samples) - 1) / (samples[-1].receive_time_s - samples[0].receive_time_s)
        text = f"{rate_hz:.1f} frames a second over {len(samples)} frames"
        if rate_hz < MIN_RATE_FRACTION * self._nominal_hz:
            return failed(
                f"{text}; the sensor makes {self._nominal_hz:g}",
                "add light or set auto_exposure = false; check that the computer is not busy "
                "with other programs",
                rate_hz=round(rate_hz, 2),
                **facts,
            )
        return passed(text, rate_hz=round(rate_hz, 2), **facts)


class LostPacketsCheck:
    """Check that few packets are lost; a frame with lost packets is discarded."""

    name = "lost-packets"
    needs = ("first-frames",)

    def run(self, context: CheckContext) -> Finding:
        counters, frames = context.stream.counters, len(context.stream.samples)
        facts = {"lost_packets": counters.lost_packets, "skipped_frames": counters.skipped}
        skipped_fraction = counters.skipped / (counters.skipped + frames)
        is_excessive = skipped_fraction > MAX_LOSS_FRACTION
        if counters.lost_packets == 0 and not is_excessive:
            return passed(f"none in {frames} frames", **facts)
        if counters.lost_packets == 0:
            return warned(
                f"none, but {counters.skipped} frames were discarded", VERBOSE_FIX, **facts
            )
        finding = failed if is_excessive else warned
        return finding(
            f"{counters.lost_packets} packets lost, {counters.skipped} frames discarded "
            f"({skipped_fraction:.1%})",
            OWN_CONTROLLER_FIX,
            **facts,
        )
