"""The service's own methods, as a run makes them."""

import pickle

import pytest

from drivers.errors import InputError
from tests.vo_service.runs.made_up import recording
from vo_service.commands.compare import recipes_of
from vo_service.config import Config, OdometrySettings
from vo_service.methods import METHODS
from vo_service.odometry.sfm_odometry import SfmOdometry
from vo_service.odometry.stopwatch import NullStopwatch
from vo_service.odometry.surf_odometry import SurfOdometry
from vo_service.runs.method_recipe import MethodRecipe, TrueScaleSfmRecipe
from vo_service.runs.recipe import Recipe, SfmScale


def recipe(method: str, scale: SfmScale = SfmScale.FIRST_DEPTH) -> Recipe:
    return recipes_of(Config(), list(METHODS), scale)[method]


def test_every_method_is_made_as_the_service_makes_it() -> None:
    assert set(recipes_of(Config(), list(METHODS), SfmScale.FIRST_DEPTH)) == set(METHODS)
    surf = recipe("surf")
    assert surf == MethodRecipe(OdometrySettings(method="surf"))
    assert isinstance(surf.make(NullStopwatch(), None), SurfOdometry)
    assert not surf.uses_truth


def test_the_scale_of_sfm_alone_comes_from_the_truth() -> None:
    sfm, surf = (recipe(method, SfmScale.GROUND_TRUTH) for method in ("sfm", "surf"))
    assert (sfm.uses_truth, surf.uses_truth) == (True, False)
    assert sfm == TrueScaleSfmRecipe(OdometrySettings(method="sfm"))
    assert sfm.settings["sfm_scale"] == "ground-truth"
    assert isinstance(sfm.make(NullStopwatch(), recording().truth), SfmOdometry)


def test_without_truth_there_is_no_such_scale() -> None:
    with pytest.raises(InputError, match=r"no groundtruth.txt"):
        recipe("sfm", SfmScale.GROUND_TRUTH).make(NullStopwatch(), None)


def test_recipes_go_to_another_process() -> None:
    for scale in SfmScale:
        sfm = recipe("sfm", scale)
        assert pickle.loads(pickle.dumps(sfm)) == sfm
