"""Keeps `odom` level: by the floor in view, the mount of a planar base, or the accelerometer."""

from collections import deque
from math import atan2, cos, hypot, radians
from typing import NamedTuple

import numpy as np

from drivers.camera import NewReadings, RgbdFrame
from drivers.core.geometry import Array, is_gravity, rigid_transform, so3_exp
from vo_service.leveling.floor_plane import FloorDetector, FloorPlane
from vo_service.leveling.level_filter import LevelFilter
from vo_service.types.level import Level, LevelSource

# The floor is looked for so often, s; the detection takes a millisecond.
FLOOR_PERIOD_S = 0.2
# Largest angle from the supposed up direction to the floor's normal.
MAX_FLOOR_TILT_RAD = radians(5.0)
# Two floors agree up to these differences. One of the last two has to agree with a new one.
MAX_TILT_DIFFERENCE_RAD, MAX_HEIGHT_DIFFERENCE_M = radians(0.5), 0.03
NUM_COMPARED = 2
# A floor may be this far from where it was, and this much farther for each second without one.
# What so many views in a row agree on is another floor, such as that beyond a step.
MAX_HEIGHT_CHANGE_M, MAX_HEIGHT_DRIFT_M_S, MAX_DRIFT_TIME_S = 0.05, 0.01, 25.0
NUM_VIEWS_OF_ANOTHER_FLOOR = 25
# Share of each floor in the learned mount.
MOUNT_SHARE = 0.01
# A lower camera is one whose mount was not told.
MIN_MOUNT_HEIGHT_M = 0.05
# A planar base whose floor differs by more from what its mount says has a wrong mount.
MAX_MOUNT_ERROR_M, MAX_MOUNT_ERROR_RAD = 0.05, radians(2.0)


class _Floor(NamedTuple):
    """A floor in `odom`.

    Attributes:
        up: (3,) its normal.
        z_m: Its height at the camera.
    """

    up: Array
    z_m: float

    def agrees(self, other: "_Floor") -> bool:
        """Whether both may be one floor."""
        is_parallel = self.up @ other.up > cos(MAX_TILT_DIFFERENCE_RAD)
        return bool(is_parallel and abs(self.z_m - other.z_m) < MAX_HEIGHT_DIFFERENCE_M)


class Leveling:
    """Finds the up direction and the floor, and corrects `odom` by them.

    Args:
        T_base_camera: 4x4 pose of the optical camera in the robot's base.
        is_planar: Whether the base stays level, on one floor.

    Attributes:
        mount_up: (3,) up direction in camera axes of a level base: told, then learned.
        mount_height_m: Height of the camera above the floor of a planar base, likewise.
        warning: What is wrong with the mount; "" if nothing is.
    """

    def __init__(self, T_base_camera: Array, is_planar: bool = False) -> None:
        self.mount_up = T_base_camera[2, :3].copy()
        self.mount_height_m = float(T_base_camera[2, 3])
        self.warning = ""
        self._T_base_camera, self._is_planar = T_base_camera, is_planar
        self._filter = LevelFilter()
        self._detector: FloorDetector | None = None
        self._new_readings = NewReadings()
        self._seen: deque[_Floor] = deque(maxlen=NUM_VIEWS_OF_ANOTHER_FLOOR)
        self._floor_z_m: float | None = None
        self._searched_s = self._floor_s = -np.inf
        self._camera_height_m: float | None = None
        self._tilt_rad = 0.0

    @property
    def level(self) -> Level:
        """The up direction now."""
        x, y, z = self._filter.bias_m_s2.tolist()
        return Level(
            self._filter.source,
            self._filter.sigma_rad,
            self._tilt_rad,
            self._camera_height_m,
            self._floor_z_m,
            (x, y, z) if self._filter.has_bias else None,
        )

    def start(self, frame: RgbdFrame) -> Array:
        """Begin an `odom` that is level at a first frame.

        Returns:
            The up direction (3,) in camera axes.
        """
        up, source = self._supposed_up(frame)
        if source is not LevelSource.ASSUMED or self._is_mount_told:
            floor = self._find_floor(frame, up)
            if floor is not None:
                up, source = floor.up, LevelSource.FLOOR
        self._filter.start(source, frame.accelerometer_bias_m_s2)
        self.forget_floor()
        return up

    def forget_floor(self) -> None:
        """Forget the height of the floor: the pose was set."""
        self._floor_z_m = 0.0 if self._is_planar else None
        self._seen.clear()

    def correct(self, T_odom_base: Array, stamp_s: float) -> Array:
        """Return the correction of a frame: 4x4, from `odom` to `odom` as it is from now on.

        Args:
            T_odom_base: 4x4 pose of the base, about which the world is turned.
            stamp_s: Stamp of the frame.
        """
        step = self._filter.step(stamp_s)
        R, position = so3_exp(step.turn_rad), T_odom_base[:3, 3]
        return rigid_transform(R, position - R @ position + [0.0, 0.0, step.shift_m])

    def add_frame(self, frame: RgbdFrame, T_odom_camera: Array) -> None:
        """Measure the up direction by a frame with a pose.

        Args:
            T_odom_camera: 4x4 pose of its camera.
        """
        R_odom_camera = T_odom_camera[:3, :3]
        if self._is_planar:
            if not self._filter.is_floor_recent(frame.stamp_s):
                self._filter.add_mount(
                    R_odom_camera @ self.mount_up,
                    self._height_error_m(T_odom_camera, self.mount_height_m),
                )
        else:
            for reading in self._new_readings.take(frame.accelerometer):
                self._filter.add_reading(
                    R_odom_camera, np.array(reading.acceleration_m_s2), reading.stamp_s
                )
        is_level = self._filter.source is not LevelSource.ASSUMED or self._is_mount_told
        if is_level and abs(frame.stamp_s - self._searched_s) >= FLOOR_PERIOD_S:
            self._searched_s = frame.stamp_s
            floor = self._find_floor(frame, R_odom_camera[2])
            if floor is not None:
                self._add_floor(floor, T_odom_camera, frame.stamp_s)
        base_up = self._T_base_camera[:3, :3] @ R_odom_camera[2]
        self._tilt_rad = atan2(hypot(base_up[0], base_up[1]), base_up[2])

    @property
    def mount_z_m(self) -> float:
        """Height in `odom` of the camera of a planar base."""
        return self.mount_height_m + (self._floor_z_m or 0.0)

    @property
    def _is_mount_told(self) -> bool:
        return bool(self._T_base_camera[2, 3] >= MIN_MOUNT_HEIGHT_M)

    def _supposed_up(self, frame: RgbdFrame) -> tuple[Array, LevelSource]:
        """Up direction (3,) in camera axes before the floor is looked for, and its source."""
        if self._is_planar:
            return self.mount_up, LevelSource.MOUNT
        if frame.gravity_m_s2 is None or not is_gravity(frame.gravity_m_s2):
            return self.mount_up, LevelSource.ASSUMED
        gravity_m_s2 = np.array(frame.gravity_m_s2)
        return -gravity_m_s2 / hypot(*gravity_m_s2), LevelSource.ACCELEROMETER

    def _find_floor(self, frame: RgbdFrame, up: Array) -> FloorPlane | None:
        if self._detector is None or self._detector.camera != frame.camera:
            self._detector = FloorDetector(frame.camera)
        return self._detector.find(frame, up, MAX_FLOOR_TILT_RAD)

    def _height_error_m(self, T_odom_camera: Array, height_m: float) -> float:
        """How much too low the floor is in `odom` if the camera is at a height above it."""
        floor_z_m = float(T_odom_camera[2, 3]) - height_m
        return 0.0 if self._floor_z_m is None else self._floor_z_m - floor_z_m

    def _add_floor(self, found: FloorPlane, T_odom_camera: Array, stamp_s: float) -> None:
        """Use a floor that agrees with one of the last, and with where the floor is."""
        up = T_odom_camera[:3, :3] @ found.up
        floor = _Floor(up, float(T_odom_camera[2, 3]) - found.height_m)
        agrees = [floor.agrees(other) for other in self._seen]
        self._seen.append(floor)
        if not any(agrees[-NUM_COMPARED:]):
            return
        if self._floor_z_m is None:
            self._floor_z_m = floor.z_m
        if abs(self._height_error_m(T_odom_camera, found.height_m)) > self._max_change_m(stamp_s):
            if len(agrees) < NUM_VIEWS_OF_ANOTHER_FLOOR or not all(agrees):
                return
            self._floor_z_m, self.mount_height_m = floor.z_m, found.height_m
        error_m = self._height_error_m(T_odom_camera, found.height_m)
        self._filter.add_floor(up, error_m, stamp_s)
        self._floor_s, self._camera_height_m = stamp_s, found.height_m
        if self._is_planar:
            self._learn_mount(found)

    def _max_change_m(self, stamp_s: float) -> float:
        """How far the floor may be from where it was."""
        age_s = min(abs(stamp_s - self._floor_s), MAX_DRIFT_TIME_S)
        return MAX_HEIGHT_CHANGE_M + MAX_HEIGHT_DRIFT_M_S * age_s

    def _learn_mount(self, found: FloorPlane) -> None:
        up = self.mount_up + MOUNT_SHARE * (found.up - self.mount_up)
        self.mount_up = up / hypot(*up)
        self.mount_height_m += MOUNT_SHARE * (found.height_m - self.mount_height_m)
        told_up, told_height_m = self._T_base_camera[2, :3], self._T_base_camera[2, 3]
        angle_rad = atan2(hypot(*np.cross(told_up, self.mount_up)), told_up @ self.mount_up)
        if (
            abs(self.mount_height_m - told_height_m) <= MAX_MOUNT_ERROR_M
            and angle_rad <= MAX_MOUNT_ERROR_RAD
        ):
            self.warning = ""
            return
        self.warning = (
            f"T_base_camera puts the camera {told_height_m:.2f} m above the floor, but the floor "
            f"in view is {self.mount_height_m:.2f} m below it and {np.degrees(angle_rad):.0f} "
            "degrees off; measure the mount with kinect-vo doctor"
        )
