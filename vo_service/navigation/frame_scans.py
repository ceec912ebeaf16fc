"""Adds the scan to each update, and loads its kernels when somebody asks for the first one."""

import logging
import threading
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from drivers.core import UserFacingError
from drivers.core.geometry import Array
from drivers.core.memory import release_memory
from drivers.ros_messages.sensors import LaserScanMessage
from vo_service.config_tables import FrameIds, ScanConfig
from vo_service.navigation.level_view import LevelMounting
from vo_service.types.frame_scan import FrameScan
from vo_service.types.odometry_update import OdometryUpdate

if TYPE_CHECKING:  # it loads the kernels
    from vo_service.navigation.robot_scan import RobotScanner

logger = logging.getLogger(__name__)

# Height of the scan's frame above the floor. A costmap of Nav2 marks no obstacle below its own
# frame's floor, and none above 0.8 m.
FRAME_HEIGHT_M = 0.2
# After a longer pause, the time between two scans is unknown.
MAX_SCAN_TIME_S = 1.0


def make_T_base_scan(T_base_camera: Array) -> Array:
    """Return the 4x4 pose of the scan's frame in the base, of a camera with this pose."""
    return LevelMounting(T_base_camera).T_base_level(FRAME_HEIGHT_M)


class FrameScans:
    """The scans of a robot's frames.

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
        self._config, self._T_base_camera, self._frame_id = config, T_base_camera, frame_id
        self._T_base_scan = make_T_base_scan(T_base_camera)
        self.is_above_floor = bool(T_base_camera[2, 3] > config.min_height_m)
        self._last_stamp_s = 0.0
        self._lock = threading.Lock()
        self._scanner: RobotScanner | None = None
        self._is_loading = False

    def load(self) -> None:
        """Load the kernels, and log what is wrong with the mounting.

        Kernels that are not in the cache are compiled by other processes first.

        Raises:
            OSError: The cache cannot be written.
            UserFacingError: A process was killed.
        """
        from vo_service.kernels.compilation import ensure_compiled
        from vo_service.navigation.height_limits import mounting_problem
        from vo_service.navigation.robot_scan import RobotScanner

        ensure_compiled(["scan"], lambda _: None)
        RobotScanner.warm_up()
        release_memory()  # of the compiler
        if problem := mounting_problem(self._config, self._T_base_camera):
            logger.warning("scan: %s", problem)
        self._scanner = RobotScanner(self._config, self._T_base_camera, self._frame_id)

    def add_to(self, update: OdometryUpdate) -> OdometryUpdate:
        """Return the update with its scan, which is made if somebody asks for it."""
        interval_s, self._last_stamp_s = update.stamp_s - self._last_stamp_s, update.stamp_s
        scan_time_s = interval_s if 0.0 < interval_s < MAX_SCAN_TIME_S else 0.0
        make = partial(self._make, update, scan_time_s)
        return replace(update, scan=FrameScan(make, self._T_base_scan, self.is_above_floor))

    def _make(self, update: OdometryUpdate, scan_time_s: float) -> LaserScanMessage | None:
        with self._lock:  # the scanner keeps the rays of its last frame
            if self._scanner is not None:
                return self._scanner.message(update, scan_time_s)
            if not self._is_loading:
                # On a thread of its own: whoever asks has images to send meanwhile.
                self._is_loading = True
                threading.Thread(target=self._load_later, name="scan kernels").start()
            return None

    def _load_later(self) -> None:
        try:
            self.load()
        except (OSError, UserFacingError) as error:
            logger.warning("scan: none, as its kernels cannot be loaded: %s", error)
