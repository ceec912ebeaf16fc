"""Who takes part, and what is told of those who cannot."""

import pytest

from drivers.errors import InputError
from vo_service.bench.contestants import NAMES, find_left_out, recipes_of
from vo_service.bench.peers import catalogue
from vo_service.bench.peers.catalogue import PEERS, Package, Peer
from vo_service.bench.peers.recipe import PeerRecipe
from vo_service.config import OdometrySettings
from vo_service.methods import METHODS, FeatureSettings
from vo_service.runs.method_recipe import MethodRecipe

NOBODYS = Package("nobodys_odometry", ("nobodys-odometry", "nobodys"))


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two peers of a package that is not installed."""
    peer = Peer(NOBODYS, PEERS["orb"].make)
    for name in ("open3d-icp", "open3d-hybrid"):
        monkeypatch.setitem(catalogue.PEERS, name, peer)


def test_ours_come_first_and_then_the_peers() -> None:
    assert (*METHODS, *PEERS) == NAMES
    assert find_left_out(["surf", "cv2-rgb", "orb"]) == []
    odometry = OdometrySettings(feature_count=500)
    recipes = recipes_of(["orb", "icp"], [], odometry)
    assert list(recipes) == ["orb", "icp"]
    assert recipes["orb"] == PeerRecipe("orb", FeatureSettings(500))
    assert recipes["icp"] == MethodRecipe(OdometrySettings("icp", feature_count=500))


@pytest.mark.usefixtures("absent")
def test_those_of_a_missing_package_are_left_out_with_one_note() -> None:
    names = ["surf", "open3d-icp", "sift", "open3d-hybrid"]
    (left_out,) = find_left_out(names)
    assert str(left_out) == (
        "left out: open3d-icp, open3d-hybrid; to have it too: pip install nobodys-odometry"
    )
    assert list(recipes_of(names, [left_out], OdometrySettings())) == ["surf", "sift"]


@pytest.mark.usefixtures("absent")
def test_when_nobody_can_take_part_it_says_what_to_install() -> None:
    left_out = find_left_out(["open3d-icp"])
    with pytest.raises(InputError, match="pip install nobodys-odometry"):
        recipes_of(["open3d-icp"], left_out, OdometrySettings())


def test_a_package_knows_its_version_where_there_is_one() -> None:
    assert catalogue.OPENCV.version.startswith("5")
    assert NOBODYS.version == ""
