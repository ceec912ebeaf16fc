import numpy as np
import pytest

from drivers.core.geometry import Array
from tests.vo_service.slam.place_recognition.corner_keyframes import make_pose
from vo_service.slam.loop_closure.keyframe_culling import find_most_redundant


def along(*positions_m: float) -> Array:
    return np.array([make_pose((path_m, 0.0, 0.0)) for path_m in positions_m])


def redundant(poses: Array) -> int:
    """Of places that are all connected."""
    return find_most_redundant(poses, np.zeros(len(poses), np.int64))


def test_the_keyframe_nearest_to_others_is_culled() -> None:
    assert redundant(along(0.0, 1.0, 2.0, 2.1, 2.3, 5.0)) == 3


def test_a_rotation_counts_like_a_distance() -> None:
    turned = [make_pose((0.0, 0.0, 0.0), (0.0, degrees, 0.0)) for degrees in (0, 60, 65, 120)]
    assert redundant(np.array(turned)) == 2


def test_the_first_and_the_newest_keyframe_are_never_culled() -> None:
    assert redundant(along(0.0, 0.1, 3.0, 6.0, 6.1)) in (1, 3)
    assert redundant(along(0.0, 5.0, 0.0)) == 1
    with pytest.raises(ValueError, match="never culled"):
        redundant(along(0.0, 0.0))


def test_unconnected_keyframes_are_not_near() -> None:
    poses = along(0.0, 1.0, 1.5, 1.01, 1.02, 9.0)
    assert find_most_redundant(poses, np.array([0, 0, 0, 1, 2, 3])) == 1
    assert find_most_redundant(poses, np.array([0, 0, 0, 1, 0, 0])) in (1, 4)
