"""Encoding of Zenoh messages. A change that breaks readers raises the schema number."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from vo_service.control import CommandResult
from vo_service.outputs.zenoh.cdr import (
    OdometryMessage,
    TransformMessage,
    encode_odometry,
    encode_transform,
)
from vo_service.types import CommandError, OdometryUpdate, Status

MESSAGE_SCHEMA = 1


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
    content = {
        "schema": MESSAGE_SCHEMA,
        "seq": update.seq,
        "state": update.state,
        "epoch": update.epoch,
        "reason": update.reason,
    }
    return json.dumps(content).encode()


def map_odom_transform(update: OdometryUpdate, frame_ids: FrameIds) -> TransformMessage:
    """Make the map->odom transform at the stamp of this pose."""
    T_map_odom = update.map.T_map_odom
    return TransformMessage(update.stamp_s, frame_ids.map_frame_id, frame_ids.frame_id, T_map_odom)


def map_odom_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the map->odom transform as CDR ``geometry_msgs/msg/TransformStamped``.

    Raises:
        ValueError: A number is not finite.
    """
    return encode_transform(map_odom_transform(update, frame_ids))


def map_odom_attachment(update: OdometryUpdate) -> bytes:
    """Encode the JSON attachment of the map->odom transform."""
    content = {
        "schema": MESSAGE_SCHEMA,
        "seq": update.seq,
        "epoch": update.epoch,
        "is_localized": update.is_localized,
        "map_keyframes": update.map.keyframes,
        "loop_closures": update.map.loop_closures,
    }
    return json.dumps(content).encode()


def status_payload(status: Status, versions: Mapping[str, str]) -> bytes:
    """Encode the status as JSON.

    Raises:
        ValueError: If a number is not finite.
    """
    content = {"schema": MESSAGE_SCHEMA, **asdict(status), "versions": dict(versions)}
    return json.dumps(content, allow_nan=False).encode()


def result_payload(result: CommandResult) -> bytes:
    """Encode a command's result as JSON.

    Raises:
        ValueError: If a number is not finite.
    """
    return json.dumps({"schema": MESSAGE_SCHEMA, **result}, allow_nan=False).encode()


def error_payload(error: CommandError) -> bytes:
    """Encode an error reply as JSON."""
    content = {"schema": MESSAGE_SCHEMA, "error": error.code, "message": str(error)}
    return json.dumps(content).encode()
