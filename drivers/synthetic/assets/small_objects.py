"""Small objects that stand on furniture, each at the origin of its own frame."""

from collections.abc import Callable

import numpy as np

from drivers.core.geometry import rigid_transform
from drivers.synthetic.assets.prints import book_spines, page, parcel, picture, poster
from drivers.synthetic.assets.textures import TexturePainter, collage, plaster, random_color
from drivers.synthetic.solids import Solid, SolidKind, make_solid

Solids = list[Solid]
FurnitureBuilder = Callable[[np.random.Generator], Solids]


def random_box_size(
    rng: np.random.Generator, low_m: float, high_m: float, shape: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Random size of a parcel, each side stretched by a factor of `shape`."""
    x, y, z = (rng.uniform(low_m, high_m) * stretch for stretch in shape)
    return x, y, z


def scatter_objects(rng: np.random.Generator, wide_m: float, deep_m: float, z: float) -> Solids:
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
    size = random_box_size(rng, 0.06, 0.18, (1.0, 1.0, 1.3))
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
