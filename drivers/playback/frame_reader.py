"""The frames of a recording: registered, undistorted and with all that is known of them."""

import time
from collections.abc import Callable

from drivers.calibration import SoftwareRegistration, Undistorter
from drivers.camera import RgbdFrame
from drivers.plausibility import PlausibilityCheck
from drivers.recording.depth_enlargement import enlarge
from drivers.recording.image_decoding import DepthImage, UnreadableFrameError
from drivers.recording.recorded_frames import FramePair
from drivers.recording.recording import Recording


class FrameReader:
    """Reads the frames of one recording, in any order; in their order is fastest.

    Raises:
        InputError: The depth camera does not look where the color camera does.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        camera = recording.calibration
        self._pinhole, self._depth_factor = camera.pinhole, camera.depth_factor
        self._undistorter = Undistorter(self._pinhole, camera.distortion)
        self._register: Callable[[DepthImage], DepthImage] = self._undistort_enlarged
        if recording.depth_camera is not None:
            registration = SoftwareRegistration(
                self._pinhole, recording.depth_camera, camera.depth_factor
            )
            self._register = registration.register
            self._depth_factor = registration.depth_factor

    def _undistort_enlarged(self, depth: DepthImage) -> DepthImage:
        factor = self._recording.depth_enlargement
        return self._undistorter.undistort_depth(enlarge(depth, factor))

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load one pair and make its frame.

        Raises:
            UnreadableFrameError: If an image cannot be read.
        """
        recording, camera = self._recording, self._recording.calibration
        color, depth = pair.load(recording.image_size, recording.depth_size)
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.color.stamp_s,
            receive_time_s=time.monotonic(),
            color_bgr=self._undistorter.undistort_color(color),
            depth_raw=self._register(depth),
            depth_factor=self._depth_factor,
            camera=self._pinhole,
            skew_s=pair.skew_s + camera.depth_offset_s,
            gravity_m_s2=recording.gravity_at(pair.color.stamp_s),
            accelerometer=recording.accelerometer.newest_at(pair.color.stamp_s),
            readout_s=camera.readout_s,
            timing_prior=camera.timing_prior,
        )


def log_implausible(recording: Recording) -> None:
    """Log what is implausible in the first, the middle and the last frame of a recording."""
    check, reader, pairs = (
        PlausibilityCheck(recording),
        FrameReader(recording),
        recording.frames.pairs,
    )
    for index in sorted({0, len(pairs) // 2, len(pairs) - 1}):
        try:
            check.examine(reader.read(pairs[index], index))
        except UnreadableFrameError:  # whoever reads all frames reports it
            continue
