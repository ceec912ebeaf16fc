"""Methods for --methods by name, and the factories that make them in the process of a run."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import Trajectory, has_match
from drivers.recording.recording import Recording
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS
from vo_service.odometry.warm_up import warm_up
from vo_service.tools.compare.baselines.orb_slam import OrbSlamFactory
from vo_service.tools.compare.baselines.orb_vocabulary import VocabularyFile
from vo_service.tools.compare.baselines.registry import (
    BASELINES,
    ORB_SLAM3,
    BaselineFactory,
    BaselinePackage,
)
from vo_service.types.odometry import ImmediateWork, Odometry, StageTimer

METHOD_NAMES = (*METHODS, *BASELINES)


class GroundTruthDistance:
    """Distances between the true positions of two frames."""

    def __init__(self, truth: Trajectory) -> None:
        self._truth = truth

    def __call__(self, from_s: float, to_s: float) -> float:
        """Return the distance between the interpolated positions at two stamps, m.

        NaN if no truth is within 20 ms of a stamp, because motion capture has gaps.
        """
        stamps_s, truth = np.array([from_s, to_s]), self._truth
        if not has_match(stamps_s, truth.stamps_s).all():
            return math.nan
        positions_m = truth.T_world_camera[:, :3, 3]
        interpolated_m = [np.interp(stamps_s, truth.stamps_s, axis_m) for axis_m in positions_m.T]
        return float(np.linalg.norm(np.diff(interpolated_m, axis=1)))


class SfmScale(StrEnum):
    """Source of the first scale of a method without metric scale."""

    FIRST_DEPTH = "first-depth"
    GROUND_TRUTH = "ground-truth"


class MethodFactory(Protocol):
    """Picklable factory of an odometry."""

    @property
    def settings(self) -> Mapping[str, object]:
        """All settings that change the result, for JSON."""
        ...

    @property
    def uses_truth(self) -> bool:
        """Whether the ground truth changes the result."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels; `on_progress` is called with each stage."""
        ...

    def make(self, stopwatch: StageTimer, recording: Recording) -> Odometry:
        """Make the odometry. `recording` has the frames that it will get."""
        ...


@dataclass(frozen=True)
class ConfiguredMethodFactory:
    """Factory of one of our methods with the settings of a configuration."""

    odometry: OdometryConfig
    uses_truth = False

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table."""
        return asdict(self.odometry)

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, on_progress)

    def make(self, stopwatch: StageTimer, recording: Recording) -> Odometry:
        """Make the odometry as the service does."""
        return self.odometry.make_odometry(stopwatch, ImmediateWork())


@dataclass(frozen=True)
class TrueScaleSfmFactory(ConfiguredMethodFactory):
    """Factory of the color-only method with its first scale from the ground truth."""

    uses_truth = True  # the distance between its first two keyframes

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table and the source of the scale."""
        return {**super().settings, "sfm_scale": SfmScale.GROUND_TRUTH}

    def make(self, stopwatch: StageTimer, recording: Recording) -> Odometry:
        """Make the odometry, with scale from the truth. Raises InputError without a truth."""
        from vo_service.odometry.features.extractor import SurfExtractor
        from vo_service.odometry.sfm.odometry import SfmOdometry
        from vo_service.odometry.sfm.scale import GivenBaselineScale

        truth = recording.ground_truth
        if truth is None:
            raise InputError("no groundtruth.txt, which --sfm-scale ground-truth needs")
        return SfmOdometry(
            SurfExtractor(self.odometry.feature_count, self.odometry.upright),
            timer=stopwatch,
            scale_source=GivenBaselineScale(GroundTruthDistance(truth)),
        )


@dataclass(frozen=True)
class UnavailableMethods:
    """Methods that cannot run because their package is not installed."""

    package: BaselinePackage
    methods: Sequence[str]

    def __str__(self) -> str:
        return f"not available: {', '.join(self.methods)}; run: {self.package.install_command}"


def find_unavailable_methods(names: Sequence[str]) -> list[UnavailableMethods]:
    """Return one entry per missing package."""
    missing: dict[BaselinePackage, list[str]] = {}
    for name in names:
        if name in BASELINES and not BASELINES[name].is_installed:
            missing.setdefault(BASELINES[name], []).append(name)
    return [UnavailableMethods(package, methods) for package, methods in missing.items()]


def make_method_factories(
    names: Sequence[str],
    unavailable: Sequence[UnavailableMethods],
    odometry: OdometryConfig,
    sfm_scale: SfmScale = SfmScale.FIRST_DEPTH,
    orb_vocabulary: VocabularyFile | None = None,
) -> Mapping[str, MethodFactory]:
    """Return factories in the order of the names, without the unavailable ones.

    ORB-SLAM3 trains a vocabulary from each recording unless one is given.

    Raises:
        InputError: If none is available.
    """

    def make_factory(name: str) -> MethodFactory:
        if name == "sfm" and sfm_scale is SfmScale.GROUND_TRUTH:
            return TrueScaleSfmFactory(replace(odometry, method=name))
        if name in METHODS:
            return ConfiguredMethodFactory(replace(odometry, method=name))
        if name == ORB_SLAM3:
            return OrbSlamFactory(odometry.feature_count, orb_vocabulary)
        return BaselineFactory(name, odometry.feature_count)

    absent = {name for entry in unavailable for name in entry.methods}
    factories = {name: make_factory(name) for name in names if name not in absent}
    if not factories:
        raise InputError("; ".join(map(str, unavailable)))
    return factories
