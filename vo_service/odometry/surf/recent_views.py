"""Recent views of different places, for the recovery of a lost camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, transport_covariance
from vo_service.odometry.feature_view import FeatureView

# Largest number of views.
MAX_VIEWS = 6
# No two views are nearer to each other than both of these.
MIN_DISTANCE_M, MIN_ANGLE_RAD = 0.3, np.radians(12.0)


@dataclass(frozen=True)
class RecentView:
    """A view with its pose.

    Attributes:
        view: Features and points.
        T_world_view: 4x4.
        covariance: 6x6 of the motion from this view to the last good one, (translation m, rotation
            rad), as a small motion in the last good camera's axes.
    """

    view: FeatureView
    T_world_view: Array
    covariance: Array


class RecentViews:
    """One view per place in one world frame, ordered by the camera's last visit."""

    def __init__(self) -> None:
        self._views: list[FeatureView] = []
        self._T_world_view = np.empty((0, 4, 4))
        self._covariance = np.empty((0, 6, 6))

    def reset(self, view: FeatureView, T_world_camera: Array) -> None:
        """Drop all views and start a new world frame with this one."""
        self._views = [view]
        self._T_world_view = T_world_camera[None]
        self._covariance = np.zeros((1, 6, 6))

    def add(
        self, view: FeatureView, T_world_camera: Array, T_last_camera: Array, covariance: Array
    ) -> None:
        """Add a good view, with the motion since the last one and its covariance."""
        self._covariance = transport_covariance(self._covariance, T_last_camera) + covariance
        is_near = self._is_near(T_world_camera)
        if not is_near.any():
            self._views.append(view)
            self._T_world_view = np.concatenate([self._T_world_view, T_world_camera[None]])
            self._covariance = np.concatenate([self._covariance, np.zeros((1, 6, 6))])
            is_near = np.append(is_near, True)
        if not is_near[-1] or len(self._views) > MAX_VIEWS:
            self._retain(np.argsort(is_near, kind="stable")[-MAX_VIEWS:])

    def excluding(self, last: FeatureView) -> list[RecentView]:
        """All views except one, the most recently visited first."""
        views = zip(self._views, self._T_world_view, self._covariance, strict=True)
        return [RecentView(view, T, C) for view, T, C in reversed(list(views)) if view is not last]

    def _is_near(self, T_world_camera: Array) -> NDArray[np.bool_]:
        distance_m = np.linalg.norm(self._T_world_view[:, :3, 3] - T_world_camera[:3, 3], axis=1)
        # The trace of the rotation between is 1 + 2 cos(angle).
        trace = np.einsum("kij,ij->k", self._T_world_view[:, :3, :3], T_world_camera[:3, :3])
        is_near: NDArray[np.bool_] = (distance_m < MIN_DISTANCE_M) & (
            trace > 1.0 + 2.0 * np.cos(MIN_ANGLE_RAD)
        )
        return is_near

    def _retain(self, indices: NDArray[np.intp]) -> None:
        self._views = [self._views[k] for k in indices]
        self._T_world_view, self._covariance = (
            self._T_world_view[indices],
            self._covariance[indices],
        )
