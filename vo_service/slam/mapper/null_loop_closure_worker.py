"""Opening what knows places, or what stands in for it where there is none."""

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
    """Where no places are remembered."""

    def process_record(self, record: RingRecord) -> "Sequence[NodeRemoval]":
        """It is a keyframe alone."""
        return ()

    def answer_query(self) -> None:
        """Nobody asks."""

    def save(self, store: MapStore, name: str, max_total_bytes: int) -> None:
        """There are none."""

    def load(self, file: Path) -> int:
        """Never possible. Raises InputError."""
        raise InputError(f"{file}: no places are remembered (map.loop_closure)")

    def anchor_to_last_keyframe(self, T_odom_camera: Array) -> AnchoredPose:
        """There is none: the map is `odom`."""
        return AnchoredPose(None, T_odom_camera)

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """As it is."""
        return pose.T_keyframe_camera


def open_loop_closure_worker(
    settings: MapConfig, send: SendMapperMessage
) -> "LoopClosureWorker | NullLoopClosureWorker":
    """What the settings ask for."""
    if not settings.loop_closure:
        return NullLoopClosureWorker()
    from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker

    return LoopClosureWorker(settings, send)
