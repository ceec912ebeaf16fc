"""Outputs: Zenoh, Rerun, recorder, trajectory file. Each takes poses and status until closed.

Here: the payloads and attachments of poses and of map->odom, which Zenoh and MCAP share.
"""

from dataclasses import dataclass

import numpy as np

from vo_service.ros_messages import (
    OdometryMessage,
    TransformMessage,
    encode_odometry,
    encode_transform,
)
from vo_service.types import NO_MAP, OdometryUpdate, TrackingState
from vo_service.types.messages import MapOdomAttachment, OdomAttachment, encode_message


@dataclass(frozen=True)
class FrameIds:
    """ROS names of the odom frame, the base frame and the map frame."""

    frame_id: str
    child_frame_id: str
    map_frame_id: str


def pose_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the pose as CDR ``nav_msgs/msg/Odometry``.

    Raises:
        ValueError: A number is not finite.
    """
    return encode_odometry(
        OdometryMessage(
            stamp_s=update.stamp_s,
            frame_id=frame_ids.frame_id,
            child_frame_id=frame_ids.child_frame_id,
            T_frame_child=update.T_odom_base,
            pose_covariance=update.pose_covariance,
            twist=update.twist,
            twist_covariance=update.twist_covariance,
        )
    )


def pose_attachment(update: OdometryUpdate) -> bytes:
    """Encode the JSON attachment of a pose: what `Odometry` has no field for."""
    return encode_message(OdomAttachment(update.seq, update.state, update.epoch, update.reason))


def map_odom_transform(update: OdometryUpdate, frame_ids: FrameIds) -> TransformMessage:
    """Make the map->odom transform at the stamp of this pose."""
    T_map_odom = update.map.T_map_odom
    return TransformMessage(update.stamp_s, frame_ids.map_frame_id, frame_ids.frame_id, T_map_odom)


def pose_transforms(update: OdometryUpdate, frame_ids: FrameIds) -> list[TransformMessage]:
    """Make odom->base and, if it is known, map->odom; nothing while lost.

    A transform has no covariance, so an uncertain one must be absent. A bad map does not hold up
    odom->base.
    """
    if update.state is TrackingState.LOST:
        return []
    base = TransformMessage(
        update.stamp_s, frame_ids.frame_id, frame_ids.child_frame_id, update.T_odom_base
    )
    is_map_known = update.map is not NO_MAP and update.is_localized
    if not is_map_known or not np.all(np.isfinite(update.map.T_map_odom)):
        return [base]
    return [base, map_odom_transform(update, frame_ids)]


def map_odom_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the map->odom transform as CDR ``geometry_msgs/msg/TransformStamped``.

    Raises:
        ValueError: A number is not finite.
    """
    return encode_transform(map_odom_transform(update, frame_ids))


def map_odom_attachment(update: OdometryUpdate) -> bytes:
    """Encode the JSON attachment of the map->odom transform."""
    return encode_message(
        MapOdomAttachment(
            update.seq,
            update.epoch,
            update.is_localized,
            update.map.keyframes,
            update.map.loop_closures,
        )
    )
