"""Snapshots from a live camera, and a camera file for raw images."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.calibration import (
    CAMERA_FILE_NAME,
    NO_DISTORTION,
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
    format_calibration,
)
from drivers.camera import EndOfStream, FrameTimeout, RgbdCamera, RgbdFrame
from drivers.core.errors import CameraError
from vo_service.tools.calibration.snapshot import NO_DEPTH, Snapshot

POLL_PERIOD_S = 0.25
# A camera without frames for this time has failed.
FRAME_TIMEOUT_S = 15.0
# A lens without distortion, and a depth camera at the same place with the same lens: undistortion
# and registration then move no pixel.
IDENTITY_POSE = RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
RAW_DEPTH_CALIBRATION = DepthCameraCalibration(525.0, 525.0, 319.5, 239.5, IDENTITY_POSE)
RAW_COLOR_CALIBRATION = CameraCalibration(
    640, 480, 525.0, 525.0, 319.5, 239.5, NO_DISTORTION, 1000.0
)
RAW_CALIBRATION = replace(RAW_COLOR_CALIBRATION, depth=RAW_DEPTH_CALIBRATION)


@contextmanager
def write_raw_camera_file(with_depth: bool) -> Iterator[Path]:
    """Write a temporary camera file with which a driver returns raw images.

    Its `[depth]` table prevents registration by the sensor.
    """
    with TemporaryDirectory(prefix="kinect-vo-") as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        file.write_text(
            format_calibration(RAW_CALIBRATION if with_depth else RAW_COLOR_CALIBRATION)
        )
        yield file


def read_frames(camera: RgbdCamera, stop: threading.Event) -> Iterator[RgbdFrame | None]:
    """Yield the camera's frames until its end or `stop`, and None while there is no frame.

    Raises:
        CameraError: There was no frame for `FRAME_TIMEOUT_S`.
    """
    last_s = time.monotonic()
    while not stop.is_set():
        try:
            frame = camera.read(POLL_PERIOD_S)
        except FrameTimeout as error:
            if time.monotonic() - last_s > FRAME_TIMEOUT_S:
                reason = camera.status.reason or "the camera sends no frames"
                raise CameraError(f"{camera.name}: {reason}") from error
            yield None
        except EndOfStream:
            return
        else:
            last_s = time.monotonic()
            yield frame


def make_snapshot(frame: RgbdFrame, with_depth: bool) -> Snapshot:
    """Make a snapshot of a frame."""
    depth = frame.depth_raw if with_depth else NO_DEPTH
    return Snapshot(f"frame {frame.seq}", frame.stamp_s, frame.color_bgr, depth)
