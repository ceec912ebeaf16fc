"""Faults on request: what goes wrong with which frames, applied as the frames are played."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.strict_toml import required, setting

Image = NDArray[np.uint8]
Depth = NDArray[np.uint16]


class FaultKind(StrEnum):
    """What can go wrong."""

    DROPPED = "dropped"  # the frame never comes
    FROZEN = "frozen"  # the images of the last good frame again, under a new stamp
    BLACK = "black"  # the colour image is black
    TORN = "torn"  # upper half new, lower half of the frame before
    DARK = "dark"  # the lights are off: hardly more than noise; depth needs no light
    COVERED = "covered"  # something lies on the camera: colour is black, and no depth is read
    NOISE = "noise"  # nothing but noise, in colour and in depth
    STAMP_JUMP = "stamp-jump"  # stamps are off by `seconds`
    STAMP_REPEAT = "stamp-repeat"  # the stamp of the frame before
    UNPLUGGED = "unplugged"  # gone at this frame, back after `seconds`


@dataclass(frozen=True)
class Fault:
    """`kind` strikes `count` frames from frame `first`; `seconds` where the kind asks for it."""

    kind: FaultKind = required("what goes wrong")
    first: int = required("number of the first frame that suffers, from 0", low=0)
    count: int = setting(1, "how many frames suffer", low=1)
    seconds: float = setting(
        0.0, "how far stamps jump, or after how long an unplugged camera is back"
    )

    def __post_init__(self) -> None:
        if self.first < 0 or self.count < 1:
            raise InputError(f"fault {self.kind}: first must be at least 0 and count at least 1")
        if self.kind is FaultKind.UNPLUGGED and self.seconds <= 0:
            raise InputError("fault unplugged: give the seconds until the camera comes back")

    def strikes(self, index: int) -> bool:
        """True if frame `index` is one of those that suffer."""
        return self.first <= index < self.first + self.count


@dataclass(frozen=True)
class Images:
    """Colour (H, W, 3) uint8 BGR and depth registered to it (H, W) uint16, both undistorted."""

    colour: Image
    depth: Depth


Source = Callable[[int], Images]

DARK_GAIN = 0.02
DARK_NOISE_SIGMA = 3.0


@dataclass(frozen=True)
class FaultySource:
    """The images and stamps of `source` as they come through when `faults` strike."""

    source: Source
    faults: tuple[Fault, ...]
    seed: int

    def strikes(self, kind: FaultKind, index: int) -> bool:
        """True if frame `index` suffers from `kind`."""
        return any(fault.kind is kind and fault.strikes(index) for fault in self.faults)

    def images(self, index: int) -> Images:
        """What the driver is given as frame `index`."""
        images = self.source(self._shown(FaultKind.FROZEN, index))
        if self.strikes(FaultKind.TORN, index):
            images = _torn(images, self.source(max(index - 1, 0)))
        if self.strikes(FaultKind.DARK, index):
            images = _dark(images, np.random.default_rng([self.seed, 6, index]))
        if self.strikes(FaultKind.BLACK, index):
            images = Images(np.zeros_like(images.colour), images.depth)
        if self.strikes(FaultKind.COVERED, index):
            images = Images(np.zeros_like(images.colour), np.zeros_like(images.depth))
        if self.strikes(FaultKind.NOISE, index):
            images = _noise(images, np.random.default_rng([self.seed, 7, index]))
        return images

    def stamped_as(self, index: int) -> tuple[int, float]:
        """The frame whose stamp frame `index` bears, and the seconds by which it is off."""
        off_s = sum(
            fault.seconds
            for fault in self.faults
            if fault.kind is FaultKind.STAMP_JUMP and fault.strikes(index)
        )
        return self._shown(FaultKind.STAMP_REPEAT, index), off_s

    def _shown(self, kind: FaultKind, index: int) -> int:
        """The last frame before a repetition of that kind; `index` itself where there is none."""
        while index > 0 and self.strikes(kind, index):
            index -= 1
        return index


def _torn(new: Images, old: Images) -> Images:
    colour, depth = new.colour.copy(), new.depth.copy()
    half = len(depth) // 2
    colour[half:], depth[half:] = old.colour[half:], old.depth[half:]
    return Images(colour, depth)


def _dark(images: Images, rng: np.random.Generator) -> Images:
    noise = DARK_NOISE_SIGMA * rng.standard_normal(images.colour.shape, dtype=np.float32)
    colour = np.clip(images.colour * np.float32(DARK_GAIN) + noise + 0.5, 0, 255)
    return Images(colour.astype(np.uint8), images.depth)


def _noise(images: Images, rng: np.random.Generator) -> Images:
    colour = rng.integers(0, 256, images.colour.shape, np.uint8)
    farthest = max(1, int(images.depth.max()))
    return Images(colour, rng.integers(0, farthest, images.depth.shape, np.uint16))
