"""The status of the service and of its map."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.camera import CameraState
from vo_service.types.update import LevelSource, TrackingState


@dataclass(frozen=True)
class MapState:
    """What there is to say of the map.

    keyframes  that it would be made of now
    saving     file of the map that is being made; "" = none
    saved      file of the last map that was made whole; "" = none
    loading    file of the map whose places are being loaded; "" = none
    loaded     file of the map whose places are known; "" = none
    """

    keyframes: int = 0
    saving: str = ""
    saved: str = ""
    loading: str = ""
    loaded: str = ""


@dataclass(frozen=True)
class Status:
    """How the service is, as it goes out in JSON. `reason` is "" while all is well.

    camera_state  how far the camera is from sending frames
    intrinsics    where they come from: "camera file FILE", "factory", "default"; "" = exact
    level         how it is known which way is up; assumed until the first frame says
    skew_ms       instant of depth minus instant of color, median of the last frames
    jitter_ms     standard deviation of the time from one stamp to the next
    paused        asked to publish no poses
    recording     folder that is being recorded into; "" = none
    mesh_keyframes, saving_map, saved_map, loading_map, loaded_map  see `MapState`
    places, loops see `MapSnapshot`
    is_localized    see `OdometryUpdate`; of the last one
    warnings      what the outputs complain of, and what was given up for want of time
    cpu_ms_per_frame, stage_ms  processor time of the odometry, whole and by stage: medians
    stage_mean_ms, stage_budget_ms  the mean of all frames, and what it may be
    """

    state: TrackingState
    reason: str
    epoch: int
    camera: str
    camera_state: CameraState
    intrinsics: str
    level: LevelSource
    method: str
    fps: float
    latency_p50_ms: float
    latency_p99_ms: float
    skew_ms: float
    jitter_ms: float
    features: int
    matches: int
    inliers: int
    frames: int
    failed: int
    dropped: int
    skipped: int
    lost_packets: int
    paused: bool = False
    recording: str = ""
    mesh_keyframes: int = 0
    saving_map: str = ""
    saved_map: str = ""
    loading_map: str = ""
    loaded_map: str = ""
    map_keyframes: int = 0
    loop_closures: int = 0
    is_localized: bool = True
    warnings: tuple[str, ...] = ()
    cpu_ms_per_frame: float = 0.0
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    stage_mean_ms: Mapping[str, float] = field(default_factory=dict)
    stage_budget_ms: Mapping[str, float] = field(default_factory=dict)
