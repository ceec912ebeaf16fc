"""The first two views: a motion whose length is not known, and what gives it one."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse, rigid_transform
from vo_service.odometry.sfm.colour_view import RayPairs
from vo_service.odometry.sfm.essential import Direction
from vo_service.odometry.sfm.keyframe import Points, pair_rays
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.placed import NotPlaced, Placed, Sight
from vo_service.odometry.sfm.refinement import Refined, refine_motion
from vo_service.odometry.sfm.scale_source import FirstPair, ScaleSource
from vo_service.odometry.sfm.sweep import Sweep
from vo_service.odometry.sfm.triangulation import triangulate


@dataclass(frozen=True)
class FirstPlaced:
    """The second view, placed in metres; sigma of the scale's logarithm."""

    placed: Placed
    sigma: float


class FirstView:
    """Waits for a second view with enough parallax."""

    def __init__(self, parameters: SfmParameters, source: ScaleSource) -> None:
        self._parameters = parameters
        self._source = source
        self._frame: RgbdFrame | None = None

    def begin(self, frame: RgbdFrame) -> None:
        """The first frame of a chain."""
        self._frame = frame

    def place(self, sight: Sight) -> FirstPlaced | NotPlaced:
        """The second view of a sight whose keyframe is the first."""
        direction, fewest = sight.direction, self._parameters.first_inliers
        agreeing = 0 if direction is None else int(direction.inlier.sum())
        if self._frame is None or direction is None or agreeing < fewest:
            return NotPlaced(sight, f"{agreeing} of {len(sight.matches)} matches agree")
        parallax = parallax_rad(direction, sight.pairs)
        if parallax < self._parameters.first_parallax_rad:
            return NotPlaced(sight, self._not_yet(parallax), waiting=True)
        sight = each_row_at_its_instant(sight, refine_direction(direction, sight.pairs))
        refined = refine_direction(direction, sight.pairs)
        if refined.inlier.sum() < fewest:
            return NotPlaced(sight, f"{refined.inlier.sum()} of {len(sight.matches)} points agree")
        scale = self._source.scale(_pair(self._frame, sight, refined))
        if scale is None:
            return NotPlaced(sight, f"no first scale from the {self._source.name}")
        self._frame = None
        return FirstPlaced(Placed(sight, in_metres(refined, scale.metres_per_unit)), scale.sigma)

    def _not_yet(self, parallax: float) -> str:
        now_deg, needed_deg = np.degrees([parallax, self._parameters.first_parallax_rad])
        return f"waiting for parallax, {now_deg:.1f} of {needed_deg:.1f} degrees: move sideways"


def _pair(frame: RgbdFrame, sight: Sight, refined: Refined) -> FirstPair:
    return FirstPair(
        frame=frame,
        features=sight.keyframe.view.features,
        stamp_s=sight.view.stamp_s,
        index=sight.matches[refined.inlier, 1],
        inverse_depth=refined.inverse_depth[refined.inlier],
    )


def each_row_at_its_instant(sight: Sight, refined: Refined) -> Sight:
    """The same sight, of a shutter that rolls, if the camera went steadily from view to view."""
    T_first_second = inverse(refined.T_camera_reference)
    first = sight.keyframe.view
    duration_s = sight.view.stamp_s - first.stamp_s
    inverse_depth = float(np.median(refined.inverse_depth))
    view = sight.view.sweeping(Sweep.over(T_first_second, duration_s, inverse_depth))
    backwards = Sweep.over(inverse(T_first_second), -duration_s, inverse_depth)
    keyframe = replace(sight.keyframe, view=first.sweeping(backwards))
    pairs = pair_rays(view, keyframe, Points.none(), sight.matches)
    return replace(sight, view=view, keyframe=keyframe, pairs=pairs)


def parallax_rad(direction: Direction, pairs: RayPairs) -> float:
    """The median over the pairs that agree; 0 of none."""
    seen = pairs.only(direction.inlier)
    found = triangulate(direction.R, direction.t, seen).parallax_rad
    return float(np.median(found)) if len(found) else 0.0


def refine_direction(direction: Direction, pairs: RayPairs) -> Refined:
    """A motion of length 1, and points in that unit, by the least reprojection error."""
    refined = refine_motion(rigid_transform(direction.R, direction.t), pairs)
    length = float(np.linalg.norm(refined.T_camera_reference[:3, 3]))
    return in_metres(refined, 1.0 / max(length, 1e-9))


def in_metres(refined: Refined, metres_per_unit: float) -> Refined:
    """The same in metres. The covariance is that of all but the length, which counts as exact."""
    T = refined.T_camera_reference
    t_m = metres_per_unit * T[:3, 3]
    along = t_m / max(float(np.linalg.norm(t_m)), 1e-12)
    units = np.eye(6)
    units[:3, :3] = metres_per_unit * (np.eye(3) - np.outer(along, along))
    covariance: Array = units @ refined.covariance @ units.T
    return replace(
        refined,
        T_camera_reference=rigid_transform(T[:3, :3], t_m),
        inverse_depth=refined.inverse_depth / metres_per_unit,
        information=refined.information * metres_per_unit**2,
        covariance=covariance,
    )
