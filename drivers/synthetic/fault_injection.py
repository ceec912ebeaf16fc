"""Fault injection: configured faults, applied to frames when they are read."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.synthetic import Fault, FaultKind

Image = NDArray[np.uint8]
Depth = NDArray[np.uint16]


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
