"""Methods by name, and their factories."""

import math
import pickle

import numpy as np
import pytest

from drivers.core import InputError
from drivers.core.geometry import Trajectory
from tests.vo_service.tools.compare.sample_runs import make_recording
from tests.vo_service.tools.evaluation.sample_trajectories import moving_along_x
from vo_service.config import OdometryConfig
from vo_service.odometry.registry import METHODS
from vo_service.odometry.sfm.odometry import SfmOdometry
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.tools.compare.baselines.registry import BASELINES, BaselineFactory, BaselinePackage
from vo_service.tools.compare.methods import (
    METHOD_NAMES,
    ConfiguredMethodFactory,
    GroundTruthDistance,
    SfmScale,
    TrueScaleSfmFactory,
    find_unavailable_methods,
    make_method_factories,
)
from vo_service.types.odometry import NullStageTimer

MISSING_PACKAGE = BaselinePackage("nobodys_odometry", ("nobodys-odometry", "nobodys"))
WALK = Trajectory(10.0 + np.array([0.0, 0.01, 0.02, 0.5]), moving_along_x([1.0, 1.1, 1.3, 9.0]))


@pytest.fixture
def missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make two baselines belong to a package that is not installed."""
    for name in ("open3d-icp", "open3d-hybrid"):
        monkeypatch.setitem(BASELINES, name, MISSING_PACKAGE)


def test_our_methods_come_first_and_then_the_baselines() -> None:
    assert (*METHODS, *BASELINES) == METHOD_NAMES
    assert find_unavailable_methods(["surf", "cv2-rgb", "orb"]) == []
    odometry = OdometryConfig(feature_count=500)
    factories = make_method_factories(["orb", "icp"], [], odometry)
    assert list(factories) == ["orb", "icp"]
    assert factories["orb"] == BaselineFactory("orb", 500)
    assert factories["icp"] == ConfiguredMethodFactory(OdometryConfig("icp", feature_count=500))


@pytest.mark.usefixtures("missing_package")
def test_methods_of_a_missing_package_are_unavailable_with_one_note() -> None:
    names = ["surf", "open3d-icp", "sift", "open3d-hybrid"]
    (unavailable,) = find_unavailable_methods(names)
    assert str(unavailable) == (
        "not available: open3d-icp, open3d-hybrid; run: pip install nobodys-odometry"
    )
    assert unavailable.package.version == ""
    assert list(make_method_factories(names, [unavailable], OdometryConfig())) == ["surf", "sift"]


@pytest.mark.usefixtures("missing_package")
def test_without_any_method_the_error_names_the_install_command() -> None:
    unavailable = find_unavailable_methods(["open3d-icp"])
    with pytest.raises(InputError, match="pip install nobodys-odometry"):
        make_method_factories(["open3d-icp"], unavailable, OdometryConfig())


def test_the_scale_of_sfm_alone_comes_from_the_truth() -> None:
    factories = make_method_factories(["sfm", "surf"], [], OdometryConfig(), SfmScale.GROUND_TRUTH)
    sfm, surf = factories["sfm"], factories["surf"]
    assert (sfm.uses_truth, surf.uses_truth) == (True, False)
    assert isinstance(surf.make(NullStageTimer(), make_recording().contents), SurfOdometry)
    assert pickle.loads(pickle.dumps(sfm)) == sfm == TrueScaleSfmFactory(OdometryConfig("sfm"))
    assert sfm.settings["sfm_scale"] == "ground-truth"
    assert isinstance(sfm.make(NullStageTimer(), make_recording().contents), SfmOdometry)
    with pytest.raises(InputError, match=r"no groundtruth.txt"):
        sfm.make(NullStageTimer(), make_recording(has_truth=False).contents)


@pytest.mark.parametrize(
    ("from_s", "to_s", "meters"),
    [(10.0, 10.02, 0.3), (10.02, 10.0, 0.3), (10.005, 10.015, 0.15), (10.0, 10.0, 0.0)],
)
def test_positions_are_interpolated_between_the_true_poses(
    from_s: float, to_s: float, meters: float
) -> None:
    assert GroundTruthDistance(WALK)(from_s, to_s) == pytest.approx(meters, abs=1e-9)


@pytest.mark.parametrize("to_s", [9.9, 10.2, 10.6])
def test_without_truth_the_distance_is_nan(to_s: float) -> None:
    assert math.isnan(GroundTruthDistance(WALK)(10.0, to_s))
