"""Known transforms of an image: a homography and a change of brightness."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array

Gray = NDArray[np.uint8]
Corners = list[tuple[float, float]]

# Blur of a camera's own optics, in its pixels (Lowe 2004, Section 3.3).
CAMERA_BLUR_PX = 0.5


def _identity(image: Gray) -> Gray:
    return image


@dataclass(frozen=True)
class ImageTransform:
    """One transform, as by a camera motion or a change of the light.

    Attributes:
        group: Its group in the table.
        warp: (width, height) -> homography (3, 3) from original to transformed pixels.
        zoom: Size of objects in the transformed image relative to the original.
        retouch: Change of the brightness after the warp.
    """

    group: str
    warp: Callable[[int, int], Array] = field(default=lambda width, height: np.eye(3))
    zoom: float = 1.0
    change_brightness: Callable[[Gray], Gray] = _identity

    def homography(self, image: Gray) -> Array:
        """Homography (3, 3) from pixels of the original to pixels of the transformed image."""
        return self.warp(image.shape[1], image.shape[0])

    def apply(self, image: Gray) -> Gray:
        """Transform an image; the result has the same size."""
        size = (image.shape[1], image.shape[0])
        H = self.homography(image)
        sharp = image if np.array_equal(H, np.eye(3)) else _resample(image, H, size, self.zoom)
        return self.change_brightness(sharp)


def all_transforms() -> list[ImageTransform]:
    """Make the 34 transforms of the benchmark."""
    return [
        *(
            ImageTransform("rotation", make_rotation(angle))
            for angle in (10, 20, 30, 45, 60, 90, 135, 180)
        ),
        *(
            ImageTransform("scale", make_rotation(0, z), z)
            for z in (0.5, 0.63, 0.8, 1.25, 1.6, 2.0)
        ),
        *(
            ImageTransform("both", make_rotation(angle, zoom), zoom)
            for angle, zoom in ((30, 0.7), (45, 1.4), (100, 0.8), (160, 1.6))
        ),
        *(ImageTransform("perspective", make_perspective_tilt(*tilt)) for tilt in TILTS),
        *(
            ImageTransform("blur", change_brightness=partial(blur, sigma))
            for sigma in (1.0, 1.5, 2.0, 3.0)
        ),
        *(
            ImageTransform("light", change_brightness=partial(_change_lighting, *light))
            for light in LIGHTS
        ),
        *(
            ImageTransform("noise", change_brightness=partial(add_noise, sigma))
            for sigma in (5.0, 10.0, 15.0, 20.0)
        ),
    ]


# Share of the width and height by which the far side shrinks: left, right, top, bottom.
TILTS = ((0.1, 0, 0, 0), (0, 0.2, 0, 0), (0, 0, 0.15, 0), (0.1, 0, 0, 0.15))
# Gamma, contrast and offset.
LIGHTS = ((0.5, 1.0, 0.0), (2.0, 1.0, 0.0), (1.0, 0.5, 0.0), (1.0, 1.3, 20.0))


def make_rotation(angle_deg: float, zoom: float = 1.0) -> Callable[[int, int], Array]:
    """Rotate about the center of the image and zoom in."""

    def warp(width: int, height: int) -> Array:
        middle = ((width - 1) / 2, (height - 1) / 2)
        H = np.eye(3)
        H[:2] = cv2.getRotationMatrix2D(middle, angle_deg, zoom)
        return H

    return warp


def make_perspective_tilt(
    left: float, right: float, top: float, bottom: float
) -> Callable[[int, int], Array]:
    """Tilt the scene away from the camera: one side becomes shorter.

    Args:
        left: Fraction of the image by which the left corners move inwards.
        right: The same for the right corners.
        top: The same for the upper corners.
        bottom: The same for the lower corners.
    """

    def warp(width: int, height: int) -> Array:
        right_px, bottom_px = width - 1.0, height - 1.0
        corners: Corners = [(0, 0), (right_px, 0), (right_px, bottom_px), (0, bottom_px)]
        moved: Corners = [
            (width * (left + top), height * (top + left)),
            (right_px - width * (right + top), height * (top + right)),
            (right_px - width * (right + bottom), bottom_px - height * (bottom + right)),
            (width * (left + bottom), bottom_px - height * (bottom + left)),
        ]
        H = cv2.getPerspectiveTransform(np.array(corners, np.float32), np.array(moved, np.float32))
        return np.asarray(H, np.float64)

    return warp


def blur(sigma_px: float, image: Gray) -> Gray:
    """Blur an image as if out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)


def _change_lighting(gamma: float, contrast: float, offset: float, image: Gray) -> Gray:
    """Change light and exposure; bright values are clipped."""
    levels = 255.0 * (np.arange(256) / 255.0) ** gamma
    table = np.clip(np.rint(contrast * levels + offset), 0, 255).astype(np.uint8)
    return table[image]


def add_noise(sigma: float, image: Gray) -> Gray:
    """Add sensor noise, the same in every run."""
    noise = np.random.default_rng(0).normal(0.0, sigma, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def _resample(image: Gray, H: Array, size: tuple[int, int], zoom: float) -> Gray:
    """Warp; where the image shrinks, first blur it like the camera's optics."""
    blur_px = CAMERA_BLUR_PX * np.sqrt(max(1.0 / zoom**2 - 1.0, 0.0))
    smooth = blur(float(blur_px), image) if blur_px > 0 else image
    # The border is replicated: there is no edge along it and no mirrored copy beyond it.
    warped = cv2.warpPerspective(
        smooth, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped, np.uint8)
