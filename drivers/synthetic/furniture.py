"""Furniture of the room, with papers and small objects on it."""

from collections.abc import Callable

import numpy as np

from drivers.core.geometry import rigid_transform
from drivers.synthetic.prints import book_spines, page, parcel, picture, poster, screen
from drivers.synthetic.solids import Solid, SolidKind, make_solid
from drivers.synthetic.textures import (
    TexturePainter,
    cabinet_doors,
    collage,
    fabric,
    plaster,
    random_color,
    wood,
)

Solids = list[Solid]
FurnitureBuilder = Callable[[np.random.Generator], Solids]


def _random_box_size(
    rng: np.random.Generator, low_m: float, high_m: float, shape: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Random size of a parcel, each side stretched by a factor of `shape`."""
    x, y, z = (rng.uniform(low_m, high_m) * stretch for stretch in shape)
    return x, y, z


def _scatter_objects(rng: np.random.Generator, wide_m: float, deep_m: float, z: float) -> Solids:
    """Books, boxes, mugs and balls on a surface, more on a larger one."""
    solids: Solids = []
    cell = 0.28
    for x in np.arange(-wide_m / 2 + cell / 2, wide_m / 2, cell):
        for y in np.arange(-deep_m + cell / 2, 0.0, cell):
            if rng.uniform() < 0.5:
                spot = rigid_transform(np.eye(3), (x + rng.uniform(-0.05, 0.05), y, z))
                build = SMALL_OBJECTS[rng.integers(len(SMALL_OBJECTS))]
                solids += [solid.transform(spot) for solid in build(rng)]
    return solids


def _books(rng: np.random.Generator) -> Solids:
    solids, z = [], 0.0
    for _ in range(int(rng.integers(1, 5))):
        thick = rng.uniform(0.015, 0.05)
        side = book_spines()
        textures = (side, side, side, side, poster(), poster())
        size = (rng.uniform(0.13, 0.21), rng.uniform(0.18, 0.26), thick)
        solids.append(make_solid((0, 0, z + thick / 2), size, textures, rng.uniform(-1.5, 1.5)))
        z += thick
    return solids


def _packet(rng: np.random.Generator) -> Solids:
    size = _random_box_size(rng, 0.06, 0.18, (1.0, 1.0, 1.3))
    texture = poster() if rng.uniform() < 0.6 else parcel()
    return [make_solid((0, 0, size[2] / 2), size, texture, rng.uniform(-1.5, 1.5))]


def _mug(rng: np.random.Generator) -> Solids:
    wide, high = rng.uniform(0.07, 0.10), rng.uniform(0.08, 0.13)
    glaze = collage(plaster(random_color(rng, 0.5, 120.0)), [(picture(), 0.08)] * 3)
    return [make_solid((0, 0, high / 2), (wide, wide, high), glaze, kind=SolidKind.CYLINDER)]


def _ball(rng: np.random.Generator) -> Solids:
    wide = rng.uniform(0.08, 0.2)
    texture = collage(plaster(random_color(rng)), [(picture(), 0.1)] * 4)
    return [make_solid((0, 0, wide / 2), (wide, wide, wide), texture, kind=SolidKind.SPHERE)]


def _standing_card(rng: np.random.Generator) -> Solids:
    size = (rng.uniform(0.12, 0.22), 0.015, rng.uniform(0.14, 0.26))
    return [make_solid((0, 0, size[2] / 2), size, poster(), rng.uniform(-0.8, 0.8))]


def random_print(rng: np.random.Generator) -> TexturePainter:
    """Choose a kind of print."""
    prints = (page(), page(0.035), poster(), picture())
    return prints[rng.integers(len(prints))]


SMALL_OBJECTS: tuple[FurnitureBuilder, ...] = (_books, _books, _packet, _mug, _ball, _standing_card)


WOODS = ((70.0, 115.0, 165.0), (95.0, 150.0, 200.0), (45.0, 70.0, 110.0), (150.0, 185.0, 210.0))


def random_wood(rng: np.random.Generator, board_m: float = 0.0) -> TexturePainter:
    """Choose one of a few kinds of wood."""
    return wood(WOODS[rng.integers(len(WOODS))], board_m)


def table(rng: np.random.Generator, wide_m: float, deep_m: float, high_m: float) -> Solids:
    """A table with papers and small objects on it."""
    timber = random_wood(rng, rng.choice((0.0, 0.14)))
    papers = [(random_print(rng), rng.uniform(0.12, 0.3)) for _ in range(int(6 * wide_m * deep_m))]
    top = (timber, timber, timber, timber, timber, collage(timber, papers, 3.1))
    solids = [make_solid((0, -deep_m / 2, high_m - 0.02), (wide_m, deep_m, 0.04), top)]
    solids += [
        make_solid((x, y, high_m / 2 - 0.02), (0.06, 0.06, high_m - 0.04), timber)
        for x in (-wide_m / 2 + 0.04, wide_m / 2 - 0.04)
        for y in (-0.04, 0.04 - deep_m)
    ]
    return solids + _scatter_objects(rng, wide_m, deep_m, high_m)


def desk(rng: np.random.Generator) -> Solids:
    """A table against a wall with a monitor and a lamp."""
    wide, high = rng.uniform(1.2, 1.7), 0.74
    x = rng.uniform(-0.2, 0.2)
    dark = plaster((40.0, 40.0, 42.0))
    monitor = (dark, dark, screen(), dark, dark, dark)
    return [
        *table(rng, wide, 0.7, high),
        make_solid((x, -0.18, high + 0.30), (0.55, 0.05, 0.36), monitor, rng.uniform(-0.4, 0.4)),
        make_solid((x, -0.16, high + 0.06), (0.06, 0.04, 0.12), dark),
        make_solid((x, -0.17, high + 0.01), (0.24, 0.16, 0.02), dark),
        *lamp(rng, 0.4 * wide, -0.15, high, 0.45),
    ]


def lamp(rng: np.random.Generator, x: float, y: float, z: float, high_m: float) -> Solids:
    """A pole with a shade, standing at (x, y, z).

    Args:
        x, y, z: Foot of the pole, m, in axes of the group.
    """
    metal, shade = plaster(random_color(rng, 0.2)), fabric(random_color(rng), random_color(rng))
    wide = 0.18 + 0.1 * high_m
    return [
        make_solid((x, y, z + high_m / 2), (0.025, 0.025, high_m), metal, kind=SolidKind.CYLINDER),
        make_solid(
            (x, y, z + high_m - 0.3 * wide),
            (wide, wide, 0.7 * wide),
            shade,
            kind=SolidKind.CYLINDER,
        ),
    ]


def standing_lamp(rng: np.random.Generator) -> Solids:
    """A lamp on the floor."""
    return lamp(rng, 0.0, -0.25, 0.0, rng.uniform(1.3, 1.7))


def bookcase(rng: np.random.Generator) -> Solids:
    """Shelves of books and boxes."""
    wide, high, deep = rng.uniform(0.8, 1.3), rng.uniform(1.6, 2.2), 0.32
    timber = random_wood(rng)
    solids = [
        make_solid((0, -0.01, high / 2), (wide, 0.02, high), timber),
        make_solid((-wide / 2, -deep / 2, high / 2), (0.03, deep, high), timber),
        make_solid((wide / 2, -deep / 2, high / 2), (0.03, deep, high), timber),
    ]
    for z in np.linspace(0.06, high - 0.015, int(rng.integers(5, 7))):
        solids.append(make_solid((0, -deep / 2, z), (wide - 0.03, deep, 0.03), timber))
        left = -wide / 2 + 0.03
        while left < wide / 2 - 0.15 and z < high - 0.1:
            run = rng.uniform(0.12, min(0.6, wide / 2 - left))
            tall, back = rng.uniform(0.16, 0.26), rng.uniform(0.14, 0.24)
            texture = book_spines() if rng.uniform() < 0.75 else parcel()
            solids.append(
                make_solid(
                    (left + run / 2, -0.03 - back / 2, z + 0.015 + tall / 2),
                    (run, back, tall),
                    texture,
                )
            )
            left += run + rng.uniform(0.0, 0.15)
    return solids


def cupboard(rng: np.random.Generator) -> Solids:
    """Doors or drawers below, small objects on top."""
    wide, high, deep = rng.uniform(0.8, 1.6), rng.uniform(0.7, 1.1), rng.uniform(0.4, 0.55)
    body = random_wood(rng) if rng.uniform() < 0.6 else plaster(random_color(rng, 0.7, 90.0))
    front = cabinet_doors(body, int(rng.integers(2, 5)), int(rng.integers(1, 4)))
    stickers = [(random_print(rng), rng.uniform(0.08, 0.2)) for _ in range(5)]
    textures = (body, body, collage(front, stickers), body, body, body)
    return [
        make_solid((0, -deep / 2, high / 2), (wide, deep, high), textures),
        *_scatter_objects(rng, wide, deep, high),
    ]


def sofa(rng: np.random.Generator) -> Solids:
    """A seat, a back, two arms and cushions."""
    cloth = fabric(random_color(rng), random_color(rng))
    wide = rng.uniform(1.3, 1.9)
    solids = [
        make_solid((0, -0.45, 0.21), (wide, 0.85, 0.42), cloth),
        make_solid((0, -0.12, 0.55), (wide, 0.24, 0.6), cloth),
        make_solid((-wide / 2, -0.45, 0.3), (0.2, 0.9, 0.6), cloth),
        make_solid((wide / 2, -0.45, 0.3), (0.2, 0.9, 0.6), cloth),
    ]
    for x in np.arange(-wide / 2 + 0.35, wide / 2 - 0.2, 0.5):
        cushion = collage(fabric(random_color(rng), random_color(rng)), [(picture(), 0.25)])
        solids.append(
            make_solid((x, -0.32, 0.6), (0.42, 0.14, 0.36), cushion, rng.uniform(-0.3, 0.3))
        )
    return solids


def chair(rng: np.random.Generator) -> Solids:
    """A wooden chair with a cushion and slats."""
    timber, cloth = random_wood(rng), fabric(random_color(rng), random_color(rng))
    solids = [make_solid((0, -0.22, 0.44), (0.42, 0.42, 0.05), cloth)]
    for x in (-0.19, 0.19):
        solids.append(make_solid((x, -0.03, 0.45), (0.04, 0.04, 0.9), timber))
        solids.append(make_solid((x, -0.41, 0.21), (0.04, 0.04, 0.42), timber))
    solids += [make_solid((0, -0.03, z), (0.36, 0.02, 0.07), timber) for z in (0.6, 0.72, 0.85)]
    return solids


def stacked_boxes(rng: np.random.Generator) -> Solids:
    """A stack of cardboard boxes."""
    solids, z = [], 0.0
    for _ in range(int(rng.integers(2, 5))):
        size = _random_box_size(rng, 0.25, 0.5, (1.2, 0.9, 0.8))
        solids.append(
            make_solid((0, -0.28, z + size[2] / 2), size, parcel(), rng.uniform(-0.4, 0.4))
        )
        z += size[2]
    return solids


WALL_FURNITURE: tuple[tuple[FurnitureBuilder, float], ...] = (
    (desk, 1.75),
    (bookcase, 1.35),
    (cupboard, 1.65),
    (sofa, 2.1),
    (stacked_boxes, 0.75),
    (bookcase, 1.35),
    (standing_lamp, 0.6),
)
