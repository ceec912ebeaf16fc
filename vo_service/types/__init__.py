"""What passes between the parts of the service, and what they ask of each other.

Every part may import this; it imports none of them.
"""

from vo_service.types.commands import (
    NAME_PATTERN,
    Command,
    CommandError,
    ErrorCode,
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ReloadConfig,
    ResetCommand,
    ResumeCommand,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
)
from vo_service.types.estimate import Estimate, Odometry, TrackingDebug
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.outputs import (
    GroundTruthSource,
    HasWarning,
    LoopClosure,
    Mapper,
    NullLoopClosure,
    NullMapper,
    NullRecorder,
    Output,
    PausableViewer,
    Recorder,
    no_ground_truth,
)
from vo_service.types.status import MapState, Status
from vo_service.types.update import LevelSource, OdometryUpdate, TrackingState

__all__ = [
    "NAME_PATTERN",
    "NO_MAP",
    "Command",
    "CommandError",
    "ErrorCode",
    "Estimate",
    "GroundTruthSource",
    "HasWarning",
    "LedCommand",
    "LevelSource",
    "LoadMapCommand",
    "LoopClosure",
    "MapSnapshot",
    "MapState",
    "Mapper",
    "NullLoopClosure",
    "NullMapper",
    "NullRecorder",
    "Odometry",
    "OdometryUpdate",
    "Output",
    "PausableViewer",
    "PauseCommand",
    "Recorder",
    "ReloadConfig",
    "ResetCommand",
    "ResumeCommand",
    "SaveIncidentCommand",
    "SaveMapCommand",
    "StartRecordingCommand",
    "Status",
    "StopRecordingCommand",
    "TiltCommand",
    "TrackingDebug",
    "TrackingState",
    "no_ground_truth",
]
