"""The room of the virtual Kinect: walls, furniture, and corners that look the same."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, transform_points
from drivers.synthetic import furniture
from drivers.synthetic.furniture import Solids, random_print
from drivers.synthetic.prints import page, picture, poster
from drivers.synthetic.solids import Solid, SolidKind, make_solid
from drivers.synthetic.textures import (
    TexturePainter,
    bricks,
    collage,
    fabric,
    fixed_seed,
    flat_color,
    plaster,
    random_color,
)

# Within this distance of the corner, along both walls, both corners are the same.
CORNER_SIZE_M = 2.6
PANEL_M = 0.02
CARPET_M = 0.005
# The row along the second wall keeps this distance from the corner for the row along the first.
ROW_CLEARANCE_M = 0.75
CORNER_PRINTS = (poster(), poster(), picture(), page(0.05))
HALF_TURN = rigid_transform(so3_exp([0.0, 0.0, np.pi]), (0.0, 0.0, 0.0))


def make_aliased_corners(
    seed: int, half_m: Array, height_m: float
) -> Iterator[tuple[Solid, Solid]]:
    """Make the solids of both corners.

    Args:
        half_m: Half of the room's size (2,).

    Yields:
        A solid of the corner at +x +y and its copy at -x -y.
    """
    rng = np.random.default_rng([seed, 10])
    corner = rigid_transform(np.eye(3), (*half_m, 0.0))
    for number, solid in enumerate(_make_corner(rng, height_m)):
        textures = tuple(
            fixed_seed(texture, (seed, 11, number, face))
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
    walls = [_hang_pictures(rng, paint, CORNER_PRINTS, 6, (0.3, 0.7)) for _ in range(2)]
    solids = [
        make_solid((middle, 0, height_m / 2), (size, PANEL_M, height_m), walls[0]),
        make_solid((0, middle, height_m / 2), (PANEL_M, size, height_m), walls[1]),
        make_solid((middle, middle, 0), (size, size, 2 * CARPET_M), collage(rug, sheets, 1.5)),
    ]
    solids += _place_against_wall(furniture.desk(rng), -1.6, 0.0)
    solids += _place_against_wall(furniture.stacked_boxes(rng), -0.4, 0.0)
    solids += _place_against_wall(furniture.bookcase(rng), -ROW_CLEARANCE_M - 0.7, -np.pi / 2)
    solids += _place_against_wall(furniture.standing_lamp(rng), 0.3 - CORNER_SIZE_M, -np.pi / 2)
    return solids


def _hang_pictures(
    rng: np.random.Generator,
    wall: TexturePainter,
    prints: tuple[TexturePainter, ...],
    count: int,
    sizes_m: tuple[float, float],
) -> TexturePainter:
    pictures = [(prints[rng.integers(len(prints))], rng.uniform(*sizes_m)) for _ in range(count)]
    return collage(wall, pictures, 0.06)


def _place_against_wall(piece: Solids, along_m: float, yaw_rad: float) -> Solids:
    """Place a piece with its back to a wall, its center at `along_m` on the wall's own axis."""
    away_m = PANEL_M
    x, y = (along_m, -away_m) if yaw_rad == 0.0 else (-away_m, along_m)
    place = rigid_transform(so3_exp([0.0, 0.0, yaw_rad]), (x, y, CARPET_M))
    return [solid.transform(place) for solid in piece]


ROOM_HEIGHT_M = 2.7
MIN_HALF_M = np.array([2.9, 2.5])
# Between the camera's path and the walls: a row of furniture and the camera's clearance.
WALL_MARGIN_M = 1.6
CAMERA_CLEARANCE_M = 0.35
BARE_WALL = 3  # the wall at +y


def build_room(seed: int, clearance_points_m: Array, bare_wall: bool, twin_corners: bool) -> Solids:
    """Build a room: its shell, then its furniture.

    Args:
        clearance_points_m: Points (N, 3) that furniture must leave free.
        bare_wall: The wall at +y has neither texture nor furniture.
        twin_corners: The corners at +x +y and -x -y look the same.
    """
    rng = np.random.default_rng([seed, 2])
    half_m = np.maximum(MIN_HALF_M, np.abs(clearance_points_m[:, :2]).max(axis=0) + WALL_MARGIN_M)
    solids = _make_center_furniture(rng)
    for wall in range(4):
        if not (bare_wall and wall == BARE_WALL):
            solids += _place_along_wall(rng, wall, half_m, CORNER_SIZE_M if twin_corners else 0.0)
    room = [
        _make_shell(rng, half_m, bare_wall),
        *(s for s in solids if _is_clear(s, clearance_points_m)),
    ]
    if twin_corners:
        for pair in make_aliased_corners(seed, half_m, ROOM_HEIGHT_M):
            if all(_is_clear(solid, clearance_points_m) for solid in pair):
                room += pair
    return room


def _make_shell(rng: np.random.Generator, half_m: Array, bare_wall: bool) -> Solid:
    walls = [_make_wall_texture(rng) for _ in range(4)]
    if bare_wall:
        walls[BARE_WALL] = flat_color((186.0, 192.0, 196.0))
    rugs = [(fabric(random_color(rng), random_color(rng)), rng.uniform(0.8, 2.0)) for _ in range(4)]
    litter = [(random_print(rng), rng.uniform(0.15, 0.35)) for _ in range(9)]
    floor = collage(furniture.random_wood(rng, 0.16), rugs + litter, 1.5)
    ceiling = collage(plaster((225.0, 228.0, 230.0)), [(picture(0.5), 0.6)] * 3)
    size = (2 * half_m[0], 2 * half_m[1], ROOM_HEIGHT_M)
    return make_solid(
        (0, 0, ROOM_HEIGHT_M / 2), size, (*walls, floor, ceiling), kind=SolidKind.ROOM
    )


def _make_wall_texture(rng: np.random.Generator) -> TexturePainter:
    paint = random_color(rng, 0.25, 130.0, 220.0)
    ground = bricks((70.0, 90.0, 150.0)) if rng.uniform() < 0.3 else plaster(paint)
    return _hang_pictures(rng, ground, (*CORNER_PRINTS, page()), 9, (0.2, 0.8))


def _make_center_furniture(rng: np.random.Generator) -> Solids:
    """Two tables side by side in the middle, with chairs."""
    turn = rigid_transform(so3_exp([0, 0, rng.uniform(-0.4, 0.4)]), (0, 0, 0))
    solids: Solids = []
    for y, high in ((0.70, rng.uniform(0.62, 0.74)), (-0.10, rng.uniform(0.42, 0.55))):
        place = turn @ rigid_transform(np.eye(3), (rng.uniform(-0.2, 0.2), y, 0.0))
        piece = furniture.table(rng, rng.uniform(1.2, 1.6), rng.uniform(0.60, 0.70), high)
        solids += [solid.transform(place) for solid in piece]
    for _ in range(3):
        yaw = rng.uniform(-np.pi, np.pi)
        spot = rigid_transform(so3_exp([0, 0, yaw]), (1.45 * np.sin(yaw), -1.25 * np.cos(yaw), 0))
        solids += [solid.transform(turn @ spot) for solid in furniture.chair(rng)]
    return solids


def _place_along_wall(
    rng: np.random.Generator, wall: int, half_m: Array, corner_m: float
) -> Solids:
    """Place a row of furniture with its back to a wall (0 to 3: -x, +x, -y, +y).

    It stays clear of the corners, and `corner_m` from those at +x +y and -x -y.
    """
    yaw = (np.pi / 2, -np.pi / 2, np.pi, 0.0)[wall]
    depth_m, reach_m = (half_m[0], half_m[1]) if wall < 2 else (half_m[1], half_m[0])
    turn = rigid_transform(so3_exp([0, 0, yaw]), (0, 0, 0))
    solids: Solids = []
    # One side of each corner stays free for the row of the next wall.
    beside_m = 0.75 if wall < 2 else 0.1
    left = -reach_m + max(beside_m, corner_m if wall < 2 else 0.0)
    right = reach_m - max(beside_m, corner_m if wall >= 2 else 0.0)
    while True:
        piece, breadth_m = furniture.WALL_FURNITURE[rng.integers(len(furniture.WALL_FURNITURE))]
        if left + breadth_m > right:
            return solids
        place = turn @ rigid_transform(np.eye(3), (left + breadth_m / 2, depth_m - 0.02, 0.0))
        solids += [solid.transform(place) for solid in piece(rng)]
        left += breadth_m + rng.uniform(0.0, 0.3)


def _is_clear(solid: Solid, clearance_points_m: Array) -> bool:
    """Whether a camera has room at all points (N, 3)."""
    return _distance_m(solid, clearance_points_m) > CAMERA_CLEARANCE_M


def _distance_m(solid: Solid, points_m: Array) -> float:
    """Smallest distance from the points (N, 3) to the box around a solid."""
    local = transform_points(inverse(solid.T_world_solid), points_m)
    outside = np.maximum(np.abs(local) - solid.half_m, 0.0)
    return float(np.linalg.norm(outside, axis=1).min())
