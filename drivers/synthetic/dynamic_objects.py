"""Objects that move through the view: rigid bodies with solids and a trajectory."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, transform_points
from drivers.synthetic.camera_motion import CameraMotion, CubicSpline, rotations_from_vectors
from drivers.synthetic.config import DynamicObjectConfig, DynamicObjectKind, SyntheticConfig
from drivers.synthetic.furniture import Solids
from drivers.synthetic.prints import picture, poster
from drivers.synthetic.solids import Solid, SolidKind, make_solid
from drivers.synthetic.textures import collage, fabric, plaster, random_color

# An object moves smoothly between waypoints; each is its configured place in the camera's view.
WAYPOINT_PERIOD_S = 1.0
# Before and after its time an object is out of sight below the room.
HIDDEN_DEPTH_M = 100.0


@dataclass(frozen=True)
class DynamicObject:
    """A moving rigid body, upright, its y axis away from the camera.

    Attributes:
        solids: Its solids, in its own frame.
        trajectory: Position x, y, z in meters and yaw in radians, over time in seconds.
        begin_s: When it enters the room.
        end_s: When it leaves the room.
    """

    solids: Solids
    trajectory: CubicSpline
    begin_s: float
    end_s: float

    def poses(self, times_s: Array) -> Array:
        """T_world_body (N, 4, 4) at `times_s` (N,)."""
        xyz_yaw = self.trajectory(times_s)
        zero = np.zeros(len(xyz_yaw))
        T = np.tile(np.eye(4), (len(xyz_yaw), 1, 1))
        T[:, :3, :3] = rotations_from_vectors(np.stack([zero, zero, xyz_yaw[:, 3]], axis=1))
        T[:, :3, 3] = xyz_yaw[:, :3]
        T[(times_s < self.begin_s) | (times_s > self.end_s), 2, 3] -= HIDDEN_DEPTH_M
        return T

    @property
    def solids_at_midpoint(self) -> Solids:
        """Its solids in the world, halfway through its time in the room."""
        (T,) = self.poses(np.array([0.5 * (self.begin_s + self.end_s)]))
        return [solid.transform(T) for solid in self.solids]

    def clearance_points_m(self, times_s: Array) -> Array:
        """World points (M, 3) that furniture must leave free: the centers of its solids."""
        centers_m = np.array([solid.T_world_solid[:3, 3] for solid in self.solids])
        return np.concatenate([transform_points(T, centers_m) for T in self.poses(times_s)])


def make_dynamic_objects(config: SyntheticConfig, motion: CameraMotion) -> list[DynamicObject]:
    """Make the moving objects of `config`, each on a trajectory in front of the moving camera."""
    return [
        DynamicObject(
            SOLID_BUILDERS[settings.kind](
                np.random.default_rng([config.seed, 8, number]), settings.size_m
            ),
            _make_trajectory(settings, config.camera, motion),
            settings.begin_s,
            settings.end_s,
        )
        for number, settings in enumerate(config.movers)
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
    positions_m = [
        transform_points(T, settings.distance_m * ray[None])[0]
        for T, ray in zip(T_world_camera, rays, strict=True)
    ]
    floor_mask = np.array([1.0, 1.0, 0.0 if settings.kind is DynamicObjectKind.PERSON else 1.0])
    yaw_rad = np.unwrap(np.arctan2(-T_world_camera[:, 0, 2], T_world_camera[:, 1, 2]))
    return CubicSpline(times_s, np.column_stack([positions_m * floor_mask, yaw_rad]))


def _make_parcel(rng: np.random.Generator, size_m: Sequence[float]) -> Solids:
    """A printed box, centered at the origin."""
    width_m, height_m, depth_m = size_m
    print_ = collage(poster(), [(picture(), 0.4 * min(width_m, height_m))] * 3)
    return [make_solid((0.0, 0.0, 0.0), (width_m, depth_m, height_m), print_)]


def _make_person(rng: np.random.Generator, size_m: Sequence[float]) -> Solids:
    """A rigid person on the floor: legs, body and head."""
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
