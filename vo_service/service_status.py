"""The status of the service, made of its parts: camera, tracking, latency, level, map, recorder."""

import math
from dataclasses import replace

from drivers.camera import CameraState, RgbdCamera
from vo_service.control import Control
from vo_service.frame_source import RECORDING_ENDED
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.stage_timers import STAGE_BUDGETS_MS
from vo_service.service_statistics import ServiceStatistics
from vo_service.types.messages import (
    CameraReport,
    LevelReport,
    MapReport,
    RecorderReport,
    Status,
    TrackingReport,
)
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.types.outputs import LoopClosure


class StatusReporter:
    """Makes the status of what its parts report.

    Args:
        camera: The camera.
        method_name: Name of the odometry method.
        odom_frame: The pose of the base, with its epoch and level.
        control: State of the commands, the mapper and the recorder.
        loop_closure: The map that poses are relative to.
        statistics: Counts and times.
    """

    def __init__(
        self,
        camera: RgbdCamera,
        method_name: str,
        odom_frame: OdomFrame,
        control: Control,
        loop_closure: LoopClosure,
        statistics: ServiceStatistics,
    ) -> None:
        self._camera = camera
        self._method_name = method_name
        self._odom_frame = odom_frame
        self._control = control
        self._loop_closure = loop_closure
        self._statistics = statistics

    def make_status(
        self,
        state: TrackingState,
        reason: str,
        warnings: tuple[str, ...],
        last: OdometryUpdate | None,
    ) -> Status:
        """Make the status.

        Args:
            state: State of the tracking.
            reason: Why it is in this state.
            warnings: Warnings of all parts.
            last: The last update; None before the first frame.
        """
        return Status(
            state=state,
            reason=reason,
            epoch=self._odom_frame.epoch,
            paused=self._control.is_paused,
            warnings=warnings,
            camera=self._camera_report(last, has_ended=reason == RECORDING_ENDED),
            level=self._level_report(),
            tracking=self._tracking_report(last),
            latency=self._statistics.make_latency_report(
                STAGE_BUDGETS_MS.get(self._method_name, {})
            ),
            map=self._map_report(),
            recorder=RecorderReport(self._control.recording),
        )

    def _camera_report(self, last: OdometryUpdate | None, *, has_ended: bool) -> CameraReport:
        counters = self._camera.counters
        report = CameraReport(
            name=self._camera.name,
            state=CameraState.LOST if has_ended else self._camera.status.state,
            intrinsics=self._camera.intrinsics_source,
            skew_ms=self._statistics.skew_ms,
            jitter_ms=self._statistics.jitter_ms,
            dropped=counters.dropped,
            skipped=counters.skipped + self._statistics.out_of_order,
            lost_packets=counters.lost_packets,
            depth_noise_per_m=self._statistics.depth_noise_per_m or 0.0,
        )
        if focal_length := self._statistics.focal_length:
            report = replace(
                report,
                focal_scale=focal_length.scale,
                focal_scale_sigma=focal_length.sigma,
                focal_source=focal_length.source,
                focal_disagreement=focal_length.disagreement or 0.0,
                focal_refused=focal_length.is_refused,
            )
        if last is None:
            return report
        timing = last.timing
        return replace(
            report,
            sensor_timing_refused=timing.is_refused,
            readout_ms=1e3 * timing.readout_s,
            readout_sigma_ms=1e3 * timing.readout_sigma_s,
            depth_offset_ms=1e3 * timing.depth_offset_s,
            depth_offset_sigma_ms=1e3 * timing.depth_offset_sigma_s,
            sensor_timing_source=timing.source,
        )

    def _level_report(self) -> LevelReport:
        level = self._odom_frame.leveling.level
        return LevelReport(
            level.source,
            math.degrees(level.tilt_rad),
            math.degrees(level.sigma_rad),
            level.camera_height_m or 0.0,
        )

    def _tracking_report(self, last: OdometryUpdate | None) -> TrackingReport:
        report = TrackingReport(
            self._method_name, frames=self._statistics.frames, failed=self._statistics.failed
        )
        if last is None:
            return report
        estimate = last.estimate
        return replace(
            report,
            features=estimate.features,
            matches=estimate.matches,
            inliers=estimate.inliers,
        )

    def _map_report(self) -> MapReport:
        mapper, snapshot = self._control.map_state, self._loop_closure.snapshot
        return MapReport(
            keyframes=snapshot.keyframes,
            loop_closures=snapshot.loop_closures,
            is_localized=snapshot.is_localized_in(self._odom_frame.epoch),
            mesh_keyframes=mapper.mesh_keyframes,
            saving=mapper.saving,
            saved=mapper.saved,
            loading=mapper.loading,
            loaded=mapper.loaded,
        )
