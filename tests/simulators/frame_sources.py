"""Sources of the simulated Kinect's frames: a recorded folder, or any of our cameras."""

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np

from drivers.camera import RgbdCamera
from drivers.tum.folder import open_tum_folder
from tests.simulators.raw_depth import fit_scale
from tests.simulators.usb_frames import ColorBgr, DepthMm, UsbFrames, write_usb_frames

MAX_DEPTH_MM = 65535
FIT_FRAMES = 30


def write_fitted_usb_frames(folder: Path, frames: Iterator[tuple[ColorBgr, DepthMm]]) -> UsbFrames:
    """Write frames for a Kinect with the constants of the one that recorded them.

    With other constants, all depth would move by up to half a step of the depth grid.
    """
    first = list(islice(frames, FIT_FRAMES))
    scale = fit_scale(depth_mm for _, depth_mm in first)
    return write_usb_frames(folder, chain(first, frames), scale=scale)


def folder_frames(
    folder: Path, camera_file: Path | None = None, max_frames: int | None = None
) -> Iterator[tuple[ColorBgr, DepthMm]]:
    """Yield the images of a TUM folder as they were recorded, with lens distortion.

    The program that receives them needs the folder's camera file.

    Args:
        folder: The TUM folder.
        camera_file: Its camera file, if it is not in the folder.
        max_frames: Yield the first frames only.

    Raises:
        InputError: The folder cannot be used.
        UnreadableFrameError: An image is broken.
    """
    contents = open_tum_folder(folder, camera_file)
    camera = contents.calibration
    for pair in contents.frames.pairs[:max_frames]:
        bgr, depth = pair.load(contents.image_size, contents.depth_size)
        yield bgr, _to_millimeters(depth, camera.depth_factor)


def camera_frames(
    camera: RgbdCamera, max_frames: int | None = None
) -> Iterator[tuple[ColorBgr, DepthMm]]:
    """Yield up to `max_frames` frames of a camera in lockstep, until it ends."""
    with camera:
        for frame in islice(camera, max_frames):
            yield frame.color_bgr, _to_millimeters(frame.depth_raw, frame.depth_factor)


def _to_millimeters(depth_raw: DepthMm, depth_factor: float) -> DepthMm:
    if depth_factor == 1000.0:
        return depth_raw
    depth_mm = np.rint(depth_raw * (1000.0 / depth_factor))
    return np.where(depth_mm <= MAX_DEPTH_MM, depth_mm, 0.0).astype(np.uint16)
