"""A furnished room, another one for every seed: z up, origin on the middle of the floor."""

import numpy as np

from drivers.geometry import Array, inverse, rigid_transform, rotation_from_vector, transform_points
from drivers.synthetic import furniture
from drivers.synthetic.collage import collage
from drivers.synthetic.prints import page, picture, poster
from drivers.synthetic.solids import Kind, Solid, box
from drivers.synthetic.textures import (
    Skin,
    bricks,
    fabric,
    plain,
    plaster,
    random_colour,
)
from drivers.synthetic.things import Solids, sheet
from drivers.synthetic.twins import CORNER_M, twin_solids

ROOM_HEIGHT_M = 2.7
LEAST_HALF_M = np.array([2.9, 2.5])
# Between the camera's path and the walls: a row of furniture, and to be out of its reach.
WALL_MARGIN_M = 1.6
BODY_RADIUS_M = 0.35
BARE_WALL = 3  # the wall at +y


def furnish(seed: int, free_m: Array, bare_wall: bool, twin_corners: bool) -> Solids:
    """A room for a camera that needs the points `free_m` (N, 3): itself, then its furniture.

    What would stand in the camera's way is left out. With `bare_wall` the wall at +y has neither
    texture nor furniture. With `twin_corners` those at +x +y and -x -y look the same.
    """
    rng = np.random.default_rng([seed, 2])
    half_m = np.maximum(LEAST_HALF_M, np.abs(free_m[:, :2]).max(axis=0) + WALL_MARGIN_M)
    solids = _island(rng)
    for wall in range(4):
        if not (bare_wall and wall == BARE_WALL):
            solids += _along_wall(rng, wall, half_m, CORNER_M if twin_corners else 0.0)
    room = [_shell(rng, half_m, bare_wall), *(s for s in solids if _is_clear(s, free_m))]
    if twin_corners:
        for here, there in twin_solids(seed, half_m, ROOM_HEIGHT_M):
            if _is_clear(here, free_m) and _is_clear(there, free_m):
                room += [here, there]
    return room


def _shell(rng: np.random.Generator, half_m: Array, bare_wall: bool) -> Solid:
    walls = [_wall(rng) for _ in range(4)]
    if bare_wall:
        walls[BARE_WALL] = plain((186.0, 192.0, 196.0))
    rugs = [
        (fabric(random_colour(rng), random_colour(rng)), rng.uniform(0.8, 2.0)) for _ in range(4)
    ]
    litter = [(sheet(rng), rng.uniform(0.15, 0.35)) for _ in range(9)]
    floor = collage(furniture.any_wood(rng, 0.16), rugs + litter, 1.5)
    ceiling = collage(plaster((225.0, 228.0, 230.0)), [(picture(0.5), 0.6)] * 3)
    size = (2 * half_m[0], 2 * half_m[1], ROOM_HEIGHT_M)
    return box((0, 0, ROOM_HEIGHT_M / 2), size, (*walls, floor, ceiling), kind=Kind.ROOM)


def _wall(rng: np.random.Generator) -> Skin:
    paint = random_colour(rng, 0.25, 130.0, 220.0)
    ground = bricks((70.0, 90.0, 150.0)) if rng.uniform() < 0.3 else plaster(paint)
    sorts: tuple[Skin, ...] = (poster(), poster(), picture(), page(0.05), page())
    hung = [(sorts[rng.integers(len(sorts))], rng.uniform(0.2, 0.8)) for _ in range(9)]
    return collage(ground, hung, 0.06)


def _island(rng: np.random.Generator) -> Solids:
    """Two tables side by side in the middle, with chairs."""
    turn = rigid_transform(rotation_from_vector([0, 0, rng.uniform(-0.4, 0.4)]), (0, 0, 0))
    solids: Solids = []
    for y, high in ((0.70, rng.uniform(0.62, 0.74)), (-0.10, rng.uniform(0.42, 0.55))):
        place = turn @ rigid_transform(np.eye(3), (rng.uniform(-0.2, 0.2), y, 0.0))
        piece = furniture.table(rng, rng.uniform(1.2, 1.6), rng.uniform(0.60, 0.70), high)
        solids += [solid.moved(place) for solid in piece]
    for _ in range(3):
        yaw = rng.uniform(-np.pi, np.pi)
        spot = rigid_transform(
            rotation_from_vector([0, 0, yaw]), (1.45 * np.sin(yaw), -1.25 * np.cos(yaw), 0)
        )
        solids += [solid.moved(turn @ spot) for solid in furniture.chair(rng)]
    return solids


def _along_wall(rng: np.random.Generator, wall: int, half_m: Array, corner_m: float) -> Solids:
    """A row of furniture with its back to a wall (0 to 3: -x, +x, -y, +y), clear of corners.

    It keeps `corner_m` from the corner at +x +y and the one at -x -y.
    """
    yaw = (np.pi / 2, -np.pi / 2, np.pi, 0.0)[wall]
    away_m, reach_m = (half_m[0], half_m[1]) if wall < 2 else (half_m[1], half_m[0])
    turn = rigid_transform(rotation_from_vector([0, 0, yaw]), (0, 0, 0))
    solids: Solids = []
    # One side of each corner stays free for the row of the next wall.
    beside_m = 0.75 if wall < 2 else 0.1
    left = -reach_m + max(beside_m, corner_m if wall < 2 else 0.0)
    right = reach_m - max(beside_m, corner_m if wall >= 2 else 0.0)
    while True:
        piece, breadth_m = furniture.ALONG_WALLS[rng.integers(len(furniture.ALONG_WALLS))]
        if left + breadth_m > right:
            return solids
        place = turn @ rigid_transform(np.eye(3), (left + breadth_m / 2, away_m - 0.02, 0.0))
        solids += [solid.moved(place) for solid in piece(rng)]
        left += breadth_m + rng.uniform(0.0, 0.3)


def _is_clear(solid: Solid, free_m: Array) -> bool:
    """Whether a camera can pass at all points (N, 3)."""
    return _gap_m(solid, free_m) > BODY_RADIUS_M


def _gap_m(solid: Solid, points_m: Array) -> float:
    """Least distance from the points to the box around a solid."""
    local = transform_points(inverse(solid.T_world_solid), points_m)
    outside = np.maximum(np.abs(local) - solid.half_m, 0.0)
    return float(np.linalg.norm(outside, axis=1).min())
