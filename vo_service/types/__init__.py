"""What passes between the parts of the service, and what they ask of each other.

Every part may import this; it imports none of them.
"""

from vo_service.types.commands import (
    NAME_PATTERN,
    Command,
    CommandError,
    ErrorCode,
    Light,
    LoadMap,
    Pause,
    Reconfigure,
    Reset,
    Resume,
    SaveIncident,
    SaveMap,
    StartRecording,
    StopRecording,
    Tilt,
)
from vo_service.types.estimate import Estimate, Evidence, Odometry
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.outputs import (
    Loops,
    Mapper,
    NoLoops,
    NoMapper,
    NoRecorder,
    Output,
    Recorder,
    Troubled,
    TruthSource,
    Viewer,
    no_truth,
)
from vo_service.types.status import MapState, Status
from vo_service.types.update import Level, PoseUpdate, TrackingState

__all__ = [
    "NAME_PATTERN",
    "NO_MAP",
    "Command",
    "CommandError",
    "ErrorCode",
    "Estimate",
    "Evidence",
    "Level",
    "Light",
    "LoadMap",
    "Loops",
    "MapSnapshot",
    "MapState",
    "Mapper",
    "NoLoops",
    "NoMapper",
    "NoRecorder",
    "Odometry",
    "Output",
    "Pause",
    "PoseUpdate",
    "Reconfigure",
    "Recorder",
    "Reset",
    "Resume",
    "SaveIncident",
    "SaveMap",
    "StartRecording",
    "Status",
    "StopRecording",
    "Tilt",
    "TrackingState",
    "Troubled",
    "TruthSource",
    "Viewer",
    "no_truth",
]
