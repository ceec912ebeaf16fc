"""The scan of a configured robot: heights by its mounting, level by its pose."""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.ros_messages.sensors import LaserScanMessage
from vo_service.config_tables import FrameIds, ScanConfig
from vo_service.navigation.depth_rays import tiny_frame
from vo_service.navigation.height_limits import height_band
from vo_service.navigation.level_view import LevelMounting
from vo_service.navigation.scan import ScanAngles, Scanner
from vo_service.types.odometry_update import OdometryUpdate


class RobotScanner:
    """Makes the scans of a robot.

    Args:
        config: Heights, ranges and angles.
        T_base_camera: 4x4 pose of the optical camera in the base, which stands on the floor.
        frame_id: Name of the scan's frame.
    """

    def __init__(
        self,
        config: ScanConfig,
        T_base_camera: Array,
        frame_id: str = FrameIds().scan_frame_id,
    ) -> None:
        self._config, self.frame_id = config, frame_id
        self._mounting = LevelMounting(T_base_camera)
        self._scanner = Scanner(np.radians(config.angle_increment_deg))

    def scan(
        self, frame: RgbdFrame, T_floor_camera: Array
    ) -> tuple[ScanAngles, NDArray[np.float32]]:
        """Scan a frame; all is unknown if the camera is not higher than an obstacle.

        Args:
            T_floor_camera: 4x4 pose in a level frame whose z is 0 on the floor.

        Returns:
            As `Scanner.scan`.
        """
        view = self._mounting.view(T_floor_camera)
        band = height_band(self._config, view.height_m, self._config.range_max_m)
        angles, ranges_m = self._scanner.scan(frame, view, band)
        if view.height_m <= self._config.min_height_m:
            ranges_m[:] = np.nan
        return angles, ranges_m

    def message(self, update: OdometryUpdate, scan_time_s: float) -> LaserScanMessage:
        """Scan the frame of an update, this long after the one before; 0 = unknown."""
        T_floor_camera = update.T_odom_camera.copy()
        T_floor_camera[2, 3] -= update.level.floor_z_m or 0.0
        angles, ranges_m = self.scan(update.frame, T_floor_camera)
        return LaserScanMessage(
            stamp_s=update.stamp_s,
            frame_id=self.frame_id,
            angle_min_rad=angles.first_rad,
            angle_increment_rad=angles.step_rad,
            scan_time_s=scan_time_s,
            range_min_m=self._config.range_min_m,
            range_max_m=self._config.range_max_m,
            ranges_m=ranges_m,
        )

    @staticmethod
    def warm_up() -> None:
        """Compile or load the kernels."""
        RobotScanner(ScanConfig(), T_BODY_CAMERA).scan(tiny_frame(), T_BODY_CAMERA)
