"""The scan of a frame, which is made only if somebody asks for it."""

import threading
from collections.abc import Callable

import numpy as np

from drivers.core.geometry import Array
from drivers.ros_messages.sensors import LaserScanMessage


class FrameScan:
    """The scan of a frame: made once, on the thread of the first who asks for it.

    Args:
        make: Makes it; returns None if it cannot be made now.
        T_base_scan: 4x4 pose of the scan's frame in the base.
        is_above_floor: Whether the camera's height above the floor is told. If not, all ranges are
            unknown.
    """

    def __init__(
        self, make: Callable[[], LaserScanMessage | None], T_base_scan: Array, is_above_floor: bool
    ) -> None:
        self.T_base_scan, self.is_above_floor = T_base_scan, is_above_floor
        self._make, self._lock = make, threading.Lock()
        self._message: LaserScanMessage | None = None

    def message(self) -> LaserScanMessage | None:
        """Return the scan; None without scans, and while their kernels are being loaded."""
        with self._lock:
            if self._message is None:
                self._message = self._make()
            return self._message


NO_SCAN = FrameScan(lambda: None, np.eye(4), is_above_floor=False)
