"""All textures of a room, painted and lit once, in one array of texels with mip levels."""

import mmap
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.synthetic.lighting import compute_face_brightness
from drivers.synthetic.solids import FACES, Solid, SolidArrays, SolidKind
from drivers.synthetic.textures import Face

MIP_LEVELS = 9
MAX_FACE_PX = 6000
ROOM_TEXEL_SCALE = 1.5  # walls and floor are farther away than the furniture


@dataclass(frozen=True)
class TextureAtlas:
    """Textures of S solids. Level k has half the size of level k - 1.

    Attributes:
        texels: (N, 3) uint8 BGR, the images of all levels one after the other.
        levels: (S, FACES, MIP_LEVELS, 3) int64: first texel, width, height.
    """

    texels: NDArray[np.uint8]
    levels: NDArray[np.int64]


def paint_atlas(
    solids: list[Solid],
    arrays: SolidArrays,
    lights: Array,
    texel_m: float,
    seed: int,
    threads: int,
    folder: Path | None = None,
) -> TextureAtlas:
    """Paint every face with its own generator: the result is the same for any number of threads.

    The texels are mapped from an unnamed file, so texels that no frame shows take no memory.

    Args:
        lights: Point lights (B, 4).
        folder: Folder of the unnamed file; None for the system's temporary folder.

    Raises:
        OSError: The disk is full.
    """
    faces = [(s, face) for s, solid in enumerate(solids) for face in range(_face_count(solid))]

    def paint(key: tuple[int, int]) -> list[NDArray[np.uint8]]:
        s, face = key
        rng = np.random.default_rng([seed, 3, s, face])
        return _mip_levels(_paint_face(solids[s], face, arrays, lights, texel_m, rng))

    with TemporaryFile(dir=folder) as file, ThreadPoolExecutor(threads) as pool:
        return _pack(len(solids), zip(faces, pool.map(paint, faces), strict=True), file)


def _face_count(solid: Solid) -> int:
    return FACES if solid.kind in (SolidKind.BOX, SolidKind.ROOM) else 1


def _paint_face(
    solid: Solid,
    face: int,
    arrays: SolidArrays,
    lights: Array,
    texel_m: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    wide_m, high_m = solid.face_size_m(face)
    if solid.kind is SolidKind.ROOM:
        texel_m *= ROOM_TEXEL_SCALE
    width, height = (int(np.clip(m / texel_m, 4, MAX_FACE_PX)) for m in (wide_m, high_m))
    paint = solid.textures[face](Face(rng, height, width, texel_m))
    light = cv2.resize(compute_face_brightness(solid, face, arrays, lights), (width, height))
    image: NDArray[np.uint8] = np.clip(paint * light[..., None], 0.0, 255.0).astype(np.uint8)
    return image


def _mip_levels(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    levels = [image]
    for _ in range(MIP_LEVELS - 1):
        height, width = levels[-1].shape[:2]
        half = max(1, width // 2), max(1, height // 2)
        levels.append(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA))  # type: ignore[arg-type]
    return levels


def _pack(
    count: int, painted: Iterable[tuple[tuple[int, int], list[NDArray[np.uint8]]]], file: BinaryIO
) -> TextureAtlas:
    table = np.zeros((count, FACES, MIP_LEVELS, 3), dtype=np.int64)
    first = 0
    for (s, face), levels in painted:
        for k, image in enumerate(levels):
            table[s, face, k] = first, image.shape[1], image.shape[0]
            file.write(np.ascontiguousarray(image).data)
            first += image.shape[0] * image.shape[1]
    file.flush()
    texels = np.frombuffer(mmap.mmap(file.fileno(), 0), np.uint8)
    return TextureAtlas(texels.reshape(-1, 3), table)
