"""The transforms of an update: of the base, and of the map if it is known."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.sample_map import make_map
from vo_service.config_tables import FrameIds
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.messages import pose_transforms
from vo_service.types.odometry_update import OdometryUpdate

FRAMES = FrameIds()


def transforms(update: OdometryUpdate) -> list[tuple[str, str, float]]:
    """Return frames and x of an update's transforms, which must have its stamp."""
    found = pose_transforms(update, FRAMES)
    assert {each.stamp_s for each in found} <= {update.stamp_s}
    return [(each.frame_id, each.child_frame_id, each.position_m[0]) for each in found]


def test_with_a_map_there_are_its_transform_and_that_of_the_base() -> None:
    update = replace(make_update(2), map=make_map(T_map_odom=rigid_transform(np.eye(3), [5, 0, 0])))
    x_m = update.T_odom_base[0, 3]
    assert transforms(update) == [("odom", "base_link", x_m), ("map", "odom", 5.0)]


@pytest.mark.parametrize(
    "snapshot",
    [
        NO_MAP,
        make_map(is_localized=False),
        make_map(epoch=0),
        make_map(T_map_odom=np.full((4, 4), np.nan)),
    ],
    ids=["none", "not located", "of the epoch before", "not finite"],
)
def test_without_a_localized_map_there_is_only_the_base(snapshot: MapSnapshot) -> None:
    update = replace(make_update(2), map=snapshot)
    assert transforms(update) == [("odom", "base_link", update.T_odom_base[0, 3])]


def test_a_lost_pose_has_no_transform() -> None:
    assert transforms(make_update(2, ok=False)) == []
