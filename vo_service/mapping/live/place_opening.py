"""Opening what knows places, or what stands in for it where there is none."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from drivers.geometry import Array
from vo_service.mapping.live.maps_folder import MapStore
from vo_service.mapping.live.messages import SendMapperMessage
from vo_service.mapping.loops.from_place import AnchoredPose
from vo_service.recorder.shared_ring import RingRecord
from vo_service.settings import MapConfig

if TYPE_CHECKING:  # its libraries take a second and a hundred megabytes
    from vo_service.mapping.graph.pose_graph import NodeRemoval
    from vo_service.mapping.live.place_desk import LoopClosureWorker


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
        raise InputError(f"{file}: no places are remembered (map.loops)")

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
    if not settings.loops:
        return NullLoopClosureWorker()
    from vo_service.mapping.live.place_desk import LoopClosureWorker

    return LoopClosureWorker(settings, send)
