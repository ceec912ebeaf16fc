"""Frames of a recording: images loaded, undistorted, registered and stamped."""

import time
from collections.abc import Callable

from drivers.camera import RgbdFrame
from drivers.recording.image_decoding import DepthImage
from drivers.recording.recording import FramePair, Recording
from drivers.rectify import SoftwareRegistration, make_undistorter


class FrameReader:
    """Reads the frames of one recording, in any order; in their order is fastest.

    Raises:
        InputError: The depth camera does not look where the color camera does.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        camera = recording.calibration
        self._pinhole, self._depth_factor = camera.pinhole, camera.depth_factor
        self._undistorter = make_undistorter(self._pinhole, camera.distortion)
        self._register: Callable[[DepthImage], DepthImage] = self._undistorter.undistort_depth
        if recording.depth_camera is not None:
            registration = SoftwareRegistration(
                self._pinhole, recording.depth_camera, camera.depth_factor
            )
            self._register = registration.register
            self._depth_factor = registration.depth_factor

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
            gravity_m_s2=recording.gravity.mean_at(pair.color.stamp_s),
            readout_s=camera.readout_s,
            timing_prior=camera.timing_prior,
        )
