"""The frames of a recording: registered, undistorted and with all that is known of them."""

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress

from drivers.camera import RgbdFrame
from drivers.plausibility import PlausibilityCheck
from drivers.recording.depth_enlargement import enlarge
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.recorded_frames import FramePair
from drivers.recording.recording import Recording
from drivers.rectify import Rectifier


class FrameReader:
    """Reads the frames of one recording, in any order; in their order is fastest.

    Raises:
        InputError: The depth camera does not look where the color camera does.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        camera = recording.calibration
        timing = camera.readout_s, camera.timing_prior
        self._rectifier = Rectifier(
            camera, recording.depth_camera, timing, recording.intrinsics_source
        )

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load one pair and make its frame. Raises UnreadableFrameError."""
        recording, rectifier = self._recording, self._rectifier
        color, depth = pair.load(recording.image_size, recording.depth_size)
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.color.stamp_s,
            receive_time_s=time.monotonic(),
            color_bgr=rectifier.rectify_color(color),
            depth_raw=rectifier.rectify_depth(enlarge(depth, recording.depth_enlargement)),
            depth_factor=rectifier.depth_factor,
            camera=rectifier.camera,
            skew_s=pair.skew_s + rectifier.depth_offset_s,
            gravity_m_s2=recording.gravity_at(pair.color.stamp_s),
            accelerometer=recording.accelerometer.newest_at(pair.color.stamp_s),
            readout_s=rectifier.readout_s,
            timing_prior=rectifier.timing_prior,
        )

    def read_sample(self, numbers: Iterable[int]) -> Iterator[RgbdFrame]:
        """Yield the frames with these numbers, without those that cannot be read.

        Whoever reads all frames reports these.
        """
        for number in numbers:
            with suppress(UnreadableFrameError):
                yield self.read(self._recording.frames.pairs[number], number)


def log_implausible(recording: Recording) -> None:
    """Log what is implausible in the first, the middle and the last frame of a recording."""
    check, count = PlausibilityCheck(recording), len(recording.frames.pairs)
    for frame in FrameReader(recording).read_sample(sorted({0, count // 2, count - 1})):
        check.examine(frame)
