"""Whether frames fit better with a learned calibration than without it.

The last frame of each keyframe, when most has moved, and some frames before it are aligned once
more with each calibration, by a quarter of the points. `negative_log_likelihood` alone decides.
"""

from collections import deque
from dataclasses import dataclass, replace

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.calibration_search import SEARCHED_CELLS
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.keyframe_selection import TrackedFrame
from vo_service.odometry.direct.motion import constant_velocity_motion
from vo_service.odometry.direct.parameters import (
    MIN_TRIAL_FRAMES,
    MIN_TRIAL_GAIN,
    NUM_TRIAL_FRAMES,
)
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.view_history import (
    TrackedView,
    correct_camera,
    corrected_shutter,
)


@dataclass(frozen=True)
class TrialFrame:
    """A frame to compare.

    Attributes:
        tracked: The frame, aligned with the keyframe.
        told: (2,) timing that it tells, s.
        camera: That it tells.
        keyframe_view: The view of the keyframe; its velocity is known.
    """

    tracked: TrackedFrame
    told: Array
    camera: PinholeCamera
    keyframe_view: TrackedView

    def negative_log_likelihood(self, calibration: Array) -> float:
        """Fit of frame and keyframe if the calibration is corrected by (3,)."""
        result, view = self.tracked.result, self.keyframe_view
        old, camera = result.keyframe, correct_camera(self.camera, calibration)
        assert view.velocity is not None
        keyframe = make_keyframe(
            replace(old.frame, camera=camera),
            replace(old.images, camera=camera, shutter=corrected_shutter(view.told, calibration)),
            old.T_world_keyframe,
            constant_velocity_motion(view.velocity),
            SEARCHED_CELLS,
        )
        images = replace(
            self.tracked.images, camera=camera, shutter=corrected_shutter(self.told, calibration)
        )
        alignment = align(
            keyframe.points,
            images,
            result.alignment.T_camera_keyframe,
            result.prior,
            result.alignment.gain,
            uniform_weights(),
        )
        return TrackingResult(keyframe, alignment, result.prior).negative_log_likelihood


class CalibrationTrial:
    """Gains of a learned value at the last frames that were compared.

    Args:
        is_accepted: Whether the value is used before any frame.

    Attributes:
        is_accepted: Whether the frames fit better with it.
    """

    def __init__(self, is_accepted: bool = False) -> None:
        self.is_accepted = is_accepted
        self._gains: deque[float] = deque(maxlen=NUM_TRIAL_FRAMES)

    @property
    def is_complete(self) -> bool:
        """Whether as many frames as are kept have been compared."""
        return len(self._gains) == NUM_TRIAL_FRAMES

    @property
    def is_refused(self) -> bool:
        """Whether several frames fit no better with it."""
        return len(self._gains) >= MIN_TRIAL_FRAMES and not self.is_accepted

    def add(self, gain: float) -> None:
        """Add by how much the negative log-likelihood of a frame is lower with the value.

        A value in use is refused by as many frames as are kept, so that it does not alternate.
        """
        self._gains.append(gain)
        mean = sum(self._gains) / len(self._gains)
        if self.is_accepted:
            self.is_accepted = len(self._gains) < NUM_TRIAL_FRAMES or mean > 0.0
        elif len(self._gains) >= MIN_TRIAL_FRAMES:
            self.is_accepted = mean > MIN_TRIAL_GAIN
