"""Methods for --methods by name: ours and the baselines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.core.errors import InputError
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.tools.benchmark.baselines.registry import (
    BASELINES,
    BaselineFactory,
    BaselinePackage,
)
from vo_service.tools.benchmark.method_factory import ConfiguredMethodFactory, MethodFactory

METHOD_NAMES = (*METHODS, *BASELINES)


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
        if name in BASELINES and not BASELINES[name].package.is_installed:
            missing.setdefault(BASELINES[name].package, []).append(name)
    return [UnavailableMethods(package, methods) for package, methods in missing.items()]


def make_method_factories(
    names: Sequence[str], unavailable: Sequence[UnavailableMethods], odometry: OdometryConfig
) -> Mapping[str, MethodFactory]:
    """Return factories in the order of the names.

    Raises:
        InputError: If none is available.
    """
    absent = {name for entry in unavailable for name in entry.methods}
    present = [name for name in names if name not in absent]
    if not present:
        raise InputError("; ".join(map(str, unavailable)))
    return {name: _make_method_factory(name, odometry) for name in present}


def _make_method_factory(name: str, odometry: OdometryConfig) -> MethodFactory:
    if name in METHODS:
        return ConfiguredMethodFactory(replace(odometry, method=name))
    return BaselineFactory(name, MethodConfig(odometry.feature_count, odometry.upright))
