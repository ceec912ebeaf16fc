"""Pieces of a recording with a fault of the camera, or with a swing as by a push."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, so3_exp
from drivers.faulty_camera import Fault, FaultKind

Image = NDArray[np.integer[Any]]

BLUR_SAMPLES = 9  # views within the exposure that are averaged for motion blur


@dataclass(frozen=True)
class SwingMotion:
    """A swing about the camera's own axes: to one side, back, and to the other side.

    Attributes:
        max_rotation_rad: (3,) rotation vector of the largest deviation.
    """

    max_rotation_rad: tuple[float, float, float]
    rate_hz: float
    exposure_s: float

    def rotation_at(self, time_s: float) -> Array:
        """R_mounting_camera, 3x3."""
        furthest_rad = np.array(self.max_rotation_rad)
        return so3_exp(furthest_rad * np.sin(2 * np.pi * self.rate_hz * time_s))


@dataclass(frozen=True)
class Corruption:
    """A fault or a swing in `pieces` evenly spread pieces of `frames` frames each."""

    kind: FaultKind | SwingMotion
    frames: int
    pieces: int

    def first_frames(self, count: int) -> list[int]:
        """First frame of each piece of a recording of `count` frames."""
        middles = ((2 * n + 1) * count // (2 * self.pieces) for n in range(self.pieces))
        return [max(0, middle - self.frames // 2) for middle in middles]

    def faults(self, count: int) -> tuple[Fault, ...]:
        """The faults of a recording of `count` frames."""
        if isinstance(self.kind, SwingMotion):
            return ()
        return tuple(Fault(self.kind, first, self.frames) for first in self.first_frames(count))

    def swing(self, frames: Iterable[RgbdFrame], count: int) -> Iterator[RgbdFrame]:
        """Yield the frames, with a swing in each piece if it is one."""
        firsts, begin_s = self.first_frames(count), 0.0
        for frame in frames:
            begin_s = frame.stamp_s if frame.seq in firsts else begin_s
            is_inside = any(first <= frame.seq < first + self.frames for first in firsts)
            if is_inside and isinstance(self.kind, SwingMotion):
                yield rotate(frame, self.kind, frame.stamp_s - begin_s)
            else:
                yield frame


def rotate(frame: RgbdFrame, swing: SwingMotion, time_s: float) -> RgbdFrame:
    """Swing the camera, with motion blur, `time_s` after the begin of the swing."""
    exposed_s = time_s + swing.exposure_s * np.linspace(-0.5, 0.5, BLUR_SAMPLES)
    shots = [
        _warp(frame.color_bgr, frame, swing.rotation_at(t), cv2.INTER_LINEAR) for t in exposed_s
    ]
    R = swing.rotation_at(time_s)
    depth = _warp(frame.depth_raw, frame, R, cv2.INTER_NEAREST)
    return replace(
        frame,
        color_bgr=np.mean(shots, axis=0).astype(np.uint8),
        depth_raw=np.rint(depth * _depth_scale(frame, R)).astype(np.uint16),
    )


def _warp(image: Image, frame: RgbdFrame, R: Array, interpolation: int) -> Image:
    """Warp an image to the view of the rotated camera, by its pixel rays rotated back."""
    K = frame.camera.K
    size = frame.camera.width, frame.camera.height
    flags = interpolation | cv2.WARP_INVERSE_MAP
    mapping = K @ R @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(image, mapping, size, flags=flags))


def _depth_scale(frame: RgbdFrame, R: Array) -> Array:
    """Depth (H, W) along the rotated camera's axis of one meter along the original axis."""
    camera = frame.camera
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    share: Array = 1.0 / (R[2, 0] * x[None, :] + R[2, 1] * y[:, None] + R[2, 2])
    return share


# A push against the robot: at most 14 degrees per frame.
SHAKE = SwingMotion((0.15, 0.4, 0.1), rate_hz=2.75, exposure_s=0.012)
# A turn to both sides in a dim room: at most 4 degrees per frame.
PAN = SwingMotion((0.15, 0.7, 0.1), rate_hz=0.5, exposure_s=0.025)

CORRUPTIONS: Mapping[str, Corruption] = {
    "black 0.5 s": Corruption(FaultKind.BLACK, 15, 4),
    "frozen 0.5 s": Corruption(FaultKind.FROZEN, 15, 4),
    "noise 0.5 s": Corruption(FaultKind.NOISE, 15, 4),
    "shaken 1 s": Corruption(SHAKE, 30, 3),
    "panned 2 s": Corruption(PAN, 60, 2),
    "missing 0.5 s": Corruption(FaultKind.DROPPED, 15, 4),
    "missing 1 s": Corruption(FaultKind.DROPPED, 30, 3),
    "missing 2 s": Corruption(FaultKind.DROPPED, 60, 2),
    "missing 3 s": Corruption(FaultKind.DROPPED, 90, 1),
}
