"""Pieces pasted over a ground at random: a littered floor, a wall of posters."""

from collections.abc import Sequence

import cv2
import numpy as np

from drivers.synthetic.textures import Paint, TexturePainter


def collage(
    background: TexturePainter,
    pieces: Sequence[tuple[TexturePainter, float]],
    turn_rad: float = 0.5,
) -> TexturePainter:
    """`pieces` (a skin and its breadth in metres) strewn over a ground, turned at random."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        image = background(rng, height, width, texel_m)
        for skin, breadth_m in pieces:
            wide = max(4, min(width, round(breadth_m / texel_m)))
            high = max(4, min(height, round(wide * rng.uniform(0.65, 1.5))))
            piece = skin(rng, high, wide, texel_m)
            angle = rng.uniform(-turn_rad, turn_rad)
            _paste(image, piece, rng.uniform(0, width), rng.uniform(0, height), angle)
        return image

    return paint


def _paste(image: Paint, piece: Paint, x: float, y: float, angle_rad: float) -> None:
    """Lay `piece` with its middle at (x, y); only the window that it covers is touched."""
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
    cover = cv2.warpAffine(np.ones((high, wide), np.float32), M, size, flags=cv2.INTER_LINEAR)
    window *= 1.0 - cover[..., None]
    # Outside the piece the warp is black: what it adds there is nothing.
    window += warped


def fixed_texture(image: Paint) -> TexturePainter:
    """A skin that is painted already."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        return image

    return paint
