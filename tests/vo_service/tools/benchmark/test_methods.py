"""Who takes part, and what is told of those who cannot."""

import pytest

from drivers.core.errors import InputError
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS, FeatureConfig
from vo_service.tools.benchmark.baselines import registry
from vo_service.tools.benchmark.baselines.registry import (
    BASELINES,
    Baseline,
    BaselineFactory,
    BaselinePackage,
)
from vo_service.tools.benchmark.method_factory import ConfiguredMethodFactory
from vo_service.tools.benchmark.methods import (
    METHOD_NAMES,
    find_unavailable_methods,
    make_method_factories,
)

NOBODYS = BaselinePackage("nobodys_odometry", ("nobodys-odometry", "nobodys"))


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two peers of a package that is not installed."""
    peer = Baseline(NOBODYS, BASELINES["orb"].make)
    for name in ("open3d-icp", "open3d-hybrid"):
        monkeypatch.setitem(registry.BASELINES, name, peer)


def test_ours_come_first_and_then_the_peers() -> None:
    assert (*METHODS, *BASELINES) == METHOD_NAMES
    assert find_unavailable_methods(["surf", "cv2-rgb", "orb"]) == []
    odometry = OdometryConfig(feature_count=500)
    recipes = make_method_factories(["orb", "icp"], [], odometry)
    assert list(recipes) == ["orb", "icp"]
    assert recipes["orb"] == BaselineFactory("orb", FeatureConfig(500))
    assert recipes["icp"] == ConfiguredMethodFactory(OdometryConfig("icp", feature_count=500))


@pytest.mark.usefixtures("absent")
def test_those_of_a_missing_package_are_left_out_with_one_note() -> None:
    names = ["surf", "open3d-icp", "sift", "open3d-hybrid"]
    (left_out,) = find_unavailable_methods(names)
    assert str(left_out) == (
        "left out: open3d-icp, open3d-hybrid; to have it too: pip install nobodys-odometry"
    )
    assert list(make_method_factories(names, [left_out], OdometryConfig())) == ["surf", "sift"]


@pytest.mark.usefixtures("absent")
def test_when_nobody_can_take_part_it_says_what_to_install() -> None:
    left_out = find_unavailable_methods(["open3d-icp"])
    with pytest.raises(InputError, match="pip install nobodys-odometry"):
        make_method_factories(["open3d-icp"], left_out, OdometryConfig())


def test_a_package_knows_its_version_where_there_is_one() -> None:
    assert registry.OPENCV.version.startswith("5")
    assert NOBODYS.version == ""
