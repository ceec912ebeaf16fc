"""Factory of ORB-SLAM3: its settings and vocabulary from a recording."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from drivers.core.errors import InputError
from drivers.tum.camera import TumFrameReader
from drivers.tum.folder import TumFolder, UnreadableFrameError
from vo_service.odometry.profiling import StageTimer
from vo_service.tools.benchmark.baselines.orb_slam_odometry import OrbSlamOdometry, format_settings
from vo_service.tools.benchmark.baselines.orb_vocabulary import (
    BRANCHES,
    LEVELS,
    Descriptors,
    VocabularyFile,
    train_vocabulary,
)
from vo_service.tools.benchmark.baselines.registry import ORB_SLAM3, PYORBSLAM3
from vo_service.types import Odometry

# Images for the training, evenly spaced. More would hardly give more words.
MAX_TRAINING_IMAGES = 30
DEFAULT_FRAME_RATE_HZ = 30.0
TRAINED_VOCABULARY = f"trained from the recording (k = {BRANCHES}, L = {LEVELS})"
# Debian's packages with the libraries that the wheel does not contain.
DEBIAN_PACKAGES = "libegl1 libgl1 libopengl0 libsm6 libxext6"


@dataclass(frozen=True)
class OrbSlamFactory:
    """`MethodFactory` of ORB-SLAM3.

    Attributes:
        feature_count: ORB features in a frame. It needs more than 500 to start.
        vocabulary: The vocabulary; None to train one from the recording.
    """

    feature_count: int
    vocabulary: VocabularyFile | None = None

    @property
    def settings(self) -> Mapping[str, object]:
        """Name, package version, number of features and vocabulary."""
        return {
            "peer": ORB_SLAM3,
            "package": f"{PYORBSLAM3.pip_names[0]} {PYORBSLAM3.version}".strip(),
            "feature_count": self.feature_count,
            "vocabulary": str(self.vocabulary or TRAINED_VOCABULARY),
        }

    @property
    def uses_truth(self) -> bool:
        """False: only the frames are used."""
        return False

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Load the library. Raises InputError if a library that it needs is missing."""
        on_progress(PYORBSLAM3.module)
        _load()

    def make(self, stopwatch: StageTimer, recording: TumFolder) -> Odometry:
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

    def _prepare_vocabulary(self, recording: TumFolder, folder: Path) -> Path:
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


def _frame_rate_hz(recording: TumFolder) -> float:
    stamps_s = np.array([pair.color.stamp_s for pair in recording.frames.pairs])
    return float(1 / np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else DEFAULT_FRAME_RATE_HZ


def _describe_images(recording: TumFolder, feature_count: int) -> Iterator[Descriptors]:
    """Yield (N, 32) ORB descriptors of evenly spaced images; unreadable ones are skipped."""
    detector = cv2.ORB_create(feature_count)  # type: ignore[attr-defined]
    reader, pairs = TumFrameReader(recording), recording.frames.pairs
    count = min(MAX_TRAINING_IMAGES, len(pairs))
    for index in np.linspace(0, len(pairs) - 1, count).round().astype(int):
        try:
            frame = reader.read(pairs[index], int(index))
        except UnreadableFrameError:  # will be reported in the run
            continue
        _, descriptors = detector.detectAndCompute(frame.color_bgr, None)
        if descriptors is not None:
            yield descriptors
