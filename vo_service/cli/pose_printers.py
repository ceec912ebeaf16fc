"""Printers of ``kinect-vo listen``: poses, and changes of the status and of the map."""

import json
import sys
from typing import Any, Protocol

from vo_service.outputs.zenoh.cdr import OdometryMessage, TransformMessage


def print_notice(text: str) -> None:
    """Print a notice to stderr; poses go to stdout."""
    print(f"listen: {text}", file=sys.stderr, flush=True)


class PosePrinter(Protocol):
    """Prints poses and changes of the status and of the map."""

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print one pose, with fields of the sample's attachment."""

    def print_status(self, content: dict[str, Any]) -> None:
        """Print a status whose state or reason has changed."""

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print a changed map->odom transform, with fields of the sample's attachment."""


class TextPosePrinter:
    """Prints poses as lines of a trajectory file; changes of status and map go to stderr."""

    def __init__(self) -> None:
        self._last_map: tuple[bool, int] = (True, 0)

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print stamp, position, quaternion, state."""
        position = " ".join(f"{v:.4f}" for v in message.position_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        state = attachment.get("state", "-")
        print(f"{message.stamp_s:.6f} {position} {quaternion} {state}", flush=True)

    def print_status(self, content: dict[str, Any]) -> None:
        """Print state and reason to stderr."""
        reason = f": {content['reason']}" if content["reason"] else ""
        print_notice(f"status {content['state']}{reason}")

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print to stderr after a loop closure or a change of localization, not per keyframe."""
        the_map = (bool(attachment["is_localized"]), int(attachment["loop_closures"]))
        if the_map == self._last_map:
            return
        self._last_map = is_localized, loop_closures = the_map
        if not is_localized:
            print_notice(
                f"map: {attachment['map_keyframes']} keyframes; its transform to odom is unknown"
            )
            return
        position = " ".join(f"{v:.4f}" for v in message.translation_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        print_notice(
            f"map: {attachment['map_keyframes']} keyframes, {loop_closures} loop closures; "
            f"odom at {position} {quaternion}"
        )


class JsonPosePrinter:
    """Prints one JSON object per line; `kind` is pose, status or map_odom."""

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print the pose with the fields of the attachment."""
        self._print(
            kind="pose",
            stamp_s=message.stamp_s,
            frame_id=message.frame_id,
            child_frame_id=message.child_frame_id,
            position_m=message.position_m.tolist(),
            quaternion_xyzw=message.quaternion_xyzw.tolist(),
            **{
                key: attachment[key]
                for key in ("seq", "state", "epoch", "reason")
                if key in attachment
            },
        )

    def print_status(self, content: dict[str, Any]) -> None:
        """Print the whole status."""
        self._print(kind="status", **content)

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print the transform with the fields of the attachment."""
        self._print(
            kind="map_odom",
            stamp_s=message.stamp_s,
            frame_id=message.frame_id,
            child_frame_id=message.child_frame_id,
            position_m=message.translation_m.tolist(),
            quaternion_xyzw=message.quaternion_xyzw.tolist(),
            **{
                key: attachment[key]
                for key in ("seq", "epoch", "is_localized", "map_keyframes", "loop_closures")
            },
        )

    def _print(self, **content: Any) -> None:
        print(json.dumps(content), flush=True)
