"""Procedural textures: each call paints a different image, without repeated tiles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Concatenate, ParamSpec

import cv2
import numpy as np
from numpy.typing import NDArray

Paint = NDArray[np.float32]
Color = tuple[float, float, float]
P = ParamSpec("P")


@dataclass(frozen=True)
class Face:
    """The face of a solid that a `TexturePainter` paints.

    Attributes:
        rng: Draws all that is random in the image.
        height: Of the image, pixels.
        width: Of the image, pixels.
        texel_m: Size of a pixel, meters.
    """

    rng: np.random.Generator
    height: int
    width: int
    texel_m: float

    def part(self, height: int, width: int) -> "Face":
        """A part of this size, in pixels."""
        return replace(self, height=height, width=width)

    def filled(self, color: Color) -> Paint:
        """One flat color."""
        return np.full((self.height, self.width, 3), color, dtype=np.float32)

    def noise(self, coarsest_m: float) -> Paint:
        """Noise (H, W) as of `fractal_noise`, whose largest blobs have this size."""
        return fractal_noise(self.rng, self.height, self.width, coarsest_m / self.texel_m)

    def blobs(self, wide_m: float, high_m: float) -> Paint:
        """Smooth noise (H, W) of about unit deviation with blobs of this size."""
        wide_px, high_px = wide_m / self.texel_m, high_m / self.texel_m
        rows, columns = int(self.height / high_px) + 3, int(self.width / wide_px) + 3
        coarse = self.rng.standard_normal((rows, columns), dtype=np.float32)
        if wide_px <= 1.0 and high_px <= 1.0:
            return coarse[: self.height, : self.width]
        # Only the needed part is enlarged; the random offset decorrelates the lattices of octaves.
        shift_x, shift_y = self.rng.uniform(0.5, 1.5, 2)
        M = np.array([[1 / wide_px, 0.0, shift_x], [0.0, 1 / high_px, shift_y]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(coarse, M, (self.width, self.height), flags=flags)  # type: ignore[return-value]


# Paints a face: float32 (height, width, 3) BGR from 0 to 255.
TexturePainter = Callable[[Face], Paint]


def texture(paint: Callable[Concatenate[Face, P], Paint]) -> Callable[P, TexturePainter]:
    """Make a function of the arguments after the face, which returns a painter with them."""

    @wraps(paint)
    def make_painter(*args: P.args, **kwargs: P.kwargs) -> TexturePainter:
        return lambda face: paint(face, *args, **kwargs)

    return make_painter


def fractal_noise(
    rng: np.random.Generator, height: int, width: int, coarsest_px: float, finest_px: float = 1.0
) -> Paint:
    """Noise (H, W) of about unit deviation, equal power in each octave: photographs' 1/f law.

    Args:
        coarsest_px: Size of the largest blobs, pixels.
        finest_px: Size of the smallest blobs, pixels.
    """
    octaves = 1 + max(0, int(np.log2(max(coarsest_px, 1.0) / finest_px)))
    total = np.zeros((2, 2), dtype=np.float32)
    for size_px in finest_px * 2.0 ** np.arange(octaves - 1, -1, -1):
        rows, columns = int(height / size_px) + 2, int(width / size_px) + 2
        total = _enlarge(total, columns, rows)
        total += rng.standard_normal((rows, columns), dtype=np.float32)
    if finest_px > 1.0:
        total = _enlarge(total, width, height)
    return total[:height, :width] / np.float32(np.sqrt(0.8 * octaves))


def _enlarge(image: Paint, width: int, height: int) -> Paint:
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)  # type: ignore[return-value]


def tint(color: Color, light: Paint) -> Paint:
    """Multiply a color by a brightness map (H, W): float32 (H, W, 3)."""
    return light[..., None] * np.array(color, dtype=np.float32)


def random_color(
    rng: np.random.Generator, saturation: float = 0.5, low: float = 60.0, high: float = 210.0
) -> Color:
    """Choose a random hue; saturation 0 is gray.

    Args:
        saturation: 0 is gray, 1 a pure hue.
        low: Least brightness, gray levels.
        high: Greatest brightness, gray levels.
    """
    brightness = rng.uniform(low, high)
    hue = [3.0 * share for share in rng.dirichlet((2.0, 2.0, 2.0)).tolist()]
    pure = max(*hue, 1.0)
    blue, green, red = (
        min(max(brightness * ((1.0 - saturation) + saturation * each / pure), 0.0), 255.0)
        for each in hue
    )
    return blue, green, red


@texture
def flat_color(face: Face, color: Color) -> Paint:
    """One flat color, for a bare wall."""
    return face.filled(color)


@texture
def plaster(face: Face, color: Color, roughness: float = 0.04) -> Paint:
    """A painted wall: clouds, stains, grain and scuffs."""
    light = 1.0 + roughness * face.noise(0.8)
    light -= 0.12 * np.maximum(0.0, face.noise(0.1) - 1.8)
    return tint(color, light)


@texture
def fabric(face: Face, color: Color, other: Color) -> Paint:
    """Woven cloth or carpet: irregular stripes of a color mixed with a little of the other."""
    b, g, r = (0.75 * one + 0.15 * two for one, two in zip(color, other, strict=True))
    stripes = face.part(1, face.width).blobs(0.03, face.texel_m)
    bands = face.part(face.height, 1).blobs(face.texel_m, 0.05)
    mix = 1.0 / (1.0 + np.exp(-1.6 * (stripes + 0.7 * bands + 0.5 * face.noise(0.3))))
    yarn = 1.0 + 0.07 * face.noise(0.02)
    return tint(color, mix * yarn) + tint((b, g, r), (1.0 - mix) * yarn)


def _wood_grain(face: Face, color: Color) -> Paint:
    rings = face.blobs(0.6, 0.04)
    veins = np.sin(7.0 * rings + face.blobs(0.2, 0.006))
    fibre = face.blobs(0.05, 0.003)
    clouds = face.noise(0.3)
    return tint(color, face.rng.uniform(0.92, 1.05) + 0.03 * veins + 0.015 * fibre + 0.03 * clouds)


@texture
def wood(face: Face, color: Color, board_m: float = 0.0) -> Paint:
    """Wood grain along the width; with `board_m`, boards of that width and random lengths."""
    if board_m == 0.0:
        return _wood_grain(face, color)
    image, rng = face.filled((0.0, 0.0, 0.0)), face.rng
    step, seam = max(4, round(board_m / face.texel_m)), max(1, round(0.003 / face.texel_m))
    for top in range(0, face.height, step):
        left = -round(rng.uniform(0.0, 1.2) / face.texel_m)
        while left < face.width:
            right = left + round(rng.uniform(0.6, 1.6) / face.texel_m)
            board = image[top : top + step, max(left, 0) : right]
            if board.size:
                board[:] = _wood_grain(face.part(*board.shape[:2]), color)
            board[-seam:] *= 0.7
            board[:, -seam:] *= 0.7
            left = right
    return image


@texture
def bricks(face: Face, color: Color, brick_m: tuple[float, float] = (0.24, 0.075)) -> Paint:
    """A wall of bricks of different shades, in rough mortar."""
    image, rng = face.filled((120.0, 128.0, 140.0)), face.rng
    long, high = (max(4, round(side / face.texel_m)) for side in brick_m)
    joint = max(1, round(0.010 / face.texel_m))
    for row, top in enumerate(range(0, face.height, high)):
        for left in range(-(row % 2) * long // 2 - rng.integers(0, 3), face.width, long):
            burnt = np.array(color) * rng.uniform(0.85, 1.1) + rng.normal(0.0, 4.0, 3)
            image[top : top + high - joint, max(left, 0) : max(left + long - joint, 0)] = burnt
    light = 1.0 + 0.06 * face.noise(0.2)
    return image * light[..., None]


@texture
def cabinet_doors(face: Face, front: TexturePainter, columns: int, rows: int) -> Paint:
    """The front of a cupboard: panels with gaps and handles.

    Args:
        rows: Number of doors one above the other.
    """
    image, rng = front(face), face.rng
    gap = max(1, round(0.004 / face.texel_m))
    for i in range(rows):
        for j in range(columns):
            top, bottom = i * face.height // rows, (i + 1) * face.height // rows
            left, right = j * face.width // columns, (j + 1) * face.width // columns
            panel = image[top:bottom, left:right]
            panel *= rng.uniform(0.93, 1.05)
            panel[:gap], panel[:, :gap] = panel[:gap] * 0.3, panel[:, :gap] * 0.3
            handle = rng.uniform(0.10, 0.16) / face.texel_m, 0.012 / face.texel_m
            x, y = left + 0.5 * (right - left), top + 0.12 * (bottom - top)
            corner = (
                (round(x - handle[0] / 2), round(y)),
                (round(x + handle[0] / 2), round(y + handle[1])),
            )
            cv2.rectangle(image, *corner, (70.0, 75.0, 78.0), -1)
    return image


@texture
def collage(
    face: Face,
    background: TexturePainter,
    pieces: Sequence[tuple[TexturePainter, float]],
    turn_rad: float = 0.5,
) -> Paint:
    """Scatter `pieces` over a background.

    Args:
        pieces: A texture and its width in meters for each piece.
        turn_rad: Largest random rotation of a piece.
    """
    image, rng = background(face), face.rng
    for paint_piece, width_m in pieces:
        wide = max(4, min(face.width, round(width_m / face.texel_m)))
        high = max(4, min(face.height, round(wide * rng.uniform(0.65, 1.5))))
        piece = paint_piece(face.part(high, wide))
        angle = rng.uniform(-turn_rad, turn_rad)
        _paste(image, piece, rng.uniform(0, face.width), rng.uniform(0, face.height), angle)
    return image


def _paste(image: Paint, piece: Paint, x: float, y: float, angle_rad: float) -> None:
    """Paste `piece`, centered at (x, y), into the window of `image` that it covers."""
    high, wide = piece.shape[:2]
    reach = int(np.hypot(high, wide) / 2) + 2
    left, top = max(0, int(x) - reach), max(0, int(y) - reach)
    window = image[top : int(y) + reach, left : int(x) + reach]
    if not window.size:
        return
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    M = np.array([[c, -s, x - left], [s, c, y - top]])
    M[:, 2] -= M[:, :2] @ ((wide - 1) / 2, (high - 1) / 2)
    size = window.shape[1], window.shape[0]
    warped = cv2.warpAffine(piece, M, size, flags=cv2.INTER_LINEAR)
    alpha = cv2.warpAffine(np.ones((high, wide), np.float32), M, size, flags=cv2.INTER_LINEAR)
    window *= 1.0 - alpha[..., None]
    # Outside the piece the warped image is black, so nothing is added there.
    window += warped


@texture
def fixed_texture(_: Face, image: Paint) -> Paint:
    """A texture that is painted already."""
    return image


@texture
def fixed_seed(face: Face, painter: TexturePainter, key: Sequence[int]) -> Paint:
    """The same image every time."""
    return painter(replace(face, rng=np.random.default_rng(key)))
