"""Null loop closure worker, and the factory of loop closure workers."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.core.shared_frames.record_ring import RingRecord
from vo_service.config_tables import MapConfig
from vo_service.slam.loop_closure.anchored_pose import AnchoredPose
from vo_service.slam.mapper.messages import SendMapperMessage
from vo_service.slam.saved_maps.map_store import MapStore

if TYPE_CHECKING:  # its libraries take a second and a hundred megabytes
    from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker
    from vo_service.slam.pose_graph.pose_graph import NodeRemoval


class NullLoopClosureWorker:
    """Loop closure worker that does nothing."""

    def process_record(self, record: RingRecord) -> "Sequence[NodeRemoval]":
        """Do nothing; no node is removed."""
        return ()

    def answer_query(self) -> None:
        """Do nothing."""

    def save(self, store: MapStore, name: str, max_total_bytes: int) -> None:
        """Do nothing."""

    def load(self, file: Path) -> int:
        """Raise InputError, as loop closure is disabled."""
        raise InputError(f"{file}: loop closure is disabled (map.loop_closure)")

    def anchor_to_last_keyframe(self, T_odom_camera: Array) -> AnchoredPose:
        """Return the pose relative to the map, which is `odom`."""
        return AnchoredPose(None, T_odom_camera)

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """4x4 pose in the map."""
        return pose.T_keyframe_camera


def open_loop_closure_worker(
    settings: MapConfig, send: SendMapperMessage
) -> "LoopClosureWorker | NullLoopClosureWorker":
    """Open the loop closure worker of the settings."""
    if not settings.loop_closure:
        return NullLoopClosureWorker()
    from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker

    return LoopClosureWorker(settings, send)
