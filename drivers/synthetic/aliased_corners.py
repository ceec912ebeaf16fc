"""Perceptual aliasing: two corners of a room that look the same, turned by 180 degrees."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.core.geometry import Array, rigid_transform, so3_exp
from drivers.synthetic.assets import furniture
from drivers.synthetic.assets.prints import page, picture, poster
from drivers.synthetic.assets.small_objects import Solids
from drivers.synthetic.assets.textures import (
    Paint,
    TexturePainter,
    collage,
    fabric,
    plaster,
    random_color,
)
from drivers.synthetic.solids import Solid, make_solid

# Within this distance of the corner, along both walls, both corners are the same.
CORNER_SIZE_M = 2.6
PANEL_M = 0.02
CARPET_M = 0.005
# The row along the second wall keeps this distance from the corner for the row along the first.
ROW_CLEARANCE_M = 0.75
HALF_TURN = rigid_transform(so3_exp([0.0, 0.0, np.pi]), (0.0, 0.0, 0.0))


def make_aliased_corners(
    seed: int, half_m: Array, height_m: float
) -> Iterator[tuple[Solid, Solid]]:
    """Make the solids of both corners.

    Args:
        seed: Seed of the room.
        half_m: Half of the room's size (2,).
        height_m: The room's height.

    Yields:
        A solid of the corner at +x +y and its copy at -x -y.
    """
    rng = np.random.default_rng([seed, 10])
    corner = rigid_transform(np.eye(3), (*half_m, 0.0))
    for number, solid in enumerate(_make_corner(rng, height_m)):
        textures = tuple(
            _with_fixed_seed((seed, 11, number, face), texture)
            for face, texture in enumerate(solid.textures)
        )
        here = replace(solid.transform(corner), textures=textures)
        yield here, here.transform(HALF_TURN)


def symmetrize_lights(lights: Array) -> Array:
    """Light both corners alike: each light (B, 4) at half power, and its copy turned by 180°."""
    opposite = lights * np.array([-1.0, -1.0, 1.0, 1.0])
    both: Array = np.concatenate([lights, opposite]) * np.array([1.0, 1.0, 1.0, 0.5])
    return both


def _make_corner(rng: np.random.Generator, height_m: float) -> Solids:
    """Walls, carpet and furniture, with the corner of the room at the origin."""
    middle, size = -CORNER_SIZE_M / 2, CORNER_SIZE_M
    paint = plaster(random_color(rng, 0.25, 130.0, 220.0))
    rug = fabric(random_color(rng), random_color(rng))
    sheets = [(picture(), 0.3), (page(0.05), 0.25), (page(), 0.25)]
    solids = [
        make_solid(
            (middle, 0, height_m / 2), (size, PANEL_M, height_m), _hang_pictures(rng, paint)
        ),
        make_solid(
            (0, middle, height_m / 2), (PANEL_M, size, height_m), _hang_pictures(rng, paint)
        ),
        make_solid((middle, middle, 0), (size, size, 2 * CARPET_M), collage(rug, sheets, 1.5)),
    ]
    solids += _place_against_wall(furniture.desk(rng), -1.6, 0.0)
    solids += _place_against_wall(furniture.stacked_boxes(rng), -0.4, 0.0)
    solids += _place_against_wall(furniture.bookcase(rng), -ROW_CLEARANCE_M - 0.7, -np.pi / 2)
    solids += _place_against_wall(furniture.standing_lamp(rng), 0.3 - CORNER_SIZE_M, -np.pi / 2)
    return solids


def _hang_pictures(rng: np.random.Generator, wall: TexturePainter) -> TexturePainter:
    prints: tuple[TexturePainter, ...] = (poster(), poster(), picture(), page(0.05))
    pictures = [(prints[rng.integers(len(prints))], rng.uniform(0.3, 0.7)) for _ in range(6)]
    return collage(wall, pictures, 0.06)


def _place_against_wall(piece: Solids, along_m: float, yaw_rad: float) -> Solids:
    """Place a piece with its back to a wall, its center at `along_m` on the wall's own axis."""
    away_m = PANEL_M
    x, y = (along_m, -away_m) if yaw_rad == 0.0 else (-away_m, along_m)
    place = rigid_transform(so3_exp([0.0, 0.0, yaw_rad]), (x, y, CARPET_M))
    return [solid.transform(place) for solid in piece]


def _with_fixed_seed(key: tuple[int, ...], painter: TexturePainter) -> TexturePainter:
    """Make a painter paint the same image every time."""

    def paint(rng: np.random.Generator, height: int, width: int, texel_m: float) -> Paint:
        return painter(np.random.default_rng(key), height, width, texel_m)

    return paint
