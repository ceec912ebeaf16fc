"""Available and unavailable methods."""

import pytest

from drivers.core.errors import InputError
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.tools.benchmark.baselines import registry
from vo_service.tools.benchmark.baselines.registry import (
    BASELINES,
    ORB_SLAM3,
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

MISSING_PACKAGE = BaselinePackage("nobodys_odometry", ("nobodys-odometry", "nobodys"))


@pytest.fixture
def missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make two baselines belong to a package that is not installed."""
    baseline = Baseline(MISSING_PACKAGE, BASELINES["orb"].make)
    for name in ("open3d-icp", "open3d-hybrid"):
        monkeypatch.setitem(registry.BASELINES, name, baseline)


def test_our_methods_come_first_and_then_the_baselines() -> None:
    assert (*METHODS, *BASELINES, ORB_SLAM3) == METHOD_NAMES
    assert find_unavailable_methods(["surf", "cv2-rgb", "orb"]) == []
    odometry = OdometryConfig(feature_count=500)
    factories = make_method_factories(["orb", "icp"], [], odometry)
    assert list(factories) == ["orb", "icp"]
    assert factories["orb"] == BaselineFactory("orb", MethodConfig(500))
    assert factories["icp"] == ConfiguredMethodFactory(OdometryConfig("icp", feature_count=500))


@pytest.mark.usefixtures("missing_package")
def test_methods_of_a_missing_package_are_unavailable_with_one_note() -> None:
    names = ["surf", "open3d-icp", "sift", "open3d-hybrid"]
    (unavailable,) = find_unavailable_methods(names)
    assert str(unavailable) == (
        "not available: open3d-icp, open3d-hybrid; run: pip install nobodys-odometry"
    )
    assert list(make_method_factories(names, [unavailable], OdometryConfig())) == ["surf", "sift"]


@pytest.mark.usefixtures("missing_package")
def test_without_any_method_the_error_names_the_install_command() -> None:
    unavailable = find_unavailable_methods(["open3d-icp"])
    with pytest.raises(InputError, match="pip install nobodys-odometry"):
        make_method_factories(["open3d-icp"], unavailable, OdometryConfig())


def test_a_package_has_its_version_if_installed() -> None:
    assert registry.OPENCV.version.startswith("5")
    assert MISSING_PACKAGE.version == ""
