"""Fault injection: configured faults, applied to frames when they are read."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import InputError
from drivers.core.fields import Field

Image = NDArray[np.uint8]
Depth = NDArray[np.uint16]


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
            raise InputError(f"fault {self.kind}: first must be at least 0 and count at least 1")
        if self.kind is FaultKind.UNPLUGGED and self.seconds <= 0:
            raise InputError("fault unplugged: seconds must be given: how long the camera is away")

    def applies_to(self, index: int) -> bool:
        """Whether frame `index` is affected."""
        return self.first <= index < self.first + self.count


@dataclass(frozen=True)
class RenderedImages:
    """Color (H, W, 3) uint8 BGR and depth registered to it (H, W) uint16, both undistorted."""

    color_bgr: Image
    depth_raw: Depth


ImageSource = Callable[[int], RenderedImages]

DARK_GAIN = 0.02
DARK_NOISE_SIGMA = 3.0


@dataclass(frozen=True)
class FaultInjector:
    """Applies `faults` to the images and stamps of `source`."""

    source: ImageSource
    faults: tuple[Fault, ...]
    seed: int

    def has_fault(self, kind: FaultKind, index: int) -> bool:
        """Whether frame `index` has a fault of `kind`."""
        return any(fault.kind is kind and fault.applies_to(index) for fault in self.faults)

    def read_images(self, index: int) -> RenderedImages:
        """Read the images of frame `index` with its faults."""
        images = self.source(self._last_unaffected(FaultKind.FROZEN, index))
        if self.has_fault(FaultKind.TORN, index):
            images = _tear(images, self.source(max(index - 1, 0)))
        if self.has_fault(FaultKind.DARK, index):
            images = _darken(images, np.random.default_rng([self.seed, 6, index]))
        if self.has_fault(FaultKind.BLACK, index):
            images = RenderedImages(np.zeros_like(images.color_bgr), images.depth_raw)
        if self.has_fault(FaultKind.COVERED, index):
            images = RenderedImages(
                np.zeros_like(images.color_bgr), np.zeros_like(images.depth_raw)
            )
        if self.has_fault(FaultKind.NOISE, index):
            images = _replace_with_noise(images, np.random.default_rng([self.seed, 7, index]))
        return images

    def stamp_source(self, index: int) -> tuple[int, float]:
        """The frame whose stamp frame `index` has, and the error of that stamp in seconds."""
        offset_s = sum(
            fault.seconds
            for fault in self.faults
            if fault.kind is FaultKind.STAMP_JUMP and fault.applies_to(index)
        )
        return self._last_unaffected(FaultKind.STAMP_REPEAT, index), offset_s

    def _last_unaffected(self, kind: FaultKind, index: int) -> int:
        """The last frame up to `index` without a fault of `kind`."""
        while index > 0 and self.has_fault(kind, index):
            index -= 1
        return index


def _tear(new: RenderedImages, old: RenderedImages) -> RenderedImages:
    color, depth = new.color_bgr.copy(), new.depth_raw.copy()
    half = len(depth) // 2
    color[half:], depth[half:] = old.color_bgr[half:], old.depth_raw[half:]
    return RenderedImages(color, depth)


def _darken(images: RenderedImages, rng: np.random.Generator) -> RenderedImages:
    noise = DARK_NOISE_SIGMA * rng.standard_normal(images.color_bgr.shape, dtype=np.float32)
    color = np.clip(images.color_bgr * np.float32(DARK_GAIN) + noise + 0.5, 0, 255)
    return RenderedImages(color.astype(np.uint8), images.depth_raw)


def _replace_with_noise(images: RenderedImages, rng: np.random.Generator) -> RenderedImages:
    color = rng.integers(0, 256, images.color_bgr.shape, np.uint8)
    farthest = max(1, int(images.depth_raw.max()))
    return RenderedImages(color, rng.integers(0, farthest, images.depth_raw.shape, np.uint16))
