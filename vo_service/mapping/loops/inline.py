"""Loops on the caller's own thread: a replay is the same every time."""

from collections.abc import Sequence

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import inverse
from drivers.trajectory import StampedPoses
from vo_service.mapping.loops.corrected import CorrectedTrajectory
from vo_service.mapping.loops.hop import Hops
from vo_service.mapping.loops.loop_closer import LoopCloser, Sight
from vo_service.mapping.places.place import Place
from vo_service.odometry.relocalising import Located, RelocalisingOdometry
from vo_service.types import Odometry, PoseUpdate, Status


class InlineLoops:
    """An output that makes places of the frames, and the finder of a `RelocalisingOdometry`.

    The world of its places is `odom`, as that of the poses that go out.
    """

    warning = ""

    def __init__(self, closer: LoopCloser) -> None:
        self.closer = closer
        self._T_world_odom = np.eye(4)  # from `odom` to the odometry's own world
        self._hops = Hops()
        self._place: Place | None = None  # the last
        self._answers: list[Located] = []
        self._corrected = CorrectedTrajectory(closer.graph)
        self.snapshot = closer.snapshot  # as `Loops`

    @property
    def trajectory(self) -> StampedPoses:
        """Poses of all good frames in the map as it is known by now; the first is identity."""
        return self._corrected.trajectory

    def around(self, odometry: Odometry) -> Odometry:
        """As `Loops`."""
        return RelocalisingOdometry(odometry, self)

    def pose(self, update: PoseUpdate) -> None:
        """Take one result; make a place of it where it is one."""
        T_odom_camera, hop = update.T_odom_camera, self._hops.next(update)
        if hop is not None:
            self._see(Sight(update.frame, update.epoch, T_odom_camera, hop))
        place = self._place
        if update.estimate.ok and place is not None and place.world == update.epoch:
            self._T_world_odom = update.T_world_camera @ inverse(T_odom_camera)
            T_place_camera = inverse(place.T_world_place) @ T_odom_camera
            self._corrected.add(update.frame.stamp_s, place.number, T_place_camera)

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def close(self) -> None:
        """No more frames come: the last loops count as well."""
        self.closer.correct()
        self.snapshot = self.closer.snapshot

    @property
    def knows_places(self) -> bool:
        """As `PlaceFinder`."""
        return len(self.closer.places) > 0

    def look(self, frame: RgbdFrame) -> None:
        """As `PlaceFinder`."""
        located = self.closer.locate(frame)
        if located is not None:
            self._answers.append(located.carried(self._T_world_odom))

    def answers(self) -> Sequence[Located]:
        """As `PlaceFinder`."""
        answers, self._answers = self._answers, []
        return answers

    def _see(self, sight: Sight) -> None:
        change = self.closer.see(sight)
        for removal in change.removals:
            self._corrected.carry_over(removal)
        self._place = change.place
        self.snapshot = self.closer.snapshot
