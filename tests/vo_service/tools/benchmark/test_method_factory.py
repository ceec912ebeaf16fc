"""Factories of our methods."""

import pickle

import pytest

from drivers.core.errors import InputError
from tests.vo_service.tools.benchmark.sample_runs import make_recording
from vo_service.cli.compare import make_method_factories
from vo_service.config import Config, OdometryConfig
from vo_service.odometry.profiling import NullStageTimer
from vo_service.odometry.registry import METHODS
from vo_service.odometry.sfm.odometry import SfmOdometry
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.tools.benchmark.method_factory import (
    ConfiguredMethodFactory,
    MethodFactory,
    SfmScale,
    TrueScaleSfmFactory,
)


def make_factory(method: str, scale: SfmScale = SfmScale.FIRST_DEPTH) -> MethodFactory:
    return make_method_factories(Config(), list(METHODS), scale)[method]


def test_every_method_is_made_as_in_the_service() -> None:
    assert set(make_method_factories(Config(), list(METHODS), SfmScale.FIRST_DEPTH)) == set(METHODS)
    surf = make_factory("surf")
    assert surf == ConfiguredMethodFactory(OdometryConfig(method="surf"))
    assert isinstance(surf.make(NullStageTimer(), make_recording().tum_folder), SurfOdometry)
    assert not surf.uses_truth


def test_the_scale_of_sfm_alone_comes_from_the_truth() -> None:
    sfm, surf = (make_factory(method, SfmScale.GROUND_TRUTH) for method in ("sfm", "surf"))
    assert (sfm.uses_truth, surf.uses_truth) == (True, False)
    assert sfm == TrueScaleSfmFactory(OdometryConfig(method="sfm"))
    assert sfm.settings["sfm_scale"] == "ground-truth"
    assert isinstance(sfm.make(NullStageTimer(), make_recording().tum_folder), SfmOdometry)


def test_without_truth_there_is_no_such_scale() -> None:
    recording = make_recording(has_truth=False).tum_folder
    with pytest.raises(InputError, match=r"no groundtruth.txt"):
        make_factory("sfm", SfmScale.GROUND_TRUTH).make(NullStageTimer(), recording)


def test_factories_can_be_pickled() -> None:
    for scale in SfmScale:
        sfm = make_factory("sfm", scale)
        assert pickle.loads(pickle.dumps(sfm)) == sfm
