"""The fixed transforms of the camera, which a reader gets whenever it comes."""

from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from drivers.core.geometry import Array, rigid_transform, transform_from_pose
from drivers.ros_messages.navigation import TRANSFORMS_SCHEMA
from tests.vo_service.outputs.frames.frame_robot import T_BASE_CAMERA, running_robot
from tests.vo_service.outputs.zenoh.query_helpers import connected_session, late_sample
from vo_service.config_tables import FrameIds
from vo_service.outputs.frames.camera_transforms import camera_transforms

ROS = get_typestore(Stores.ROS2_JAZZY)


def late_transforms(session: zenoh.Session) -> dict[tuple[str, str], Array]:
    """Frames and transforms that were published before the subscription."""
    payload = late_sample(session, "kinect/tf_static")
    message: Any = ROS.deserialize_cdr(payload, TRANSFORMS_SCHEMA)
    found = {}
    for stamped in message.transforms:
        q, t = stamped.transform.rotation, stamped.transform.translation
        T = transform_from_pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))
        found[stamped.header.frame_id, stamped.child_frame_id] = T
    return found


@pytest.mark.zenoh
def test_a_late_reader_gets_a_tree_from_the_base_to_camera_and_scan(free_port: int) -> None:
    with running_robot(free_port), connected_session(free_port) as session:
        found = late_transforms(session)
    T_base_rgb = T_link = found["base_link", "camera_link"]
    for parent, child in (
        ("camera_link", "camera_rgb_frame"),
        ("camera_rgb_frame", "camera_rgb_optical_frame"),
    ):
        T_base_rgb = T_base_rgb @ found[parent, child]
    np.testing.assert_allclose(T_base_rgb, T_BASE_CAMERA, atol=1e-12)
    np.testing.assert_allclose(T_link, rigid_transform(np.eye(3), (0.1, 0.0, 0.5)), atol=1e-12)
    T_base_scan = rigid_transform(np.eye(3), (0.1, 0.0, 0.2))
    np.testing.assert_allclose(found["base_link", "camera_scan"], T_base_scan, atol=1e-12)


@pytest.mark.zenoh
def test_a_frame_of_another_name_gets_one_transform(free_port: int) -> None:
    with (
        running_robot(free_port, frame_ids=FrameIds(camera_frame_id="front")),
        connected_session(free_port) as session,
    ):
        assert late_transforms(session).keys() == {
            ("base_link", "front"),
            ("base_link", "camera_scan"),
        }


def test_registered_depth_has_the_frame_of_color() -> None:
    found = {
        (each.frame_id, each.child_frame_id): each.T_frame_child
        for each in camera_transforms(0.0, "base_link", "front_rgb_optical_frame", T_BASE_CAMERA)
    }
    for name in ("frame", "optical_frame"):
        parent = "front_link" if name == "frame" else "front_{}_frame"
        depth = found[parent.format("depth"), f"front_depth_{name}"]
        np.testing.assert_array_equal(depth, found[parent.format("rgb"), f"front_rgb_{name}"])
