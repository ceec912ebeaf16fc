"""Snapshots from a camera that is open now, and the file that makes it show raw images."""

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
# A camera that has not shown anything for so long is not going to.
FRAME_TIMEOUT_S = 15.0
# A lens that bends nothing, and a depth camera in the same place with the same lens: undistorting
# and registering then leave every pixel where it is.
IDENTITY_POSE = RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
RAW_DEPTH_CALIBRATION = DepthCameraCalibration(525.0, 525.0, 319.5, 239.5, IDENTITY_POSE)
RAW_COLOR_CALIBRATION = CameraCalibration(
    640, 480, 525.0, 525.0, 319.5, 239.5, NO_DISTORTION, 1000.0
)
RAW_CALIBRATION = replace(RAW_COLOR_CALIBRATION, depth=RAW_DEPTH_CALIBRATION)


@contextmanager
def write_raw_camera_file(with_depth: bool) -> Iterator[Path]:
    """A camera file under which a driver hands on what the sensor sees; gone after the block.

    Its `[depth]` table keeps a sensor from registering depth itself.
    """
    with TemporaryDirectory(prefix="kinect-vo-") as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        file.write_text(
            format_calibration(RAW_CALIBRATION if with_depth else RAW_COLOR_CALIBRATION)
        )
        yield file


def read_frames(camera: RgbdCamera, stop: threading.Event) -> Iterator[RgbdFrame | None]:
    """The camera's frames until its end or `stop`; None while it has nothing to show.

    Raises CameraError if there is none for `PATIENCE_S`.
    """
    last_s = time.monotonic()
    while not stop.is_set():
        try:
            frame = camera.read(POLL_PERIOD_S)
        except FrameTimeout as error:
            if time.monotonic() - last_s > FRAME_TIMEOUT_S:
                reason = camera.status.reason or "it is there but sends no frames"
                raise CameraError(f"{camera.name}: {reason}") from error
            yield None
        except EndOfStream:
            return
        else:
            last_s = time.monotonic()
            yield frame


def make_snapshot(frame: RgbdFrame, with_depth: bool) -> Snapshot:
    """A frame as the calibration sees it."""
    depth = frame.depth_raw if with_depth else NO_DEPTH
    return Snapshot(f"frame {frame.seq}", frame.stamp_s, frame.color_bgr, depth)
