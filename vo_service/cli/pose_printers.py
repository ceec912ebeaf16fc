"""How ``kinect-vo listen`` shows poses, and changes of the status and of the map."""

import json
import sys
from typing import Any, Protocol

from vo_service.outputs.zenoh.cdr import OdometryMessage, TransformMessage


def print_notice(text: str) -> None:
    """Tell a person something that is not a pose."""
    print(f"listen: {text}", file=sys.stderr, flush=True)


class PosePrinter(Protocol):
    """How a pose and a change of status or map look on stdout."""

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print one pose; `about` is the sample's attachment."""

    def print_status(self, content: dict[str, Any]) -> None:
        """Print a status whose state or reason has changed."""

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print how `odom` lies in the map, which has changed; `about` is the attachment."""


class TextPosePrinter:
    """One line a pose, in a trajectory file's order; changes of status and map go to stderr."""

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
        """Print to stderr what corrects it; a place more is no news."""
        the_map = (bool(attachment["is_localized"]), int(attachment["loop_closures"]))
        if the_map == self._last_map:
            return
        self._last_map = is_localized, loops = the_map
        if not is_localized:
            print_notice(
                f"map: {attachment['map_keyframes']} keyframes; its transform to odom is unknown"
            )
            return
        position = " ".join(f"{v:.4f}" for v in message.translation_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        print_notice(
            f"map: {attachment['map_keyframes']} keyframes, {loops} loop closures; "
            f"odom at {position} {quaternion}"
        )


class JsonPosePrinter:
    """One object a line; `kind` is pose, status or map_odom."""

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print the pose with what the attachment says."""
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
        """Print the transform with what the attachment says."""
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
