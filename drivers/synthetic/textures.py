"""Procedural textures: each call paints a different image, without repeated tiles.

A `TexturePainter` paints the face of a solid. Its arguments are a random generator, the height and
width in pixels and the size of a pixel in meters. It returns float32 (height, width, 3) BGR from
0 to 255.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Paint = NDArray[np.float32]
TexturePainter = Callable[[np.random.Generator, int, int, float], Paint]
Color = tuple[float, float, float]


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


def _anisotropic_noise(
    rng: np.random.Generator, height: int, width: int, size_x: float, size_y: float
) -> Paint:
    """Smooth noise (H, W) of about unit deviation with blobs of the given size in pixels."""
    rows, columns = int(height / size_y) + 3, int(width / size_x) + 3
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    if size_x <= 1.0 and size_y <= 1.0:
        return coarse[:height, :width]
    # Only the needed part is enlarged; the random offset decorrelates the lattices of octaves.
    shift_x, shift_y = rng.uniform(0.5, 1.5, 2)
    M = np.array([[1 / size_x, 0.0, shift_x], [0.0, 1 / size_y, shift_y]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    result: Paint = cv2.warpAffine(coarse, M, (width, height), flags=flags)  # type: ignore[assignment]
    return result


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


def flat_color(color: Color) -> TexturePainter:
    """One flat color, for a bare wall."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        return np.full((height, width, 3), color, dtype=np.float32)

    return paint


def plaster(color: Color, roughness: float = 0.04) -> TexturePainter:
    """A painted wall: clouds, stains, grain and scuffs."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        light = 1.0 + roughness * fractal_noise(rng, height, width, 0.8 / texel_m)
        scuffs = fractal_noise(rng, height, width, 0.1 / texel_m)
        light -= 0.12 * np.maximum(0.0, scuffs - 1.8)
        return tint(color, light)

    return paint


def fabric(color: Color, other: Color) -> TexturePainter:
    """Woven cloth or carpet: irregular stripes of a color mixed with a little of the other."""
    b, g, r = (0.75 * one + 0.15 * two for one, two in zip(color, other, strict=True))
    shade = (b, g, r)

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        stripes = _anisotropic_noise(rng, 1, width, 0.03 / texel_m, 1.0)
        bands = _anisotropic_noise(rng, height, 1, 1.0, 0.05 / texel_m)
        wander = 0.5 * fractal_noise(rng, height, width, 0.3 / texel_m)
        mix = 1.0 / (1.0 + np.exp(-1.6 * (stripes + 0.7 * bands + wander)))
        yarn = 1.0 + 0.07 * fractal_noise(rng, height, width, 0.02 / texel_m)
        return tint(color, mix * yarn) + tint(shade, (1.0 - mix) * yarn)

    return paint


def wood(color: Color, board_m: float = 0.0) -> TexturePainter:
    """Wood grain along the width; with `board_m`, boards of that width and random lengths."""

    def grain(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        rings = _anisotropic_noise(rng, height, width, 0.6 / texel_m, 0.04 / texel_m)
        veins = np.sin(
            7.0 * rings + _anisotropic_noise(rng, height, width, 0.2 / texel_m, 0.006 / texel_m)
        )
        fibre = _anisotropic_noise(rng, height, width, 0.05 / texel_m, 0.003 / texel_m)
        clouds = fractal_noise(rng, height, width, 0.3 / texel_m)
        light = rng.uniform(0.92, 1.05) + 0.03 * veins + 0.015 * fibre + 0.03 * clouds
        return tint(color, light)

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        if board_m == 0.0:
            return grain(rng, height, width, texel_m)
        image = np.zeros((height, width, 3), dtype=np.float32)
        step, seam = max(4, round(board_m / texel_m)), max(1, round(0.003 / texel_m))
        for top in range(0, height, step):
            left = -round(rng.uniform(0.0, 1.2) / texel_m)
            while left < width:
                right = left + round(rng.uniform(0.6, 1.6) / texel_m)
                part = image[top : top + step, max(left, 0) : right]
                if part.size:
                    part[:] = grain(rng, part.shape[0], part.shape[1], texel_m)
                part[-seam:] *= 0.7
                part[:, -seam:] *= 0.7
                left = right
        return image

    return paint


def bricks(color: Color, brick_m: tuple[float, float] = (0.24, 0.075)) -> TexturePainter:
    """A wall of bricks of different shades, in rough mortar."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        image = np.full((height, width, 3), (120.0, 128.0, 140.0), dtype=np.float32)
        long, high = (max(4, round(side / texel_m)) for side in brick_m)
        joint = max(1, round(0.010 / texel_m))
        for row, top in enumerate(range(0, height, high)):
            for left in range(-(row % 2) * long // 2 - rng.integers(0, 3), width, long):
                burnt = np.array(color) * rng.uniform(0.85, 1.1) + rng.normal(0.0, 4.0, 3)
                image[top : top + high - joint, max(left, 0) : max(left + long - joint, 0)] = burnt
        light = 1.0 + 0.06 * fractal_noise(rng, height, width, 0.2 / texel_m)
        return image * light[..., None]

    return paint


def cabinet_doors(front: TexturePainter, columns: int, rows: int) -> TexturePainter:
    """The front of a cupboard: panels with gaps and handles.

    Args:
        rows: Number of doors one above the other.
    """

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        image = front(rng, height, width, texel_m)
        gap = max(1, round(0.004 / texel_m))
        for i in range(rows):
            for j in range(columns):
                top, bottom = i * height // rows, (i + 1) * height // rows
                left, right = j * width // columns, (j + 1) * width // columns
                panel = image[top:bottom, left:right]
                panel *= rng.uniform(0.93, 1.05)
                panel[:gap], panel[:, :gap] = panel[:gap] * 0.3, panel[:, :gap] * 0.3
                handle = rng.uniform(0.10, 0.16) / texel_m, 0.012 / texel_m
                x, y = left + 0.5 * (right - left), top + 0.12 * (bottom - top)
                corner = (
                    (round(x - handle[0] / 2), round(y)),
                    (round(x + handle[0] / 2), round(y + handle[1])),
                )
                cv2.rectangle(image, *corner, (70.0, 75.0, 78.0), -1)
        return image

    return paint


def collage(
    background: TexturePainter,
    pieces: Sequence[tuple[TexturePainter, float]],
    turn_rad: float = 0.5,
) -> TexturePainter:
    """Scatter `pieces` over a background.

    Args:
        pieces: A texture and its width in meters for each piece.
        turn_rad: Largest random rotation of a piece.
    """

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        image = background(rng, height, width, texel_m)
        for paint_piece, width_m in pieces:
            wide = max(4, min(width, round(width_m / texel_m)))
            high = max(4, min(height, round(wide * rng.uniform(0.65, 1.5))))
            piece = paint_piece(rng, high, wide, texel_m)
            angle = rng.uniform(-turn_rad, turn_rad)
            _paste(image, piece, rng.uniform(0, width), rng.uniform(0, height), angle)
        return image

    return paint


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


def fixed_texture(image: Paint) -> TexturePainter:
    """A texture that is painted already."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        return image

    return paint
