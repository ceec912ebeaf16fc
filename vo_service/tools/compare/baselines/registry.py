"""Baselines by name, and their packages."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from platform import machine
from types import ModuleType

from drivers.recording.recording import Recording
from vo_service.odometry.stage_timers import StageReporter
from vo_service.odometry.warm_up import run_warm_up_frames
from vo_service.types.odometry import Odometry, StageTimer


@dataclass(frozen=True)
class BaselinePackage:
    """Library of a baseline: the name of its module, and its names for pip."""

    module: str
    pip_names: tuple[str, ...]

    @property
    def is_installed(self) -> bool:
        """Whether it is installed, without importing it, which may take seconds."""
        return find_spec(self.module) is not None

    @property
    def install_command(self) -> str:
        """Command that installs it."""
        return f"pip install {self.pip_names[0]}"

    @property
    def version(self) -> str:
        """Installed version; "" if it has no metadata."""
        for name in self.pip_names:
            try:
                return version(name)
            except PackageNotFoundError:
                continue
        return ""

    def load(self) -> ModuleType:
        """Import and return the module."""
        return importlib.import_module(self.module)


OPENCV = BaselinePackage("cv2", ("opencv-python-headless",))
# The package without CUDA's libraries exists for x86_64 only.
OPEN3D = BaselinePackage(
    "open3d", ("open3d-cpu", "open3d") if machine() == "x86_64" else ("open3d",)
)
SMALL_GICP = BaselinePackage("small_gicp", ("small-gicp",))
PYORBSLAM3 = BaselinePackage("pyorbslam3", ("pyorbslam3",))


# It has a factory of its own, because it needs the recording.
ORB_SLAM3 = "orb-slam3"
# The makers of the others are in `frame_to_frame`, which imports OpenCV.
BASELINES: Mapping[str, BaselinePackage] = {
    "cv2-rgb": OPENCV,
    "cv2-rgb-depth": OPENCV,
    "cv2-depth": OPENCV,
    "open3d-icp": OPEN3D,
    "open3d-hybrid": OPEN3D,
    "small-gicp": SMALL_GICP,
    "sift": OPENCV,
    "orb": OPENCV,
    ORB_SLAM3: PYORBSLAM3,
}


@dataclass(frozen=True)
class BaselineFactory:
    """`MethodFactory` of a baseline; `feature_count` is for those that use features."""

    name: str
    feature_count: int
    uses_truth = False

    @property
    def settings(self) -> Mapping[str, object]:
        """Name, package version and number of features."""
        package = BASELINES[self.name]
        return {
            "peer": self.name,
            "package": f"{package.pip_names[0]} {package.version}".strip(),
            "feature_count": self.feature_count,
        }

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Load its library and process warm-up frames."""
        on_progress(BASELINES[self.name].module)
        run_warm_up_frames(lambda: self._make(StageReporter(on_progress)))

    def make(self, stopwatch: StageTimer, recording: Recording) -> Odometry:
        """Make a new odometry."""
        return self._make(stopwatch)

    def _make(self, stopwatch: StageTimer) -> Odometry:
        from vo_service.tools.compare.baselines.frame_to_frame import make_baseline

        library = BASELINES[self.name].load()
        return make_baseline(self.name, library, self.feature_count, stopwatch)
