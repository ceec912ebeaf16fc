"""Places of a corner whose truth is known."""

from collections.abc import Sequence

import numpy as np

from drivers.geometry import Array, rigid_transform, rotation_from_vector
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.recognition import Recogniser
from vo_service.mapping.places.view import PlaceView

STANDING = np.zeros(6)


def pose(shift_m: Sequence[float], turn_deg: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
    """4x4 T_world_camera."""
    return rigid_transform(rotation_from_vector(np.radians(turn_deg)), shift_m)


HERE = pose((0.0, 0.0, 0.0))
BESIDE = pose((0.15, -0.05, 0.1), (3.0, -6.0, 2.0))
# Nothing of the view from HERE is seen from there.
ELSEWHERE = pose((1.6, -0.3, 0.2), (0.0, 40.0, 0.0))


def view_from(recogniser: Recogniser, T_world_camera: Array) -> PlaceView:
    """What a camera that stands there sees of the corner."""
    return recogniser.view(view_of_a_corner(T_world_camera), STANDING)


def place_at(
    recogniser: Recogniser, T_world_place: Array, number: int = 0, world: int = 0
) -> Place:
    """The view from there, as a place."""
    return recogniser.place(view_from(recogniser, T_world_place), number, world, T_world_place)
