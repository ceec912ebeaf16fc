"""Printed matter: pictures, pages, posters, book spines, parcels and screens."""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.synthetic.textures import (
    Color,
    Face,
    Paint,
    collage,
    fixed_texture,
    fractal_noise,
    random_color,
    texture,
    tint,
)

FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)
MIN_PX_PER_LEAF = 30
LETTERS = "aaabcdeeeefghiiklmnnooprrssttuuvwyABDEGKMNPRSTZ0123456789"


Canvas = NDArray[np.uint8]  # OpenCV smooths what it draws in bytes only


def to_canvas(paint: Paint) -> Canvas:
    """Convert paint to bytes, to draw on."""
    return np.clip(paint, 0.0, 255.0).astype(np.uint8)


@texture
def picture(face: Face, detail: float = 1.0) -> Paint:
    """A picture with the statistics of photographs: discs of all sizes on top of each other.

    Lee, Mumford and Huang, Occlusion models for natural images, IJCV 2001: radii with density
    r^-3 give the 1/f spectrum and the edges of natural scenes.
    """
    rng = face.rng
    image = np.full((face.height, face.width, 3), random_color(rng), dtype=np.uint8)
    largest = 0.5 * max(face.height, face.width)
    smallest = 0.05 * largest
    count = min(int(rng.uniform(25, 140) * detail), face.height * face.width // MIN_PX_PER_LEAF)
    palette = [random_color(rng, rng.uniform(0.05, 0.7)) for _ in range(8)]
    radii = smallest / np.sqrt(1.0 - rng.uniform(0.0, 1.0 - (smallest / largest) ** 2, count))
    for radius in np.sort(radii)[::-1]:
        _draw_leaf(rng, image, radius, palette[rng.integers(len(palette))])
    light = 1.0 + 0.12 * fractal_noise(rng, face.height, face.width, largest, 2.0)
    return image * light[..., None]


def _draw_leaf(rng: np.random.Generator, image: Canvas, radius: float, color: Color) -> None:
    height, width = image.shape[:2]
    center = rng.uniform(0, width), rng.uniform(0, height)
    shade = tuple(float(c) for c in np.clip(np.array(color) * rng.uniform(0.7, 1.25), 0, 255))
    corners = int(rng.integers(3, 9))
    if corners > 6:
        axes = max(1, round(radius)), max(1, round(radius * rng.uniform(0.3, 1.0)))
        at = round(center[0]), round(center[1])
        cv2.ellipse(image, at, axes, rng.uniform(0, 180), 0, 360, shade, -1, cv2.LINE_AA)
        return
    angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
    reach = radius * rng.uniform(0.5, 1.2, corners)
    points = np.stack([np.cos(angles) * reach, np.sin(angles) * reach], axis=1) + center
    cv2.fillPoly(image, [np.round(points * 16).astype(np.int32)], shade, cv2.LINE_AA, 4)


def _random_text(rng: np.random.Generator, length: int) -> str:
    text = ""
    while len(text) < length:
        word = "".join(rng.choice(list(LETTERS), int(rng.integers(2, 10))))
        text += word + " "
    return text[:length]


def _draw_text(
    rng: np.random.Generator, image: Canvas, left: float, base: float, high_px: float, ink: Color
) -> None:
    """Draw random words from (`left`, `base`) to the right edge, letters `high_px` high."""
    if high_px < 3.0:
        return
    font, scale = FONTS[rng.integers(len(FONTS))], high_px / 21.0
    length = int((image.shape[1] - 2 * left) / (0.85 * high_px))
    thickness = max(1, round(high_px / 9.0))
    at = round(left), round(base)
    cv2.putText(image, _random_text(rng, length), at, font, scale, ink, thickness, cv2.LINE_AA)


@texture
def page(face: Face, heading_m: float = 0.02) -> Paint:
    """A printed sheet: a heading, lines of text, sometimes a picture."""
    rng, height, width = face.rng, face.height, face.width
    image = np.full((height, width, 3), rng.uniform(180.0, 235.0), dtype=np.uint8)
    margin, y = 0.08 * width, 0.06 * height + heading_m / face.texel_m
    ink = random_color(rng, 0.7, 10.0, 120.0)
    _draw_text(rng, image, margin, y, heading_m / face.texel_m, ink)
    body_px = max(3.5, rng.uniform(0.004, 0.009) / face.texel_m)
    while y < height - 2 * body_px:
        y += 1.9 * body_px
        if rng.uniform() < 0.06 and y + 0.25 * height < height:
            inset = image[int(y) : int(y + 0.22 * height), int(margin) : int(width - margin)]
            if inset.size:
                inset[:] = picture(0.4)(face.part(*inset.shape[:2]))
            y += 0.25 * height
        else:
            _draw_text(rng, image, margin, y, body_px, (75.0, 75.0, 75.0))
    return image.astype(np.float32)


@texture
def poster(face: Face) -> Paint:
    """A picture with large writing across it, in a border."""
    rng, height, width = face.rng, face.height, face.width
    image = to_canvas(picture()(face))
    for _ in range(int(rng.integers(1, 4))):
        high = rng.uniform(0.03, 0.10) * height
        base = rng.uniform(0.15, 0.95) * height
        band = image[max(0, int(base - 1.3 * high)) : int(base + 0.4 * high)]
        band[:] = 0.35 * band + 0.65 * np.array(random_color(rng))
        _draw_text(rng, image, 0.05 * width, base, high, random_color(rng, 0.5, 0.0, 255.0))
    edge = max(1, int(0.02 * min(height, width)))
    frame = random_color(rng, 0.3, 20.0, 250.0)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), frame, 2 * edge)
    return image.astype(np.float32)


@texture
def book_spines(face: Face) -> Paint:
    """A row of book spines of different widths and heights, with titles."""
    rng = face.rng
    image = face.filled((28.0, 28.0, 28.0))
    left = 0
    while left < face.width:
        right = left + max(3, round(rng.uniform(0.012, 0.055) / face.texel_m))
        top = round(rng.uniform(0.0, 0.28) * face.height)
        book = image[top:, left : right - 1]
        if book.size:
            book[:] = _paint_spine(rng, book.shape[0], book.shape[1])
        left = right
    return image


def _paint_spine(rng: np.random.Generator, height: int, width: int) -> Paint:
    """One book, painted lying on its side, then stood up."""
    light = 1.0 + 0.05 * fractal_noise(rng, width, height, height / 2)
    round_back = np.sin(np.linspace(0.6, np.pi - 0.6, width, dtype=np.float32))
    color = random_color(rng, rng.uniform(0.2, 0.9))
    lying = to_canvas(tint(color, light * round_back[:, None]))
    for _ in range(int(rng.integers(0, 3))):
        x = int(rng.uniform(0.02, 0.95) * height)
        lying[:, x : x + max(1, height // 25)] = random_color(rng)
    ink = random_color(rng, 0.3, 0.0, 255.0)
    _draw_text(rng, lying, rng.uniform(0.08, 0.3) * height, 0.7 * width, 0.5 * width, ink)
    standing = lying.transpose(1, 0, 2)
    return standing[:: rng.choice((-1, 1))].astype(np.float32)


@texture
def parcel(face: Face) -> Paint:
    """Cardboard with tape, a label and print."""
    rng, height, width = face.rng, face.height, face.width
    card = np.array((95.0, 140.0, 180.0), dtype=np.float32) * rng.uniform(0.75, 1.1)
    light = 1.0 + 0.06 * face.noise(0.2)
    image = to_canvas(light[..., None] * card)
    middle, tape = height // 2, max(1, round(0.025 / face.texel_m))
    image[middle - tape : middle + tape] = random_color(rng, 0.3)
    for _ in range(2):
        ink = random_color(rng, 0.8, 10.0, 130.0)
        _draw_text(rng, image, 0.1 * width, rng.uniform(0.2, 0.95) * height, 0.12 * height, ink)
    labels = [(page(0.01), 0.35 * width * face.texel_m)] * 2
    return collage(fixed_texture(image.astype(np.float32)), labels)(face)


@texture
def screen(face: Face) -> Paint:
    """A monitor that is switched on: windows of text and pictures in a black frame."""
    windows = [(page(0.012), 0.2), (page(0.008), 0.25)]
    image = collage(picture(0.3), windows, turn_rad=0.0)(face)
    edge = max(1, round(0.02 / face.texel_m))
    corner = face.width - 1, face.height - 1
    cv2.rectangle(image, (0, 0), corner, (18.0, 18.0, 20.0), 2 * edge)
    return image
