"""How ``kinect-vo listen`` shows poses and changes of status."""

import json
import sys
from typing import Any, Protocol

from vo_service.outputs.cdr import OdometryMessage


def say(text: str) -> None:
    """Tell a person something that is not a pose."""
    print(f"listen: {text}", file=sys.stderr, flush=True)


class Printer(Protocol):
    """How a pose and a change of status look on stdout."""

    def pose(self, message: OdometryMessage, about: dict[str, Any]) -> None:
        """Print one pose; `about` is the sample's attachment."""

    def status(self, content: dict[str, Any]) -> None:
        """Print a status whose state or reason has changed."""


class TextPrinter:
    """One line a pose, in a trajectory file's order; status changes go to stderr."""

    def pose(self, message: OdometryMessage, about: dict[str, Any]) -> None:
        """Print stamp, position, quaternion, state."""
        position = " ".join(f"{v:.4f}" for v in message.position_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        state = about.get("state", "-")
        print(f"{message.stamp_s:.6f} {position} {quaternion} {state}", flush=True)

    def status(self, content: dict[str, Any]) -> None:
        """Print state and reason to stderr."""
        reason = f": {content['reason']}" if content["reason"] else ""
        say(f"status {content['state']}{reason}")


class JsonPrinter:
    """One object a line; `kind` is pose or status."""

    def pose(self, message: OdometryMessage, about: dict[str, Any]) -> None:
        """Print the pose with what the attachment says."""
        self._print(
            kind="pose",
            stamp_s=message.stamp_s,
            frame_id=message.frame_id,
            child_frame_id=message.child_frame_id,
            position_m=message.position_m.tolist(),
            quaternion_xyzw=message.quaternion_xyzw.tolist(),
            **{key: about[key] for key in ("seq", "state", "epoch", "reason") if key in about},
        )

    def status(self, content: dict[str, Any]) -> None:
        """Print the whole status."""
        self._print(kind="status", **content)

    def _print(self, **content: Any) -> None:
        print(json.dumps(content), flush=True)
