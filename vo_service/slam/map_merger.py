"""Merging of world frames by loops that agree."""

from dataclasses import dataclass

from drivers.core.geometry import Array, inverse, poses_close
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import MapKeyframe

# Largest difference of two loops that agree on the relative pose of two world frames.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD = 0.10, 0.05


@dataclass(frozen=True, eq=False)
class _MergeHypothesis:
    """A loop between two world frames, and their relative pose by it."""

    loop: Edge
    world_ids: tuple[int, int]
    T_old_new: Array


class MapMerger:
    """Merge two world frames once two loops agree on their relative pose."""

    def __init__(self) -> None:
        self._pending_hypotheses: list[_MergeHypothesis] = []

    def add_loop(self, loop: Edge, old: MapKeyframe, new: MapKeyframe) -> list[Edge]:
        """Add a loop between two world frames.

        Args:
            loop: From the old keyframe to the new one.

        Returns:
            The loops to close: none, or this one and the pending ones that agree with it.
        """
        T_old_new = old.T_world_keyframe @ loop.T_a_b @ inverse(new.T_world_keyframe)
        hypothesis = _MergeHypothesis(loop, (old.world_id, new.world_id), T_old_new)
        others = [
            each for each in self._pending_hypotheses if each.world_ids == hypothesis.world_ids
        ]
        agreed = [
            each
            for each in others
            if poses_close(each.T_old_new, T_old_new, MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD)
        ]
        resolved = others if agreed else []
        self._pending_hypotheses = [
            each for each in self._pending_hypotheses if each not in resolved
        ]
        if agreed:
            return [*(each.loop for each in agreed), loop]
        self._pending_hypotheses.append(hypothesis)
        return []
