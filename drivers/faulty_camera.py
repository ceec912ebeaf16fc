"""Faults that are injected into the frames of any camera."""

import time
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraCounters, RgbdCamera, RgbdFrame
from drivers.camera_wrapper import CameraWrapper
from drivers.core.config import Field, FieldError

DARK_GAIN = 0.02
DARK_NOISE_SIGMA = 3.0


class FaultKind(StrEnum):
    """Kinds of faults."""

    DROPPED = "dropped"  # the frame is not delivered
    FROZEN = "frozen"  # the images of the last good frame again, with a new stamp
    BLACK = "black"  # the color image is black
    TORN = "torn"  # upper half new, lower half of the frame before
    DARK = "dark"  # the lights are off: color is mostly noise; depth needs no light
    COVERED = "covered"  # the camera is covered: color is black, and depth has no readings
    NOISE = "noise"  # only noise, in color and in depth
    STAMP_JUMP = "stamp-jump"  # stamps are off by `seconds`
    STAMP_REPEAT = "stamp-repeat"  # the stamp of the frame before
    UNPLUGGED = "unplugged"  # disconnected at this frame, back after `seconds`


@dataclass(frozen=True)
class Fault:
    """A fault of `count` frames from frame `first`; `seconds` if the kind needs it."""

    kind: Annotated[FaultKind, "kind of fault"]
    first: Annotated[int, Field("number of the first affected frame, from 0", minimum=0)]
    count: Annotated[int, Field("number of affected frames", minimum=1)] = 1
    seconds: Annotated[float, "size of a stamp jump, or how long an unplugged camera is away"] = 0.0

    def __post_init__(self) -> None:
        if self.first < 0 or self.count < 1:
            name = "first" if self.first < 0 else "count"
            raise FieldError((name,), "first must be at least 0 and count at least 1")
        if self.kind is FaultKind.UNPLUGGED and self.seconds <= 0:
            raise FieldError(("seconds",), "seconds must be given: how long the camera is away")

    def applies_to(self, index: int) -> bool:
        """Whether frame `index` is affected."""
        return self.first <= index < self.first + self.count


class FaultyCamera(CameraWrapper):
    """Applies faults to the frames of another camera, chosen by their numbers.

    A frame that is dropped counts as skipped. To be unplugged is up to the camera itself, which
    knows where it is when it comes back.
    """

    def __init__(self, camera: RgbdCamera, faults: tuple[Fault, ...], seed: int) -> None:
        super().__init__(camera)
        self._faults, self._seed = faults, seed
        self._skipped = 0
        self._last: RgbdFrame | None = None  # the last frame,
        self._last_moving: RgbdFrame | None = None  # that was not frozen,
        self._last_stamped: RgbdFrame | None = None  # and that had a stamp of its own

    def read(self, timeout_s: float) -> RgbdFrame:
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = self._camera.read(max(0.0, deadline_s - time.monotonic()))
            kinds = {fault.kind for fault in self._faults if fault.applies_to(frame.seq)}
            faulty = self._apply(frame, kinds)
            if FaultKind.DROPPED not in kinds:
                return faulty
            self._skipped += 1

    @property
    def counters(self) -> CameraCounters:
        skipped = self._skipped
        return self._camera.counters + CameraCounters(delivered=-skipped, skipped=skipped)

    def _apply(self, frame: RgbdFrame, kinds: set[FaultKind]) -> RgbdFrame:
        before = self._last if frame.seq and self._last else frame
        if before is frame or FaultKind.FROZEN not in kinds or self._last_moving is None:
            self._last_moving = frame
        if before is frame or FaultKind.STAMP_REPEAT not in kinds or self._last_stamped is None:
            self._last_stamped = frame
        self._last = frame
        if not kinds:
            return frame
        color, depth = self._last_moving.color_bgr, self._last_moving.depth_raw
        if FaultKind.TORN in kinds:
            color, depth = _tear(color, before.color_bgr), _tear(depth, before.depth_raw)
        if FaultKind.DARK in kinds:
            color = _darken(color, np.random.default_rng([self._seed, 6, frame.seq]))
        if kinds & {FaultKind.BLACK, FaultKind.COVERED}:
            color = np.zeros_like(color)
        if FaultKind.COVERED in kinds:
            depth = np.zeros_like(depth)
        if FaultKind.NOISE in kinds:
            rng = np.random.default_rng([self._seed, 7, frame.seq])
            color = rng.integers(0, 256, color.shape, np.uint8)
            depth = rng.integers(0, max(1, int(depth.max())), depth.shape, np.uint16)
        stamp_s = round(self._last_stamped.stamp_s + self._stamp_offset_s(frame.seq), 6)
        return replace(frame.restamped(stamp_s), color_bgr=color, depth_raw=depth)

    def _stamp_offset_s(self, seq: int) -> float:
        return sum(
            fault.seconds
            for fault in self._faults
            if fault.kind is FaultKind.STAMP_JUMP and fault.applies_to(seq)
        )


def _tear(new: NDArray[Any], old: NDArray[Any]) -> NDArray[Any]:
    half = len(new) // 2
    return np.concatenate((new[:half], old[half:]))


def _darken(color: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    noise = DARK_NOISE_SIGMA * rng.standard_normal(color.shape, dtype=np.float32)
    return np.clip(color * np.float32(DARK_GAIN) + noise + 0.5, 0, 255).astype(np.uint8)
