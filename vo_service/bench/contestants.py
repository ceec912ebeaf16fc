"""Who takes part: our methods and the peers, by the names that --methods takes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.errors import InputError
from vo_service.bench.peers.catalogue import PEERS, Package
from vo_service.bench.peers.recipe import PeerRecipe
from vo_service.config import OdometrySettings
from vo_service.methods import METHODS, FeatureSettings
from vo_service.runs.method_recipe import MethodRecipe
from vo_service.runs.recipe import Recipe

NAMES = (*METHODS, *PEERS)


@dataclass(frozen=True)
class LeftOut:
    """Methods that cannot take part, as their package is not installed."""

    package: Package
    methods: Sequence[str]

    def __str__(self) -> str:
        what = ", ".join(self.methods)
        return f"left out: {what}; to have it too: {self.package.how_to_install}"

    def as_json(self) -> dict[str, object]:
        """For report.json."""
        return {"methods": list(self.methods), "install": self.package.how_to_install}


def find_left_out(names: Sequence[str]) -> list[LeftOut]:
    """One entry a package that is missing."""
    missing: dict[Package, list[str]] = {}
    for name in names:
        if name in PEERS and not PEERS[name].package.is_installed:
            missing.setdefault(PEERS[name].package, []).append(name)
    return [LeftOut(package, methods) for package, methods in missing.items()]


def recipes_of(
    names: Sequence[str], left_out: Sequence[LeftOut], odometry: OdometrySettings
) -> Mapping[str, Recipe]:
    """How each is made, in the order of the names. Raises InputError if none can take part."""
    absent = {name for each in left_out for name in each.methods}
    present = [name for name in names if name not in absent]
    if not present:
        raise InputError("; ".join(map(str, left_out)))
    return {name: _recipe(name, odometry) for name in present}


def _recipe(name: str, odometry: OdometrySettings) -> Recipe:
    if name in METHODS:
        return MethodRecipe(replace(odometry, method=name))
    return PeerRecipe(name, FeatureSettings(odometry.feature_count, odometry.upright))
