"""ORB-SLAM3 (Campos et al. 2021) in its RGB-D mode, as an odometry of live poses."""

import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from drivers.calibration import CameraCalibration
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, inverse
from drivers.playback.frame_reader import FrameReader
from drivers.recording.recording import Recording
from vo_service.tools.compare.baselines.orb_vocabulary import Descriptors, VocabularyFile
from vo_service.tools.compare.baselines.registry import ORB_SLAM3, PYORBSLAM3
from vo_service.tools.compare.baselines.vocabulary_training import (
    BRANCHES,
    LEVELS,
    train_vocabulary,
)
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry, StageTimer

# Virtual stereo baseline, and the depth in baselines up to which a point is taken from one frame:
# the values of ORB-SLAM3's own settings for a Kinect. So are those of the ORB features.
BASELINE_M, MAX_CLOSE_DEPTH = 0.0773, 40.0
SCALE_FACTOR, SCALE_LEVELS, FAST_THRESHOLD, MIN_FAST_THRESHOLD = 1.2, 8, 20, 7

# A thread of ORB-SLAM3 without work looks for some every 3 or 5 ms. So all have finished if none is
# seen running for longer than that.
THREAD_POLL_PERIOD_S, IDLE_POLLS = 0.002, 6
# Images for the training, evenly spaced. More would hardly give more words.
MAX_TRAINING_IMAGES = 30
DEFAULT_FRAME_RATE_HZ = 30.0
TRAINED_VOCABULARY = f"trained from the recording (k = {BRANCHES}, L = {LEVELS})"
# Debian's packages with the libraries that the wheel does not contain.
DEBIAN_PACKAGES = "libegl1 libgl1 libopengl0 libsm6 libxext6"


class OrbSlamOdometry:
    """Odometry of a `pyorbslam3.Slam`.

    A frame's pose is the one that tracking returns, not the one after later optimizations. After
    each frame it waits for the threads that extend and optimize the map. So the next frame sees
    the same map on every computer, however slow.
    """

    def __init__(self, slam: Any) -> None:
        self._slam = slam
        self._T_world_camera: Array | None = None
        self._is_tracking = False
        self._has_map_changed = False

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Track a frame, and wait until the map is complete."""
        self._has_map_changed |= self._slam.map_changed()
        depth = frame.depth_raw.astype(np.float32)
        result = self._slam.track_rgbd(frame.color_bgr, depth, frame.stamp_s)
        wait_for_idle_threads()
        if result.ok:
            return self._accept(np.array(result.pose_wc, np.float64), result.num_tracked_points)
        self._is_tracking = False
        last = np.eye(4) if self._T_world_camera is None else self._T_world_camera
        reason = str(result.state.name).lower().replace("_", " ")
        return Estimate(False, reason, last, np.eye(4), np.zeros((6, 6)))

    def _accept(self, T_world_camera: Array, inliers: int) -> Estimate:
        last = self._T_world_camera
        # A new map starts at the origin; a loop closure moves the whole map.
        is_new_map = not self._is_tracking and np.array_equal(T_world_camera, np.eye(4))
        is_reset = last is not None and (is_new_map or self._has_map_changed)
        step = np.eye(4) if last is None or is_reset else inverse(last) @ T_world_camera
        self._T_world_camera = T_world_camera
        self._is_tracking, self._has_map_changed = True, False
        unknown = np.zeros((6, 6))
        return Estimate(True, "", T_world_camera, step, unknown, inliers=inliers, is_reset=is_reset)


def wait_for_idle_threads() -> None:
    """Wait until no other thread of this process has run at several polls in a row."""
    idle_polls = 0
    while idle_polls < IDLE_POLLS:
        time.sleep(THREAD_POLL_PERIOD_S)
        idle_polls = idle_polls + 1 if _are_other_threads_asleep() else 0


def _are_other_threads_asleep() -> bool:
    own = str(threading.get_native_id())
    return all(
        _thread_state(thread) in ("S", "")
        for thread in Path("/proc/self/task").iterdir()
        if thread.name != own
    )


def _thread_state(thread: Path) -> str:
    """Return the state of a thread, one letter of proc(5); "" if it has ended."""
    try:
        # The name before the state is in parentheses and may contain anything.
        return (thread / "stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""


def format_settings(
    calibration: CameraCalibration, frame_rate_hz: float, feature_count: int
) -> str:
    """Return ORB-SLAM3's settings file for undistorted BGR and raw depth images."""
    camera = calibration.pinhole
    settings = {
        "File.version": '"1.0"',
        "Camera.type": '"PinHole"',
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera1.fx": float(camera.fx),
        "Camera1.fy": float(camera.fy),
        "Camera1.cx": float(camera.cx),
        "Camera1.cy": float(camera.cy),
        "Camera.fps": max(1, round(frame_rate_hz)),
        "Camera.RGB": 0,
        "Stereo.b": BASELINE_M,
        "Stereo.ThDepth": MAX_CLOSE_DEPTH,
        "RGBD.DepthMapFactor": float(calibration.depth_factor),
        "ORBextractor.nFeatures": feature_count,
        "ORBextractor.scaleFactor": SCALE_FACTOR,
        "ORBextractor.nLevels": SCALE_LEVELS,
        "ORBextractor.iniThFAST": FAST_THRESHOLD,
        "ORBextractor.minThFAST": MIN_FAST_THRESHOLD,
        **_UNUSED_VIEWER_SETTINGS,
    }
    return "%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in settings.items())


# ORB-SLAM3 exits without them, even if it shows nothing.
_UNUSED_VIEWER_SETTINGS = {
    "Viewer.KeyFrameSize": 0.05,
    "Viewer.KeyFrameLineWidth": 1.0,
    "Viewer.GraphLineWidth": 0.9,
    "Viewer.PointSize": 2.0,
    "Viewer.CameraSize": 0.08,
    "Viewer.CameraLineWidth": 3.0,
    "Viewer.ViewpointX": 0.0,
    "Viewer.ViewpointY": -0.7,
    "Viewer.ViewpointZ": -1.8,
    "Viewer.ViewpointF": 500.0,
}


@dataclass(frozen=True)
class OrbSlamFactory:
    """`MethodFactory` of ORB-SLAM3.

    Attributes:
        feature_count: ORB features in a frame. It needs more than 500 to start.
        vocabulary: The vocabulary; None to train one from the recording.
    """

    feature_count: int
    vocabulary: VocabularyFile | None = None
    uses_truth = False

    @property
    def settings(self) -> Mapping[str, object]:
        """Name, package version, number of features and vocabulary."""
        return {
            "peer": ORB_SLAM3,
            "package": f"{PYORBSLAM3.pip_names[0]} {PYORBSLAM3.version}".strip(),
            "feature_count": self.feature_count,
            "vocabulary": str(self.vocabulary or TRAINED_VOCABULARY),
        }

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Load the library. Raises InputError if a library that it needs is missing."""
        on_progress(PYORBSLAM3.module)
        _load()

    def make(self, stopwatch: StageTimer, recording: Recording) -> Odometry:
        """Start ORB-SLAM3 with the camera of the recording, and a vocabulary."""
        module = _load()
        with tempfile.TemporaryDirectory(prefix="kinect-vo-") as folder:
            settings_file = Path(folder) / "settings.yaml"
            settings_file.write_text(
                format_settings(
                    recording.calibration, _frame_rate_hz(recording), self.feature_count
                )
            )
            vocabulary_file = self._prepare_vocabulary(recording, Path(folder))
            # The constructor reads both files completely.
            return OrbSlamOdometry(
                module.Slam(vocabulary_file, settings_file, module.Sensor.RGBD, use_viewer=False)
            )

    def _prepare_vocabulary(self, recording: Recording, folder: Path) -> Path:
        if self.vocabulary is not None:
            return self.vocabulary.path
        images = list(_describe_images(recording, self.feature_count))
        if not any(map(len, images)):
            raise InputError("no ORB features to train a vocabulary; give --orb-vocabulary FILE")
        file = folder / "vocabulary.txt"
        file.write_text(train_vocabulary(images))
        return file


def _load() -> ModuleType:
    try:
        return PYORBSLAM3.load()
    except ImportError as error:
        raise InputError(
            f"{PYORBSLAM3.module} cannot be loaded: {error}; run: apt install {DEBIAN_PACKAGES}"
        ) from error


def _frame_rate_hz(recording: Recording) -> float:
    stamps_s = np.array([pair.color.stamp_s for pair in recording.frames.pairs])
    return float(1 / np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else DEFAULT_FRAME_RATE_HZ


def _describe_images(recording: Recording, feature_count: int) -> Iterator[Descriptors]:
    """Yield (N, 32) ORB descriptors of evenly spaced images; unreadable ones are skipped."""
    detector = cv2.ORB_create(feature_count)  # type: ignore[attr-defined]
    last = len(recording.frames.pairs) - 1
    numbers = np.linspace(0, last, min(MAX_TRAINING_IMAGES, last + 1)).round().astype(int)
    for frame in FrameReader(recording).read_sample(numbers.tolist()):
        _, descriptors = detector.detectAndCompute(frame.color_bgr, None)
        if descriptors is not None:
            yield descriptors
