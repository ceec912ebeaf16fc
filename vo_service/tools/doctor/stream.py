"""Whether frames come, often enough, and whole."""

from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream_probe import StreamSample

REPLUG_FIX = "check its cable and power supply: unplug both, wait ten seconds, plug them in again"
OWN_CONTROLLER_FIX = "give the sensor a USB controller of its own, no hub, and a shorter cable"
VERBOSE_FIX = "run it with --verbose, which says more; see that the computer is not too busy"
MIN_RATE_FRACTION = 0.9
MAX_LOSS_FRACTION = 0.01
MIN_FRAMES_FOR_RATE = 10


class FirstFramesCheck:
    """The camera is opened here, and read for the checks that follow."""

    name = "first-frames"

    def __init__(self, *needs: str) -> None:
        self.needs = needs

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        watched = context.stream
        if watched.first_frame_s is None or watched.size is None:
            return _no_frame_finding(watched)
        width, height = watched.size
        source = watched.intrinsics_source
        return passed(
            f"color and depth, {width}x{height}, after {watched.first_frame_s:.1f} s"
            + (f"; intrinsics: {source}" if source else ""),
            after_s=round(watched.first_frame_s, 3),
            intrinsics=source,
        )


def _no_frame_finding(stream: StreamSample) -> Finding:
    lost, torn = stream.counters.lost_packets, stream.counters.skipped
    if lost and torn:
        return failed(
            f"all {torn} frames lost packets ({lost}) and were thrown away",
            OWN_CONTROLLER_FIX,
            lost_packets=lost,
            skipped_frames=torn,
        )
    return failed(*_split_error(stream.error or "the recording has no frame"))


def _split_error(error: str) -> tuple[str, str]:
    """An error's two halves; what the driver does about it by itself is no advice."""
    text, _, advice = error.rpartition("; ")
    has_advice = text and not advice.startswith("it is opened again")
    return (text, advice) if has_advice else (text or advice, REPLUG_FIX)


class FrameRateCheck:
    """Frames to the end, as many as the sensor makes."""

    name = "frame-rate"
    needs = ("first-frames",)

    def __init__(self, nominal_hz: float) -> None:
        """`nominal_hz` is what the sensor makes; 0 for a source that may have any rate."""
        self._nominal_hz = nominal_hz

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        watched = context.stream
        samples = watched.samples
        facts = {"frames": len(samples), "dropped": watched.counters.dropped}
        if watched.error:
            text, advice = _split_error(watched.error)
            return failed(f"stopped after {len(samples)} frames: {text}", advice, **facts)
        if len(samples) < MIN_FRAMES_FOR_RATE:
            return unknown(f"{len(samples)} frames are too few to tell")
        rate_hz = (len(samples) - 1) / (samples[-1].receive_time_s - samples[0].receive_time_s)
        text = f"{rate_hz:.1f} frames a second over {len(samples)} frames"
        if rate_hz < MIN_RATE_FRACTION * self._nominal_hz:
            return failed(
                f"{text}, of {self._nominal_hz:g}",
                "give it more light or set auto_exposure = false; see that the computer is not "
                "busy with something else",
                rate_hz=round(rate_hz, 2),
                **facts,
            )
        return passed(text, rate_hz=round(rate_hz, 2), **facts)


class LostPacketsCheck:
    """A frame that lost packets is thrown away whole."""

    name = "lost-packets"
    needs = ("first-frames",)

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        counters, frames = context.stream.counters, len(context.stream.samples)
        facts = {"lost_packets": counters.lost_packets, "skipped_frames": counters.skipped}
        share = counters.skipped / (counters.skipped + frames)
        is_much = share > MAX_LOSS_FRACTION
        if counters.lost_packets == 0 and not is_much:
            return passed(f"none in {frames} frames", **facts)
        if counters.lost_packets == 0:
            return warned(
                f"none, yet {counters.skipped} frames were of no use", VERBOSE_FIX, **facts
            )
        finding = failed if is_much else warned
        return finding(
            f"{counters.lost_packets} packets lost, {counters.skipped} frames thrown away "
            f"({share:.1%})",
            OWN_CONTROLLER_FIX,
            **facts,
        )
