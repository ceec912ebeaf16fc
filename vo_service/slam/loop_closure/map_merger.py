"""When two worlds are one: after a loss, or a restart, nothing is known of how they lie."""

from dataclasses import dataclass

from drivers.core.geometry import Array, inverse, poses_close
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.pose_graph.edges import Edge

# Two loops agree about how two worlds lie to each other to within this.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD = 0.10, 0.05


@dataclass(frozen=True, eq=False)
class _MergeHypothesis:
    """A loop between two worlds, and how these lie to each other if it is right."""

    loop: Edge
    world_ids: tuple[int, int]
    T_old_new: Array


class MapMerger:
    """Waits for a second opinion: one loop between two worlds is not believed."""

    def __init__(self) -> None:
        self._pending_hypotheses: list[_MergeHypothesis] = []

    def add_loop(self, loop: Edge, old: MapKeyframe, new: MapKeyframe) -> list[Edge]:
        """The loops to be closed now: none, or this one and those that waited for it.

        loop  from the old place to the new one
        """
        T_old_new = old.T_world_keyframe @ loop.T_a_b @ inverse(new.T_world_keyframe)
        opinion = _MergeHypothesis(loop, (old.world_id, new.world_id), T_old_new)
        others = [each for each in self._pending_hypotheses if each.world_ids == opinion.world_ids]
        agreed = [
            each
            for each in others
            if poses_close(each.T_old_new, T_old_new, MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD)
        ]
        settled = others if agreed else []
        self._pending_hypotheses = [
            each for each in self._pending_hypotheses if each not in settled
        ]
        if agreed:
            return [*(each.loop for each in agreed), loop]
        self._pending_hypotheses.append(opinion)
        return []
