"""How a source's raw images become a frame's: lens, registration, unit, and who says so.

The rule of registration, for everything that libOpenNI2 opens:

- A camera file with a `[depth]` table says that depth is a camera of its own: a device is told not
  to register, and registration happens here.
- A camera file without one says that a recording's depth is registered. A device says so itself.
- Without a camera file a device must register, and say that it does. A recording is refused: the
  format has no place for it, and depth taken for registered when it is not bends every pose.
"""

from dataclasses import dataclass
from enum import Enum
from math import tan
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.camera_file import NO_DISTORTION, CameraFile, read_camera_file
from drivers.errors import InputError
from drivers.registration import SoftwareRegistration
from drivers.undistort import Undistorter, undistorter

# The usual values of these sensors, for an image 640 pixels wide.
DEFAULT_FOCAL, DEFAULT_WIDTH = 525.0, 640
# A camera file corrects a sensor's scale by per cent; beyond this it is one for another unit.
LARGEST_CORRECTION = 1.25

Size = tuple[int, int]


class Registered(Enum):
    """Whether the depth that a source delivers is registered to its colour image."""

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Source:
    """What a device or a recording says of its images; sizes are (width, height)."""

    name: str
    colour_size: Size
    depth_size: Size
    colour_fov_rad: tuple[float, float]
    depth_factor: float
    registered: Registered
    flip_colour: bool = False
    flip_depth: bool = False


@dataclass(frozen=True)
class CameraChoice:
    """The camera file that the user gave, if any."""

    path: Path | None
    file: CameraFile | None

    @classmethod
    def read(cls, path: Path | None) -> "CameraChoice":
        """Read it. Raises InputError."""
        return cls(path, None if path is None else read_camera_file(path))

    @property
    def has_depth_camera(self) -> bool:
        """Whether depth is to be registered here."""
        return self.file is not None and self.file.depth is not None


class DepthPath(Protocol):
    """Makes depth as delivered the depth of the undistorted colour camera."""

    def __call__(self, image: NDArray[np.uint16], /) -> NDArray[np.uint16]:
        """(height, width) uint16 in the same unit."""
        ...


@dataclass(frozen=True)
class Optics:
    """Makes a frame's images. `intrinsics_source` says where `camera` comes from.

    The timing is the camera file's, see `CameraFile`; zero without one.
    """

    camera: PinholeCamera
    depth_factor: float
    intrinsics_source: str
    lens: Undistorter
    depth_path: DepthPath
    flip_colour: bool
    flip_depth: bool
    readout_s: float = 0.0
    depth_offset_s: float = 0.0

    def colour(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistorted."""
        if self.flip_colour:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.lens.colour(image)

    def depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistorted and registered."""
        if self.flip_depth:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.depth_path(image)


def make_optics(source: Source, choice: CameraChoice) -> Optics:
    """Raises InputError where file and source do not fit, or depth cannot be registered."""
    if choice.file is None:
        return _without_file(source)
    _check_file(source, choice.file, f"camera file {choice.path}")
    camera, depth = choice.file.pinhole, choice.file.depth
    lens = undistorter(camera, choice.file.distortion)
    path: DepthPath
    if depth is None:
        path, factor = lens.depth, choice.file.depth_factor
    else:
        registration = SoftwareRegistration(camera, depth, choice.file.depth_factor)
        path, factor = registration.register, registration.depth_factor
    return Optics(
        camera,
        factor,
        f"camera file {choice.path}",
        lens,
        path,
        source.flip_colour,
        source.flip_depth,
        choice.file.readout_s,
        choice.file.depth_offset_s,
    )


def _without_file(source: Source) -> Optics:
    if source.registered is not Registered.YES:
        raise _unregistered(source)
    _check_same_size(source)
    camera, told = _told_by(source)
    lens = undistorter(camera, NO_DISTORTION)
    return Optics(
        camera,
        source.depth_factor,
        told,
        lens,
        lens.depth,
        source.flip_colour,
        source.flip_depth,
    )


def _told_by(source: Source) -> tuple[PinholeCamera, str]:
    """Intrinsics from the field of view that the source tells, else the usual ones."""
    width, height = source.colour_size
    centre = ((width - 1) / 2, (height - 1) / 2)
    across, down = source.colour_fov_rad
    if 0.1 < across < 3.0 and 0.1 < down < 3.0:
        fx, fy = width / (2 * tan(across / 2)), height / (2 * tan(down / 2))
        return PinholeCamera(width, height, fx, fy, *centre), "factory"
    focal = DEFAULT_FOCAL * width / DEFAULT_WIDTH
    return PinholeCamera(width, height, focal, focal, *centre), "default"


def _check_file(source: Source, file: CameraFile, name: str) -> None:
    _check_size(source, "colour", source.colour_size, (file.width, file.height), name)
    if file.depth is not None:
        depth_size = (file.depth.width, file.depth.height)
        _check_size(source, "depth", source.depth_size, depth_size, f"[depth] of {name}")
        if source.registered is Registered.YES:
            raise InputError(
                f"{source.name}: registers its depth and cannot be told not to; leave [depth] "
                f"out of {name}"
            )
    else:
        if source.registered is Registered.NO:
            raise _unregistered(source)
        _check_same_size(source)
    correction = file.depth_factor / source.depth_factor
    if not 1 / LARGEST_CORRECTION < correction < LARGEST_CORRECTION:
        raise InputError(
            f"{name}: depth_factor is {file.depth_factor:g}, but {source.name} delivers "
            f"{source.depth_factor:g} per metre; set depth_factor = {source.depth_factor:.1f}"
        )


def _check_size(source: Source, what: str, has: Size, wanted: Size, name: str) -> None:
    if has != wanted:
        raise InputError(
            f"{source.name}: {what} is {has[0]}x{has[1]}, but {name} is for "
            f"{wanted[0]}x{wanted[1]}; give the camera file of these images"
        )


def _check_same_size(source: Source) -> None:
    if source.colour_size != source.depth_size:
        (w, h), (depth_w, depth_h) = source.colour_size, source.depth_size
        raise InputError(
            f"{source.name}: colour is {w}x{h} but depth is {depth_w}x{depth_h}, so it cannot be "
            "registered; give a camera file with a [depth] table (kinect-vo calibrate --depth)"
        )


def _unregistered(source: Source) -> InputError:
    if source.registered is Registered.UNKNOWN:
        return InputError(
            f"{source.name}: does not say whether its depth was registered to colour; give a "
            "camera file: without a [depth] table if it was, with one if it was not (kinect-vo "
            "calibrate --depth)"
        )
    return InputError(
        f"{source.name}: does not register its depth to colour; give a camera file with a [depth] "
        "table (kinect-vo calibrate --depth)"
    )
