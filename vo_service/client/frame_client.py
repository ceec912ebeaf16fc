"""Client of the images and points of a running kinect-vo."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import zenoh

from drivers.core.geometry import transform_from_pose
from vo_service.client.connection import FrameUnavailable, check_timeout
from vo_service.client.frame import AssembledFrame, Frame, FrameAssembly, Located, PointCloud
from vo_service.client.pose import PoseReader
from vo_service.client.subscription import ServiceClient
from vo_service.config_tables import DEFAULT_ENDPOINT
from vo_service.outputs.zenoh.session import MAX_FRAME_MESSAGE_BYTES
from vo_service.ros_messages.sensors import (
    decode_camera_info,
    decode_compressed_image,
    decode_image,
    decode_point_cloud,
)
from vo_service.types.messages import FrameAttachment, decode_message, parse_json_message


class FrameClient(ServiceClient):
    """Client of one service's frames, on a session of its own: it never delays a `PoseClient`.

    Images are sent only while a loop over `frames` or `points` runs. A slow reader skips to the
    newest frame.
    """

    max_message_bytes = MAX_FRAME_MESSAGE_BYTES

    def __init__(
        self,
        prefix: str = "kinect",
        connect: str = DEFAULT_ENDPOINT,
        config_file: Path | str | None = None,
    ) -> None:
        """Connect to a service; see `ServiceClient`."""
        super().__init__(prefix, connect, config_file)
        self._assemblies: list[FrameAssembly] = []  # of the loops that run

    def close(self) -> None:
        """Disconnect; `frames` and `points` end. Safe to call twice."""
        self._state.close()
        for assembly in list(self._assemblies):
            assembly.stop()
        self._connection.close()

    def frames(
        self, timeout_s: float | None = None, *, depth: bool = True, compressed: bool = False
    ) -> Iterator[Frame]:
        """Iterate over frames as they arrive, newest first.

        Args:
            timeout_s: Longest wait for the next frame; None waits without limit.
            depth: Whether to ask for depth as well.
            compressed: Whether to ask for JPEG, and PNG for depth: for a narrow link.

        Raises:
            FrameUnavailable: No frame arrived in time.
            InputError: The time is not valid.
            ValueError: A message cannot be read.
        """
        form, decode = (
            ("compressed", decode_compressed_image) if compressed else ("image", decode_image)
        )
        color_topic, depth_topic, info_topic = f"color/{form}", f"depth/{form}", "color/camera_info"
        topics = (info_topic, color_topic, *([depth_topic] if depth else []))
        for located, payloads in self._assembled(topics, timeout_s):
            yield Frame(
                located.pose,
                located.T_base_camera,
                decode_camera_info(payloads[info_topic]).K,
                decode(payloads[color_topic]),
                decode(payloads[depth_topic]) if depth else None,
            )

    def points(self, timeout_s: float | None = None) -> Iterator[PointCloud]:
        """Iterate over colored point clouds as they arrive, newest first.

        Args:
            timeout_s: Longest wait for the next cloud; None waits without limit.

        Raises:
            FrameUnavailable: No cloud arrived in time.
            InputError: The time is not valid.
            ValueError: A message cannot be read.
        """
        for located, payloads in self._assembled(("points",), timeout_s):
            yield PointCloud(
                located.pose, located.T_base_camera, decode_point_cloud(payloads["points"])
            )

    def _assembled(
        self, topics: tuple[str, ...], timeout_s: float | None
    ) -> Iterator[tuple[Located, Mapping[str, bytes]]]:
        check_timeout(timeout_s)
        reader = PoseReader()
        session = self._session(timeout_s)
        assembly = FrameAssembly(session, self._prefix, topics)
        self._assemblies.append(assembly)
        try:
            while frame := assembly.wait_for_newest(timeout_s):
                yield _locate(frame, reader), frame.payloads
        finally:
            self._assemblies.remove(assembly)
            assembly.close()
        if not self._state.is_closed:
            raise FrameUnavailable(self._no_frame_reason(topics, timeout_s))

    def _session(self, timeout_s: float | None) -> zenoh.Session:
        """Return the session; wait for it with the service, as it may open later."""
        if not self._connection.sessions:
            self._state.wait_until_alive(timeout_s)
        for session in self._connection.sessions:
            return session
        raise FrameUnavailable(f"{self._prefix}: no service or router is reachable")

    def _no_frame_reason(self, topics: tuple[str, ...], timeout_s: float | None) -> str:
        where = f"{self._prefix}: no frame within {timeout_s or 0.0:g} s: "
        status = self._state.status.item
        if not self._state.is_alive:
            return where + "no kinect-vo publishes there, or access is denied"
        if status is not None and status["state"] in ("no_camera", "lost"):
            return where + f"{status['state']}: {status['reason']}"
        return where + (
            f"the service is up but sends no {' or '.join(topics)}: frames.enabled is false, this "
            "client may not see images, or the link is too narrow (try compressed=True)"
        )


def _locate(frame: AssembledFrame, reader: PoseReader) -> Located:
    content = parse_json_message(frame.attachment)
    attachment = decode_message(FrameAttachment, content, "a frame")
    T_base_camera = transform_from_pose(
        attachment.camera_position_m, attachment.camera_quaternion_xyzw
    )
    return Located(reader.read(frame.pose), T_base_camera)
