"""Methods for --methods by name: ours and the baselines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.core.errors import InputError
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.tools.benchmark.baselines.orb_slam_factory import OrbSlamFactory
from vo_service.tools.benchmark.baselines.orb_vocabulary import VocabularyFile
from vo_service.tools.benchmark.baselines.registry import (
    BASELINE_NAMES,
    ORB_SLAM3,
    BaselineFactory,
    BaselinePackage,
    find_package,
)
from vo_service.tools.benchmark.method_factory import ConfiguredMethodFactory, MethodFactory

METHOD_NAMES = (*METHODS, *BASELINE_NAMES)


@dataclass(frozen=True)
class UnavailableMethods:
    """Methods that cannot run because their package is not installed."""

    package: BaselinePackage
    methods: Sequence[str]

    def __str__(self) -> str:
        return f"not available: {', '.join(self.methods)}; run: {self.package.install_command}"

    def as_json(self) -> dict[str, object]:
        """Return the entry for report.json."""
        return {"methods": list(self.methods), "install": self.package.install_command}


def find_unavailable_methods(names: Sequence[str]) -> list[UnavailableMethods]:
    """Return one entry per missing package."""
    missing: dict[BaselinePackage, list[str]] = {}
    for name in names:
        if name in BASELINE_NAMES and not find_package(name).is_installed:
            missing.setdefault(find_package(name), []).append(name)
    return [UnavailableMethods(package, methods) for package, methods in missing.items()]


def make_method_factories(
    names: Sequence[str],
    unavailable: Sequence[UnavailableMethods],
    odometry: OdometryConfig,
    orb_vocabulary: VocabularyFile | None = None,
) -> Mapping[str, MethodFactory]:
    """Return factories in the order of the names.

    Args:
        names: Names of the methods.
        unavailable: Those that cannot run.
        odometry: Settings of the methods.
        orb_vocabulary: Vocabulary of ORB-SLAM3; None to train one from each recording.

    Raises:
        InputError: If none is available.
    """
    absent = {name for entry in unavailable for name in entry.methods}
    present = [name for name in names if name not in absent]
    if not present:
        raise InputError("; ".join(map(str, unavailable)))
    return {name: _make_method_factory(name, odometry, orb_vocabulary) for name in present}


def _make_method_factory(
    name: str, odometry: OdometryConfig, orb_vocabulary: VocabularyFile | None
) -> MethodFactory:
    if name in METHODS:
        return ConfiguredMethodFactory(replace(odometry, method=name))
    if name == ORB_SLAM3:
        return OrbSlamFactory(odometry.feature_count, orb_vocabulary)
    return BaselineFactory(name, MethodConfig(odometry.feature_count, odometry.upright))
