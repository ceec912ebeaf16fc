"""What moves by itself through the view: bodies with solids and a path of their own."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, transform_points
from drivers.synthetic.assets.prints import picture, poster
from drivers.synthetic.assets.small_objects import Solids
from drivers.synthetic.assets.textures import collage, fabric, plaster, random_color
from drivers.synthetic.config import DynamicObjectConfig, DynamicObjectKind, SyntheticConfig
from drivers.synthetic.motion.base import CameraMotion, rotations_from_vectors
from drivers.synthetic.motion.spline import CubicSpline
from drivers.synthetic.solids import Solid, SolidKind, make_solid

# A body goes smoothly from where the camera is to see it at one such time to where at the next.
WAYPOINT_PERIOD_S = 1.0
# Where it is before and after: out of sight below the room.
HIDDEN_DEPTH_M = 100.0


@dataclass(frozen=True)
class DynamicObject:
    """Solids in a frame of their own, upright, its y axis away from the camera.

    The way is x, y, z in metres and the turn to the left in radians, over the time in seconds.
    It is in the room from `start_s` to `end_s`.
    """

    solids: Solids
    trajectory: CubicSpline
    begin_s: float
    end_s: float

    def poses(self, times_s: Array) -> Array:
        """T_world_body (N, 4, 4) at `times_s` (N,)."""
        at = self.trajectory(times_s)
        zero = np.zeros(len(at))
        T = np.tile(np.eye(4), (len(at), 1, 1))
        T[:, :3, :3] = rotations_from_vectors(np.stack([zero, zero, at[:, 3]], axis=1))
        T[:, :3, 3] = at[:, :3]
        T[(times_s < self.begin_s) | (times_s > self.end_s), 2, 3] -= HIDDEN_DEPTH_M
        return T

    @property
    def solids_at_midpoint(self) -> Solids:
        """Its solids in the world, in the middle of its way."""
        (T,) = self.poses(np.array([0.5 * (self.begin_s + self.end_s)]))
        return [solid.transform(T) for solid in self.solids]

    def clearance_points_m(self, times_s: Array) -> Array:
        """Points (M, 3) of the world from which furniture keeps away: the middles of its solids."""
        middles_m = np.array([solid.T_world_solid[:3, 3] for solid in self.solids])
        return np.concatenate([transform_points(T, middles_m) for T in self.poses(times_s)])


def make_dynamic_objects(config: SyntheticConfig, motion: CameraMotion) -> list[DynamicObject]:
    """The movers of `config`, each on a way on which `path` has the camera see it as it asks."""
    return [
        DynamicObject(
            SOLID_BUILDERS[mover.kind](
                np.random.default_rng([config.seed, 8, number]), mover.size_m
            ),
            _make_trajectory(mover, config.camera, motion),
            mover.begin_s,
            mover.end_s,
        )
        for number, mover in enumerate(config.movers)
    ]


def _make_trajectory(
    settings: DynamicObjectConfig, camera: PinholeCamera, motion: CameraMotion
) -> CubicSpline:
    count = 1 + math.ceil((settings.end_s - settings.begin_s) / WAYPOINT_PERIOD_S)
    times_s = np.linspace(settings.begin_s, settings.end_s, count)
    view = np.linspace(settings.begin_view, settings.end_view, count)
    half_image = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    rays = np.column_stack([view * half_image, np.ones(count)])
    T_world_camera = motion.poses(times_s)
    seen_m = [
        transform_points(T, settings.distance_m * ray[None])[0]
        for T, ray in zip(T_world_camera, rays, strict=True)
    ]
    on_floor = np.array([1.0, 1.0, 0.0 if settings.kind is DynamicObjectKind.PERSON else 1.0])
    turn_rad = np.unwrap(np.arctan2(-T_world_camera[:, 0, 2], T_world_camera[:, 1, 2]))
    return CubicSpline(times_s, np.column_stack([seen_m * on_floor, turn_rad]))


def _make_parcel(rng: np.random.Generator, size_m: Sequence[float]) -> Solids:
    """A printed box about its own middle."""
    width_m, height_m, depth_m = size_m
    print_ = collage(poster(), [(picture(), 0.4 * min(width_m, height_m))] * 3)
    return [make_solid((0.0, 0.0, 0.0), (width_m, depth_m, height_m), print_)]


def _make_person(rng: np.random.Generator, size_m: Sequence[float]) -> Solids:
    """Legs, body and head on the floor, stiff as a doll."""
    width_m, height_m, depth_m = size_m
    trousers = fabric(random_color(rng, 0.4, 40.0, 120.0), random_color(rng, 0.4, 40.0, 120.0))
    shirt = collage(fabric(random_color(rng), random_color(rng)), [(picture(), 0.25)] * 2)
    skin = plaster(random_color(rng, 0.2, 110.0, 190.0), 0.1)
    leg = (0.42 * width_m, 0.7 * depth_m, 0.48 * height_m)
    legs: list[Solid] = [
        make_solid((side * 0.24 * width_m, 0.0, 0.24 * height_m), leg, trousers) for side in (-1, 1)
    ]
    body = make_solid((0.0, 0.0, 0.66 * height_m), (width_m, depth_m, 0.38 * height_m), shirt)
    head_m = 0.13 * height_m
    head = make_solid(
        (0.0, 0.0, 0.925 * height_m), (head_m, head_m, 1.15 * head_m), skin, kind=SolidKind.SPHERE
    )
    return [*legs, body, head]


SOLID_BUILDERS = {DynamicObjectKind.PARCEL: _make_parcel, DynamicObjectKind.PERSON: _make_person}
