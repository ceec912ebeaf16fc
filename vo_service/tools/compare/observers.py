"""Observers of a run: none, or loop closure.

Observers change neither a method's estimates nor its times: they get each frame after both were
recorded.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.uncertainty import diagonal_covariance
from vo_service.tools.compare.run_outcome import LoopClosureRun
from vo_service.tools.compare.versions import digest_sources
from vo_service.types.estimate import Estimate

# Sources of loop closure besides the libraries.
SOURCES = (
    "vo_service/slam",
    "vo_service/odometry/uncertainty.py",
    "vo_service/odom_frame.py",
    "vo_service/tools/compare/observers.py",
)
# Standard deviation of a motion if the method gives no covariance: about that of a Kinect's depth
# from one frame to the next.
DEFAULT_SIGMA_M, DEFAULT_SIGMA_RAD = 0.003, 0.002


class NullObserver:
    """Factory and observer that do nothing."""

    result = None
    settings: Mapping[str, object] = {}
    config_tables: Mapping[str, Mapping[str, object]] = {}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Do nothing."""

    def make(self) -> "NullObserver":
        """Return itself; it has no state."""
        return self

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class LoopClosureObserverFactory:
    """Factory of loop closure with the settings of a configuration."""

    map: MapConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """Memory limit, and a digest of the code."""
        return {
            "loop_closure": {
                "keyframe_database_mb": self.map.keyframe_database_mb,
                "source": digest_sources(SOURCES),
                "scipy": version("scipy"),
            }
        }

    @property
    def config_tables(self) -> Mapping[str, Mapping[str, object]]:
        """The memory limit of `[map]`."""
        return {"map": {"keyframe_database_mb": self.map.keyframe_database_mb}}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        from vo_service.slam.synchronous_loop_closure import warm_up_loop_closure  # slow to load

        warm_up_loop_closure(on_progress)

    def make(self) -> "LoopClosureObserver":
        """Make loop closure with an empty map."""
        return LoopClosureObserver(self.map)


class LoopClosureObserver:
    """Observer that runs loop closure and measures its CPU time."""

    def __init__(self, settings: MapConfig) -> None:
        from vo_service.slam.synchronous_loop_closure import create_synchronous_loop_closure

        self._tracker = OdomFrame()
        self._loop_closure = create_synchronous_loop_closure(settings)
        self._cpu_ms: list[float] = []

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Process the next frame and its estimate."""
        begin_cpu_s = time.process_time()
        stamped = StampedFrame(frame, frame.stamp_s)
        self._loop_closure.on_update(
            self._tracker.update(stamped, _with_default_covariance(estimate), {}, 0.0)
        )
        self._cpu_ms.append(1e3 * (time.process_time() - begin_cpu_s))

    @property
    def result(self) -> LoopClosureRun:
        """Result of all frames so far."""
        self._loop_closure.close()
        mean_ms = float(np.mean(self._cpu_ms)) if self._cpu_ms else 0.0
        return LoopClosureRun(
            self._loop_closure.trajectory, **self._loop_closure.counts, cpu_ms_per_frame=mean_ms
        )


def _with_default_covariance(estimate: Estimate) -> Estimate:
    """Add a covariance to estimates of methods that give none."""
    if estimate.covariance.any():
        return estimate
    return replace(estimate, covariance=diagonal_covariance(DEFAULT_SIGMA_M, DEFAULT_SIGMA_RAD))


NULL_OBSERVER = NullObserver()
ObserverFactory = NullObserver | LoopClosureObserverFactory
